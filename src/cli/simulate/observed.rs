//! What is handed over of a hallway, in whichever way: what its environment is, and what is
//! observed in a trial.

use crate::api::json::description_of_text;
use crate::cli::Failure;
use crate::cli::lags::Lags;
use crate::domain::{Schema, SchemaDraft};
use crate::error::Problem;
use crate::simulation::hallway::Hallway;
use crate::simulation::observation::{self, Observations};

/// Returns the description of the environment, with what both do at these lags.
pub(super) fn description(lags: &Lags) -> Result<SchemaDraft, Failure> {
    Ok(SchemaDraft {
        lags: lags.numbers().iter().copied().map(i64::from).collect(),
        ..description_of_text(observation::DESCRIPTION)?.0
    })
}

/// Begins to observe a trial.
pub(super) fn observed(
    hallway: &Hallway,
    number: u32,
    schema: &Schema,
) -> Result<Observations, Failure> {
    let trial = hallway
        .trial(number)
        .map_err(|fault| Problem::invalid("hallway", vec![fault]))?;
    Ok(Observations::of_trial(trial, schema))
}
