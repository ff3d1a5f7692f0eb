//! Habits that differ from segment to segment: opposite ones, and a random walk of their logarithms.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::simulation::planted::joint::{dirichlet, shuffle};

/// Where habits drift, their logarithms begin with a standard deviation of 1 and move by so much
/// from one segment to the next.
const STEP: f64 = 0.25;

/// Draws a habit and its opposite, in turns: the letter that is likeliest in one is unlikeliest in
/// the other.
pub(super) fn opposite(segments: usize, letters: usize, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let mut sorted = dirichlet(1.0, letters, rng);
    sorted.sort_by(f64::total_cmp);

    let mut ranks: Vec<usize> = (0..letters).collect();
    shuffle(&mut ranks, rng);
    let habit = |segment: usize| {
        let rank = |rank: &usize| {
            if segment.is_multiple_of(2) {
                *rank
            } else {
                letters - 1 - rank
            }
        };
        ranks.iter().map(|at| sorted[rank(at)]).collect()
    };
    (0..segments).map(habit).collect()
}

/// Draws habits whose logarithms are a random walk.
pub(super) fn drifting(segments: usize, letters: usize, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let mut logarithms: Vec<f64> = (0..letters).map(|_| StandardNormal.sample(rng)).collect();
    let mut habit = |_| {
        let exponentials: Vec<f64> = logarithms.iter().map(|ln| ln.exp()).collect();
        let sum: f64 = exponentials.iter().sum();
        for ln in &mut logarithms {
            let step: f64 = StandardNormal.sample(rng);
            *ln += STEP * step;
        }
        exponentials.into_iter().map(|e| e / sum).collect()
    };
    (0..segments).map(&mut habit).collect()
}
