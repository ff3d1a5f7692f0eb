//! Kullback-Leibler divergence row by row, from terms that cannot be negative: accurate however
//! near to independence, at any total. Not the quick way for a whole small table: that is in
//! `plug_in`.

use super::table::{Occupied, Table};

/// Returns n ln(n / e) + e - n with e = row column / total, in nats: what a cell adds to N times
/// the plug-in mutual information, never negative. The sums are at least 1.
pub(super) fn cell_deviance(n: u64, row: u64, column: u64, total: u64) -> f64 {
    let [n, row, column, wide] = [n, row, column, total].map(u128::from);
    let scaled = if n == 0 {
        (row * column) as f64
    } else {
        deviance(n * wide, row * column)
    };
    scaled / total as f64
}

/// Returns the plug-in Kullback-Leibler divergence of row i, in nats (Kullback & Leibler 1951): how
/// far the column frequencies of the row lie from those of the whole table. Never negative.
///
/// K_i = sum_j (n_ij / r_i) ln(n_ij N / (r_i c_j)), so that
/// [`plug_in`](super::plug_in) = sum_i (r_i / N) K_i. `row` is a position in [`Table::rows`].
///
/// Its bias grows as the row gets rarer, so the largest K_i mostly points at the rarest action: it
/// is a share of the plug-in, not a ranking. The only row of a table, and any row of a single
/// column, has 0. A row without counts has no divergence and is not in the table.
///
/// # Panics
///
/// If the table has no such row.
pub fn divergence(table: &Table, row: usize) -> f64 {
    let scale = table.rows()[row] as f64 * table.total() as f64;
    row_deviance(table, table.row(row)) / scale
}

/// Returns N^2 times the plug-in mutual information, in nats: the rows' deviances, summed in their
/// order.
pub(super) fn table_deviance(table: &Table) -> f64 {
    table
        .cells()
        .chunk_by(|a, b| a.row == b.row)
        .fold(0.0, |sum, row| sum + row_deviance(table, row))
}

/// Returns r_i N K_i as the sum, over every column, of the deviance of n N from r c, given one
/// row's cells (a row in the table has at least one).
///
/// The cells sum to the same with and without the terms r c - n N, which add up to 0 over a row;
/// with them, no term is negative and nothing cancels. An empty cell contributes r c; all of those
/// together are what the occupied ones leave of r N, to the last digit.
fn row_deviance(table: &Table, cells: &[Occupied]) -> f64 {
    let row_sum = u128::from(table.rows()[cells[0].row as usize]);
    let total = u128::from(table.total());
    let mut empty = row_sum * total;
    let mut occupied = 0.0;

    for cell in cells {
        let expected = row_sum * u128::from(table.columns()[cell.column as usize]);
        occupied += deviance(u128::from(cell.n) * total, expected);
        empty -= expected;
    }
    occupied + empty as f64
}

/// Where |a - b| / (a + b) is below this, the series is used; above it, subtraction costs at most a
/// digit.
const SERIES_BELOW: f64 = 0.1;

/// Returns a ln(a / b) + b - a, for a and b of at least 1: never negative, and 0 at a = b.
///
/// Near a = b by the series (a - b) v + 2a (v^3/3 + v^5/5 + ...) in v = (a - b) / (a + b), which
/// keeps every digit where the formula would lose all (Loader 2000, "Fast and accurate computation
/// of binomial probabilities", bd0).
fn deviance(a: u128, b: u128) -> f64 {
    let (observed, expected) = (a as f64, b as f64);
    // Below 2^126, so that neither the signed difference nor the sum overflows.
    let difference = (a as i128 - b as i128) as f64;
    let v = difference / (observed + expected);

    if v.abs() >= SERIES_BELOW {
        return observed * (observed / expected).ln() - difference;
    }

    // At v = 0.1 the first power left out is below the rounding of the sum.
    let square = v * v;
    let tail = [17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0]
        .iter()
        .fold(0.0, |tail, odd| (tail + 1.0 / odd) * square);
    difference * v + 2.0 * observed * v * tail
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::samples::{grid, tables};
    use crate::information::{LARGEST_TOTAL, plug_in};
    use proptest::prelude::*;

    const ROUNDING: f64 = 1e-14;

    #[test]
    fn a_row_that_decides_the_column_has_its_surprise() {
        let table = grid(&[&[0, 90], &[10, 0]]);

        assert!((divergence(&table, 0) - (100_f64 / 90.0).ln()).abs() < ROUNDING);
        assert!((divergence(&table, 1) - 10_f64.ln()).abs() < ROUNDING);
    }

    #[test]
    fn rows_alike_have_exactly_none() {
        for table in [
            grid(&[&[1, 2, 3], &[7, 14, 21]]),
            grid(&[&[3, 1, 4]]),
            grid(&[&[3], &[1], &[4]]),
        ] {
            assert!((0..table.rows().len()).all(|row| divergence(&table, row) == 0.0));
        }
    }

    #[test]
    fn the_rarest_row_of_the_largest_table_stays_finite() {
        let table = Table::from_counts([(0, 0, LARGEST_TOTAL - 1), (1, 1, 1)]);

        assert!((divergence(&table, 1) - (LARGEST_TOTAL as f64).ln()).abs() < ROUNDING);
        assert!(divergence(&table, 0) > 0.0 && divergence(&table, 0) < 2.0 / LARGEST_TOTAL as f64);
    }

    #[test]
    fn the_series_meets_the_formula() {
        let (below, above) = (
            deviance(1_222_222, 1_000_000),
            deviance(1_222_223, 1_000_000),
        );

        // d/da of a ln(a / b) + b - a is ln(a / b).
        assert!((above - below - 1.222_222_5_f64.ln()).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn rows_add_up_to_the_plug_in(table in tables()) {
            let shares = table.rows().iter().enumerate();
            let sum: f64 = shares.map(|(row, &r)| r as f64 / table.total() as f64 * divergence(&table, row)).sum();

            prop_assert!((sum - plug_in(&table)).abs() < ROUNDING);
        }

        #[test]
        fn never_negative(a in 1..=u128::MAX >> 2, b in 1..=u128::MAX >> 2, step in 0..1000_u128) {
            prop_assert!(deviance(a, b) >= 0.0);
            prop_assert!(deviance(a, a + step) >= 0.0 && deviance(a + step, a) >= 0.0);
        }
    }
}
