//! Counts as bytes: delta-encoded cells in order, in rows of sixteen neighbouring states, and in
//! the sorted runs of a journal that is folded into them, as in a log-structured merge tree.
//!
//! `cells` is the coding, of `varint`s; `checked` guards what is kept on disk; a `row` has sixteen
//! states, a `run` the cells of a commit; `merge` adds sorted cells together; `unfolded` is the
//! journal in memory, `fold` adds it to rows, `size` is how much something is.
//!
//! Absent on purpose: SQL, a runtime, a clock. A database keeps rows and journal as it likes.

pub(in crate::store) mod cells;
pub(in crate::store) mod checked;
pub(in crate::store) mod fold;
pub(in crate::store) mod merge;
pub(in crate::store) mod row;
pub(in crate::store) mod run;
pub(in crate::store) mod size;
pub(in crate::store) mod unfolded;
mod varint;
