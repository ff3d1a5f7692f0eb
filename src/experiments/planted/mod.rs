//! Planted influence: worlds in which it is known which states have influence and how much, and what each way of deciding makes of them.
//!
//! Three generators of states, each beside two arms that take something away: where the other's actions are shuffled nothing is left to find, and
//! where a state without influence has the margins of one with influence, margins give nothing away. Then worlds of other sizes, with influence
//! nowhere, in some states and everywhere. And hard worlds, which the evidence was not built on: other alphabets, other habits, other volumes.

mod case;
mod decision;
mod figure;
pub mod hard;
mod plot;
mod report;
pub mod segments;
mod targets;
mod world;

use futures::{StreamExt, TryStreamExt, stream};

pub use case::Case;
pub use decision::Decision;
pub use figure::{Figure, measure};
pub use plot::plot;
pub use report::Report;
pub use targets::{Findings, Target};
pub use world::{World, arm_name, generator_name};

use super::findings;
use super::seeds::Seeds;
use crate::error::Problem;
use crate::simulation::planted::{Arm, Generator};
use figure::Measured;

/// The percentage of states with influence that targets and arms are stated for.
pub const USUAL_SHARE: u32 = 30;

/// Percentages of states with influence.
pub const SHARES: [u32; 3] = [0, USUAL_SHARE, 100];

/// The sizes of the smaller worlds.
const FEWER_STATES: [usize; 2] = [50, 200];

/// Worlds at work at once: while one is drawn and sent, the other is asked.
const AT_ONCE: usize = 2;

/// What is run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Which seeds.
    pub seeds: Seeds,
    /// States of the largest worlds, on which the decisions are compared.
    pub states: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { seeds: Seeds { number: 10, first: 1 }, states: 2_500 }
    }
}

impl Options {
    /// Returns the sizes of worlds, ascending.
    pub fn sizes(&self) -> Vec<usize> {
        FEWER_STATES.into_iter().filter(|fewer| *fewer < self.states).chain([self.states]).collect()
    }

    /// Returns the world of a generator and an arm on which all decisions are compared.
    pub fn compared(&self, generator: Generator, arm: Arm) -> World {
        World { generator, arm, states: self.states, dependent: USUAL_SHARE }
    }

    /// Returns the worlds that are drawn, for every seed: those on which all decisions are compared, then those of other sizes and shares.
    pub fn worlds(&self) -> Vec<World> {
        let compared = Generator::USUAL
            .into_iter()
            .flat_map(|generator| [Arm::Plain, Arm::LeakFree, Arm::Shuffled].map(|arm| self.compared(generator, arm)));
        let varied = Generator::USUAL.into_iter().flat_map(|generator| {
            let varied = self.sizes().into_iter().flat_map(|states| SHARES.map(|dependent| (states, dependent)));
            varied.map(move |(states, dependent)| World { generator, arm: Arm::Plain, states, dependent })
        });
        let compared: Vec<World> = compared.collect();
        let varied: Vec<World> = varied.filter(|world| !compared.contains(world)).collect();
        [compared, varied].concat()
    }

    /// Returns the decisions that are made in a world: all of them where they are compared, else only those that end in a verdict.
    fn decisions(&self, world: &World) -> &'static [Decision] {
        let is_compared = *world == self.compared(world.generator, world.arm);
        if is_compared { &Decision::ALL } else { &Decision::WITH_VERDICT }
    }
}

/// Runs the experiment; `done` is called after each world of each seed.
pub async fn run(options: &Options, done: impl FnMut()) -> Result<Report, Problem> {
    let decisions = |world: &World| options.decisions(world);
    let findings = measured(&options.worlds(), options.seeds, decisions, &Figure::USUAL, done).await?;
    Ok(Report { options: *options, findings })
}

/// Measures the decisions that are made in each world, for every seed.
async fn measured(
    worlds: &[World],
    seeds: Seeds,
    decisions: impl Fn(&World) -> &'static [Decision],
    figures: &[Figure],
    mut done: impl FnMut(),
) -> Result<Findings, Problem> {
    let runs = worlds.iter().flat_map(|world| seeds.iter().map(|seed| (*world, seed)));
    let run = async |(world, seed): (World, u64)| -> Result<Measured, Problem> {
        let decisions = decisions(&world);
        Ok(figure::measure(decisions, figures, &world.cases(seed, decisions).await?))
    };
    let measured = stream::iter(runs).map(run).buffered(AT_ONCE).inspect_ok(|_| done());
    let measured: Vec<Measured> = measured.try_collect().await?;

    let worlds = worlds.iter().zip(measured.chunks(seeds.number as usize));
    let findings = worlds.flat_map(|(world, of_seeds)| findings::over_seeds(*world, of_seeds)).collect();
    Ok(findings::Findings(findings))
}
