//! What some states say together: by how much their statistics exceed independence.

use crate::information::mutual_information::plug_in;
use crate::information::pooled::MomentsMemo;
use crate::information::table::Table;

/// A rule whose states have fewer visits in the search half is not looked at.
pub const FEWEST_VISITS: u64 = 100;

/// Variances below this are of states in which nothing could be told.
const NOTHING: f64 = 1e-9;

/// Sums over strata of T - M and V, with T = N times the plug-in mutual information and M and V its
/// mean and variance under independence, and their visits.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sum {
    /// T - M, in nats.
    pub beyond: f64,
    /// V, in nats squared.
    pub variance: f64,
    /// N.
    pub visits: u64,
}

impl Sum {
    /// Returns that of a single stratum.
    pub fn of(table: &Table, memo: &mut MomentsMemo) -> Self {
        let visits = table.total();
        if table.is_line() {
            return Self {
                visits,
                ..Self::default()
            };
        }
        let null = memo.moments(table);
        Self {
            beyond: visits as f64 * plug_in(table) - null.mean,
            variance: null.variance,
            visits,
        }
    }

    /// Adds that of other strata.
    #[inline]
    pub fn add(&mut self, other: &Self) {
        self.beyond += other.beyond;
        self.variance += other.variance;
        self.visits += other.visits;
    }

    /// Returns (T - M) / sqrt(V); 0 where nothing can be told.
    pub fn z(&self) -> f64 {
        if self.is_silent() {
            0.0
        } else {
            self.beyond / self.variance.sqrt()
        }
    }

    /// Returns z of the difference of the rates D / V, whose variances are 1 / V, from those of
    /// other states; 0 where either can tell nothing.
    pub(super) fn above(&self, other: &Self) -> f64 {
        if self.is_silent() || other.is_silent() {
            return 0.0;
        }
        let rate = |sum: &Self| sum.beyond / sum.variance;
        (rate(self) - rate(other)) / (self.variance.recip() + other.variance.recip()).sqrt()
    }

    pub(super) fn is_silent(&self) -> bool {
        self.variance < NOTHING
    }
}
