//! How often searches find planted regions, and find some where nothing was planted; and what a
//! search costs.
//!
//! `cargo bench --bench search` prints all of it (a minute); `cargo bench --bench search -- planted`,
//! `-- nulls` or `-- cost` a part.

#![allow(missing_docs)]

use std::time::Instant;

use nudge_core::information::search::{Axis, MOST_RULES, States, Sum, search};
use nudge_worlds::simulation::planted::regions::{
    NULLS, World, drawn, is_exact, planted_z, searched,
};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use rayon::prelude::*;

const DRAWS: usize = 8_000;
const SEEDS: u64 = 200;
const FDR: f64 = 0.05;

fn main() {
    let asked: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with("--"))
        .collect();
    let wants = |part: &str| asked.is_empty() || asked.iter().any(|one| one == part);

    if wants("planted") {
        planted();
    }
    if wants("nulls") {
        nulls();
    }
    if wants("cost") {
        cost();
    }
}

/// Prints, by z of the planted region on the half that is searched, how often anything was found
/// and how often it was exactly that.
fn planted() {
    let worlds = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6];
    let seeds = worlds.into_par_iter().flat_map(|information| {
        (0..SEEDS)
            .into_par_iter()
            .map(move |seed| (information, seed))
    });
    let found: Vec<(f64, bool, bool)> = seeds
        .map(|(information, seed)| {
            let drawn = drawn(World::Planted(information), DRAWS, seed);
            let tested = searched(&drawn);
            let mut passing = tested.iter().filter(|(_, _, q)| *q <= FDR);
            let first = passing.next();
            let exact = first.is_some_and(|(rule, ..)| is_exact(rule));
            (planted_z(&drawn), first.is_some(), exact)
        })
        .collect();

    println!("z of the planted region: worlds, found, exact");
    for ends in [f64::MIN, 3.0, 5.0, 6.5, 8.0, 9.5, 11.0, 13.0, f64::MAX].windows(2) {
        let here = || {
            found
                .iter()
                .filter(|(z, ..)| (ends[0]..ends[1]).contains(z))
        };
        let all = here().count() as f64;
        let share = |some: usize| some as f64 / all;
        println!(
            "below {:5.1}: {all:4}  {:.3}  {:.3}",
            ends[1].min(99.0),
            share(here().filter(|(_, found, _)| *found).count()),
            share(here().filter(|(.., exact)| *exact).count()),
        );
    }
}

/// Prints in how many worlds without influence a region was found.
fn nulls() {
    for world in NULLS {
        let worlds = (0..SEEDS)
            .into_par_iter()
            .map(|seed| searched(&drawn(world, DRAWS, seed)));
        let is_wrong = |tested: &Vec<_>| tested.iter().any(|(_, _, q): &(_, _, f64)| *q <= FDR);
        let wrong = worlds.filter(is_wrong).count();
        println!("{world:?}: found in {wrong} of {SEEDS}");
    }
}

/// Prints how long a search of 100,000 states takes, in which ten rules can be found.
fn cost() {
    for (features, bins) in [(6, 6), (6, 10), (6, 24), (12, 10), (25, 10), (25, 24)] {
        let states = many(100_000, features, bins);
        let begun = Instant::now();
        let found = search(states, MOST_RULES, &|| true).expect("nobody ends it");
        println!(
            "{features} features of {bins} bins: {:.2} s, {} rules of {} looked at, left out {:?}",
            begun.elapsed().as_secs_f64(),
            found.rules.len(),
            found.looked_at,
            found.left_out,
        );
    }
}

/// Returns states of which one in ten, in ten places, lies beyond independence.
fn many(states: usize, features: usize, bins: u32) -> States {
    let mut random = Pcg64::seed_from_u64(1);
    let mut all = States::new(vec![Axis::Ordered(bins); features]);
    for _ in 0..states {
        let state: Vec<u32> = (0..features)
            .map(|_| random.random_range(0..bins))
            .collect();
        let noise: f64 = StandardNormal.sample(&mut random);
        let planted = (0..features).any(|at| state[at] == 1 && state[(at + 1) % features] < 3);
        let sum = Sum {
            beyond: noise + f64::from(u8::from(planted)),
            variance: 1.0,
            visits: 10,
        };
        all.push(state, sum);
    }
    all
}
