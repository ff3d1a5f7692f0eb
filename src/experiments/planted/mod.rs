//! Planted influence: worlds in which it is known which states have influence and how much, and
//! what each way of deciding makes of them.
//!
//! Three generators of states, each beside two arms that take something away: where the other's
//! actions are shuffled nothing is left to find, and where a state without influence has the
//! margins of one with influence, margins give nothing away. Then worlds of other sizes, with
//! influence nowhere, in some states and everywhere. And hard worlds, which the evidence was not
//! built on: other alphabets, other habits, other volumes. And tracks in which one agent copies the
//! other some steps later.

mod case;
mod figure;
pub mod hard;
pub mod lagged;
mod method;
mod options;
mod plot;
mod report;
pub mod segments;
mod targets;
mod world;

use futures::{StreamExt, TryStreamExt, stream};

pub use case::Case;
pub use figure::{Figure, measure};
pub use method::Method;
pub use options::{Options, SHARES, USUAL_SHARE};
pub use plot::plot;
pub use report::Report;
pub use targets::{Findings, Target};
pub use world::{World, arm_name, generator_name};

use super::findings;
use super::seeds::Seeds;
use crate::error::Problem;
use figure::Measured;

/// Worlds at work at once: while one is drawn and sent, the other is asked.
const AT_ONCE: usize = 2;

/// Runs the experiment; `done` is called after each world of each seed.
pub async fn run(options: &Options, done: impl FnMut()) -> Result<Report, Problem> {
    let methods = |world: &World| options.methods(world);
    let findings = measured(
        &options.worlds(),
        options.seeds,
        methods,
        &Figure::USUAL,
        done,
    )
    .await?;
    Ok(Report {
        options: *options,
        findings,
    })
}

/// Measures the methods that are made in each world, for every seed.
async fn measured(
    worlds: &[World],
    seeds: Seeds,
    methods: impl Fn(&World) -> &'static [Method],
    figures: &[Figure],
    mut done: impl FnMut(),
) -> Result<Findings, Problem> {
    let runs = worlds
        .iter()
        .flat_map(|world| seeds.iter().map(|seed| (*world, seed)));
    let run = async |(world, seed): (World, u64)| -> Result<Measured, Problem> {
        let methods = methods(&world);
        Ok(figure::measure(
            methods,
            figures,
            &world.cases(seed, methods).await?,
        ))
    };
    let measured = stream::iter(runs)
        .map(run)
        .buffered(AT_ONCE)
        .inspect_ok(|_| done());
    let measured: Vec<Measured> = measured.try_collect().await?;

    let worlds = worlds.iter().zip(measured.chunks(seeds.number as usize));
    let findings = worlds
        .flat_map(|(world, of_seeds)| findings::over_seeds(*world, of_seeds))
        .collect();
    Ok(findings::Findings(findings))
}
