//! Conditional mutual information: figures given other agents' actions, one table for each of their
//! values, averaged.

use super::table::Table;

/// Returns the mean of a figure over slices, one table for each value of the other agents' actions,
/// weighted by their shares of the visits: sum_c (n_c / N) f(table_c), N = sum_c n_c.
///
/// With [`plug_in`](super::plug_in) this is the conditional mutual information I(ego; other |
/// others) in nats (Shannon 1948); with [`miller_madow`](super::miller_madow),
/// [`excess`](super::excess) or the mean under independence, their conditional forms. It has the
/// units of `figure`, is summed in the order of the slices, and is 0 where they hold no visits;
/// empty slices are not asked for their figure.
///
/// Conditioning on an action of the same tick can itself open a dependence, where both agents cause
/// it (a collider).
pub fn conditional(slices: &[Table], mut figure: impl FnMut(&Table) -> f64) -> f64 {
    let total: u128 = slices.iter().map(|slice| u128::from(slice.total())).sum();
    let occupied = slices.iter().filter(|slice| slice.total() > 0);
    occupied.fold(0.0, |sum, slice| {
        sum + slice.total() as f64 / total as f64 * figure(slice)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::samples::{grid, tables};
    use crate::information::{excess, expected_if_independent, miller_madow, plug_in};
    use proptest::prelude::*;

    #[test]
    fn nothing_seen_gives_nothing() {
        assert_eq!(conditional(&[], plug_in), 0.0);
        assert_eq!(conditional(&[Table::default()], |_| f64::NAN), 0.0);
    }

    #[test]
    fn weighs_slices_by_their_visits() {
        let copy = grid(&[&[5, 0], &[0, 5]]);
        let coins = grid(&[&[5, 5], &[10, 10]]);

        let information = conditional(&[copy, coins], plug_in);

        assert!((information - 0.25 * 2_f64.ln()).abs() < 1e-15);
    }

    #[test]
    fn sees_what_only_the_third_agent_reveals() {
        // The other's action is the exclusive or of the ego's and the third agent's.
        let slices = [grid(&[&[4, 0], &[0, 4]]), grid(&[&[0, 4], &[4, 0]])];

        assert_eq!(plug_in(&grid(&[&[4, 4], &[4, 4]])), 0.0);
        assert!((conditional(&slices, plug_in) - 2_f64.ln()).abs() < 1e-15);
    }

    proptest! {
        #[test]
        fn one_slice_is_the_table_itself(table in tables()) {
            let expected = |table: &Table| expected_if_independent(table).0;
            for figure in [plug_in, miller_madow, excess, expected] {
                prop_assert_eq!(conditional(std::slice::from_ref(&table), figure), figure(&table));
            }
        }
    }
}
