//! The estimators that are there on request.

use super::{TARGET, alphabet, answers, close, number, tables, with_reference};
use nudge::information::{
    adjusted, chao_shen, dirichlet, grassberger_2003, james_stein, nsb, plug_in, uniform_policy,
};
use serde_json::Value;

/// ndd 1.10.6 approximates the quadrature: each of its three entropies is up to some 3e-4 off.
const APPROXIMATE: f64 = 1e-3;

#[test]
fn estimators_match_high_precision() {
    let file: Value = serde_json::from_str(include_str!("../../golden/estimators.json"))
        .expect("the file is JSON");
    for (golden, table) in tables() {
        let reference = &file["tables"][golden["id"].as_str().expect("an id")];
        let alphabet = alphabet(&golden);
        close(
            &golden,
            nsb(&table, alphabet),
            number(&reference["nsb"]),
            TARGET,
        );
        close(
            &golden,
            grassberger_2003(&table),
            number(&reference["grassberger_2003"]),
            TARGET,
        );
        close(
            &golden,
            chao_shen(&table),
            number(&reference["chao_shen"]),
            TARGET,
        );
        close(
            &golden,
            james_stein(&table, alphabet),
            number(&reference["james_stein"]),
            TARGET,
        );
        close(
            &golden,
            uniform_policy(&table),
            number(&reference["uniform_policy"]),
            TARGET,
        );
    }
}

#[test]
fn the_dirichlet_posterior_mean_matches_50_digits() {
    for (golden, table) in with_reference() {
        let by_prior =
            &golden["reference"]["hutter_zaffalon_posterior_mean_nats_by_alpha_per_cell"];
        close(
            &golden,
            dirichlet(&table, alphabet(&golden)),
            number(&by_prior["perks"]),
            TARGET,
        );
    }
}

#[test]
fn other_tools_agree_where_they_estimate_the_same() {
    for (golden, table) in with_reference() {
        for answer in answers(&golden, "mi_chao_shen_nats") {
            close(&golden, chao_shen(&table), answer, TARGET);
        }
        for answer in answers(&golden, "mi_shrink_nats") {
            close(
                &golden,
                james_stein(&table, alphabet(&golden)),
                answer,
                TARGET,
            );
        }
        for answer in answers(&golden, "mi_nsb_K_alphabet_nats") {
            close(&golden, nsb(&table, alphabet(&golden)), answer, APPROXIMATE);
        }
    }
}

#[test]
fn the_adjusted_information_is_that_of_scikit_learn() {
    for (golden, table) in with_reference() {
        for answer in answers(&golden, "ami_arithmetic") {
            let by_convention = ["t04_2x2_single_cell", "t06_2x2_N2_diag"]
                .iter()
                .any(|id| golden["id"] == *id);
            // Where there is nothing to adjust, scikit-learn calls the agreement perfect, and we
            // call it chance.
            assert_eq!(by_convention, answer == 1.0 && adjusted(&table) == 0.0);
            if !by_convention {
                close(&golden, adjusted(&table), answer, TARGET);
            }
        }
    }
}

/// The form of 1988 is another estimator: this file would not notice if the names were confused,
/// but for this test.
#[test]
fn grassberger_of_1988_is_told_apart() {
    let (golden, table) = tables()
        .find(|(golden, _)| golden["id"] == "t18_3x3_N8")
        .expect("a golden table");

    let of_1988 = answers(&golden, "mi_grassberger_nats")[0];

    assert!((grassberger_2003(&table) - of_1988).abs() > 1e-3);
    assert!((grassberger_2003(&table) - plug_in(&table)).abs() > 1e-3);
}
