//! Why no network is made, as problems that callers are told: it would be too large, there is too
//! little to learn from, or something failed.

use super::encoder::{self, MOST_INPUTS};
use super::letters::Letters;
use super::member::Interaction;
use super::training::TrainingError;
use super::{file, member};
use crate::domain::{Environment, Pair, Training};
use crate::error::{ErrorKind, Problem};
use crate::evidence::MOST_CELLS;

/// The most cells of all strata at a lag: forty actions of each agent, in as many strata.
const MOST_STRATIFIED_CELLS: u64 = 1 << 16;

/// Says what is too large for a network.
pub fn check_size(
    environment: &Environment,
    pair: &Pair,
    training: &Training,
) -> Result<(), Problem> {
    let inputs = encoder::width(&environment.schema);
    let letters = Letters::of_pair(&environment.schema, pair);
    let cells = letters.actions;

    if inputs > MOST_INPUTS {
        return Err(too_large(format!(
            "a state is {inputs} numbers, more than the {MOST_INPUTS} that a network takes"
        )));
    }

    if cells.rows.saturating_mul(cells.columns) > MOST_CELLS {
        return Err(too_large(format!(
            "the agents have {} x {} actions, more than {MOST_CELLS} pairs",
            cells.rows, cells.columns
        )));
    }

    if pair.later.is_some() && letters.cells() > MOST_STRATIFIED_CELLS {
        let problem = too_large(format!(
            "the agents have {} x {} actions in each of {} strata, one for each of the other's own actions a step before, more than {MOST_STRATIFIED_CELLS} in all",
            cells.rows, cells.columns, letters.strata
        ));
        return Err(problem);
    }

    let outputs: usize = member::heads(training.kind, letters, Interaction::ByStratum)
        .iter()
        .map(|(_, outputs)| outputs)
        .sum();
    let numbers = training.members * (training.width * (inputs + outputs + 1) + outputs);

    // A part of the file is for names and the card.
    if numbers * size_of::<f32>() > file::MOST_BYTES - (1 << 20) {
        return Err(too_large(format!(
            "it would have {numbers} weights; take fewer members or a smaller width"
        )));
    }
    Ok(())
}

fn too_large(message: String) -> Problem {
    Problem::new(ErrorKind::TooLarge, "NETWORK_TOO_LARGE", message)
}

/// Says why a training came to no network.
pub fn no_network(error: &TrainingError) -> Problem {
    let (kind, reason) = match error {
        TrainingError::TooFew(_) => (ErrorKind::Conflict, "TOO_FEW_DATA"),
        TrainingError::Diverged(_) => (ErrorKind::Conflict, "TRAINING_DIVERGED"),
        TrainingError::Cancelled => (ErrorKind::Conflict, "CANCELLED"),
    };
    Problem::new(kind, reason, format!("no network is made: {error}"))
}

/// Says that a training ended by a fault of ours, whose cause goes to the log.
pub fn internal(error: &dyn std::fmt::Display) -> Problem {
    tracing::error!(%error, "a training ended unexpectedly");
    Problem::new(
        ErrorKind::Internal,
        "INTERNAL",
        "the training ended unexpectedly; the cause is in the service's log",
    )
}
