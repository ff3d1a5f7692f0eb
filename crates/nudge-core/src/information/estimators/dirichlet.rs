//! The Dirichlet (Bayesian) estimator: the posterior mean of the mutual information under Perks's
//! prior.

use statrs::function::gamma::digamma;

use super::margins_and_cells;
use crate::information::alphabet::Alphabet;
use crate::information::alphabet_sizes::AlphabetSizes;
use crate::information::counts_of_counts::{CountOfCounts, sum};
use crate::information::table::Table;

/// Returns the exact posterior mean of the mutual information under a Dirichlet prior that adds
/// 1 / RK to every cell of the R x K alphabet, one visit in all, in nats (Hutter & Zaffalon 2005,
/// "Distribution of mutual information from complete and incomplete data"; the prior is Perks's,
/// 1947).
///
/// The mean is (1/n) sum_ij n_ij (psi(n_ij + 1) - psi(n_i. + 1) - psi(n_.j + 1) + psi(n + 1)), with
/// the prior in n_ij.
///
/// In words: the mean over all the policies that could have made these counts. Nearly all of them
/// have some influence, so it stays above 0 where there is none: about (R - 1)(K - 1) / 2N above.
///
/// Never negative. At N = 0 it is 0, though the prior mean is not: what was not seen says nothing.
pub fn dirichlet(table: &Table, alphabet: Alphabet) -> f64 {
    if table.total() == 0 {
        return 0.0;
    }
    let sizes = AlphabetSizes::new(table, alphabet);
    let total = table.total() as f64 + 1.0;
    let [rows, columns, cells] = margins_and_cells(table);
    let margins =
        mean_digamma(&rows, sizes.rows, total) + mean_digamma(&columns, sizes.columns, total);
    (digamma(total + 1.0) - margins + mean_digamma(&cells, sizes.cells, total)).max(0.0)
}

/// Returns the sum of x psi(x + 1) / n over all letters, x = count + 1 / letters; the unseen ones
/// together.
fn mean_digamma(counts: &[CountOfCounts], letters: f64, total: f64) -> f64 {
    let of = |x: f64| x / total * digamma(x + 1.0);
    let seen: f64 = counts.iter().map(|count| count.times).sum();
    (letters - seen).max(0.0) * of(1.0 / letters) + sum(counts, |n| of(n as f64 + 1.0 / letters))
}
