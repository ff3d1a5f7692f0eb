//! Parameters of the experiment: hard worlds by their names, at their usual sizes or smaller, and
//! for which seeds.

use crate::experiments::planted::{Method, USUAL_SHARE, World, generator_name};
use crate::experiments::seeds::Seeds;
use crate::simulation::planted::{Arm, Generator};

/// The one way to decide that is asked.
pub const METHOD: Method = Method::SpikeAndSlab;

/// Parameters of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Which seeds.
    pub seeds: Seeds,
    /// The most states of a world.
    pub states: Option<usize>,
    /// The worlds, at their usual sizes.
    pub worlds: Vec<World>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seeds: Seeds {
                number: 10,
                first: 1,
            },
            states: None,
            worlds: worlds(),
        }
    }
}

impl Options {
    /// Returns the worlds as they are drawn, none larger than wanted.
    pub fn worlds(&self) -> Vec<World> {
        let most = self.states.unwrap_or(usize::MAX);
        self.worlds
            .iter()
            .map(|world| World {
                states: world.states.min(most),
                ..*world
            })
            .collect()
    }
}

/// Returns every hard world at its usual size, in the order in which they are told.
pub fn worlds() -> Vec<World> {
    let everywhere_and_nowhere = [100, 0].map(|dependent| world(Generator::Responses, dependent));
    let hard = Generator::HARD.map(|generator| world(generator, usual_share(generator)));
    [everywhere_and_nowhere.as_slice(), &hard].concat()
}

/// Returns the hard world of a name.
pub fn named(text: &str) -> Option<World> {
    worlds().into_iter().find(|world| name(world) == text)
}

/// Returns the name of a hard world.
pub fn name(world: &World) -> &'static str {
    match (world.generator, world.dependent) {
        (Generator::Responses, 100) => "all-dependent",
        (Generator::Responses, 0) => "none",
        (generator, _) => generator_name(generator),
    }
}

fn world(generator: Generator, dependent: u32) -> World {
    World {
        generator,
        arm: Arm::Plain,
        states: usual_states(generator),
        dependent,
    }
}

/// Returns the percentage of dependent states.
fn usual_share(generator: Generator) -> u32 {
    match generator {
        Generator::Weak(_) => 50,
        Generator::Segments => 0,
        _ => USUAL_SHARE,
    }
}

/// Returns how many states are drawn: the larger their tables, the fewer.
fn usual_states(generator: Generator) -> usize {
    match generator {
        Generator::Weak(64) => 150,
        Generator::Answer64 => 400,
        Generator::Weak(25) | Generator::Segments => 500,
        Generator::Stay25 | Generator::Copy(25) => 1_000,
        _ => 1_500,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_world_is_found_by_its_own_name() {
        let found: Vec<World> = worlds()
            .iter()
            .map(|world| named(name(world)).expect("a hard world"))
            .collect();
        assert_eq!(found, worlds());
        assert_eq!(worlds().len(), 16);
    }

    #[test]
    fn no_world_is_larger_than_wanted() {
        let options = Options {
            states: Some(200),
            ..Options::default()
        };
        let states: Vec<usize> = options.worlds().iter().map(|world| world.states).collect();
        assert!(
            states.contains(&150) && states.iter().all(|states| *states == 150 || *states == 200),
            "{states:?}"
        );
    }
}
