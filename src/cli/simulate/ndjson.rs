//! Transitions as newline-delimited JSON, as `POST /v1/environments/{e}/transitions` takes them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use serde::Serialize;

use super::observed::{description, observed};
use crate::cli::Failure;
use crate::cli::lags::Lags;
use crate::cli::output::cannot_write;
use crate::domain::{Entry, Record, Schema};
use crate::error::Problem;
use crate::simulation::hallway::Hallway;

/// Writes every transition of a hallway to a file, or to standard output if it is called `-`.
pub(super) fn write(hallway: &Hallway, file: &Path, lags: &Lags) -> Result<(), Failure> {
    let schema = Schema::try_from(&description(lags)?.schema)
        .map_err(|faults| Problem::invalid("environment", faults))?;
    let failed = |error| cannot_write(file, &error);
    let out: Box<dyn Write> = if file == Path::new("-") {
        Box::new(io::stdout().lock())
    } else {
        Box::new(File::create(file).map_err(failed)?)
    };
    let mut out = BufWriter::new(out);
    for number in 1..=hallway.protocol().trials {
        for observation in observed(hallway, number, &schema)?.flatten() {
            writeln!(out, "{}", line(&schema, &observation.transition)).map_err(failed)?;
        }
    }

    out.flush().map_err(failed)
}

#[derive(Serialize)]
struct Line<'a> {
    state: BTreeMap<&'a str, f32>,
    actions: BTreeMap<&'a str, BTreeMap<&'a str, f32>>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    outcomes: BTreeMap<&'a str, BTreeMap<&'a str, f32>>,
    entry: bool,
}

/// Returns a transition by the names of an environment, on one line.
fn line(schema: &Schema, transition: &Record) -> String {
    let state = schema.state().iter().zip(&transition.state);
    let mut actions: BTreeMap<&str, BTreeMap<&str, f32>> = BTreeMap::new();
    for ((agent, feature), value) in schema.action_features().zip(&transition.actions) {
        actions
            .entry(agent.name.as_str())
            .or_default()
            .insert(feature.name.as_str(), *value);
    }

    let line = Line {
        state: state
            .map(|(feature, value)| (feature.name.as_str(), *value))
            .collect(),
        actions,
        outcomes: outcomes(schema, transition),
        entry: transition.entry == Entry::Entered,
    };

    serde_json::to_string(&line).expect("names are text")
}

/// Returns the outcomes that were observed, by name.
fn outcomes<'a>(
    schema: &'a Schema,
    transition: &Record,
) -> BTreeMap<&'a str, BTreeMap<&'a str, f32>> {
    let mut values = transition.outcomes.iter();
    let mut observed = BTreeMap::new();
    for (at, outcome) in schema.outcomes().iter().enumerate() {
        let features = outcome.value.iter().map(|feature| feature.name.as_str());
        let value: BTreeMap<&str, f32> = features.zip(values.by_ref().copied()).collect();

        let present = transition.outcomes_present.get(at);
        if !value.is_empty() && present.copied().unwrap_or(true) {
            observed.insert(outcome.name.as_str(), value);
        }
    }
    observed
}
