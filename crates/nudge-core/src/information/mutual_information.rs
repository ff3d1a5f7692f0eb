//! Mutual information of a table: the plug-in estimator, Miller-Madow's, and the excess over
//! chance. Not for posterior means or significance: these figures are the counts' own, without a
//! prior.

use super::deviance::table_deviance;
use super::null::expected_if_independent;
use super::table::Table;
use super::x_ln_x;

/// Returns the plug-in (maximum-likelihood) estimate of mutual information: that of the observed
/// frequencies, in nats (Shannon 1948).
///
/// I = sum_ij (n_ij / N) ln(n_ij N / (r_i c_j)) = ln N + (T(n_ij) - T(r_i) - T(c_j)) / N, with
/// T(x) = sum x ln x.
///
/// Never negative; 0 at N = 0 and exactly 0 where the table is the product of its margins, as with
/// one row or one column. Biased upwards, by about (R - 1)(C - 1) / 2N: see
/// [`expected_if_independent`].
pub fn plug_in(table: &Table) -> f64 {
    match by_entropies(table) {
        Some(information) if information >= CANCELS_BELOW => information,
        _ => by_deviance(table),
    }
}

/// Returns the Miller-Madow estimate of mutual information: the plug-in with each of its entropies
/// corrected by (m - 1) / 2N, in nats, where m counts what is occupied (Miller 1955, "Note on the
/// bias of information estimates", who credits Madow).
///
/// I - (m_ij - m_r - m_c + 1) / 2N, with m_ij occupied cells, m_r rows and m_c columns. May be
/// negative. 0 at N = 0, and with one row or one column.
pub fn miller_madow(table: &Table) -> f64 {
    if table.total() == 0 {
        return 0.0;
    }

    let [cells, rows, columns] = [
        table.cells().len(),
        table.rows().len(),
        table.columns().len(),
    ]
    .map(|occupied| occupied as f64);
    plug_in(table) - (cells - rows - columns + 1.0) / (2.0 * table.total() as f64)
}

/// Returns the plug-in less its mean under independence at the same margins, in nats: the part of
/// it that chance does not explain (Vinh, Epps & Bailey 2010; the numerator of their adjusted
/// information).
///
/// May be negative. 0 at N = 0, and with one row or one column.
pub fn excess(table: &Table) -> f64 {
    plug_in(table) - expected_if_independent(table).0
}

/// Below this many nats the difference of entropies has lost digits worth having. Its error is some
/// 1e-15.
pub(super) const CANCELS_BELOW: f64 = 1e-3;

/// The form in T(x), where all of its terms are tabulated: the quick way.
fn by_entropies(table: &Table) -> Option<f64> {
    if table.total() == 0 || table.total() > x_ln_x::LARGEST {
        return None;
    }

    let x_ln_x = x_ln_x::tabulated();
    let sum = |counts: &[u64]| counts.iter().fold(0.0, |sum, &n| sum + x_ln_x[n as usize]);
    let cells = table
        .cells()
        .iter()
        .fold(0.0, |sum, cell| sum + x_ln_x[cell.n as usize]);
    let total = x_ln_x[table.total() as usize];
    Some((total - sum(table.rows()) - sum(table.columns()) + cells) / table.total() as f64)
}

/// The form without a negative term: the sure way.
fn by_deviance(table: &Table) -> f64 {
    if table.total() == 0 {
        return 0.0;
    }
    let total = table.total() as f64;
    table_deviance(table) / (total * total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::LARGEST_TOTAL;
    use crate::information::samples::{grid, scaled, tables};
    use proptest::prelude::*;

    const ROUNDING: f64 = 1e-14;

    #[test]
    fn the_empty_table_has_none() {
        let empty = Table::default();

        assert_eq!(
            [plug_in(&empty), miller_madow(&empty), excess(&empty)],
            [0.0; 3]
        );
    }

    #[test]
    fn one_row_or_one_column_has_none() {
        for table in [
            grid(&[&[3, 1, 4, 1, 5]]),
            grid(&[&[3], &[1], &[4]]),
            grid(&[&[7]]),
        ] {
            assert_eq!(
                [plug_in(&table), miller_madow(&table), excess(&table)],
                [0.0; 3]
            );
        }
    }

    #[test]
    fn a_copy_has_the_whole_entropy() {
        assert!((plug_in(&grid(&[&[5, 0], &[0, 5]])) - 2_f64.ln()).abs() < ROUNDING);
        let half = LARGEST_TOTAL / 2;
        assert!((plug_in(&grid(&[&[half, 0], &[0, half]])) - 2_f64.ln()).abs() < ROUNDING);
    }

    #[test]
    fn one_visit_too_many_is_seen_among_the_most_there_can_be() {
        // By hand: margins are equal, so every cell deviates by 1 from e and I = 4
        // (1 / 2e) / 4e = 1 / 2e^2.
        let e = 1 << 60;

        let information = plug_in(&grid(&[&[e + 1, e - 1], &[e - 1, e + 1]]));

        let by_hand = 0.5 * (e as f64).powi(-2);
        assert!((information / by_hand - 1.0).abs() < ROUNDING);
    }

    proptest! {
        #[test]
        fn never_negative_and_at_most_the_smaller_alphabet(table in tables()) {
            let letters = table.rows().len().min(table.columns().len()).max(1);

            prop_assert!((0.0..=(letters as f64).ln() + ROUNDING).contains(&plug_in(&table)));
        }

        #[test]
        fn symmetric(table in tables()) {
            prop_assert!((plug_in(&table) - plug_in(&table.transposed())).abs() < ROUNDING);
            prop_assert!((excess(&table) - excess(&table.transposed())).abs() < ROUNDING);
        }

        #[test]
        fn both_forms_agree(table in tables()) {
            let quick = by_entropies(&table).unwrap_or(0.0);

            prop_assert!((quick - by_deviance(&table)).abs() < ROUNDING);
        }

        #[test]
        fn frequencies_decide_whatever_the_scale(table in tables(), scale in 1..1_u64 << 50) {
            prop_assert!((plug_in(&table) - plug_in(&scaled(&table, scale))).abs() < ROUNDING);
        }

        #[test]
        fn a_product_has_exactly_none(
            (rows, columns) in prop_oneof![(factors(6), factors(6)), (factors(1 << 20), factors(1 << 20))],
        ) {
            let product: Vec<Vec<u64>> = rows.iter().map(|r| columns.iter().map(|c| r * c).collect()).collect();
            let product: Vec<&[u64]> = product.iter().map(Vec::as_slice).collect();

            prop_assert_eq!(plug_in(&grid(&product)), 0.0);
        }
    }

    fn factors(below: u64) -> impl Strategy<Value = Vec<u64>> {
        prop::collection::vec(0..below, 1..7)
    }
}
