//! How many letters the two variables of a table have, seen or not.

/// The alphabets of a table: what could have been seen, where the [`Table`](super::Table) holds what was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Alphabet {
    /// Letters of the row variable.
    pub rows: u64,
    /// Letters of the column variable.
    pub columns: u64,
}
