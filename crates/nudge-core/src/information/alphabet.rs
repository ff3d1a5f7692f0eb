//! Alphabets: how many values the two variables of a contingency table can take, seen or not.

/// The sizes of the alphabets of a table's row and column variables: R and K in the formulas.
///
/// They come from the environment, not from what was seen, and a [`Table`](super::Table) does not
/// know them. Where a table has more occupied rows or columns than its alphabet is said to have,
/// those occupied are taken instead.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Alphabet {
    /// How many values the row variable (the ego's action) can take.
    pub rows: u64,
    /// How many values the column variable (the other's action) can take.
    pub columns: u64,
}

impl Alphabet {
    /// Returns ln min(R, K) in nats: no mutual information is larger.
    pub fn largest_information(self) -> f64 {
        (self.rows.min(self.columns).max(1) as f64).ln()
    }
}
