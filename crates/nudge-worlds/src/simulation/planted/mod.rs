//! Synthetic tables with known ground truth: states in which influence was planted, or was not. For
//! measuring decisions, not for playing.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use nudge_core::information::Table;

mod generator;
pub mod graphs;
mod hard;
mod joint;
pub mod lagged;
pub mod regions;
pub mod segments;
#[cfg(test)]
mod tests;

pub use generator::Generator;
pub use joint::information;
use joint::{draw, multinomial, product_of_margins, shuffle};

/// What is done to the states once they are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arm {
    /// Nothing.
    Plain,
    /// A state without influence is the product of the margins of one with influence, so that
    /// margins give nothing away.
    LeakFree,
    /// The other's actions are shuffled within each state: nothing is left to find. The truth told
    /// is that before shuffling.
    Shuffled,
}

/// What to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How many states.
    pub states: usize,
    /// The share of states with influence.
    pub dependent: f64,
    /// What is done to them.
    pub arm: Arm,
    /// The same seed gives the same states.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            states: 2_500,
            dependent: 0.3,
            arm: Arm::Plain,
            seed: 1,
        }
    }
}

/// One state.
#[derive(Debug, Clone, PartialEq)]
pub struct Planted {
    /// What was seen; rows are the ego's actions.
    pub table: Table,
    /// The mutual information of the distribution it was drawn from, in nats.
    pub information: f64,
    /// Whether influence was planted.
    pub dependent: bool,
    /// What was seen in each segment; empty where there is only one.
    pub segments: Vec<Table>,
}

/// Above this, visits are not drawn one by one.
const ONE_BY_ONE: usize = 5_000;

/// Segments, and visits of each.
const SEGMENTS: usize = 8;
const SEGMENT_VISITS: usize = 40;

/// Draws states.
pub fn planted(generator: Generator, options: &Options) -> Vec<Planted> {
    let mut rng = Pcg64::seed_from_u64(options.seed);
    let mut state = || match generator {
        Generator::Segments => in_segments(&mut rng),
        _ => random_state(generator, options, &mut rng),
    };
    (0..options.states).map(|_| state()).collect()
}

fn random_state(generator: Generator, options: &Options, rng: &mut Pcg64) -> Planted {
    let dependent = rng.random_bool(options.dependent);
    let leak_free = options.arm == Arm::LeakFree;
    let mut joint = generator.joint(dependent || leak_free, rng);
    if leak_free && !dependent {
        joint = product_of_margins(&joint);
    }

    let visits = generator.visits().sample(rng);
    let table = match options.arm {
        Arm::Shuffled => shuffled(&joint, visits, rng),
        _ if visits > ONE_BY_ONE => multinomial(&joint, visits, rng),
        _ => Table::from_counts(
            draw(&joint, visits, rng)
                .into_iter()
                .map(|(ego, other)| (ego, other, 1)),
        ),
    };

    Planted {
        table,
        information: information(&joint),
        dependent,
        segments: Vec::new(),
    }
}

fn shuffled(joint: &[Vec<f64>], visits: usize, rng: &mut Pcg64) -> Table {
    let seen = draw(joint, visits, rng);
    let mut others: Vec<u64> = seen.iter().map(|(_, other)| *other).collect();
    shuffle(&mut others, rng);
    Table::from_counts(
        seen.into_iter()
            .zip(others)
            .map(|((ego, _), other)| (ego, other, 1)),
    )
}

fn in_segments(rng: &mut Pcg64) -> Planted {
    let mut all = Vec::with_capacity(SEGMENTS * SEGMENT_VISITS);
    let mut segment = || {
        let seen = draw(&hard::segment(rng), SEGMENT_VISITS, rng);
        all.extend_from_slice(&seen);
        Table::from_counts(seen.into_iter().map(|(ego, other)| (ego, other, 1)))
    };

    let segments = (0..SEGMENTS).map(|_| segment()).collect();
    let table = Table::from_counts(all.into_iter().map(|(ego, other)| (ego, other, 1)));
    Planted {
        table,
        information: 0.0,
        dependent: false,
        segments,
    }
}
