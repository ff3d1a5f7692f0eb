//! The pool against brute force, against the table of one stratum, and against shuffled worlds.
//! Figures against references of 50 digits are in `tests/it/golden/pooled.rs`.

use super::*;
use crate::information::null::moments::moments;
use crate::information::samples::{grid, tables};
use crate::information::{Table, excess, expected_if_independent};
use proptest::prelude::*;

const ROUNDING: f64 = 1e-12;
const SEVEN: Alphabet = Alphabet {
    rows: 7,
    columns: 7,
};

fn pool(alphabet: Alphabet, strata: &[Stratum<'_>]) -> Pooled {
    let (mut pool, mut memo) = (Pool::new(alphabet), MomentsMemo::default());
    strata
        .iter()
        .for_each(|stratum| pool.add(*stratum, &mut memo));
    pool.pooled(1)
}

fn alone(table: &Table) -> Stratum<'_> {
    Stratum {
        state: 0,
        segment: 0,
        table,
    }
}

#[test]
fn nothing_is_said_of_nothing() {
    let (empty, line) = (Table::default(), grid(&[&[3, 1, 4]]));

    let nothing = pool(SEVEN, &[alone(&empty)]);
    let uninformative = pool(SEVEN, &[alone(&line), alone(&empty)]);

    assert_eq!((nothing.strata, nothing.visits), (0, 0));
    assert_eq!((uninformative.strata, uninformative.visits), (1, 8));
    for pooled in [nothing, uninformative] {
        assert_eq!(
            [
                pooled.plug_in,
                pooled.excess,
                pooled.z,
                pooled.size,
                pooled.share
            ],
            [0.0; 5]
        );
        assert_eq!((pooled.p_value, pooled.same_pattern), (1.0, None));
        assert_eq!(
            (pooled.size_interval, pooled.size_interval_new_segments),
            (None, None)
        );
    }
}

#[test]
fn margins_without_choice_have_no_tail() {
    let copy = grid(&[&[1, 0, 0], &[0, 1, 0], &[0, 0, 1]]);

    let pooled = pool(SEVEN, &[alone(&copy); 5]);

    assert_eq!((pooled.p_value, pooled.z), (1.0, 0.0));
    assert!(pooled.excess.abs() < ROUNDING && pooled.share < ROUNDING);
}

#[test]
fn the_mantel_haenszel_test_of_two_by_two_tables_is_the_textbook_s() {
    // (sum n - r c / N)^2 / sum r r' c c' / (N^2 (N - 1)), Mantel & Haenszel 1959, by hand:
    // 4 x (5 - 3) and 4 x 36 x 16 / (100 x 9)... of one table of 10 with rows 6, 4, columns 5, 5.
    let table = grid(&[&[5, 1], &[0, 4]]);

    let pattern = pool(SEVEN, &[alone(&table); 4])
        .same_pattern
        .expect("two rows and columns");

    let variance = 6.0 * 4.0 * 5.0 * 5.0 / (100.0 * 9.0);
    assert_eq!(pattern.rank, 1);
    assert!((pattern.statistic - 4.0 * (5.0_f64 - 3.0).powi(2) / variance).abs() < ROUNDING);
}

#[test]
fn opposite_patterns_are_dependence_but_not_one_pattern() {
    let (copy, contrary) = (grid(&[&[8, 1], &[1, 8]]), grid(&[&[1, 8], &[8, 1]]));

    let pooled = pool(SEVEN, &[alone(&copy), alone(&contrary)]);

    assert!(pooled.p_value < 1e-3);
    assert!(pooled.same_pattern.is_some_and(|test| test.p_value > 0.99));
}

#[test]
fn alphabets_beyond_the_bound_have_no_pattern_test() {
    let large = Alphabet {
        rows: 1 << 40,
        columns: 3,
    };

    let pooled = pool(large, &[alone(&grid(&[&[3, 1], &[1, 3]]))]);

    assert_eq!(pooled.same_pattern, None);
}

#[test]
fn clusters_that_differ_widen_the_interval() {
    let (copy, product) = (grid(&[&[9, 1], &[1, 9]]), grid(&[&[5, 5], &[5, 5]]));
    let of_segment = |segment, table| Stratum {
        state: 0,
        segment,
        table,
    };
    let width = |interval: Option<[f64; 2]>| interval.map_or(0.0, |[low, high]| high - low);

    let differing: Vec<_> = (0..6)
        .map(|segment| of_segment(segment, if segment < 3 { &copy } else { &product }))
        .collect();
    let alike: Vec<_> = (0..6).map(|segment| of_segment(segment, &copy)).collect();
    let [differing, alike] = [differing, alike].map(|strata| pool(SEVEN, &strata));

    assert!(width(differing.size_interval_new_segments) > 1.5 * width(differing.size_interval));
    assert!(
        (width(alike.size_interval_new_segments) / width(alike.size_interval) - 1.0).abs()
            < ROUNDING
    );
}

#[test]
fn the_memo_changes_no_bit() {
    let strata = [
        grid(&[&[3, 1], &[2, 4]]),
        grid(&[&[1, 3], &[4, 2]]),
        grid(&[&[60, 9], &[2, 8]]),
    ];
    let (mut memo, mut again) = (MomentsMemo::default(), Vec::new());
    for table in strata.iter().chain(&strata) {
        again.push(memo.moments(table));
        assert_eq!(memo.moments(table), moments(table.rows(), table.columns()));
    }
    assert_eq!(again[..3], again[3..]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn one_stratum_is_its_table(table in tables()) {
        let pooled = pool(SEVEN, &[alone(&table)]);

        prop_assert!((pooled.plug_in - plug_in(&table)).abs() < ROUNDING);
        prop_assert!((pooled.expected_if_independent - expected_if_independent(&table).0).abs() < ROUNDING);
        prop_assert!((pooled.excess - excess(&table)).abs() < ROUNDING);
        prop_assert!((0.0..=1.0).contains(&pooled.p_value));
        prop_assert!((0.0..=1.0).contains(&pooled.share));
    }

    #[test]
    fn rows_and_columns_are_alike(tables in prop::collection::vec(tables(), 1..5)) {
        let turned: Vec<Table> = tables.iter().map(Table::transposed).collect();
        let [one, other] = [&tables, &turned].map(|tables| {
            pool(SEVEN, &tables.iter().map(alone).collect::<Vec<_>>())
        });

        let close = |a: f64, b: f64| (a - b).abs() < 1e-9 * a.abs().max(1.0);
        prop_assert!(close(one.z, other.z) && close(one.size, other.size) && close(one.share, other.share));
        match (one.same_pattern, other.same_pattern) {
            (Some(one), Some(other)) => {
                prop_assert_eq!(one.rank, other.rank);
                prop_assert!(close(one.statistic, other.statistic));
            }
            (one, other) => prop_assert_eq!(one, other),
        }
    }
}

/// Of 2 x 2 tables of so many visits and these sums of the rare row and column, with so many visits in
/// both: Fisher's exact p, summed by hand.
#[test]
fn p_values_of_rare_actions_are_exact_however_many_visits_there_are() {
    for (total, row, column, both, exact) in [
        (10_000, 1, 1, 0, 1.0),
        (300, 3, 3, 1, 0.0298),
        (300, 2, 6, 1, 0.0397),
        (300, 4, 8, 1, 0.103),
        (1_000, 4, 8, 1, 0.0317),
        (1_000, 2, 500, 0, 0.4995),
        (1_000, 1, 1, 1, 0.001),
    ] {
        let table = grid(&[
            &[total - row - column + both, column - both],
            &[row - both, both],
        ]);
        let found = pool(SEVEN, &[alone(&table)]);
        // 600 permutations that reach it leave 4 %; of .001 there are 100.
        let error = if exact < 0.01 { 0.4 } else { 0.15 };
        assert!(
            (found.p_value / exact - 1.0).abs() < error,
            "{total} {row} {column} {both}: {found:?}"
        );
    }
}

#[test]
fn one_stratum_of_rare_actions_hides_nothing() {
    let copied: Vec<(u64, u64, u64)> = (0..12)
        .map(|label| (label, label, 1 + 4_000 / 3_u64.pow(label as u32)))
        .collect();
    let copied = Table::from_counts(copied);
    let found = pool(
        Alphabet {
            rows: 12,
            columns: 12,
        },
        &[alone(&copied)],
    );
    assert!(found.p_value < 1e-6 && found.z > 100.0, "{found:?}");
    assert!(found.excess_deviation < 0.01, "{found:?}");
}

/// The short form of `benches/pooled.rs`: permuted pools, of which the p-values are known.
#[test]
fn p_values_are_as_often_small_as_they_say() {
    const DRAWS: usize = 400;
    let few = grid(&[&[2, 1, 0], &[0, 1, 1], &[1, 0, 1]]);
    let dominated = grid(&[&[70, 2, 1], &[1, 3, 1], &[1, 1, 0]]);
    for (table, strata, method) in [
        (&few, 6, TailMethod::Permutation),
        (&dominated, 12, TailMethod::ShiftedGamma),
    ] {
        let mut random = rand_pcg::Pcg64::new(1, 1);
        let mut small = 0;
        for _ in 0..DRAWS {
            let drawn: Vec<Table> = (0..strata).map(|_| shuffled(table, &mut random)).collect();
            let pooled = pool(SEVEN, &drawn.iter().map(alone).collect::<Vec<_>>());
            assert_eq!(pooled.method, method);
            small += usize::from(pooled.p_value <= 0.1);
        }

        let rate = small as f64 / DRAWS as f64;
        let error = (0.1 * 0.9 / DRAWS as f64).sqrt();
        assert!(
            rate < 0.1 + 4.0 * error && rate > 0.1 - 5.0 * error,
            "{method:?}: {rate}"
        );
    }
}

fn shuffled(table: &Table, random: &mut rand_pcg::Pcg64) -> Table {
    use rand::seq::SliceRandom;
    let visits = || {
        table
            .triples()
            .flat_map(|(i, j, n)| std::iter::repeat_n((i, j), n as usize))
    };
    let mut columns: Vec<u64> = visits().map(|(_, column)| column).collect();
    columns.shuffle(random);
    Table::from_counts(
        visits()
            .zip(columns)
            .map(|((row, _), column)| (row, column, 1)),
    )
}
