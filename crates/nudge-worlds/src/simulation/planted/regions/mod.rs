//! Regions in which influence was planted, among states where it was not (subgroup discovery): 900
//! states of six features, eight segments, and as many draws as are asked for.
//!
//! Visits are uneven: some states have hundreds, most a few. In the planted region the other copies
//! the ego so often that the mutual information of its states is as large as is asked for; elsewhere,
//! and everywhere in the worlds of [`NULLS`], it acts by its habits.

use nudge_core::domain::Entry;
use nudge_core::tracks::EntryRule;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use super::joint::{dirichlet, shuffle};

mod searched;
#[cfg(test)]
mod tests;

pub use searched::{Tested, axes, is_exact, planted_z, searched};

/// How many bins each feature has.
pub const BINS: [u32; 6] = [5, 4, 2, 6, 3, 4];
/// The features whose bins have no order.
pub const UNORDERED: [usize; 2] = [2, 4];
/// States, segments, and actions of either agent.
pub const STATES: usize = 900;
/// How many segments there are.
pub const SEGMENTS: usize = 8;
/// How many actions either agent has.
pub const ACTIONS: usize = 5;

/// How uneven visits are: the standard deviation of their logarithm.
const UNEVEN: f64 = 1.0;
/// How often an action is held from one step to the next, where it is.
const HELD: f64 = 0.9;
/// Steps of one track where actions are held, and of how many states it is.
const TRACK: usize = 1_000;
const ROAMED: usize = 40;

/// How agents act.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum World {
    /// In a region of two conditions the other copies the ego: mutual information in nats.
    Planted(f64),
    /// Nobody depends on anybody, and everybody has the same habits everywhere.
    Independent,
    /// Likewise, but habits differ from segment to segment: all segments together, they depend.
    Simpson,
    /// Likewise, but actions are held from step to step: what counts is what a game server would flag.
    Held,
}

/// The worlds in which nothing is to be found.
pub const NULLS: [World; 3] = [World::Independent, World::Simpson, World::Held];

/// The features and the bins of the planted region: from the first to before the last.
pub const PLANTED: [(usize, [u32; 2]); 2] = [(0, [1, 4]), (2, [1, 2])];

/// One draw: where, and what both did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Draw {
    /// Which state.
    pub state: usize,
    /// Which segment.
    pub segment: usize,
    /// What the ego did.
    pub ego: usize,
    /// What the other did.
    pub other: usize,
}

/// What was drawn.
#[derive(Debug, Clone)]
pub struct Drawn {
    /// The bins of each state.
    pub states: Vec<[u32; 6]>,
    /// The draws, in order.
    pub draws: Vec<Draw>,
}

/// Draws from a world; the same seed gives the same.
pub fn drawn(world: World, draws: usize, seed: u64) -> Drawn {
    let mut random = Pcg64::seed_from_u64(seed);
    let states = states(&mut random);
    let play = Play {
        copies: match world {
            World::Planted(information) => share_of_copies(information),
            _ => 0.0,
        },
        habits: habits(world, &mut random),
        visits: visits(&mut random),
        states,
    };
    let draws = match world {
        World::Held => play.held(draws, &mut random),
        _ => (0..draws).map(|_| play.draw(&mut random)).collect(),
    };
    Drawn {
        states: play.states,
        draws,
    }
}

/// Returns whether a state lies in the planted region.
pub fn is_planted(bins: &[u32]) -> bool {
    PLANTED
        .iter()
        .all(|(feature, [first, end])| (*first..*end).contains(&bins[*feature]))
}

/// Draws different states.
fn states(random: &mut Pcg64) -> Vec<[u32; 6]> {
    let all: u32 = BINS.iter().product();
    let mut numbers: Vec<u32> = (0..all).collect();
    shuffle(&mut numbers, random);
    let bins = |mut number: u32| {
        BINS.map(|bins| {
            let bin = number % bins;
            number /= bins;
            bin
        })
    };
    numbers.into_iter().take(STATES).map(bins).collect()
}

/// Draws the habits of the ego and of the other in each segment.
fn habits(world: World, random: &mut Pcg64) -> Vec<[Choice; 2]> {
    let mut draw =
        |concentration| [(); 2].map(|()| choice(&dirichlet(concentration, ACTIONS, random)));
    if world == World::Simpson {
        return (0..SEGMENTS).map(|_| draw(1.0)).collect();
    }
    vec![draw(20.0); SEGMENTS]
}

fn visits(random: &mut Pcg64) -> Choice {
    let uneven = Normal::new(0.0, UNEVEN).expect("a positive deviation");
    let weights: Vec<f64> = (0..STATES)
        .map(|_| f64::exp(uneven.sample(random)))
        .collect();
    choice(&weights)
}

/// One of some numbers, by weights: their sums up to each.
#[derive(Debug, Clone)]
struct Choice(Vec<f64>);

fn choice(weights: &[f64]) -> Choice {
    let mut sum = 0.0;
    let up_to = |weight: &f64| {
        sum += weight;
        sum
    };
    Choice(weights.iter().map(up_to).collect())
}

impl Choice {
    fn sample(&self, random: &mut Pcg64) -> usize {
        let all = self.0.last().copied().unwrap_or(0.0);
        let at = random.random_range(0.0..all);
        self.0.partition_point(|sum| *sum <= at)
    }
}

/// Returns how often the other must copy so that mutual information is that large, where either
/// would take any action alike.
fn share_of_copies(information: f64) -> f64 {
    let all = ACTIONS as f64;
    let told = |copies: f64| {
        let same = copies + (1.0 - copies) / all;
        let others = (1.0 - same) / (all - 1.0);
        all.ln() + same * same.ln() + (1.0 - same) * others.ln()
    };
    let (mut low, mut high) = (0.0, 1.0 - 1e-9);
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if told(middle) < information {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

/// How a world goes on.
struct Play {
    states: Vec<[u32; 6]>,
    visits: Choice,
    habits: Vec<[Choice; 2]>,
    copies: f64,
}

impl Play {
    fn draw(&self, random: &mut Pcg64) -> Draw {
        let segment = random.random_range(0..SEGMENTS);
        let state = self.visits.sample(random);
        let [ego, other] = self.habits[segment]
            .each_ref()
            .map(|habits| habits.sample(random));
        let copies = is_planted(&self.states[state]) && random.random_bool(self.copies);
        Draw {
            state,
            segment,
            ego,
            other: if copies { ego } else { other },
        }
    }

    /// Returns the entries of tracks in which both hold their actions.
    fn held(&self, draws: usize, random: &mut Pcg64) -> Vec<Draw> {
        let mut counted = Vec::with_capacity(draws);
        let mut track = 0;
        while counted.len() < draws {
            self.track(track % SEGMENTS, draws, random, &mut counted);
            track += 1;
        }
        counted
    }

    /// Adds the entries of one track, which comes by the same few states over and over.
    fn track(&self, segment: usize, draws: usize, random: &mut Pcg64, counted: &mut Vec<Draw>) {
        let roamed: Vec<usize> = (0..ROAMED).map(|_| self.visits.sample(random)).collect();
        let mut rule = EntryRule::new([ACTIONS as u64; 2]);
        let mut acts = self.habits[segment]
            .each_ref()
            .map(|habits| habits.sample(random));
        for _ in 0..TRACK {
            let state = roamed[random.random_range(0..ROAMED)];
            for (action, habits) in acts.iter_mut().zip(&self.habits[segment]) {
                if !random.random_bool(HELD) {
                    *action = habits.sample(random);
                }
            }
            let [ego, other] = acts;
            let entry = rule.entry(&state, &acts.map(|action| Some(action as u64)));
            if entry == Entry::Entered && counted.len() < draws {
                counted.push(Draw {
                    state,
                    segment,
                    ego,
                    other,
                });
            }
        }
    }
}
