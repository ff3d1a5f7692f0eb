//! What marginal likelihoods are: by statrs's ln Gamma from their definitions, term by term.

use statrs::function::gamma::ln_gamma;

use super::*;
use crate::information::LARGEST_TOTAL;
use crate::information::samples::grid;

/// Of logarithms of up to some hundred thousand visits, relative to 1 or to the value.
const PRECISION: f64 = 1e-9;

fn assert_close(told: f64, expected: f64, what: &str) {
    assert!(
        (told - expected).abs() <= PRECISION * expected.abs().max(1.0),
        "{what}: {told} instead of {expected}"
    );
}

/// ln DM(n; a), by its definition.
fn dirichlet_multinomial(counts: &[(f64, f64)]) -> f64 {
    let (total, a) = counts
        .iter()
        .fold((0.0, 0.0), |(n, a), (count, share)| (n + count, a + share));
    let cells = counts.iter().map(|(n, a)| ln_gamma(n + a) - ln_gamma(*a));
    cells.sum::<f64>() + ln_gamma(a) - ln_gamma(total + a)
}

/// ln DM of counts by letter, around k times these shares.
fn around(counts: &[u64], k: f64, shares: &[f64]) -> f64 {
    let pairs = counts.iter().zip(shares).map(|(n, m)| (*n as f64, k * m));
    dirichlet_multinomial(&pairs.collect::<Vec<_>>())
}

/// Tables whose every row and column is visited: small cells, cells beyond what is tabulated or
/// multiplied out, and more factors than a product has room for.
fn tables() -> Vec<Vec<Vec<u64>>> {
    vec![
        vec![vec![3, 1, 2], vec![1, 4, 2]],
        vec![vec![17, 300, 16], vec![2_500, 40, 1], vec![5, 5, 5]],
        (0..12)
            .map(|i| (0..3).map(|j| 6 + (i * 7 + j * 5) % 11).collect())
            .collect(),
    ]
}

fn table(counts: &[Vec<u64>]) -> Table {
    grid(&counts.iter().map(|row| &row[..]).collect::<Vec<_>>())
}

fn column_sums(counts: &[Vec<u64>]) -> Vec<u64> {
    (0..counts[0].len())
        .map(|j| counts.iter().map(|row| row[j]).sum())
        .collect()
}

fn likelihood(rows: usize) -> Likelihood {
    Likelihood::new(rows as u64, Base::new(&[4, 0, 9]))
}

#[test]
fn shared_and_own_responses_are_dirichlet_multinomials() {
    for counts in tables() {
        let likelihood = likelihood(counts.len());
        let evidence = likelihood.evidence(&table(&counts));
        let bases = [likelihood.base.shares().to_vec(), vec![1.0 / 3.0; 3]];
        let sums = column_sums(&counts);

        assert!(evidence.anchor.is_none());
        for (at, told) in evidence.nulls.into_iter().enumerate() {
            let (grid, base) = (
                NULL_CONCENTRATIONS.len(),
                &bases[at / NULL_CONCENTRATIONS.len()],
            );
            assert_close(
                told,
                around(&sums, NULL_CONCENTRATIONS[at % grid], base),
                "null",
            );
        }
        for (at, told) in evidence.fixed.into_iter().enumerate() {
            let (k, base) = (
                FIXED_CONCENTRATIONS[at % FIXED_GRID],
                &bases[at / FIXED_GRID],
            );
            let rows = counts.iter().map(|row| around(row, k, base));
            assert_close(told, rows.sum(), "fixed");
        }
    }
}

#[test]
fn rows_around_their_own_marginal_are_told_relative_to_it() {
    for counts in tables() {
        let likelihood = likelihood(counts.len());
        let own = likelihood.evidence(&table(&counts)).own;
        let sums = column_sums(&counts);
        let total: f64 = sums.iter().sum::<u64>() as f64;
        let marginal: Vec<f64> = sums
            .iter()
            .zip(likelihood.base.shares())
            .map(|(c, g)| (*c as f64 + g) / (total + 1.0))
            .collect();
        let null: f64 = sums
            .iter()
            .zip(&marginal)
            .map(|(c, m)| *c as f64 * m.ln())
            .sum();
        // Letters that are free to vary: c / (c + 4) of each, less one.
        let free = sums
            .iter()
            .map(|c| *c as f64 / (*c as f64 + 4.0))
            .sum::<f64>()
            - 1.0;

        for (told, k) in own.into_iter().zip(OWN_CONCENTRATIONS) {
            let rows: f64 = counts.iter().map(|row| around(row, k, &marginal)).sum();
            let effective: f64 = counts
                .iter()
                .map(|row| row.iter().sum::<u64>() as f64)
                .map(|r| r * (k + 1.0) / (k + r))
                .sum();
            let volume = 0.5 * free * (total / effective).ln();
            assert_close(told, rows - null + volume, "own");
        }
    }
}

/// Cells of most visits and least share: of the largest total, each fills a product to its last
/// factor.
#[test]
fn rising_factorials_outgrow_one_product() {
    const CELLS: u64 = 40;
    const N: u64 = 16;

    for total in [700, 10_u64.pow(15), LARGEST_TOTAL] {
        let share = N as f64 / (total as f64 + 1.0);
        let mut rising = Rising::new(total);
        (0..CELLS).for_each(|_| rising.multiply(share, N));

        assert_eq!(rising.visits, CELLS * N);
        for (told, k) in rising.ln().into_iter().zip(OWN_CONCENTRATIONS) {
            let a = k * share;
            let one = ln_gamma(a + N as f64) - ln_gamma(a) - N as f64 * a.ln();
            assert_close(told, CELLS as f64 * one, "rising");
        }
    }
}

#[test]
fn an_anchored_row_is_in_both_hypotheses() {
    let (anchored, rest) = ([50, 7, 3], [1, 0, 1]);
    let likelihood = likelihood(2);

    let evidence = likelihood.evidence(&grid(&[&anchored, &rest]));

    let shares = likelihood.base.shares();
    let anchor = evidence.anchor.expect("two visits are outside");
    assert_close(
        anchor[5],
        around(&anchored, NULL_CONCENTRATIONS[5], shares),
        "anchor",
    );
    assert_close(
        evidence.fixed[5],
        around(&rest, FIXED_CONCENTRATIONS[5], shares),
        "rest",
    );
    // Of a whole part no row is anchored.
    assert_close(
        likelihood.rows_apart(&grid(&[&anchored, &rest]))[5],
        around(&anchored, FIXED_CONCENTRATIONS[5], shares)
            + around(&rest, FIXED_CONCENTRATIONS[5], shares),
        "apart",
    );
}

#[test]
fn a_row_is_an_anchor_where_fewer_than_three_visits_are_in_the_others() {
    assert_eq!(anchor(&grid(&[&[1, 0], &[8, 1], &[0, 1]])), Some(1));
    assert_eq!(anchor(&grid(&[&[1, 0], &[8, 1], &[1, 1]])), None);
    assert_eq!(
        anchor(&grid(&[&[1, 1], &[1, 1]])),
        Some(0),
        "the first of equals"
    );
    assert_eq!(anchor(&Table::default()), None);
}

/// By hand: k m = 1 and 1 in the first row, (1 2)(1) / (2 3 4) = 1/12; 1/2 and 3/2 in the second,
/// (3/2 5/2 7/2) / (2 3 4) = 35/64.
#[test]
fn rows_evidence_is_a_product_over_rows() {
    let table = grid(&[&[2, 1], &[0, 3]]);
    let share = |i: usize, j: usize| [[0.5, 0.5], [0.25, 0.75]][i][j];

    assert_close(
        rows_evidence(&table, 2.0, share),
        (35.0_f64 / (12.0 * 64.0)).ln(),
        "rows",
    );
}

#[test]
fn a_null_mixture_weighs_its_components() {
    let mut weights = [0.0; NULLS];
    [weights[0], weights[1], weights[2]] = [0.25, 0.75, 1e-7];
    let nulls = NullMixture::new(&weights);
    let mut evidence = [0.0; NULLS];
    // What has next to no weight is left out, however likely.
    [evidence[0], evidence[1], evidence[2]] = [-800.0, -800.0 + 2_f64.ln(), 0.0];

    let null = nulls.given(&evidence);

    let expected = -800.0 + 1.75_f64.ln();
    assert_close(null.ln, expected, "ln");
    assert_close(nulls.ln_mixed(&evidence), expected, "mixed");
    assert_close(null.components[0], 1.0 / 7.0, "first");
    assert_close(null.components[1], 6.0 / 7.0, "second");
    assert!(null.components[2..].iter().all(|p| *p == 0.0));
    assert_close(
        null.ln_joint[1],
        0.75_f64.ln() - 800.0 + 2_f64.ln(),
        "joint",
    );
}

#[test]
fn parts_that_are_alike_are_told_from_parts_that_differ() {
    let likelihood = likelihood(2);
    let alike = [grid(&[&[8, 4, 8]]), grid(&[&[8, 4, 8]])];
    let differ = [grid(&[&[16, 4, 0]]), grid(&[&[0, 4, 16]])];

    let around = |parts: &[Table; 2]| likelihood.around(by_part(parts.iter()));

    assert!(around(&alike).iter().all(|ln| *ln < 0.0));
    assert!(around(&differ)[3] > 5.0);
    assert_eq!(
        likelihood.around(by_part(alike.iter().take(1))),
        [0.0; AROUND],
        "one part differs from nothing"
    );
}
