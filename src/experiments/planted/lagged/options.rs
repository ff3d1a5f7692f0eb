//! Parameters of the experiment: which worlds, how many states, for which seeds, and what is asked.

use crate::experiments::seeds::Seeds;
use crate::simulation::planted::lagged::{self as drawn, Asked, WORLDS};

/// Draws of each state.
pub const DRAWS: usize = 200;

/// The greatest lag that is asked about.
pub const MOST_LAG: usize = 8;

/// A world of so many states, half of which are near.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct World {
    /// What the agents do.
    pub drawn: drawn::World,
    /// How many states there are.
    pub states: usize,
}

/// Parameters of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Which seeds.
    pub seeds: Seeds,
    /// States of each world.
    pub states: usize,
    /// What the agents do.
    pub worlds: Vec<drawn::World>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seeds: Seeds {
                number: 10,
                first: 1,
            },
            states: drawn::Options::default().states,
            worlds: WORLDS.to_vec(),
        }
    }
}

impl Options {
    /// Returns the worlds that are drawn, for every seed.
    pub fn worlds(&self) -> Vec<World> {
        let world = |drawn: &drawn::World| World {
            drawn: *drawn,
            states: self.states,
        };
        self.worlds.iter().map(world).collect()
    }
}

impl World {
    /// Returns how many states are near.
    pub(super) fn near(&self) -> usize {
        self.states.div_ceil(2)
    }

    pub(super) fn options(&self, seed: u64) -> drawn::Options {
        drawn::Options {
            states: self.states,
            near: self.near(),
            seed,
            ..drawn::Options::default()
        }
    }
}

/// Returns every question: the leader about the follower at each lag, then the reverse.
pub fn asked() -> Vec<Asked> {
    let lags = |ego| (0..=MOST_LAG).map(move |lag| Asked { ego, lag });
    [0, 1].into_iter().flat_map(lags).collect()
}

/// Returns the world of a name.
pub fn named(text: &str) -> Option<drawn::World> {
    WORLDS.into_iter().find(|world| world.name == text)
}
