//! How a store is opened.

use crate::store::Quotas;

/// How a store is opened.
#[derive(Debug, Clone)]
pub struct Options {
    /// The most that may be held.
    pub quotas: Quotas,
    /// The size of the cache of counts, in cells of 40 bytes; a state weighs six cells more.
    pub cache_cells: usize,
    /// Cells in the journal from which on it is folded into rows: about 4 bytes of memory each.
    pub fold_from: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            quotas: Quotas::default(),
            cache_cells: 400_000,
            fold_from: 4_000_000,
        }
    }
}
