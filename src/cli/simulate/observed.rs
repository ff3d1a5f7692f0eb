//! What is handed over of a hallway, in whichever way: what its environment is, and what is
//! observed in a trial.

use crate::api::json::description_of_text;
use crate::cli::Failure;
use crate::cli::lags::Lags;
use crate::domain::Schema;
use crate::domain::draft::DescriptionDraft;
use crate::error::Problem;
use crate::simulation::hallway::Hallway;
use crate::simulation::observation::{self, Observations};

/// Returns the description of the environment, with what both do at these lags.
pub(super) fn description(lags: &Lags) -> Result<DescriptionDraft, Failure> {
    let mut description = description_of_text(observation::DESCRIPTION)?;
    description.schema.lags = lags.numbers().iter().copied().map(i64::from).collect();
    Ok(description)
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
