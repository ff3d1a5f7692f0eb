//! Parameters of the experiment: which worlds, for which seeds, and which methods are made in them.

use super::{Method, World};
use crate::experiments::seeds::Seeds;
use crate::simulation::planted::{Arm, Generator};

/// The percentage of states with influence that targets and arms are stated for.
pub const USUAL_SHARE: u32 = 30;

/// Percentages of states with influence.
pub const SHARES: [u32; 3] = [0, USUAL_SHARE, 100];

/// The sizes of the smaller worlds.
const FEWER_STATES: [usize; 2] = [50, 200];

/// Parameters of the experiment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Which seeds.
    pub seeds: Seeds,
    /// States of the largest worlds, on which the methods are compared.
    pub states: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seeds: Seeds {
                number: 10,
                first: 1,
            },
            states: 2_500,
        }
    }
}

impl Options {
    /// Returns the sizes of worlds, ascending.
    pub fn sizes(&self) -> Vec<usize> {
        FEWER_STATES
            .into_iter()
            .filter(|fewer| *fewer < self.states)
            .chain([self.states])
            .collect()
    }

    /// Returns the world of a generator and an arm on which all methods are compared.
    pub fn compared(&self, generator: Generator, arm: Arm) -> World {
        World {
            generator,
            arm,
            states: self.states,
            dependent: USUAL_SHARE,
        }
    }

    /// Returns the worlds that are drawn, for every seed: those on which all methods are
    /// compared, then those of other sizes and shares.
    pub fn worlds(&self) -> Vec<World> {
        let compared = Generator::USUAL.into_iter().flat_map(|generator| {
            [Arm::Plain, Arm::LeakFree, Arm::Shuffled].map(|arm| self.compared(generator, arm))
        });
        let varied = Generator::USUAL.into_iter().flat_map(|generator| {
            let varied = self
                .sizes()
                .into_iter()
                .flat_map(|states| SHARES.map(|dependent| (states, dependent)));
            varied.map(move |(states, dependent)| World {
                generator,
                arm: Arm::Plain,
                states,
                dependent,
            })
        });

        let compared: Vec<World> = compared.collect();
        let varied: Vec<World> = varied.filter(|world| !compared.contains(world)).collect();
        [compared, varied].concat()
    }

    /// Returns the methods that are made in a world: all of them where they are compared, else
    /// only those that end in a verdict.
    pub(super) fn methods(&self, world: &World) -> &'static [Method] {
        let is_compared = *world == self.compared(world.generator, world.arm);
        if is_compared {
            &Method::ALL
        } else {
            &Method::WITH_VERDICT
        }
    }
}
