//! The figures of observed frequencies and their yardsticks.

use super::{TARGET, answers, close, list, number, relatively_close, tables, with_reference};
use nudge::information::{
    ExpectedMethod, Table, divergence, excess, expected_if_independent, miller_madow, plug_in,
};
use serde_json::Value;
use std::f64::consts::LN_2;

/// What is left of the enumerated expectations of the golden file; see its notes.
const ENUMERATION: f64 = 1e-10;

#[test]
fn plug_in_and_miller_madow_match_the_references() {
    for (golden, table) in with_reference() {
        let reference = &golden["reference"];
        close(
            &golden,
            plug_in(&table),
            number(&reference["mi_plugin_nats"]),
            TARGET,
        );
        close(
            &golden,
            miller_madow(&table),
            number(&reference["mi_miller_madow_nats"]),
            TARGET,
        );
    }
}

#[test]
fn divergences_match_the_references_and_unvisited_rows_have_none() {
    for (golden, table) in with_reference() {
        for (label, reference) in (0..).zip(list(&golden["reference"]["dkl_per_ego_action_nats"])) {
            match table.row_labels().binary_search(&label) {
                Ok(row) => close(&golden, divergence(&table, row), number(reference), TARGET),
                Err(_) => assert!(
                    reference.is_null(),
                    "{}: row {label} was visited",
                    golden["id"]
                ),
            }
        }
    }
}

#[test]
fn occupied_rows_columns_and_cells_match_the_references() {
    for (golden, table) in with_reference() {
        let support = &golden["reference"]["support"];
        let occupied = [
            table.rows().len(),
            table.columns().len(),
            table.cells().len(),
        ];
        assert_eq!(
            occupied.map(Value::from),
            [&support["R"], &support["H"], &support["joint"]].map(Value::clone)
        );
        assert_eq!(table.total(), golden["N"]);
    }
}

#[test]
fn the_table_of_no_visits_has_zero_of_everything() {
    let (golden, table) = tables()
        .find(|(golden, _)| golden["N"] == 0)
        .expect("the golden file has an empty table");

    assert!(golden.get("reference").is_none());
    assert_eq!(
        [plug_in(&table), miller_madow(&table), excess(&table)],
        [0.0; 3]
    );
    assert_eq!(
        expected_if_independent(&table),
        (0.0, ExpectedMethod::Hypergeometric)
    );
}

#[test]
fn other_tools_agree() {
    for (golden, table) in with_reference() {
        let (expected, method) = expected_if_independent(&table);
        for answer in answers(&golden, "mi_plugin_nats") {
            close(&golden, plug_in(&table), answer, TARGET);
        }
        for answer in answers(&golden, "mi_plugin_bits") {
            close(&golden, plug_in(&table), answer * LN_2, TARGET);
        }
        for answer in answers(&golden, "mi_miller_madow_nats") {
            close(&golden, miller_madow(&table), answer, TARGET);
        }
        for answer in answers(&golden, "emi_hypergeometric_nats") {
            assert_eq!(method, ExpectedMethod::Hypergeometric);
            close(&golden, expected, answer, TARGET);
        }
        if let Some(enumerated) = golden["exact_permutation"]["exact_E_MI_null_nats"].as_f64() {
            close(&golden, expected, enumerated, ENUMERATION);
        }
    }
}

/// mpmath, 50 digits: `expected` in `tests/golden/SOURCE.md`. The two tables of 10^9 visits are
/// beyond the exact mean.
const EXPECTED: [(&str, f64); 18] = [
    ("t00_2x2_indep_balanced", 0.005_076_369_386_985_359),
    ("t03_2x2_hutter", 0.003_375_229_309_212_459),
    ("t04_2x2_single_cell", 0.0),
    ("t06_2x2_N2_diag", LN_2),
    ("t09_2x2_skew", 0.000_111_472_759_736_409_71),
    ("t12_2x2_antidiag_unbalanced", 0.005_961_526_418_381_403),
    ("t15_3x3_zero_row_col", 0.036_297_567_312_566_98),
    ("t18_3x3_N8", 0.380_495_640_094_859_26),
    ("t21_4x4_uniform1", 0.391_603_249_459_430_8),
    ("t24_5x3_rect", 0.067_634_066_431_155_87),
    ("t27_6x6_indep_N500", 0.026_299_155_030_093_252),
    ("t30_6x6_dep_N12", 0.360_644_207_803_873_4),
    ("t36_6x6_one_human_action", 0.0),
    ("t39_6x6_N36_uniform", 0.449_295_630_909_330_06),
    ("t40_6x6_N0", 0.0),
    ("t42_9x9_sfm_N30", 0.344_915_393_217_174_96),
    ("t45_12x12_N1000", 0.064_460_454_046_499_28),
    ("t48_1x6", 0.0),
];

#[test]
fn the_exact_expectation_matches_50_digits() {
    for (golden, table) in tables().filter(|(golden, _)| golden["N"].as_u64() <= Some(1_000)) {
        let (_, reference) = EXPECTED
            .iter()
            .find(|(id, _)| golden["id"] == *id)
            .expect("every small table is listed");
        let (expected, method) = expected_if_independent(&table);

        assert_eq!(method, ExpectedMethod::Hypergeometric);
        close(&golden, expected, *reference, TARGET);
        close(&golden, excess(&table), plug_in(&table) - reference, TARGET);
    }
}

#[test]
fn the_expectation_of_a_billion_visits_is_the_leading_term() {
    for (golden, table) in tables().filter(|(golden, _)| golden["N"] == 1_000_000_000) {
        let freedoms = number(&golden["reference"]["df_effective"]);

        let (expected, method) = expected_if_independent(&table);

        assert_eq!(method, ExpectedMethod::Asymptotic);
        // The next term is about a billionth of it.
        assert!((expected / (freedoms / 2e9) - 1.0).abs() < 1e-7);
    }
}

/// Where nearly everything cancels, an absolute tolerance would be passed by 0: these ask for the
/// digits themselves.
#[test]
fn billions_of_visits_near_independence_keep_their_digits() {
    // 10^6 a_i b_j with a = (10, 20, 30), b = (50, 30, 20), and a handful of visits more or less in
    // each cell. mpmath, 50 digits: `information` in tests/golden/SOURCE.md of exactly these
    // counts.
    let nearly_a_product = [
        [500_000_007, 299_999_997, 200_000_001],
        [999_999_998, 600_000_005, 399_999_989],
        [1_500_000_004, 900_000_000, 600_000_013],
    ];
    let cells = (0..)
        .zip(nearly_a_product)
        .flat_map(|(i, row)| (0..).zip(row).map(move |(j, n)| (i, j, n)));
    relatively_close(
        plug_in(&Table::from_counts(cells)),
        5.134_259_250_946_52e-17,
    );

    let (golden, table) = tables()
        .find(|(golden, _)| golden["id"] == "t10_2x2_1e9")
        .expect("a golden table");
    relatively_close(
        plug_in(&table),
        number(&golden["reference"]["mi_plugin_nats"]),
    );
    relatively_close(
        divergence(&table, 0),
        number(&golden["reference"]["dkl_per_ego_action_nats"][0]),
    );
}
