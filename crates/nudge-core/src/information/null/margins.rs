//! The margins of a table as counts of counts, on which alone everything expected under
//! independence depends.

use crate::information::counts_of_counts::{CountOfCounts, counts_of_counts};
use crate::information::urn::Urn;
use crate::information::x_ln_x;

/// How many different rows and columns there are, and how often each.
pub(in crate::information) struct Margins {
    pub rows: Vec<CountOfCounts>,
    pub columns: Vec<CountOfCounts>,
    pub total: u64,
    /// Whether large sums are interpolated.
    pub is_coarse: bool,
}

impl Margins {
    /// Groups the occupied rows and columns of a table by their sums.
    ///
    /// Where there are many visits in many different rows and columns, they are interpolated
    /// linearly between sums a fifth apart: what is expected of a cell becomes linear in its
    /// margins the more visits it has, so that little is lost (.2 %: `benches/pooled.rs`).
    pub fn new(rows: &[u64], columns: &[u64]) -> Self {
        let total = rows.iter().sum();
        let [rows, columns] = [rows, columns].map(|sums| counts_of_counts(sums.iter().copied()));
        let is_coarse = total > x_ln_x::LARGEST && rows.len() * columns.len() > MOST_PAIRS;
        let [rows, columns] =
            [rows, columns].map(|sums| if is_coarse { coarse(sums, total) } else { sums });

        Self {
            rows,
            columns,
            total,
            is_coarse,
        }
    }

    /// Returns the urn of the cells in these rows and columns.
    pub fn urn(&self, row: &CountOfCounts, column: &CountOfCounts) -> Urn {
        Urn {
            marked: row.n,
            drawn: column.n,
            total: self.total,
        }
    }
}

/// To so many pairs of different rows and columns, each is reckoned on its own.
const MOST_PAIRS: usize = 1_024;
/// Sums above this share of the total stay as they are: there are few of them.
const LARGE_SHARE: u64 = 8;

/// Returns counts of counts with the same total and number, at few sums. The counts are ascending.
fn coarse(counts: Vec<CountOfCounts>, total: u64) -> Vec<CountOfCounts> {
    let mut knots: Vec<CountOfCounts> = Vec::new();
    let [mut below, mut above] = [0, 1];

    for count in counts {
        if count.n > total / LARGE_SHARE {
            add(&mut knots, count.n, count.times);
            continue;
        }
        while above <= count.n {
            [below, above] = [above, above + (above / 5).max(1)];
        }

        let upwards = (count.n - below) as f64 / (above - below) as f64;
        add(&mut knots, below, count.times * (1.0 - upwards));
        add(&mut knots, above, count.times * upwards);
    }
    knots
}

/// Adds to the knot at a sum, one of the last two or a new one.
fn add(knots: &mut Vec<CountOfCounts>, n: u64, times: f64) {
    if times == 0.0 {
        return;
    }
    match knots.iter_mut().rev().take(2).find(|knot| knot.n == n) {
        Some(knot) => knot.times += times,
        None => knots.push(CountOfCounts { n, times }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn interpolating_keeps_the_number_and_the_total(sums in prop::collection::vec(1..100_000_u64, 1..400)) {
            let total: u64 = sums.iter().sum();
            let knots = coarse(counts_of_counts(sums.iter().copied()), total);

            let times: f64 = knots.iter().map(|knot| knot.times).sum();
            let visits: f64 = knots.iter().map(|knot| knot.times * knot.n as f64).sum();
            prop_assert!((times / sums.len() as f64 - 1.0).abs() < 1e-12);
            prop_assert!((visits / total as f64 - 1.0).abs() < 1e-12);
            prop_assert!(knots.len() <= 80 && knots.iter().all(|knot| knot.n <= total));
        }
    }
}
