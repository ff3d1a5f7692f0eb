//! Expected mutual information under the null hypothesis: what the plug-in would be on average were
//! the two variables independent, the yardstick beside every answer. Not a test of significance: it
//! knows the mean of the null distribution, not its tail.

mod margins;
pub(super) mod moments;

use super::table::Table;
use margins::Margins;

/// How [`expected_if_independent`] found its figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExpectedMethod {
    /// The exact mean over all tables with these margins.
    Hypergeometric,
    /// That mean, with a series in place of the longest sums, or between margins in place of very
    /// many.
    Asymptotic,
    /// The mean over seeded permutations.
    Permutation,
}

impl ExpectedMethod {
    /// Returns the name the method goes by in answers: `hypergeometric`, `asymptotic` or `permutation`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Hypergeometric => "hypergeometric",
            Self::Asymptotic => "asymptotic",
            Self::Permutation => "permutation",
        }
    }
}

/// Returns the mean of [`plug_in`](super::plug_in) over all ways to pair up the same margins at
/// random, in nats, and how it was found.
///
/// (1 / N) sum_ij E\[n_ij ln(n_ij / e_ij)\], e_ij = r_i c_j / N,
///
/// with each n_ij hypergeometric in (r_i, c_j, N) (Vinh, Epps & Bailey 2010, "Information theoretic
/// measures for clusterings comparison"). Exact to N = 1,000 and wherever fewer than 100 visits are
/// expected in each cell. A cell with more has its Taylor series to the fourth order, which is
/// right to 1e-6 of itself and tends to (1 - r_i / N)(1 - c_j / N) / 2: together the leading term
/// (R - 1)(C - 1) / 2N of the bias (Miller 1955). More than 1,024 pairs of different margins are
/// interpolated, right to .2 %.
///
/// Never negative; exactly 0 at N = 0 and with one row or one column.
pub fn expected_if_independent(table: &Table) -> (f64, ExpectedMethod) {
    if table.is_line() {
        return (0.0, ExpectedMethod::Hypergeometric);
    }

    let margins = Margins::new(table.rows(), table.columns());
    let (sum, is_exact) = sum_of_means(&margins);
    // Dependence by chance is positive, but where it is tiny, rounding may say otherwise.
    let expected = (sum / table.total() as f64).max(0.0);

    let method = if is_exact {
        ExpectedMethod::Hypergeometric
    } else {
        ExpectedMethod::Asymptotic
    };
    (expected, method)
}

/// Returns what all cells add on average to N times the plug-in, and whether that is exact.
fn sum_of_means(margins: &Margins) -> (f64, bool) {
    let (mut sum, mut is_exact) = (0.0, !margins.is_coarse);
    for row in &margins.rows {
        for column in &margins.columns {
            let urn = margins.urn(row, column);
            sum += row.times * column.times * urn.mean_deviance();
            is_exact &= !urn.is_expanded();
        }
    }
    (sum, is_exact)
}

/// Returns the plug-in entropy of a margin in nats, at least 0.
pub(super) fn entropy(sums: &[u64], total: u64) -> f64 {
    let share = |sum: &u64| *sum as f64 / total as f64;
    sums.iter()
        .map(share)
        .map(|p| -p * p.ln())
        .sum::<f64>()
        .max(0.0)
}

#[cfg(test)]
mod tests;
