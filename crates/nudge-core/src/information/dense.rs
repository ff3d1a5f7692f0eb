//! Plug-in mutual information of a small grid of counts as it lies in memory, for those who measure
//! very many. Not for alphabets that are known only at run time: those make a [`Table`].

use super::mutual_information::{CANCELS_BELOW, plug_in};
use super::table::Table;
use super::x_ln_x;

/// Returns the plug-in mutual information of a grid of counts, rows first, in nats: what
/// [`plug_in`] gives, to 1e-14, mostly without making a [`Table`]. One is made for more than 1,000
/// visits, and where nearly nothing is left of the entropies.
///
/// The size is part of the type, so that each is compiled to straight code.
pub fn plug_in_dense<const ROWS: usize, const COLUMNS: usize>(
    counts: &[[u32; COLUMNS]; ROWS],
) -> f64 {
    by_entropies(counts).unwrap_or_else(|| plug_in(&table(counts)))
}

/// The form in T(x), where all of its terms are tabulated and it keeps its digits. Cells are summed
/// row by row, so that the rows' sums do not wait for each other.
fn by_entropies<const ROWS: usize, const COLUMNS: usize>(
    counts: &[[u32; COLUMNS]; ROWS],
) -> Option<f64> {
    const LAST: usize = x_ln_x::LARGEST as usize;
    let x_ln_x: &[f64; LAST + 1] = x_ln_x::tabulated()
        .try_into()
        .expect("as many are tabulated");
    // Cut off, so that no access needs a check; with a larger total, nothing comes of it.
    let x_ln_x = |n: u64| x_ln_x[(n as usize).min(LAST)];

    let mut columns = [0; COLUMNS];
    let (mut total, mut of_rows, mut of_cells) = (0, 0.0, 0.0);

    for row in counts {
        let (mut sum, mut cells) = (0, 0.0);
        for (column, &n) in columns.iter_mut().zip(row) {
            let n = u64::from(n);
            *column += n;
            sum += n;
            cells += x_ln_x(n);
        }
        total += sum;
        of_rows += x_ln_x(sum);
        of_cells += cells;
    }

    let of_columns = columns.iter().fold(0.0, |sum, &n| sum + x_ln_x(n));
    let of_all = x_ln_x(total);
    if total > x_ln_x::LARGEST {
        return None;
    }

    // Only a single row or column has as much as all of it together.
    if of_rows == of_all || of_columns == of_all {
        return Some(0.0);
    }

    let information = (of_all - of_rows - of_columns + of_cells) / total as f64;
    (information >= CANCELS_BELOW).then_some(information)
}

fn table<const ROWS: usize, const COLUMNS: usize>(counts: &[[u32; COLUMNS]; ROWS]) -> Table {
    let row = |(row, counts): (u64, &[u32; COLUMNS])| {
        (0..)
            .zip(*counts)
            .map(move |(column, n)| (row, column, n.into()))
    };
    Table::from_counts((0..).zip(counts).flat_map(row))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::samples::counts;
    use proptest::prelude::*;

    const ROUNDING: f64 = 1e-14;

    #[test]
    fn grids_of_any_size_have_their_information() {
        assert_eq!(plug_in_dense(&[[0; 6]; 6]), 0.0);
        assert_eq!(plug_in_dense(&[[5; 6]; 6]), 0.0);
        assert_eq!(plug_in_dense::<1, 0>(&[[]]), 0.0);
        assert!((plug_in_dense(&[[0, 5], [5, 0]]) - 2_f64.ln()).abs() < ROUNDING);
        assert!((plug_in_dense(&[[u32::MAX, 0], [0, u32::MAX]]) - 2_f64.ln()).abs() < ROUNDING);
    }

    proptest! {
        #[test]
        fn agrees_with_the_table(counts in counts(), scale in prop_oneof![Just(1), 1..1_000_u32]) {
            let mut grid = [[0; 7]; 7];
            for (row, column, n) in counts {
                grid[row as usize][column as usize] += n as u32 * scale;
            }

            prop_assert!((plug_in_dense(&grid) - plug_in(&table(&grid))).abs() < ROUNDING);
        }
    }
}
