//! p-values against enumerations by others.

use super::{close, number, tables};
use nudge::information::{Method, p_value};

/// The enumerations' probabilities sum to 1 within this.
const ENUMERATION: f64 = 1e-12;

#[test]
fn exact_p_values_match_the_enumerations() {
    let enumerated = tables().filter_map(|(golden, table)| {
        let p = golden["exact_permutation"]["p_ge"].as_f64()?;
        Some((golden, table, p))
    });
    let mut exact = 0;
    for (golden, table, reference) in enumerated {
        let significance = p_value(&[table], 20_000, 1);
        if significance.method == Method::Exact {
            exact += 1;
            close(&golden, significance.p_value, reference, ENUMERATION);
        } else {
            let standard_error = (reference * (1.0 - reference) / 20_000.0).sqrt();
            close(
                &golden,
                significance.p_value,
                reference,
                4.0 * standard_error + 1.0 / 20_000.0,
            );
        }
    }
    assert!(exact >= 6, "only {exact} tables were enumerated");
}

#[test]
fn a_billion_visits_have_the_chi_square_of_their_g() {
    let (_, nearly_independent) = tables()
        .find(|(golden, _)| golden["id"] == "t10_2x2_1e9")
        .expect("a golden table");
    let (golden, dependent) = tables()
        .find(|(golden, _)| golden["id"] == "t33_6x6_dep_1e9")
        .expect("a golden table");

    let chance = p_value(&[nearly_independent], 199, 1);
    let certain = p_value(&[dependent], 199, 1);

    // erfc(sqrt(G / 2)) with G = 1.6e-8, by mpmath 1.4.1; scipy's G of this table has lost all
    // digits but one.
    close(&golden, chance.p_value, 0.999_899_074_699_388_3, 1e-12);
    assert_eq!([chance.method, certain.method], [Method::GTest; 2]);
    assert_eq!(
        certain.p_value,
        number(&golden["peers"]["G_effective_df"][0]["value"]["p"])
    );
}
