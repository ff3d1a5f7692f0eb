//! The three ways to a p-value against each other, against hand-made answers and against what
//! chance does.

use super::*;
use crate::information::LARGEST_TOTAL;
use crate::information::samples::{grid, tables};
use g_test::williams;
use permutation::{Cells, Visits};
use proptest::prelude::*;
use rand::RngExt;
use statrs::function::gamma::gamma_ur;

const ROUNDING: f64 = 1e-12;
const B: u64 = 199;

fn p(slices: &[Table]) -> f64 {
    p_value(slices, B, 7).p_value
}

#[test]
fn nothing_to_compare_is_never_significant() {
    let single = [
        Table::default(),
        grid(&[&[7]]),
        grid(&[&[3, 1, 4]]),
        grid(&[&[3], &[1], &[LARGEST_TOTAL - 4]]),
    ];
    for table in &single {
        let one = Significance {
            p_value: 1.0,
            method: Method::Exact,
        };
        assert_eq!(p_value(std::slice::from_ref(table), B, 7), one);
        assert_eq!(smallest_p(std::slice::from_ref(table)), 1.0);
    }
    assert_eq!((p(&single), smallest_p(&single)), (1.0, 1.0));
    assert_eq!((p(&[]), smallest_p(&[])), (1.0, 1.0));
}

#[test]
fn the_lady_tasting_tea() {
    // Fisher 1935: 8 cups, 4 of each kind; of the 70 ways to choose, 1 or 16 are as good, and as
    // many as bad.
    assert!((p(&[grid(&[&[4, 0], &[0, 4]])]) - 2.0 / 70.0).abs() < ROUNDING);
    assert!((p(&[grid(&[&[3, 1], &[1, 3]])]) - 34.0 / 70.0).abs() < ROUNDING);
    assert!((smallest_p(&[grid(&[&[3, 1], &[1, 3]])]) - 2.0 / 70.0).abs() < ROUNDING);
}

#[test]
fn ties_count() {
    // Every table with these margins is a perfect copy: chance always does as well.
    let table = grid(&[&[1, 0, 0], &[0, 1, 0], &[0, 0, 1]]);

    assert!((p(std::slice::from_ref(&table)) - 1.0).abs() < ROUNDING);
    assert_eq!(by_permutation(&[&table], B, 7, &|| true), Some(1.0));
}

#[test]
fn different_tables_with_the_same_information_tie() {
    // 4 ln 4 = 4 (2 ln 2): nothing but rounding tells these two tables apart, whose margins are the
    // same.
    let (one, other) = (
        grid(&[&[4, 0], &[1, 1], &[1, 1]]),
        grid(&[&[2, 2], &[2, 0], &[2, 0]]),
    );

    assert_eq!((one.rows(), one.columns()), (other.rows(), other.columns()));
    assert_eq!(p(&[one]), p(&[other]));
}

#[test]
fn visits_are_exchanged_within_slices_only() {
    let copy = grid(&[&[2, 0], &[0, 2]]);

    assert!((p(std::slice::from_ref(&copy)) - 1.0 / 3.0).abs() < ROUNDING);
    assert!((p(&[copy.clone(), copy]) - 1.0 / 9.0).abs() < ROUNDING);
}

#[test]
fn slices_show_what_the_whole_hides() {
    // The other's action is the exclusive or of the ego's and the third agent's.
    let slices = [grid(&[&[9, 0], &[0, 9]]), grid(&[&[0, 9], &[9, 0]])];

    assert!(p(&slices) < 1e-6);
    assert!(p(&[grid(&[&[9, 9], &[9, 9]])]) == 1.0);
}

#[test]
fn the_g_test_is_scipy_s_but_for_the_correction() {
    let table = grid(&[
        &[10, 3, 1],
        &[19, 3, 3],
        &[0, 0, 1],
        &[2, 1, 0],
        &[16, 1, 0],
    ]);
    let half_g = statistic(&[&table]);

    // scipy 1.17.1, `G_effective_df` of t24_5x3_rect in tests/golden/mi_tables.json.
    assert!((gamma_ur(4.0, half_g) - 0.175_220_818_787_294_74).abs() < ROUNDING);
    // mpmath 1.4.1, 30 digits: 1 + (N sum 1/r - 1)(N sum 1/c - 1) / (6 N 8), and the chi-square of
    // G over that.
    assert!((williams(&table) - 1.612_628_986_878_431_4).abs() < ROUNDING);
    assert!((g_test(&[&table]) - 0.522_906_304_087_715_9).abs() < ROUNDING);
    // Two slices alike have twice the statistic and twice the freedoms.
    assert!(
        (g_test(&[&table, &table]) - gamma_ur(8.0, 2.0 * half_g / williams(&table))).abs()
            < ROUNDING
    );
}

#[test]
fn a_product_of_its_margins_is_what_chance_always_reaches() {
    let product = grid(&[&[100, 200], &[300, 600]]);

    assert_eq!(
        p_value(&[product], B, 7),
        Significance {
            p_value: 1.0,
            method: Method::GTest
        }
    );
}

#[test]
fn methods_follow_the_margins_not_the_counts() {
    let method = |table: Table| p_value(&[table], B, 7).method.as_str();

    assert_eq!(method(grid(&[&[300, 200], &[200, 300]])), "exact");
    assert_eq!(method(grid(&[&[300, 200], &[200, 301]])), "g_test");
    assert_eq!(method(grid(&[&[1_000, 3], &[1_000, 2]])), "permutation");
    assert_eq!(
        method(grid(&[&[9, 9, 9], &[9, 9, 9], &[9, 9, 9]])),
        "permutation"
    );
}

#[test]
fn more_permutations_buy_the_exact_answer() {
    let table = [grid(&[&[7, 2, 3], &[1, 6, 3], &[2, 2, 6]])];
    let (rough, exact) = (p_value(&table, B, 7), p_value(&table, 10_000, 7));

    assert_eq!(
        (rough.method, exact.method),
        (Method::Permutation, Method::Exact)
    );
    let standard_error = (exact.p_value * (1.0 - exact.p_value) / B as f64).sqrt();
    assert!((rough.p_value - exact.p_value).abs() < 4.0 * standard_error + 1.0 / B as f64);
}

#[test]
fn a_seed_gives_an_answer_and_no_permutations_give_none() {
    let table = [grid(&[&[9, 5, 7], &[5, 9, 8], &[6, 6, 9]])];

    assert_eq!(p_value(&table, B, 1), p_value(&table, B, 1));
    assert!((2..9).any(|seed| p_value(&table, B, seed) != p_value(&table, B, 1)));
    assert_eq!(p_value(&table, 0, 1).p_value, 1.0);
}

#[test]
fn both_samplers_draw_what_enumeration_lists() {
    const DRAWS: u32 = 4_000;
    for table in [
        grid(&[&[5, 1, 2], &[0, 4, 2], &[1, 1, 4]]),
        grid(&[&[30, 2], &[1, 3]]),
        grid(&[&[3, 3, 0, 1], &[0, 2, 2, 4]]),
    ] {
        let (bar, exact) = (
            bar(statistic(&[&table])),
            exact(&[&table], statistic(&[&table])),
        );
        for mut sampler in [
            Sampler::Visits(Visits::new(&table)),
            Sampler::Cells(Cells::new(&table)),
        ] {
            let mut random = Pcg64::seed_from_u64(3);
            let reaching = (0..DRAWS)
                .filter(|_| sampler.draw(&mut random) >= bar)
                .count();

            let error = reaching as f64 / f64::from(DRAWS) - exact;
            assert!(
                error.abs() < 4.0 * (exact * (1.0 - exact) / f64::from(DRAWS)).sqrt(),
                "{error} of {exact}"
            );
        }
    }
}

#[test]
fn every_extreme_has_a_p_value() {
    let half = LARGEST_TOTAL / 2;
    let extremes = [
        grid(&[&[half, 0], &[0, half]]),
        grid(&[&[LARGEST_TOTAL - 2, 0], &[1, 1]]),
        grid(&[&[half / 2; 2], &[half / 2; 2]]),
        grid(&[&[half / 3; 3], &[0, half / 3, 1]]),
        Table::from_counts((0..300).map(|i| (i, i, 1))),
        Table::from_counts((0..900).map(|i| (i % 300, i * i % 299, 1))),
    ];
    for table in extremes.each_ref().map(std::slice::from_ref) {
        assert!((0.0..=1.0).contains(&p(table)) && (0.0..=1.0).contains(&smallest_p(table)));
    }
    assert!((0.0..=1.0).contains(&p(&extremes)));
}

/// Of independent actions, at most one table in twenty may be significant at .05. Counting only
/// what is above the observed statistic, not what equals it, passes four in five at three visits.
#[test]
fn chance_is_significant_as_often_as_it_should_be() {
    const TABLES: u32 = 1_500;
    for (visits, letters) in [(3, 6), (5, 6), (8, 6), (12, 6), (32, 6), (20, 9), (40, 25)] {
        let mut random = Pcg64::seed_from_u64(visits);
        let mut table = || {
            let mut visit = || {
                (
                    random.random_range(0..letters),
                    random.random_range(0..letters),
                    1,
                )
            };
            Table::from_counts((0..visits).map(|_| visit()).collect::<Vec<_>>())
        };
        let significant = (0..TABLES)
            .filter(|&seed| p_value(&[table()], B, seed.into()).p_value <= 0.05)
            .count();

        let rate = significant as f64 / f64::from(TABLES);
        assert!(
            rate < 0.05 + 4.0 * (0.05 * 0.95 / f64::from(TABLES)).sqrt(),
            "{visits} visits: {rate}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn all_tables_together_are_certain(table in tables()) {
        prop_assume!(few_tables(&[&table], 3_000) || table.total() == 0);
        let mut whole = 0.0;
        enumerate(&informative(std::slice::from_ref(&table)), |_, probability| whole += probability);

        prop_assert!((whole - 1.0_f64).abs() < ROUNDING);
    }

    #[test]
    fn rows_and_columns_are_alike_and_no_p_is_below_the_smallest(table in tables()) {
        let turned = table.transposed();
        let (one, other) = (p_value(std::slice::from_ref(&table), B, 7), p_value(std::slice::from_ref(&turned), B, 7));
        let smallest = [&table, &turned].map(|table| smallest_p(std::slice::from_ref(table)));

        prop_assert_eq!(one.method, other.method);
        prop_assert!(one.method != Method::Exact || (one.p_value - other.p_value).abs() < ROUNDING);
        prop_assert!(one.p_value > 0.0 && one.p_value <= 1.0);
        prop_assert!(smallest[0] <= one.p_value * (1.0 + 1e-9) && (smallest[0] - smallest[1]).abs() < ROUNDING);
    }

    #[test]
    fn empty_slices_change_nothing(table in tables()) {
        let with_others = [Table::default(), table.clone(), grid(&[&[5, 2]])];
        let alone = [table];

        prop_assert_eq!(p_value(&alone, B, 7), p_value(&with_others, B, 7));
        prop_assert_eq!(smallest_p(&alone), smallest_p(&with_others));
    }
}
