//! Mutual information under another policy (an interventional estimate by reweighing, as in
//! off-policy evaluation): what it would be had the ego other habits, the other's responses being
//! the same. Not a posterior: its figures are the counts' own.

mod random_tables;
#[cfg(test)]
mod tests;

use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::null::moments::{Moments, moments};
use super::table::Table;
use random_tables::RandomTables;

/// Whose habits weigh the ego's actions.
#[derive(Debug, Clone, Copy)]
pub enum Policy<'a> {
    /// Those seen in the table itself: the figure is the plug-in.
    Observed,
    /// Every one of so many actions alike.
    Uniform {
        /// How many actions the ego has, seen here or not.
        actions: u64,
    },
    /// Those seen in another table's rows: the same state in other segments, say.
    Habits(&'a Table),
}

/// The information of one table under a policy.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnderPolicy {
    /// In nats, never negative.
    pub information: f64,
    /// The policy's probability of the actions that were seen here, in \[0, 1\], of which alone
    /// `information` speaks: what the other does after the rest is not known.
    pub covered: f64,
}

/// Returns the mutual information of a table had the ego followed a policy, in nats:
///
/// I = sum_i p_i KL(rho_i || q), rho_ij = n_ij / r_i, q = sum_i p_i rho_i,
///
/// with p the policy's probabilities of the actions that were seen, made to sum to 1. It weighs an
/// action seen once like one seen often where the policy does, and so is more biased upwards than
/// the plug-in: hold it against [`null_under_policy`]. 0 where the policy takes fewer than two of
/// the actions seen.
pub fn under_policy(table: &Table, policy: Policy<'_>) -> UnderPolicy {
    let (weights, covered) = weights(table, policy);
    let cells = table
        .cells()
        .iter()
        .map(|cell| (cell.row as usize, cell.column as usize, cell.n));
    let information = information(table, &weights, cells);

    UnderPolicy {
        information,
        covered,
    }
}

/// How many permutations the moments under a policy come from.
const PERMUTATIONS: u32 = 256;

/// Returns the mean and variance of N times [`under_policy`]'s information over permutations of the
/// visits, in nats: exact for the observed policy, else from 256 of them by `seed`.
pub fn null_under_policy(table: &Table, policy: Policy<'_>, seed: u64) -> Moments {
    if table.is_line() {
        return Moments::default();
    }
    if matches!(policy, Policy::Observed) {
        return moments(table.rows(), table.columns());
    }

    let (weights, _) = weights(table, policy);
    let mut random = Pcg64::seed_from_u64(seed);
    let mut tables = RandomTables::new(table);
    let total = table.total() as f64;
    let draws = (0..PERMUTATIONS)
        .map(|_| total * information(table, &weights, tables.draw(&mut random)))
        .collect::<Vec<f64>>();
    Moments::of_sample(&draws)
}

/// What many strata together say under a policy, as [`Pool`](super::pooled::Pool) says it under the
/// habits observed: sums of N times the information, and of its moments under independence.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PolicyPool {
    visits: u64,
    statistic: f64,
    null: Moments,
    covered: f64,
}

impl PolicyPool {
    /// Adds a stratum. The `seed` is for the permutations of [`null_under_policy`], and should
    /// differ from stratum to stratum.
    pub fn add(&mut self, table: &Table, policy: Policy<'_>, seed: u64) {
        let visits = table.total() as f64;
        let under = under_policy(table, policy);

        self.visits += table.total();
        self.statistic += visits * under.information;
        self.covered += visits * under.covered;
        self.null.add(null_under_policy(table, policy, seed));
    }

    /// Returns the information of the strata in nats, weighed by their visits, never negative.
    pub fn information(&self) -> f64 {
        self.per_visit(self.statistic)
    }

    /// Returns its mean were actions independent within each stratum, in nats.
    pub fn expected_if_independent(&self) -> f64 {
        self.per_visit(self.null.mean)
    }

    /// Returns by how much the information exceeds that mean, in nats; may be negative.
    pub fn excess(&self) -> f64 {
        self.per_visit(self.statistic - self.null.mean)
    }

    /// Returns the same in standard deviations under independence; 0 without any.
    pub fn z(&self) -> f64 {
        let deviation = self.null.variance.sqrt();
        if deviation > 0.0 {
            (self.statistic - self.null.mean) / deviation
        } else {
            0.0
        }
    }

    /// Returns the policy's probability of the actions seen, the mean over visits, in \[0, 1\].
    pub fn covered(&self) -> f64 {
        self.per_visit(self.covered)
    }

    fn per_visit(&self, sum: f64) -> f64 {
        if self.visits > 0 {
            sum / self.visits as f64
        } else {
            0.0
        }
    }
}

/// Returns the probability of each row of the table, and what they sum to before they are made to
/// sum to 1.
fn weights(table: &Table, policy: Policy<'_>) -> (Vec<f64>, f64) {
    let labels = table.row_labels().iter();
    let mut weights: Vec<f64> = match policy {
        Policy::Observed => labels
            .zip(table.rows())
            .map(|(_, &r)| r as f64 / table.total() as f64)
            .collect(),
        Policy::Uniform { actions } => labels.map(|_| 1.0 / actions as f64).collect(),
        Policy::Habits(other) => {
            let total = other.total().max(1) as f64;
            labels
                .map(|&label| other.row_sum(label) as f64 / total)
                .collect()
        }
    };

    let covered: f64 = weights.iter().sum();
    if covered > 0.0 {
        weights.iter_mut().for_each(|weight| *weight /= covered);
    }
    (weights, covered.min(1.0))
}

/// Returns sum_ij p_i rho_ij ln(rho_ij / q_j) of cells with these margins, at least 0.
fn information(
    table: &Table,
    weights: &[f64],
    cells: impl Iterator<Item = (usize, usize, u64)> + Clone,
) -> f64 {
    let rho = |row: usize, n: u64| n as f64 / table.rows()[row] as f64;
    let mut q = vec![0.0; table.columns().len()];
    cells
        .clone()
        .for_each(|(row, column, n)| q[column] += weights[row] * rho(row, n));

    let term = |(row, column, n): (usize, usize, u64)| {
        let joint = weights[row] * rho(row, n);
        if joint > 0.0 {
            joint * f64::ln(rho(row, n) / q[column])
        } else {
            0.0
        }
    };
    cells.map(term).sum::<f64>().max(0.0)
}
