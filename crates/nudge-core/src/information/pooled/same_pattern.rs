//! The generalised Cochran-Mantel-Haenszel test of R x K tables: is there one pattern that all
//! strata share? Far stronger than the test of any dependence where there is, and blind where each
//! stratum has a pattern of its own.

use statrs::function::gamma::gamma_ur;

use crate::information::alphabet::Alphabet;
use crate::information::table::Table;

/// The test of one pattern shared by all strata.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SamePattern {
    /// Q = d' V^- d.
    pub statistic: f64,
    /// The rank of V: the degrees of freedom.
    pub rank: u64,
    /// The upper tail of the chi-square distribution, in \[0, 1\].
    ///
    /// Where agents hold their actions, draws in different states are not independent, and it is to
    /// be believed only beside the same question of shifted tracks.
    pub p_value: f64,
}

/// With more free cells the covariance is not kept: its 4 MB take a tenth of a second to solve.
const MOST_FREE_CELLS: u64 = 1_024;

/// Sums over strata of d = n_ij - r_i c_j / N and of its covariance under independence at fixed
/// margins, A (x) B / (N^2 (N - 1)) with A = N diag r - r r', B = N diag c - c c' (Landis, Heyman &
/// Koch 1978, "Average partial association in three-way contingency tables").
#[derive(Debug, Clone)]
pub(super) struct Patterns {
    rows: usize,
    columns: usize,
    /// d, row by row; empty until there is a stratum, or where alphabets are too large.
    differences: Vec<f64>,
    /// The covariance of (i, j) and (k, l), for i >= k and j >= l: both factors are symmetric.
    covariance: Vec<f64>,
}

impl Patterns {
    pub fn new(alphabet: Alphabet) -> Self {
        let [rows, columns] = [alphabet.rows, alphabet.columns];
        let free = u128::from(rows.saturating_sub(1)) * u128::from(columns.saturating_sub(1));
        let fits = free > 0 && free <= u128::from(MOST_FREE_CELLS);
        let [rows, columns] = if fits { [rows, columns] } else { [0, 0] };

        Self {
            rows: rows as usize,
            columns: columns as usize,
            differences: Vec::new(),
            covariance: Vec::new(),
        }
    }

    /// Adds a stratum of two rows and two columns at least.
    pub fn add(&mut self, table: &Table) {
        if self.rows == 0 {
            return;
        }
        self.make_room();
        self.add_differences(table);
        self.add_covariance(table);
    }

    fn make_room(&mut self) {
        if self.differences.is_empty() {
            self.differences = vec![0.0; self.rows * self.columns];
            self.covariance = vec![0.0; pairs(self.rows) * pairs(self.columns)];
        }
    }

    fn add_differences(&mut self, table: &Table) {
        for (row, column, n) in table.triples() {
            self.differences[row as usize * self.columns + column as usize] += n as f64;
        }
        for (&row, &r) in table.row_labels().iter().zip(table.rows()) {
            let share = r as f64 / table.total() as f64;
            for (&column, &c) in table.column_labels().iter().zip(table.columns()) {
                self.differences[row as usize * self.columns + column as usize] -= share * c as f64;
            }
        }
    }

    fn add_covariance(&mut self, table: &Table) {
        let n = table.total() as f64;
        let of_columns = covariances(table.column_labels(), table.columns(), n);
        let width = pairs(self.columns);

        for (pair, of_rows) in covariances(table.row_labels(), table.rows(), n) {
            let scaled = of_rows / (n - 1.0);
            let line = &mut self.covariance[pair * width..(pair + 1) * width];
            for &(at, value) in &of_columns {
                line[at] += scaled * value;
            }
        }
    }

    /// Returns the test; `None` without a stratum that could show a pattern.
    pub fn test(&self) -> Option<SamePattern> {
        let [rows, columns] = self.occupied()?;
        let cells = || {
            rows.iter()
                .flat_map(|&i| columns.iter().map(move |&j| (i, j)))
        };

        let width = pairs(self.columns);
        let covariance = |(i, j), (k, l)| self.covariance[pair(i, k) * width + pair(j, l)];
        let lower = cells()
            .enumerate()
            .map(|(at, one)| {
                cells()
                    .take(at + 1)
                    .map(|other| covariance(one, other))
                    .collect()
            })
            .collect();
        let differences = cells()
            .map(|(i, j)| self.differences[i * self.columns + j])
            .collect();

        let (statistic, rank) = quadratic_form(lower, differences);
        (rank > 0).then(|| SamePattern {
            statistic,
            rank,
            p_value: upper_tail(statistic, rank),
        })
    }

    /// Returns the rows and columns that vary in any stratum, without the last of each, which the
    /// others decide.
    fn occupied(&self) -> Option<[Vec<usize>; 2]> {
        if self.differences.is_empty() {
            return None;
        }
        let width = pairs(self.columns);
        let varies = |i: usize, j: usize| self.covariance[pair(i, i) * width + pair(j, j)] > 0.0;
        let mut rows: Vec<usize> = (0..self.rows)
            .filter(|&i| (0..self.columns).any(|j| varies(i, j)))
            .collect();
        let mut columns: Vec<usize> = (0..self.columns)
            .filter(|&j| (0..self.rows).any(|i| varies(i, j)))
            .collect();

        rows.pop();
        columns.pop();
        Some([rows, columns])
    }
}

fn upper_tail(statistic: f64, rank: u64) -> f64 {
    if statistic > 0.0 {
        gamma_ur(rank as f64 / 2.0, statistic / 2.0).clamp(0.0, 1.0)
    } else {
        1.0
    }
}

/// Returns how many unordered pairs of so many things there are, a thing with itself among them.
fn pairs(things: usize) -> usize {
    things * (things + 1) / 2
}

/// Returns the place of an unordered pair.
fn pair(one: usize, other: usize) -> usize {
    let (small, large) = (one.min(other), one.max(other));
    pairs(large) + small
}

/// Returns the entries of diag s - s s' / N of the lines of a table, by the places of their labels.
fn covariances(labels: &[u64], sums: &[u64], n: f64) -> Vec<(usize, f64)> {
    let mut entries = Vec::with_capacity(pairs(labels.len()));
    for (at, (&label, &sum)) in labels.iter().zip(sums).enumerate() {
        let share = sum as f64 / n;
        for (&other, &other_sum) in labels[..at].iter().zip(sums) {
            let place = pair(label as usize, other as usize);
            entries.push((place, -share * other_sum as f64));
        }
        let own = pair(label as usize, label as usize);
        entries.push((own, share * (n - sum as f64)));
    }
    entries
}

/// What is left of a variance below this share of itself is rounding.
const DEPENDENT: f64 = 1e-9;

/// Returns d' V^- d and the rank of V, given its lower triangle row by row, by a Cholesky
/// decomposition with diagonal pivoting (Higham 1990) of V bordered by d.
///
/// d lies in the range of V, so that every generalised inverse gives the same.
fn quadratic_form(mut lower: Vec<Vec<f64>>, mut d: Vec<f64>) -> (f64, u64) {
    let variances: Vec<f64> = (0..d.len()).map(|at| lower[at][at]).collect();
    let mut left: Vec<usize> = (0..d.len()).filter(|&at| variances[at] > 0.0).collect();
    let (mut form, mut rank) = (0.0, 0);

    while let Some((place, ratio)) = most_left(&left, &lower, &variances) {
        if ratio < DEPENDENT {
            break;
        }
        let pivot = left.swap_remove(place);
        form += d[pivot] * d[pivot] / lower[pivot][pivot];
        rank += 1;
        eliminate(pivot, &left, &mut lower, &mut d);
    }
    (form, rank)
}

/// Returns the place in `left` of the variable of which most is left, and that share.
fn most_left(left: &[usize], lower: &[Vec<f64>], variances: &[f64]) -> Option<(usize, f64)> {
    left.iter()
        .map(|&at| lower[at][at] / variances[at])
        .enumerate()
        .max_by(|one, other| one.1.total_cmp(&other.1))
}

/// Takes out of all that are left what the pivot explains.
fn eliminate(pivot: usize, left: &[usize], lower: &mut [Vec<f64>], d: &mut [f64]) {
    let with_pivot = |lower: &[Vec<f64>], at: usize| lower[at.max(pivot)][at.min(pivot)];
    let mut column = vec![0.0; d.len()];
    left.iter()
        .for_each(|&at| column[at] = with_pivot(lower, at));
    let variance = lower[pivot][pivot];

    for &at in left {
        let share = column[at] / variance;
        d[at] -= share * d[pivot];
        if share != 0.0 {
            // The columns that are not left have 0 here.
            for (entry, other) in lower[at].iter_mut().zip(&column) {
                *entry -= share * other;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_singular_covariance_has_the_form_of_its_range() {
        // V = diag(1, 2) with the sum of both as a third variable: rank 2, d' V^- d = 4 + 9 / 2.
        let lower = vec![vec![1.0], vec![0.0, 2.0], vec![1.0, 2.0, 3.0]];

        let (form, rank) = quadratic_form(lower, vec![2.0, 3.0, 5.0]);

        assert_eq!(rank, 2);
        assert!((form - 8.5).abs() < 1e-12);
    }

    #[test]
    fn pairs_have_places_of_their_own() {
        let mut places: Vec<usize> = (0..6)
            .flat_map(|one| (0..=one).map(move |other| pair(one, other)))
            .collect();
        places.sort_unstable();

        assert!(places.into_iter().eq(0..pairs(6)));
        assert_eq!(pair(2, 5), pair(5, 2));
    }
}
