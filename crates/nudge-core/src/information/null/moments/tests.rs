//! The moments against every table there is, and against shuffled visits where there are too many.

use super::*;
use crate::information::Table;
use crate::information::significance::{Sampler, freedoms};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// Relative to the variance, or to 1 where that is larger.
const ROUNDING: f64 = 1e-12;

#[test]
fn a_line_has_no_choice() {
    for (rows, columns) in [(&[7][..], &[3, 4][..]), (&[1, 2], &[3]), (&[], &[])] {
        assert_eq!(moments(rows, columns), Moments::default());
    }
    // Every table with these margins is a perfect copy.
    assert!(moments(&[1, 1, 1], &[1, 1, 1]).variance < ROUNDING);
}

#[test]
fn match_50_digits() {
    // mpmath 1.4.1, all tables: tests/golden/pooled.py, which writes these among others.
    let references: [(&[u64], &[u64], f64, f64); 6] = [
        (
            &[2, 2, 2, 2],
            &[3, 3, 1, 1],
            5.686933466481801,
            1.223684410959011,
        ),
        (&[32, 32], &[32, 32], 0.5120583714288028, 0.52484244438345),
        (
            &[60, 2, 2],
            &[59, 3, 2],
            0.9681979337581895,
            1.3081985167013275,
        ),
        (
            &[20, 14, 6],
            &[25, 10, 5],
            2.352070093683717,
            2.2993391233209484,
        ),
        (
            &[90, 60],
            &[100, 50],
            0.5062843963818688,
            0.5128378832719988,
        ),
        (
            &[600, 500],
            &[1000, 100],
            0.5025831944986434,
            0.5052332837524919,
        ),
    ];
    for (rows, columns, mean, variance) in references {
        let found = moments(rows, columns);

        assert!(
            (found.mean - mean).abs() < ROUNDING,
            "{rows:?} {columns:?}: {found:?}"
        );
        assert!(
            (found.variance - variance).abs() < ROUNDING,
            "{rows:?} {columns:?}: {found:?}"
        );
    }
}

#[test]
fn agree_with_shuffled_visits() {
    const SHUFFLES: usize = 20_000;
    let geometric: Vec<u64> = (0..13).map(|at| 1 + 4_000 / 3_u64.pow(at)).collect();
    let steep: Vec<u64> = vec![60_000, 30_000, 8_000, 1_500, 400, 70, 20, 6, 3, 1];
    let margins: [(&[u64], &[u64]); 8] = [
        (&[40, 31, 17, 8, 3, 1], &[55, 25, 10, 5, 4, 1]),
        (&[95, 2, 1, 1, 1], &[80, 5, 5, 5, 5]),
        (&[10; 10], &[4; 25]),
        (&[900, 700, 400], &[1_500, 300, 200]),
        (&[9_000, 7_000, 4_000], &[15_000, 4_997, 3]),
        // Where the recurrence is unstable in most cells.
        (&geometric, &geometric),
        (&steep, &steep),
        (
            &[1_000, 500, 300, 100, 60, 25, 10, 4, 1],
            &[1_200, 500, 200, 70, 20, 7, 2, 1],
        ),
    ];
    for (rows, columns) in margins {
        let exact = moments(rows, columns);
        let table = any_table_with(rows, columns);
        let mut sampler = Sampler::new(&table, freedoms(&table));
        let mut random = Pcg64::seed_from_u64(1);
        let draws: Vec<f64> = (0..SHUFFLES).map(|_| sampler.draw(&mut random)).collect();
        let sampled = Moments::of_sample(&draws);

        let error = (exact.variance / SHUFFLES as f64).sqrt();
        assert!(
            (sampled.mean - exact.mean).abs() < 4.0 * error,
            "{exact:?} {sampled:?}"
        );
        // The variance of a variance is 2 + excess kurtosis over n of itself; these have less than 4.
        let spread = (6.0 / SHUFFLES as f64).sqrt();
        assert!(
            (sampled.variance / exact.variance - 1.0).abs() < 4.0 * spread,
            "{exact:?} {sampled:?}"
        );
    }
}

#[test]
fn many_visits_tend_to_half_a_chi_square() {
    for (rows, columns) in [([300_000; 3], [225_000; 4]), ([1 << 60; 3], [3 << 58; 4])] {
        let found = moments(&rows, &columns);

        assert!(
            (found.mean - 3.0).abs() < 1e-3 && (found.variance - 3.0).abs() < 1e-3,
            "{found:?}"
        );
    }
}

#[test]
fn the_limit_meets_the_expansion() {
    let urn = Urn {
        marked: 15_000,
        drawn: 9_000,
        total: 50_000,
    };
    let mut coefficients = Vec::new();
    let mut basis = Basis::default();
    basis.lay_out(urn);
    let mut link = 0.0;
    for order in 0..2 {
        let next = (urn.rising(order) * urn.falling(order + 1)).sqrt();
        coefficients.push(basis.step(urn.rising(order) + urn.falling(order), link, next));
        link = next;
    }

    for (limit, summed) in limits(urn).iter().zip(coefficients) {
        assert!(
            (limit - summed).abs() < 3.0 / urn.mean(),
            "{limit} {summed}"
        );
    }
}

proptest! {
    #[test]
    fn rows_and_columns_are_alike(sums in prop::collection::vec(1..20_u64, 2..7), lines in 2..7_usize) {
        let total: u64 = sums.iter().sum();
        let columns: Vec<u64> = (0..lines as u64).map(|at| (total + at) / lines as u64).filter(|sum| *sum > 0).collect();
        let (one, other) = (moments(&sums, &columns), moments(&columns, &sums));

        prop_assert!((one.mean - other.mean).abs() < 1e-11 && (one.variance - other.variance).abs() < 1e-11);
    }
}

/// Returns one table with these margins: visits in order of both labels.
fn any_table_with(rows: &[u64], columns: &[u64]) -> Table {
    let labels = |sums: &[u64]| -> Vec<u64> {
        let of_line = |(label, &sum): (u64, &u64)| std::iter::repeat_n(label, sum as usize);
        (0..).zip(sums).flat_map(of_line).collect()
    };
    Table::from_counts(
        labels(rows)
            .into_iter()
            .zip(labels(columns))
            .map(|(i, j)| (i, j, 1)),
    )
}
