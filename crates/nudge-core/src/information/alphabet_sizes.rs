//! Alphabet sizes as numbers to calculate with.

use super::alphabet::Alphabet;
use super::table::Table;

/// Sizes of the row alphabet, the column alphabet and their product. The product of two `u64` is
/// below 2^128, which a float holds, so no cell is ever listed.
pub(super) struct AlphabetSizes {
    pub rows: f64,
    pub columns: f64,
    pub cells: f64,
}

impl AlphabetSizes {
    /// Returns the alphabet sizes of a table: never fewer letters than were seen, and at least one.
    pub fn new(table: &Table, alphabet: Alphabet) -> Self {
        let at_least = |size: u64, seen: &[u64]| size.max(seen.len() as u64).max(1) as f64;
        let rows = at_least(alphabet.rows, table.rows());
        let columns = at_least(alphabet.columns, table.columns());
        Self {
            rows,
            columns,
            cells: rows * columns,
        }
    }
}
