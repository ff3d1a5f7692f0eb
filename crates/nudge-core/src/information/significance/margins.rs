//! What margins alone say about the tables that have them: how many there are, and how unlikely one
//! can be.

use statrs::function::gamma::ln_gamma;

use crate::information::table::Table;
use crate::information::x_ln_x;

/// Returns whether there are at most so many combinations of tables with these margins, none of
/// more than 1,000 visits.
///
/// Bounded by the ways to fill each column but the largest on its own, or each row but the largest,
/// whichever are fewer.
pub(super) fn few_tables(slices: &[&Table], at_most: u64) -> bool {
    let at_most = at_most as f64;
    let mut tables = 1.0;
    slices.iter().all(|slice| {
        let small = slice.total() <= x_ln_x::LARGEST;

        let fewest = |enough| {
            ways(slice.rows(), slice.columns(), enough).min(ways(
                slice.columns(),
                slice.rows(),
                enough,
            ))
        };

        tables *= if small {
            fewest(at_most)
        } else {
            f64::INFINITY
        };
        tables <= at_most
    })
}

/// Returns the number of ways to fill each of the lines but the largest on its own from crossing
/// lines with room for their own sums, or some number above `enough` where it is above that.
fn ways(crossing: &[u64], lines: &[u64], enough: f64) -> f64 {
    let mut lines = lines.to_vec();
    lines.sort_unstable();
    lines.pop();

    let mut product = 1.0;
    for line in lines {
        if product > enough {
            break;
        }
        product *= fillings(crossing, line as usize);
    }
    product
}

/// Returns in how many ways a sum splits among places with the given room: the coefficient of x^sum
/// in prod_i (1 + x + ... + x^room_i).
fn fillings(room: &[u64], sum: usize) -> f64 {
    let mut ways = vec![0.0; sum + 1];
    ways[0] = 1.0;

    for &room in room {
        // From the largest sum down: the smaller ones still count the ways without this place.
        for at in (1..=sum).rev() {
            let least = at.saturating_sub(room as usize);
            ways[at] = ways[least..=at].iter().sum();
        }
    }
    ways[sum]
}

/// The relative error of ln n!, and some to spare.
const ROUNDING: f64 = 1e-14;

/// Returns a lower bound of the probability of any table with these margins: prod r_i! prod
/// c_j! / (N! prod n_ij!), with prod n_ij! at most what it is where each row fills the largest
/// columns first, or each column the largest rows.
pub(super) fn least_probability(table: &Table) -> f64 {
    let (rows, columns) = (table.rows(), table.columns());
    let of_sums = |sums: &[u64]| sums.iter().map(|&sum| ln_factorial(sum)).sum::<f64>();
    let of_all = ln_factorial(table.total());
    let of_cells = fullest(rows, columns).min(fullest(columns, rows));
    let least = of_sums(rows) + of_sums(columns) - of_all - of_cells;
    // Of the largest totals rounding leaves nothing: then the bound is 0, which is true of any
    // probability.
    (least - ROUNDING * of_all).exp().min(1.0)
}

/// Returns an upper bound of sum ln n_ij!: convex, so that each line has most where it fills the
/// largest rooms first.
fn fullest(lines: &[u64], rooms: &[u64]) -> f64 {
    let mut rooms = rooms.to_vec();
    rooms.sort_unstable_by(|a, b| b.cmp(a));

    let filled = |mut left: u64| {
        let fill = |&room: &u64| {
            let n = left.min(room);
            left -= n;
            n
        };
        rooms
            .iter()
            .map(fill)
            .take_while(|n| *n > 0)
            .map(ln_factorial)
            .sum::<f64>()
    };

    lines.iter().map(|&line| filled(line)).sum()
}

fn ln_factorial(n: u64) -> f64 {
    ln_gamma(n as f64 + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::samples::{grid, tables};
    use crate::information::significance::enumeration::enumerate;
    use proptest::prelude::*;

    #[test]
    fn counts_the_tables_of_two_rows_exactly() {
        let table = grid(&[&[3, 1], &[2, 2]]);

        assert!(few_tables(&[&table], 4) && !few_tables(&[&table], 3));
        assert!(few_tables(&[&table, &table], 16) && !few_tables(&[&table, &table], 15));
    }

    #[test]
    fn leaves_the_largest_totals_to_others() {
        assert!(!few_tables(&[&grid(&[&[999, 1], &[0, 1]])], u64::MAX));
        assert_eq!(
            least_probability(&grid(&[&[1 << 60, 1], &[0, 1 << 60]])),
            0.0
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn bounds_hold_for_every_table(table in tables()) {
            prop_assume!(table.total() > 0 && few_tables(&[&table], 5_000));
            let (mut tables, mut least) = (0, 1.0_f64);
            enumerate(&[&table], |_, probability| {
                tables += 1;
                least = least.min(probability);
            });

            prop_assert!(few_tables(&[&table], 5_000) && tables <= 5_000);
            prop_assert!(least_probability(&table) <= least * (1.0 + 1e-9));
        }
    }
}
