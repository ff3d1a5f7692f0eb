//! Stratified worlds (Simpson 1951): states whose visits come in segments, between which habits may
//! differ and within which influence is planted, or is not.
//!
//! Pooled over segments, differing habits look like dependence. The truth is what happens within:
//! the conditional mutual information I = sum_g w_g I(p_g, rho_g), where w_g is the segment's share
//! of the visits, p_g the ego's habits in it and rho_g how the other responds there.
//!
//! | file | what |
//! |---|---|
//! | `world` | kinds of worlds: how visits, habits and dependence are laid over segments |
//! | `catalogue` | the worlds that decisions are measured in |
//! | `joints`, `habits` | the joint distribution of each segment of a state |
//! | `state` | what was seen of a state, and the truth |

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::joint::{draw, information, multinomial};
use nudge_core::information::Table;

mod catalogue;
mod habits;
mod joints;
mod state;
#[cfg(test)]
mod tests;
mod world;

pub use catalogue::WORLDS;
pub use state::{State, pooled};
pub use world::{Dependence, Differ, Sizes, World};

/// What to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How many states.
    pub states: usize,
    /// The share of dependent states, where a world has any.
    pub dependent: f64,
    /// Visits of each state, over all of its segments.
    pub visits: usize,
    /// The same seed gives the same states.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            states: 200,
            dependent: 0.3,
            visits: 30,
            seed: 1,
        }
    }
}

/// Draws the states of a world.
pub fn states(world: &World, options: &Options) -> Vec<State> {
    let mut rng = Pcg64::seed_from_u64(options.seed);
    (0..options.states)
        .map(|_| random_state(world, options, &mut rng))
        .collect()
}

fn random_state(world: &World, options: &Options, rng: &mut Pcg64) -> State {
    let dependent = world.dependent_segments(rng.random_bool(options.dependent), rng);
    let joints = world.joints(&dependent, rng);
    let weights = world.weights();
    // Of the others it is 0, which sums would only nearly be.
    let information = dependent
        .iter()
        .map(|segment| weights[*segment] * information(&joints[*segment]))
        .sum();
    State {
        tables: seen(&weights, &joints, options.visits, rng),
        dependent,
        information,
    }
}

/// Deals visits to segments, and draws those of each.
fn seen(
    weights: &[f64],
    joints: &[Vec<Vec<f64>>],
    visits: usize,
    rng: &mut Pcg64,
) -> Vec<(usize, Table)> {
    let dealt = multinomial(&[weights.to_vec()], visits, rng);
    let mut table = |(segment, visits): (&u64, &u64)| {
        let segment = *segment as usize;
        let seen = draw(&joints[segment], *visits as usize, rng);
        (
            segment,
            Table::from_counts(seen.into_iter().map(|(ego, other)| (ego, other, 1))),
        )
    };
    dealt
        .column_labels()
        .iter()
        .zip(dealt.columns())
        .map(&mut table)
        .collect()
}
