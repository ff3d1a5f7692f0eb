//! Searches in drawn worlds: what was planted is found as it is, and nothing where nothing was.

use rayon::prelude::*;

use super::*;

/// As many draws as one layout of recorded play has.
const DRAWS: usize = 8_000;
/// The rate at which rules pass.
const FDR: f64 = 0.05;

fn passing(drawn: &Drawn) -> Vec<Tested> {
    let tested = searched(drawn).into_iter();
    tested.filter(|(_, _, q)| *q <= FDR).collect()
}

#[test]
fn copies_are_as_many_as_their_information_says() {
    for information in [0.05, 0.4, 1.0] {
        let (copies, all) = (share_of_copies(information), ACTIONS as f64);
        let row = |ego: usize| -> Vec<f64> {
            let same = |other| if ego == other { copies } else { 0.0 };
            (0..ACTIONS)
                .map(|other| (same(other) + (1.0 - copies) / all) / all)
                .collect()
        };
        let joint: Vec<Vec<f64>> = (0..ACTIONS).map(row).collect();
        assert!((super::super::information(&joint) - information).abs() < 1e-9);
    }
}

#[test]
fn planted_regions_are_found_as_they_are_where_there_is_enough_to_see() {
    let drawn = (0..30)
        .into_par_iter()
        .map(|seed| drawn(World::Planted(0.6), DRAWS, seed));
    let seen: Vec<Drawn> = drawn.filter(|drawn| planted_z(drawn) >= 11.0).collect();
    let seen = &seen[..20];

    let found: Vec<Vec<Tested>> = seen.par_iter().map(passing).collect();
    let firsts: Vec<&Tested> = found.iter().filter_map(|found| found.first()).collect();
    assert!(firsts.len() >= 18, "found in {} of 20", firsts.len());
    let exact = firsts.iter().filter(|(rule, ..)| is_exact(rule)).count();
    assert!(exact >= 18, "exact in {exact} of 20");
}

#[test]
fn nothing_is_found_where_nothing_was_planted() {
    for world in NULLS {
        let found = (0..20)
            .into_par_iter()
            .map(|seed| passing(&drawn(world, DRAWS, seed)));
        let wrong = found.filter(|found| !found.is_empty()).count();
        // Of 200 at most 17; binomially, 2 of 20 or fewer with .92.
        assert!(wrong <= 3, "{world:?}: found in {wrong} of 20");
    }
}

#[test]
fn the_same_seed_draws_the_same() {
    let [one, again] = [7, 7].map(|seed| drawn(World::Held, 500, seed));
    assert_eq!(one.draws, again.draws);
    assert_ne!(one.draws, drawn(World::Held, 500, 8).draws);
}
