//! The Chao-Shen estimator: mutual information from entropies corrected by coverage, for what was
//! not seen.

use super::by_entropies;
use crate::information::counts_of_counts::{self, CountOfCounts};
use crate::information::table::Table;

/// Returns the mutual information by Chao & Shen's entropies of rows, columns and cells, in nats
/// (Chao & Shen 2003, "Nonparametric estimation of Shannon's index of diversity when there are
/// unseen species in sample").
///
/// H = -sum C p ln(C p) / (1 - (1 - C p)^N) over what was seen, p = n / N, with the coverage
/// C = 1 - f1 / N that the number f1 of singletons suggests (Good 1953); where all are singletons,
/// f1 = N - 1 is taken, as others do.
///
/// In words: the more often something was seen just once, the more there must be that was not seen
/// at all. Do not believe it below some 50 visits, where a handful of singletons decides.
///
/// May be negative, since the three entropies are corrected apart; 0 at N = 0 and at N = 1. A
/// single row or column has 0, but for rounding.
pub fn chao_shen(table: &Table) -> f64 {
    if table.total() <= 1 {
        return 0.0;
    }
    by_entropies(table, |counts| entropy(counts, table.total()))
}

fn entropy(counts: &[CountOfCounts], total: u64) -> f64 {
    let singletons = counts
        .first()
        .filter(|smallest| smallest.n == 1)
        .map_or(0, |smallest| smallest.times as u64);
    let covered = total - singletons.min(total - 1);
    let seen = covered as f64 / (total as f64 * total as f64);

    -counts_of_counts::sum(counts, |n| {
        let share = n as f64 * seen;
        // The chance that something with this share is seen at all; exactly 1 where the share is.
        let found = if share < 1.0 {
            -(total as f64 * (-share).ln_1p()).exp_m1()
        } else {
            1.0
        };
        share * share.ln() / found
    })
}
