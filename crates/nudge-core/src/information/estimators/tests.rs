//! What the estimators promise, whatever the table; `tests/it/golden` has their values.

use super::*;
use crate::information::samples::{grid, scaled, tables};
use crate::information::{Alphabet, LARGEST_TOTAL, plug_in};
use proptest::prelude::*;

/// What may be left where entropies of up to 88 nats cancel.
const ROUNDING: f64 = 1e-13;
const SEVEN: Alphabet = Alphabet {
    rows: 7,
    columns: 7,
};
const HUGE: Alphabet = Alphabet {
    rows: u64::MAX,
    columns: u64::MAX,
};

fn never_negative(table: &Table, alphabet: Alphabet) -> [f64; 3] {
    [
        james_stein(table, alphabet),
        dirichlet(table, alphabet),
        uniform_policy(table),
    ]
}

fn maybe_negative(table: &Table, alphabet: Alphabet) -> [f64; 4] {
    [
        chao_shen(table),
        grassberger_2003(table),
        nsb(table, alphabet),
        adjusted(table),
    ]
}

#[test]
fn nothing_seen_gives_nothing() {
    for alphabet in [
        SEVEN,
        HUGE,
        Alphabet {
            rows: 0,
            columns: 1,
        },
    ] {
        assert_eq!(never_negative(&Table::default(), alphabet), [0.0; 3]);
        assert_eq!(maybe_negative(&Table::default(), alphabet), [0.0; 4]);
    }
}

#[test]
fn an_alphabet_of_one_letter_has_no_information() {
    let table = grid(&[&[3, 1, 4, 1, 5]]);
    let alphabet = Alphabet {
        rows: 1,
        columns: 5,
    };

    assert!(
        never_negative(&table, alphabet)
            .iter()
            .all(|information| *information < ROUNDING)
    );
    assert_eq!(
        [chao_shen(&table), nsb(&table, alphabet), adjusted(&table)],
        [0.0; 3]
    );
}

#[test]
fn every_figure_is_finite_at_every_extreme() {
    let half = LARGEST_TOTAL / 2;
    let extremes = [
        grid(&[&[1]]),
        grid(&[&[LARGEST_TOTAL]]),
        grid(&[&[half, 0], &[0, half]]),
        grid(&[&[LARGEST_TOTAL - 1, 0], &[0, 1]]),
        grid(&[&[half / 2; 2], &[half / 2; 2]]),
        grid(&[
            &[1_000_000_000; 3],
            &[1_000_000_000, 999_999_999, 1_000_000_001],
        ]),
        Table::from_counts((0..2_000).map(|i| (i, i, 1))),
        Table::from_counts((0..500).flat_map(|i| [(i, i, 1), (i, i + 1, 1)])),
        Table::from_counts((0..1_500).map(|i| (i % 500, i * i % 499, 1))),
    ];
    for table in extremes {
        for alphabet in [
            SEVEN,
            HUGE,
            Alphabet {
                rows: 1,
                columns: 1,
            },
            Alphabet {
                rows: u64::MAX,
                columns: 1,
            },
        ] {
            let figures = (
                never_negative(&table, alphabet),
                maybe_negative(&table, alphabet),
            );

            assert!(
                figures
                    .0
                    .iter()
                    .all(|figure| figure.is_finite() && *figure >= 0.0),
                "{figures:?} {alphabet:?}"
            );
            assert!(
                figures.1.iter().all(|figure| figure.is_finite()),
                "{figures:?} {alphabet:?}"
            );
        }
    }
}

#[test]
fn visits_without_end_bring_all_of_them_together() {
    let table = scaled(&grid(&[&[5, 1, 0], &[2, 3, 3], &[0, 4, 1]]), 1 << 40);

    let [chao_shen, grassberger, nsb, _] = maybe_negative(&table, SEVEN);
    let [james_stein, dirichlet, _] = never_negative(&table, SEVEN);

    for estimate in [chao_shen, grassberger, nsb, james_stein, dirichlet] {
        assert!((estimate - plug_in(&table)).abs() < 1e-10, "{estimate}");
    }
}

#[test]
fn a_habit_hides_power_but_not_from_the_uniform_policy() {
    // The other copies the ego, which turns left all but three times.
    let table = grid(&[&[997, 0], &[0, 3]]);

    assert!(plug_in(&table) < 0.021);
    assert!((uniform_policy(&table) - 2_f64.ln()).abs() < ROUNDING);
}

#[test]
fn the_uniform_policy_leaves_out_what_was_hardly_tried() {
    assert_eq!(uniform_policy(&grid(&[&[50, 0], &[0, 2]])), 0.0);
    assert_eq!(uniform_policy(&grid(&[&[2, 0], &[0, 2]])), 0.0);
}

#[test]
fn the_adjusted_information_tells_a_copy_from_chance() {
    assert!((adjusted(&grid(&[&[5, 0], &[0, 5]])) - 1.0).abs() < ROUNDING);
    assert!(adjusted(&grid(&[&[5, 5], &[5, 5]])) < 0.0);
    // No action was ever repeated: every pairing looks like a copy.
    assert_eq!(adjusted(&grid(&[&[1, 0], &[0, 1]])), 0.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn keep_their_promises_on_small_tables(table in tables(), (rows, columns) in (0..9_u64, 0..9_u64)) {
        let alphabet = Alphabet { rows, columns };
        let turned = Alphabet { rows: columns, columns: rows };
        let sure = never_negative(&table, alphabet);
        let open = maybe_negative(&table, alphabet);

        prop_assert!(sure.iter().all(|figure| figure.is_finite() && *figure >= 0.0));
        prop_assert!(open.iter().all(|figure| figure.is_finite()));
        let symmetric = [sure[0], sure[1], open[0], open[1], open[2], open[3]];
        let (sure, open) = (never_negative(&table.transposed(), turned), maybe_negative(&table.transposed(), turned));
        let other_way = [sure[0], sure[1], open[0], open[1], open[2], open[3]];
        prop_assert!(symmetric.iter().zip(other_way).all(|(one, other)| (one - other).abs() < ROUNDING * (1.0 + one.abs())));
    }

    #[test]
    fn equal_rows_are_the_policy_s_plug_in(table in tables()) {
        // Every row as often as any other: then the ego chose uniformly.
        let rows = table.rows().iter().map(|&r| r as u128).product::<u128>();
        prop_assume!(rows > 0 && rows < 1 << 40);
        let even = Table::from_counts(table.cells().iter().map(|cell| {
            let row = table.rows()[cell.row as usize] as u128;
            (u64::from(cell.row), u64::from(cell.column), (3 * u128::from(cell.n) * rows / row) as u64)
        }));

        prop_assert!((uniform_policy(&even) - plug_in(&even)).abs() < ROUNDING);
    }
}
