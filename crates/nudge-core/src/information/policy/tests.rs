//! Reweighed information against the plug-in, by hand, and against its own permutations.

use super::*;
use crate::information::plug_in;
use crate::information::samples::{grid, tables};
use proptest::prelude::*;

const ROUNDING: f64 = 1e-14;
const UNIFORM: Policy<'_> = Policy::Uniform { actions: 2 };

#[test]
fn a_habit_hides_what_another_policy_shows() {
    // The ego turns once in ten times, and the other always follows.
    let table = grid(&[&[90, 0], &[0, 10]]);

    let (observed, uniform) = (
        under_policy(&table, Policy::Observed),
        under_policy(&table, UNIFORM),
    );

    assert!((observed.information - plug_in(&table)).abs() < ROUNDING);
    assert!((uniform.information - 2_f64.ln()).abs() < ROUNDING);
    assert_eq!((observed.covered, uniform.covered), (1.0, 1.0));
}

#[test]
fn habits_of_other_segments_weigh_these_responses() {
    let table = grid(&[&[9, 1], &[2, 8], &[5, 5]]);
    let elsewhere = Table::from_counts([(0, 7, 30), (1, 7, 10), (5, 7, 60)]);

    let found = under_policy(&table, Policy::Habits(&elsewhere));

    // p = (3/4, 1/4) of the two actions that were seen here, 4 of 10 there.
    let q = 0.75 * 0.9 + 0.25 * 0.2;
    let divergence = |p: f64| p * (p / q).ln() + (1.0 - p) * ((1.0 - p) / (1.0 - q)).ln();
    assert!((found.information - 0.75 * divergence(0.9) - 0.25 * divergence(0.2)).abs() < ROUNDING);
    assert!((found.covered - 0.4).abs() < ROUNDING);
}

#[test]
fn actions_never_seen_here_say_nothing() {
    let table = grid(&[&[9, 1], &[2, 8]]);
    let elsewhere = Table::from_counts([(5, 0, 3)]);

    for habits in [&elsewhere, &Table::default()] {
        let found = under_policy(&table, Policy::Habits(habits));
        assert_eq!((found.information, found.covered), (0.0, 0.0));
        assert_eq!(
            null_under_policy(&table, Policy::Habits(habits), 1),
            Moments::default()
        );
    }
    assert_eq!(under_policy(&Table::default(), UNIFORM).information, 0.0);
    assert_eq!(
        under_policy(&table, Policy::Uniform { actions: 8 }).covered,
        0.25
    );
}

#[test]
fn permutations_under_the_observed_habits_have_the_exact_moments() {
    for table in [
        grid(&[&[9, 5, 7], &[5, 9, 8], &[1, 1, 9]]),
        grid(&[&[900, 500], &[800, 300]]),
    ] {
        let exact = null_under_policy(&table, Policy::Observed, 1);
        let sampled = null_under_policy(&table, Policy::Habits(&table), 1);

        assert!((sampled.mean - exact.mean).abs() < 4.0 * (exact.variance / 256.0).sqrt());
        assert!((sampled.variance / exact.variance - 1.0).abs() < 4.0 * (6.0_f64 / 256.0).sqrt());
    }
}

#[test]
fn a_seed_gives_the_same_moments() {
    let table = grid(&[&[9, 5, 7], &[5, 9, 8], &[1, 1, 9]]);
    let null = |seed| null_under_policy(&table, Policy::Uniform { actions: 3 }, seed);

    assert_eq!(null(1), null(1));
    assert_ne!(null(1), null(2));
}

#[test]
fn strata_add_up_by_their_visits() {
    let (copy, product) = (grid(&[&[30, 0], &[0, 10]]), grid(&[&[5, 15], &[10, 30]]));
    let mut pool = PolicyPool::default();
    for (table, seed) in [(&copy, 1), (&product, 2)] {
        pool.add(table, UNIFORM, seed);
    }

    let nulls =
        [(&copy, 1), (&product, 2)].map(|(table, seed)| null_under_policy(table, UNIFORM, seed));
    assert!((pool.information() - 0.4 * 2_f64.ln()).abs() < ROUNDING);
    assert!(
        (pool.expected_if_independent() - (nulls[0].mean + nulls[1].mean) / 100.0).abs() < ROUNDING
    );
    assert!((pool.excess() - pool.information() + pool.expected_if_independent()).abs() < ROUNDING);
    assert!(pool.z() > 5.0 && pool.covered() == 1.0);
    assert_eq!(PolicyPool::default().z(), 0.0);
}

proptest! {
    #[test]
    fn own_habits_are_the_plug_in(table in tables()) {
        for policy in [Policy::Observed, Policy::Habits(&table)] {
            prop_assert!((under_policy(&table, policy).information - plug_in(&table)).abs() < ROUNDING);
        }
        let letters = table.rows().len().min(table.columns().len()).max(1);
        let uniform = under_policy(&table, Policy::Uniform { actions: 7 }).information;
        prop_assert!((0.0..=(letters as f64).ln() + ROUNDING).contains(&uniform));
    }
}
