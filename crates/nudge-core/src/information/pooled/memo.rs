//! A bounded memo of null moments: strata are small, and most have margins that others have too.

use std::collections::HashMap;

use crate::information::null::moments::{Moments, moments};
use crate::information::table::Table;

/// Tables above this total have margins of their own.
const LARGEST_TOTAL: u64 = 64;
/// So many margins are kept, in some 8 MB; those met later are reckoned each time.
const MOST_KEPT: usize = 1 << 16;

/// The exact moments of small tables' statistics under independence, kept by their sorted margins.
///
/// What is kept changes no bit of any answer. One memo serves any number of pools after each other.
#[derive(Debug, Clone, Default)]
pub struct MomentsMemo {
    kept: HashMap<Box<[u8]>, Moments>,
    key: Vec<u8>,
}

impl MomentsMemo {
    /// Returns the mean and the variance of N times the plug-in mutual information of all tables
    /// with these margins, in nats, exact.
    pub fn moments(&mut self, table: &Table) -> Moments {
        let (rows, columns) = (table.rows(), table.columns());
        if table.total() > LARGEST_TOTAL {
            return moments(rows, columns);
        }

        self.spell(rows, columns);
        if let Some(kept) = self.kept.get(self.key.as_slice()) {
            return *kept;
        }
        let found = moments(rows, columns);
        if self.kept.len() < MOST_KEPT {
            self.kept.insert(self.key.as_slice().into(), found);
        }
        found
    }

    /// Makes the key of these margins: sorted rows, 0, sorted columns.
    fn spell(&mut self, rows: &[u64], columns: &[u64]) {
        self.key.clear();
        self.key.extend(rows.iter().map(|&sum| sum as u8));
        self.key.sort_unstable();
        self.key.push(0);
        let columns_from = self.key.len();
        self.key.extend(columns.iter().map(|&sum| sum as u8));
        self.key[columns_from..].sort_unstable();
    }
}
