//! Parameters of the experiment: which worlds of segments, how often each state of theirs is seen,
//! and for which seeds.

use crate::experiments::seeds::Seeds;
use crate::simulation::planted::segments::{self as drawn, WORLDS};

/// Visits of a state: those that targets are stated for.
pub const VISITS: [usize; 2] = [30, 150];

/// The false discovery rate of lists.
pub const FDR: f64 = 0.05;

/// A world: a kind of states, how often each is seen, and how many there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct World {
    /// How its states come about.
    pub drawn: drawn::World,
    /// Visits of each state.
    pub visits: usize,
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
    /// The kinds of states.
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
        let with_visits = |visits| self.worlds.iter().map(move |drawn| (*drawn, visits));
        let worlds = VISITS.into_iter().flat_map(with_visits);
        worlds
            .map(|(drawn, visits)| World {
                drawn,
                visits,
                states: self.states,
            })
            .collect()
    }
}

/// Returns the kind of states of a name.
pub fn named(text: &str) -> Option<drawn::World> {
    WORLDS.into_iter().find(|world| world.name == text)
}
