//! Pooled evidence: many tables asked about as one, each a stratum within which alone actions are
//! compared (a state, in one segment, given other agents' actions). A stratified analysis of
//! contingency tables: a test of any dependence, the generalised Cochran-Mantel-Haenszel test of
//! one pattern shared by all, and a size with its intervals.
//!
//! Not for a single state, which has its own exact test ([`p_value`](super::p_value)), nor for
//! probabilities of dependence, which need a prior.
//!
//! ```
//! use nudge_core::information::{Alphabet, Table};
//! use nudge_core::information::pooled::{MomentsMemo, Pool, Stratum};
//!
//! // In each of a hundred states the other mostly copies; nowhere are there visits enough to tell.
//! let table = Table::from_counts([(0, 0, 3), (0, 1, 1), (1, 1, 2)]);
//! let alphabet = Alphabet { rows: 2, columns: 2 };
//! let (mut pool, mut memo) = (Pool::new(alphabet), MomentsMemo::default());
//! for state in 0..100 {
//!     pool.add(Stratum { state, segment: state % 4, table: &table }, &mut memo);
//! }
//!
//! let pooled = pool.pooled(1);
//! assert!(pooled.p_value < 1e-6 && pooled.same_pattern.is_some_and(|test| test.p_value < 1e-6));
//! assert!(pooled.size > 0.1 && pooled.excess > 0.0);
//! ```

mod clusters;
mod haldane;
mod memo;
mod responses;
mod same_pattern;
mod size;
mod stratum;
mod tail;
#[cfg(test)]
mod tests;

use super::alphabet::Alphabet;
use super::mutual_information::plug_in;
use super::null::moments::Moments;
use same_pattern::Patterns;
use size::Sizes;
use tail::Kept;

pub use memo::MomentsMemo;
pub use responses::{Response, Responses};
pub use same_pattern::SamePattern;
pub use stratum::Stratum;
pub use tail::{TailMethod, gamma_tail};

/// What all strata together say.
#[derive(Debug, Clone, PartialEq)]
pub struct Pooled {
    /// How many strata have visits.
    pub strata: u64,
    /// In how many states.
    pub states: u64,
    /// In how many segments.
    pub segments: u64,
    /// N, the sum of their visits.
    pub visits: u64,
    /// T / N in nats: the plug-in mutual information of the strata, weighed by their visits, never
    /// negative. T = sum_s N_s I_s.
    pub plug_in: f64,
    /// M / N in nats: its exact mean were actions independent within each stratum, at the margins
    /// of each.
    pub expected_if_independent: f64,
    /// (T - M) / N in nats: may be negative. No measure of strength: it shrinks with the visits of
    /// a stratum, where [`size`](Self::size) does not.
    pub excess: f64,
    /// The standard deviation of `excess` under independence, in nats: sqrt(V) / N, exact.
    pub excess_deviation: f64,
    /// (T - M) / sqrt(V); 0 where V is 0.
    pub z: f64,
    /// How likely independence within the strata is to reach T, whatever the pattern, in \[0, 1\].
    pub p_value: f64,
    /// How that was found.
    pub method: TailMethod,
    /// The test of one pattern shared by all strata; `None` where no stratum can show one or the
    /// alphabets are too large to test ((R - 1)(K - 1) above 1,024).
    pub same_pattern: Option<SamePattern>,
    /// Half of Pearson's phi-squared behind the counts: their mutual information, in nats, where that
    /// is weak; see [`Pool::pooled`]. May be negative; 0 where no stratum has two rows and two columns.
    pub size: f64,
    /// sum_s N_s kappa_s: the visits that `size` stands on, out of `visits`.
    pub effective_visits: f64,
    /// `effective_visits` over `visits`, in \[0, 1\]. Where it is below .5, `size` is a lower bound; above
    /// .8 it is .06 to .3 of itself too large.
    pub share: f64,
    /// Where `size` lies on these segments, were they played again: 95 %, in nats. `None` where
    /// `share` is 0.
    pub size_interval: Option<[f64; 2]>,
    /// Where it lies on new segments like these: 95 %, in nats. `None` too below three segments.
    pub size_interval_new_segments: Option<[f64; 2]>,
}

impl Pooled {
    /// Returns the same with every figure that is in nats put through a function, as for another
    /// unit.
    pub fn in_unit(self, of: impl Fn(f64) -> f64) -> Self {
        Self {
            plug_in: of(self.plug_in),
            expected_if_independent: of(self.expected_if_independent),
            excess: of(self.excess),
            excess_deviation: of(self.excess_deviation),
            size: of(self.size),
            size_interval: self.size_interval.map(|ends| ends.map(&of)),
            size_interval_new_segments: self.size_interval_new_segments.map(|ends| ends.map(&of)),
            ..self
        }
    }
}

/// Strata that are being added up.
///
/// Sums run in the order in which strata are added, so that the same order gives the same bits.
#[derive(Debug, Clone)]
pub struct Pool {
    strata: u64,
    visits: u64,
    statistic: f64,
    null: Moments,
    kept: Kept,
    patterns: Patterns,
    sizes: Sizes,
}

impl Pool {
    /// Returns the pool of no strata, whose tables will have labels of this alphabet.
    pub fn new(alphabet: Alphabet) -> Self {
        Self {
            strata: 0,
            visits: 0,
            statistic: 0.0,
            null: Moments::default(),
            kept: Kept::default(),
            patterns: Patterns::new(alphabet),
            sizes: Sizes::default(),
        }
    }

    /// Adds a stratum; one without visits changes nothing. The strata of a state come one after the
    /// other: what comes later counts as another state's.
    ///
    /// # Panics
    ///
    /// If a label of its table is not in the alphabet.
    pub fn add(&mut self, stratum: Stratum<'_>, memo: &mut MomentsMemo) {
        let table = stratum.table;
        if table.total() == 0 {
            return;
        }
        self.strata += 1;
        self.visits += table.total();
        self.sizes.add(stratum);
        if table.is_line() {
            return;
        }

        self.statistic += table.total() as f64 * plug_in(table);
        let own = memo.moments(table);
        self.null.add(own);
        self.patterns.add(table);
        self.kept.add(table, own, self.null);
    }

    /// Returns what all strata together say. The `seed` is for the permutations of small pools, the
    /// same for the same counts.
    ///
    /// - T = sum_s N_s I_s, M and V its exact mean and variance at the margins of each stratum; the
    ///   p-value is the upper tail Q(M^2 / V, T M / V) of the gamma distribution with these two
    ///   moments; where that is not good, of one with a third moment, or of permutations within
    ///   strata: see [`TailMethod`].
    /// - The size is 1/2 sum (X_s^2 - E_0) / sum N_s kappa_s of Pearson's X^2 and its exact mean
    ///   and variance under independence (Haldane 1940), with kappa_s = min(1, Var_0(X_s^2) / 2
    ///   df_s): near independence each X_s^2 exceeds its mean by 2 N_s I_s kappa_s.
    /// - Intervals: size +- 1.96 times the larger of its standard deviation by strata (under
    ///   independence, with what sampling adds in strata that were seen often) and that clustered by
    ///   state; on new segments +- the largest of these and t(G - 1) times that
    ///   clustered by segment, G = 1 / sum u_g^2 with u_g the shares of the effective visits.
    pub fn pooled(&self, seed: u64) -> Pooled {
        let visits = self.visits as f64;
        let per_visit = |sum: f64| if visits > 0.0 { sum / visits } else { 0.0 };
        let beyond = self.statistic - self.null.mean;
        let deviation = self.null.variance.sqrt();
        let (p_value, method) = self.kept.p_value(self.statistic, self.null, seed);
        let [states, segments] = self.sizes.clusters();

        Pooled {
            strata: self.strata,
            states,
            segments,
            visits: self.visits,
            plug_in: per_visit(self.statistic),
            expected_if_independent: per_visit(self.null.mean),
            excess: per_visit(beyond),
            excess_deviation: per_visit(deviation),
            z: if deviation > 0.0 {
                beyond / deviation
            } else {
                0.0
            },
            p_value,
            method,
            same_pattern: self.patterns.test(),
            size: self.sizes.size(),
            effective_visits: self.sizes.effective_visits(),
            share: per_visit(self.sizes.effective_visits()),
            size_interval: self.sizes.interval(),
            size_interval_new_segments: self.sizes.interval_new_segments(),
        }
    }
}
