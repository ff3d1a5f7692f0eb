//! Planted influence where people were: the states that players of Overcooked visited, with
//! policies fitted to theirs, and an other that answers the ego in a known way.
//!
//! The training games are counted; the states that only the test games have are asked about. Counts
//! say nothing of them, so what is compared is what can be said without: networks, coarser tables,
//! and rules of thumb. Only the actions are drawn: the states and how often they are visited are
//! those of the recordings, whatever the seed.

mod figure;
mod layout;
mod method;
mod options;
mod plot;
mod policy;
mod report;
mod response_model;
mod scene;
mod targets;
mod trial;
mod visits;

use futures::{StreamExt, TryStreamExt, stream};

pub use figure::Figure;
pub use layout::Layout;
pub use method::Method;
pub use options::{Options, World};
pub use plot::plot;
pub use report::{Facts, Report};
pub use response_model::ResponseModel;
pub use targets::Target;

use super::findings;
use crate::error::Problem;
use figure::Measured;
use scene::Scene;
use visits::Visits;

/// Worlds at work at once: each is at most one training at a time, which takes one core.
const AT_ONCE: usize = 2;

/// Runs the experiment; `done` is called after each world of each seed.
pub async fn run(options: &Options, mut done: impl FnMut()) -> Result<Report, Problem> {
    let worlds = scenes(options);
    let runs = worlds
        .iter()
        .flat_map(|(_, scene)| options.seeds.iter().map(move |seed| (scene, seed)));
    let run = async |(scene, seed): (&Scene, u64)| -> Result<Measured, Problem> {
        Ok(figure::measure(
            &trial::trial(scene, seed, options.epochs).await?,
        ))
    };

    let measured = stream::iter(runs)
        .map(run)
        .buffered(AT_ONCE)
        .inspect_ok(|_| done());
    let measured: Vec<Measured> = measured.try_collect().await?;
    let findings = worlds
        .iter()
        .zip(measured.chunks(options.seeds.number as usize));
    let findings = findings
        .flat_map(|((world, _), of_seeds)| findings::over_seeds(*world, of_seeds))
        .collect();
    let worlds = worlds
        .iter()
        .map(|(world, scene)| (*world, Facts::of_scene(scene)))
        .collect();

    Ok(Report {
        options: options.clone(),
        worlds,
        findings: findings::Findings(findings),
    })
}

fn scenes(options: &Options) -> Vec<(World, Scene)> {
    let visits: Vec<(Layout, Visits)> = options
        .layouts
        .iter()
        .map(|layout| (*layout, Visits::of_layout(*layout)))
        .collect();
    let of = |(layout, visits): &(Layout, Visits), response_model: ResponseModel| {
        (
            World {
                layout: *layout,
                response_model,
            },
            Scene::of_visits(visits, response_model, options.steps),
        )
    };
    visits
        .iter()
        .flat_map(|visits| {
            options
                .response_models
                .iter()
                .map(move |response_model| of(visits, *response_model))
        })
        .collect()
}
