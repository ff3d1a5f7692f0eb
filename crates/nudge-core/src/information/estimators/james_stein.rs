//! The James-Stein shrinkage estimator: mutual information of a table shrunk towards the uniform
//! one.

use super::margins_and_cells;
use crate::information::alphabet::Alphabet;
use crate::information::alphabet_sizes::AlphabetSizes;
use crate::information::counts_of_counts::{CountOfCounts, sum};
use crate::information::table::Table;

/// Returns the mutual information of the table shrunk towards uniform by as much as its own noise
/// suggests, in nats (Hausser & Strimmer 2009, "Entropy inference and the James-Stein estimator").
///
/// p*_ij = l / RK + (1 - l) n_ij / N over the whole R x K alphabet, with the shrinkage
///
/// l = (1 - sum (n_ij / N)^2) / ((N - 1) sum (1 / RK - n_ij / N)^2),
///
/// at most 1; then the information of p*.
///
/// In words: the fewer the visits and the flatter the table, the more it is taken for chance. It
/// errs towards no influence, and mistakes habits for noise too, since it shrinks the margins with
/// the cells.
///
/// Never negative; 0 at N = 0 and at N = 1, where l = 1.
pub fn james_stein(table: &Table, alphabet: Alphabet) -> f64 {
    let sizes = AlphabetSizes::new(table, alphabet);
    let [rows, columns, cells] = margins_and_cells(table);
    let kept = 1.0 - shrinkage(&cells, table.total(), sizes.cells);
    if kept <= 0.0 {
        return 0.0;
    }

    let entropy = |counts: &[CountOfCounts], letters: f64| {
        shrunk_entropy(counts, table.total(), letters, kept)
    };
    let margins = entropy(&rows, sizes.rows) + entropy(&columns, sizes.columns);
    (margins - entropy(&cells, sizes.cells)).max(0.0)
}

/// Returns the weight l of the uniform table, from 0 to 1.
fn shrinkage(cells: &[CountOfCounts], total: u64, letters: f64) -> f64 {
    if total <= 1 {
        return 1.0;
    }

    let total = total as f64;
    let uniform = 1.0 / letters;
    let seen: f64 = cells.iter().map(|count| count.times).sum();
    let unseen = (letters - seen).max(0.0) * uniform * uniform;
    let distance = unseen + sum(cells, |n| (uniform - n as f64 / total).powi(2));
    let variance = sum(cells, |n| n as f64 / total * (1.0 - n as f64 / total)) / (total - 1.0);

    if variance < distance {
        variance / distance
    } else {
        1.0
    }
}

/// Returns the entropy of the counts' shares shrunk towards the uniform share of a letter; unseen
/// letters included.
fn shrunk_entropy(counts: &[CountOfCounts], total: u64, letters: f64, kept: f64) -> f64 {
    let uniform = (1.0 - kept) / letters;
    let seen: f64 = counts.iter().map(|count| count.times).sum();
    let unseen = (letters - seen).max(0.0) * p_ln_p(uniform);
    -unseen
        - sum(counts, |n| {
            p_ln_p(uniform + kept * (n as f64 / total as f64))
        })
}

/// Returns p ln p, 0 ln 0 = 0.
fn p_ln_p(share: f64) -> f64 {
    if share > 0.0 { share * share.ln() } else { 0.0 }
}
