//! A permutation test of a joint network's dependence: its gain in log-likelihood on held-out
//! counts, beside the null distribution where the other's actions are shuffled within each state.
//!
//! The gain of a state is T = sum n_ij s_ij, s_ij = ln p(j | i) - ln p(j). If nothing depends on
//! anything, every order of the other's actions within a state is as likely as every other. Over
//! all orders, with a_i = sum_j c_j s_ij / N, b_j = sum_i r_i s_ij / N and m = sum_i r_i a_i / N, E
//! T = N m and Var T = sum_ij r_i c_j (s_ij - a_i - b_j + m)^2 / (N - 1) (Hoeffding 1951, "A
//! combinatorial central limit theorem"). At a lag it is each stratum of a state whose draws are
//! shuffled.

use super::dataset::cells;
use super::letters::Letters;
use super::member::Joint;
use crate::information::Table;

/// Standard deviations by which a gain must exceed what orders by chance would give. More than
/// usual, since a network is stopped where its gain is largest of many looks: of 30 that were
/// trained on worlds without influence, three were ahead by more than 3.
const AHEAD: f64 = 4.0;

/// The gains of states, beside their null distribution.
#[derive(Debug, Clone, Copy)]
pub struct PermutationTest {
    letters: Letters,
    gain: f64,
    mean: f64,
    variance: f64,
}

impl PermutationTest {
    /// Begins without states.
    pub fn new(letters: Letters) -> Self {
        Self {
            letters,
            gain: 0.0,
            mean: 0.0,
            variance: 0.0,
        }
    }

    /// Adds a state with what a network says of it.
    pub fn add(&mut self, table: &Table, joint: &Joint) {
        self.gain += joint.gain(table);
        for (stratum, table) in self.letters.strata_of(table) {
            let first = (stratum * self.letters.actions.rows) as usize;
            let chance = NullDistribution::of_stratum(&table, joint, first);
            self.mean += chance.mean;
            self.variance += chance.variance;
        }
    }

    /// Returns whether the gains are more than chance, and more than nothing.
    pub fn is_more_than_chance(&self) -> bool {
        self.gain > 0.0 && self.gain - self.mean > AHEAD * self.variance.sqrt()
    }
}

/// Mean and variance of the gain of a stratum over all permutations of the other's actions.
struct NullDistribution {
    mean: f64,
    variance: f64,
}

impl NullDistribution {
    /// Returns that of a table whose first row is this one of what a network says.
    fn of_stratum(table: &Table, joint: &Joint, first: usize) -> Self {
        let total = table.total() as f64;
        if table.is_line() {
            // There is one order only.
            let gain = cells(table).map(|(i, j, n)| n * joint.ln_ratio(first + i, j));
            return Self {
                mean: gain.sum(),
                variance: 0.0,
            };
        }

        let sums = |sums: &[u64]| sums.iter().map(|n| *n as f64 / total).collect::<Vec<f64>>();
        let (rows, columns) = (sums(table.rows()), sums(table.columns()));
        let label = |labels: &[u64], at: usize| labels[at] as usize;

        let s = |i: usize, j: usize| {
            joint.ln_ratio(
                first + label(table.row_labels(), i),
                label(table.column_labels(), j),
            )
        };
        let a: Vec<f64> = (0..rows.len())
            .map(|i| columns.iter().enumerate().map(|(j, c)| c * s(i, j)).sum())
            .collect();
        let b: Vec<f64> = (0..columns.len())
            .map(|j| rows.iter().enumerate().map(|(i, r)| r * s(i, j)).sum())
            .collect();

        let m: f64 = rows.iter().zip(&a).map(|(r, a)| r * a).sum();
        let mut squares = 0.0;
        for (i, r) in rows.iter().enumerate() {
            for (j, c) in columns.iter().enumerate() {
                squares += r * c * (s(i, j) - a[i] - b[j] + m).powi(2);
            }
        }

        Self {
            mean: total * m,
            variance: squares * total * total / (total - 1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::array;

    use super::*;
    use crate::information::Alphabet;

    const COIN: Letters = Letters {
        actions: Alphabet {
            rows: 2,
            columns: 2,
        },
        strata: 1,
    };

    fn copies() -> Joint {
        Joint::from_policy(vec![0.5, 0.5], array![[0.9, 0.1], [0.2, 0.8]])
    }

    #[test]
    fn chance_is_the_mean_over_all_orders() {
        // Three draws of (0, 0, 1) and (0, 1, 1): three orders, of which the gains can be written
        // down.
        let table = Table::from_counts([(0, 0, 1), (0, 1, 1), (1, 1, 1)]);
        let joint = copies();
        let gain = |cells: [(usize, usize); 3]| {
            cells
                .iter()
                .map(|(i, j)| joint.ln_ratio(*i, *j))
                .sum::<f64>()
        };
        let orders = [
            gain([(0, 0), (0, 1), (1, 1)]),
            gain([(0, 1), (0, 0), (1, 1)]),
            gain([(0, 1), (0, 1), (1, 0)]),
        ];
        let mean = orders.iter().sum::<f64>() / 3.0;
        let variance = orders.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / 3.0;
        let chance = NullDistribution::of_stratum(&table, &joint, 0);
        assert!((chance.mean - mean).abs() < 1e-12 && (chance.variance - variance).abs() < 1e-12);
    }

    #[test]
    fn one_strong_state_suffices_and_many_of_chance_do_not() {
        let found = |table: &Table, states: usize| {
            let mut test = PermutationTest::new(COIN);
            (0..states).for_each(|_| test.add(table, &copies()));
            test.is_more_than_chance()
        };
        let strong = Table::from_counts([(0, 0, 20), (1, 1, 20)]);
        assert!(found(&strong, 1));
        let chance = Table::from_counts([(0, 0, 5), (0, 1, 5), (1, 0, 5), (1, 1, 5)]);
        assert!(!found(&chance, 100));
        assert!(!found(&chance, 0));
    }
}
