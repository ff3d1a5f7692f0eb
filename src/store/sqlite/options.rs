//! How a store is opened.

use std::time::Duration;

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
    /// How soon an environment that seems damaged is looked at again; then after twice as long, and
    /// so on.
    pub look_again_after: Duration,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            quotas: Quotas::default(),
            cache_cells: 400_000,
            fold_from: 4_000_000,
            look_again_after: Duration::from_secs(1),
        }
    }
}
