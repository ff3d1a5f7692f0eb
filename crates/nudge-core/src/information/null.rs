//! Expected mutual information under the null hypothesis: what the plug-in would be on average were
//! the two variables independent, the yardstick beside every answer. Not a test of significance: it
//! knows the mean of the null distribution, not its tail.

use super::counts_of_counts::{self, CountOfCounts, counts_of_counts};
use super::table::Table;
use super::x_ln_x;

/// How [`expected_if_independent`] found its figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExpectedMethod {
    /// The exact mean over all tables with these margins.
    Hypergeometric,
    /// The leading term of the bias for many visits.
    Asymptotic,
}

impl ExpectedMethod {
    /// Returns the name the method goes by in answers: `hypergeometric` or `asymptotic`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Hypergeometric => "hypergeometric",
            Self::Asymptotic => "asymptotic",
        }
    }
}

/// Returns the mean of [`plug_in`](super::plug_in) over all ways to pair up the same margins at
/// random, in nats, and how it was found.
///
/// To N = 1,000 exact:
///
/// ln N + (sum_ij E[n_ij ln n_ij] - sum_i r_i ln r_i - sum_j c_j ln c_j) / N,
///
/// with each n_ij hypergeometric in (r_i, c_j, N) (Vinh, Epps & Bailey 2010, "Information theoretic
/// measures for clusterings comparison"). Above that (R - 1)(C - 1) / 2N on the occupied rows and
/// columns (Miller 1955), which overstates tables with fewer visits than cells; never more than the
/// smaller entropy of the two margins, which bounds any plug-in.
///
/// Never negative; exactly 0 at N = 0 and with one row or one column.
pub fn expected_if_independent(table: &Table) -> (f64, ExpectedMethod) {
    if table.total() > x_ln_x::LARGEST {
        return (asymptotic(table), ExpectedMethod::Asymptotic);
    }
    (hypergeometric(table), ExpectedMethod::Hypergeometric)
}

fn asymptotic(table: &Table) -> f64 {
    let [rows, columns] = [table.rows(), table.columns()].map(|sums| sums.len() as f64);
    let [of_rows, of_columns] =
        [table.rows(), table.columns()].map(|sums| entropy(sums, table.total()));
    ((rows - 1.0) * (columns - 1.0) / (2.0 * table.total() as f64))
        .min(of_rows)
        .min(of_columns)
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

fn hypergeometric(table: &Table) -> f64 {
    if table.is_line() {
        return 0.0;
    }

    let [rows, columns] =
        [table.rows(), table.columns()].map(|sums| counts_of_counts(sums.iter().copied()));
    let mut sum =
        x_ln_x::tabulated()[table.total() as usize] - surprise(&rows) - surprise(&columns);

    for row in &rows {
        for column in &columns {
            sum += row.times * column.times * mean_x_ln_x(row.n, column.n, table.total());
        }
    }

    // Dependence by chance is positive, but where it is tiny, rounding may say otherwise.
    (sum / table.total() as f64).max(0.0)
}

fn surprise(margins: &[CountOfCounts]) -> f64 {
    let x_ln_x = x_ln_x::tabulated();
    counts_of_counts::sum(margins, |n| x_ln_x[n as usize])
}

/// A term this small beside the sum so far ends it: those that follow fall off faster than
/// geometrically, and at most a thousand pairs of margins are large enough to be cut short.
const NEGLIGIBLE: f64 = 1e-19;

/// Returns the mean of x ln x, in nats, where x is the number of marked balls among `drawn` from an
/// urn of `total`, `marked` of them marked.
///
/// The probabilities rise from the smallest x by their ratios,
/// p(x + 1) / p(x) = (r - x)(c - x) / ((x + 1)(N - r - c + x + 1)), and are made to sum to 1 in the
/// end, so no factorial is needed. They stay below C(1000, 500) < 1e300 times the first. While they
/// rise, each is at least a thousandth of the sum before it, so only the upper tail can end it.
fn mean_x_ln_x(marked: u64, drawn: u64, total: u64) -> f64 {
    let smallest = (marked + drawn).saturating_sub(total);
    let largest = marked.min(drawn);
    let values = &x_ln_x::tabulated()[smallest as usize..=largest as usize];

    let mut marked_left = (marked - smallest) as f64;
    let mut draws_left = (drawn - smallest) as f64;
    let mut next = (smallest + 1) as f64;
    let mut unmarked_undrawn = (total + smallest + 1 - marked - drawn) as f64;
    let (mut weight, mut weights, mut sum) = (1.0, 0.0, 0.0);
    for value in values {
        weights += weight;
        sum += weight * value;
        if weight < NEGLIGIBLE * weights {
            break;
        }
        weight *= marked_left * draws_left / (next * unmarked_undrawn);
        marked_left -= 1.0;
        draws_left -= 1.0;
        next += 1.0;
        unmarked_undrawn += 1.0;
    }
    sum / weights
}

#[cfg(test)]
mod tests;
