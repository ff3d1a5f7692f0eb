//! Exactly-once delivery as a pure rule: idempotent batches by producer and sequence, the merging
//! of a group commit, quotas and receipts.
//!
//! A database carries the rule out and does not know it. It answers the questions of [`Books`]
//! within one transaction, lets [`Ledgers::open`] and [`Ledgers::decide`] work, writes what
//! [`Ledgers::into_accepted`] gives, and commits. `batch` is what is decided, and what is answered;
//! `books` the questions, which are the ports; `account` one producer, `receipts` what is kept of
//! its last batches; `merge` adds equal cells together, which `order` sorts; `book` holds all of that for one
//! environment; `quota` and `decide` are the rule, the table of [`crate::store::Store`].
//!
//! Absent on purpose: SQL, a driver, a runtime, a clock, a log. A test holds this room to it.

mod account;
mod batch;
mod book;
mod books;
mod decide;
mod merge;
mod order;
mod quota;
mod receipts;

#[cfg(test)]
mod tests;

pub(in crate::store) use account::Account;
pub use batch::{Numbered, Outcome, Quotas, Refusal};
pub(in crate::store) use book::{Ledger, Ledgers};
pub(in crate::store) use books::{Books, CellAt, Named, Opened, Opening, RowId, StoredProducer};
pub(in crate::store) use merge::StateName;
pub(in crate::store) use receipts::{Kept, inconsistency, last_dropped};
