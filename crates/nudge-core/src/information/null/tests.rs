//! The expected information against two other ways to it: every table there is, and shuffled
//! visits.

use super::*;
use crate::information::plug_in;
use crate::information::samples::{grid, tables};
use proptest::prelude::*;
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;

const ROUNDING: f64 = 1e-13;

#[test]
fn nothing_is_expected_without_two_rows_and_two_columns() {
    for table in [
        Table::default(),
        grid(&[&[7]]),
        grid(&[&[3, 1, 4]]),
        grid(&[&[3], &[1], &[4]]),
        grid(&[&[9_999, 1]]),
    ] {
        assert_eq!(
            expected_if_independent(&table),
            (0.0, ExpectedMethod::Hypergeometric)
        );
    }
}

#[test]
fn visits_that_never_repeat_look_like_certainty() {
    let table = Table::from_counts((0..1_000).map(|i| (i, i, 1)));

    let (expected, _) = expected_if_independent(&table);

    assert!((expected - 1_000_f64.ln()).abs() < ROUNDING);
}

#[test]
fn the_method_changes_where_cells_have_a_hundred_visits_of_more_than_a_thousand() {
    let (exact, method) = expected_if_independent(&grid(&[&[250, 250], &[250, 250]]));
    let (expanded, above) = expected_if_independent(&grid(&[&[250, 250], &[250, 251]]));

    assert_eq!(
        (method.as_str(), above.as_str()),
        ("hypergeometric", "asymptotic")
    );
    assert!((exact / expanded - 1_001.0 / 1_000.0).abs() < 2e-6);
}

#[test]
fn agrees_with_every_table_at_the_same_margins() {
    let margins: [(&[u64], &[u64]); 7] = [
        (&[1, 1], &[1, 1]),
        (&[7, 2], &[4, 5]),
        (&[3, 3, 2], &[4, 4]),
        (&[2, 2, 2], &[3, 2, 1]),
        (&[5, 1, 1, 1], &[4, 2, 2]),
        (&[12, 9], &[20, 1]),
        (&[4, 3, 3], &[4, 3, 3]),
    ];
    for (rows, columns) in margins {
        let mut mean = Mean::default();
        enumerate(rows, &mut columns.to_vec(), &mut Vec::new(), 1.0, &mut mean);

        let (expected, _) = expected_if_independent(&any_table_with(rows, columns));

        let by_enumeration = mean.sum / mean.weights;
        assert!(
            (expected - by_enumeration).abs() < ROUNDING,
            "{rows:?} {columns:?}: {expected} {by_enumeration}"
        );
    }
}

#[test]
fn the_longest_recurrences_keep_their_digits() {
    // mpmath 1.3.0, 50 digits: `expected` in tests/golden/SOURCE.md.
    let references: [(&[u64], &[u64], f64); 4] = [
        (&[500, 500], &[500, 500], 0.000_500_751_336_805_611_5),
        (&[999, 1], &[998, 2], 1.504_092_083_539_219_7e-5),
        (
            &[333, 333, 334],
            &[333, 333, 334],
            0.002_005_360_632_788_619_5,
        ),
        (
            &[400, 300, 200, 50, 50],
            &[700, 200, 90, 10],
            0.006_252_348_932_689_48,
        ),
    ];
    for (rows, columns, reference) in references {
        let (expected, _) = expected_if_independent(&any_table_with(rows, columns));

        assert!(
            (expected - reference).abs() < ROUNDING,
            "{rows:?} {columns:?}: {expected:e}"
        );
    }
}

#[test]
fn agrees_with_shuffled_visits() {
    const SHUFFLES: u32 = 4_000;
    let mut random = StdRng::seed_from_u64(20);
    let rows = labels(&[40, 31, 17, 8, 3, 1]);
    let mut columns = labels(&[55, 25, 10, 5, 4, 1]);
    let shuffled =
        |columns: &[u64]| Table::from_counts(rows.iter().zip(columns).map(|(&i, &j)| (i, j, 1)));
    let (expected, _) = expected_if_independent(&shuffled(&columns));

    let (mut sum, mut squares) = (0.0, 0.0);
    for _ in 0..SHUFFLES {
        columns.shuffle(&mut random);
        let information = plug_in(&shuffled(&columns));
        sum += information;
        squares += information * information;
    }

    let mean = sum / f64::from(SHUFFLES);
    let standard_error =
        ((squares / f64::from(SHUFFLES) - mean * mean) / f64::from(SHUFFLES)).sqrt();
    assert!(
        (mean - expected).abs() < 4.0 * standard_error,
        "{mean} +- {standard_error}, expected {expected}"
    );
}

proptest! {
    #[test]
    fn never_negative_and_symmetric(table in tables()) {
        let (expected, _) = expected_if_independent(&table);

        prop_assert!(expected >= 0.0);
        prop_assert!((expected - expected_if_independent(&table.transposed()).0).abs() < ROUNDING);
    }

    #[test]
    fn two_rows_and_two_columns_always_expect_some(a in 1..500_u64, b in 1..500_u64, cut in any::<u64>()) {
        let first = 1 + cut % (a + b - 1);
        let (expected, _) = expected_if_independent(&any_table_with(&[a, b], &[first, a + b - first]));

        prop_assert!(expected > 0.0 && expected <= 2_f64.ln());
    }
}

#[derive(Default)]
struct Mean {
    sum: f64,
    weights: f64,
}

/// Visits every table at the given margins, each weighted by the number of pairings that make it,
/// which is in proportion to 1 / prod n_ij!.
fn enumerate(
    rows: &[u64],
    columns_left: &mut Vec<u64>,
    cells: &mut Vec<u64>,
    weight: f64,
    mean: &mut Mean,
) {
    let column = cells.len() % columns_left.len();
    let Some(&row_left) = rows.first() else {
        let width = columns_left.len() as u64;
        let table = Table::from_counts(
            cells
                .iter()
                .zip(0..)
                .map(|(&n, at)| (at / width, at % width, n)),
        );
        mean.weights += weight;
        mean.sum += weight * plug_in(&table);
        return;
    };
    let last_column = column + 1 == columns_left.len();
    let last_row = rows.len() == 1;
    for n in 0..=row_left.min(columns_left[column]) {
        if (last_column && n < row_left) || (last_row && n < columns_left[column]) {
            continue;
        }
        let mut rows_left = rows.to_vec();
        rows_left[0] -= n;
        columns_left[column] -= n;
        cells.push(n);
        let factorial: f64 = (1..=n).map(|k| k as f64).product();
        enumerate(
            &rows_left[usize::from(last_column)..],
            columns_left,
            cells,
            weight / factorial,
            mean,
        );
        cells.pop();
        columns_left[column] += n;
    }
}

/// Returns one table with these margins: visits in order of both labels.
fn any_table_with(rows: &[u64], columns: &[u64]) -> Table {
    let (rows, columns) = (labels(rows), labels(columns));
    assert_eq!(
        rows.len(),
        columns.len(),
        "margins of one table have one total"
    );
    Table::from_counts(rows.into_iter().zip(columns).map(|(i, j)| (i, j, 1)))
}

/// Returns each label as often as its sum says.
fn labels(sums: &[u64]) -> Vec<u64> {
    sums.iter()
        .zip(0..)
        .flat_map(|(&sum, label)| std::iter::repeat_n(label, sum as usize))
        .collect()
}
