//! Batches of transitions: a document, or a transition a line.
//!
//! What is wrong with a batch itself fails it as a whole. What is wrong with one transition rejects that record and keeps its place, so every
//! transition is first cut out as text and then read on its own.

use std::collections::{BTreeMap, HashSet};

use serde::Deserialize;
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::loose::{Loose, named};
use super::{decode, pointer};
use crate::api::grpc;
use crate::domain::{Batch, Entry, ProducerId, Record, Records, Schema, Widths};
use crate::error::{Fault, Problem};

/// A numbered batch of transitions, counted as a whole or not at all.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of producer, sequence, segment and transitions")]
pub struct Transitions<'a> {
    /// Who sends: 1 to 128 of A-Z, a-z, 0-9, '.', '_', ':', '@' and '-', beginning with a letter or a digit.
    #[schema(example = "game-7")]
    pub producer: String,
    /// 1, 2, 3, ... per environment and producer.
    #[schema(example = 1, minimum = 1)]
    pub sequence: u64,
    /// Where its transitions come from: a trial, a split, a policy version.
    #[serde(default)]
    #[schema(example = "trial-3")]
    pub segment: Option<String>,
    /// The transitions, at most 10,000.
    #[serde(borrow)]
    #[schema(value_type = Vec<Transition>)]
    pub transitions: Vec<&'a RawValue>,
}

/// One transition: a state and what every agent did there. Also a line of `application/x-ndjson`.
#[derive(Debug, ToSchema)]
pub struct Transition {
    /// A value a feature: a number in the feature's unit, or a label.
    #[schema(value_type = BTreeMap<String, Object>, example = json!({"distance": 1.2, "held": "onion"}))]
    pub state: BTreeMap<String, serde_json::Value>,
    /// A value an action feature, by agent and feature; bare where the agent's action has one feature.
    #[schema(value_type = BTreeMap<String, Object>, example = json!({"robot": {"turn": 0.1, "speed": 0}, "human": "stay"}))]
    pub actions: BTreeMap<String, serde_json::Value>,
    /// Whether this step entered its state (true) or a stay goes on (false); absent if the sender does not say.
    pub entry: Option<bool>,
    /// How often it was observed, for counts that were merged elsewhere; absent for once.
    #[schema(minimum = 1)]
    pub count: Option<u64>,
}

/// A decoded batch and who sent it.
#[derive(Debug, Clone, PartialEq)]
pub struct Incoming {
    /// Who sent it.
    pub producer: ProducerId,
    /// The batch.
    pub batch: Batch,
}

/// Decodes a batch that is one JSON document.
pub fn batch_of_json(schema: &Schema, body: &[u8]) -> Result<Incoming, Problem> {
    let Transitions { producer, sequence, segment, transitions } = decode("batch", body)?;
    grpc::within_limit(transitions.len())?;
    let texts = transitions.into_iter().map(|transition| transition.get().as_bytes());
    head(&producer, sequence, segment.as_deref(), collect(schema, texts))
}

/// Decodes a batch that is a transition a line; lines that are empty are passed over.
pub fn batch_of_lines(
    schema: &Schema,
    (producer, sequence, segment): (String, u64, Option<String>),
    body: &[u8],
) -> Result<Incoming, Problem> {
    let lines: Vec<&[u8]> =
        body.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii).filter(|line| !line.is_empty()).collect();
    grpc::within_limit(lines.len())?;
    head(&producer, sequence, segment.as_deref(), collect(schema, lines.into_iter()))
}

fn head(producer: &str, sequence: u64, segment: Option<&str>, records: Records) -> Result<Incoming, Problem> {
    let producer =
        producer.parse().map_err(|detail: String| Problem::invalid("batch", vec![Fault::new("/producer", detail)]))?;
    let batch = Batch { sequence: grpc::sequence(sequence)?, segment: grpc::segment(segment.unwrap_or(""))?, records };
    Ok(Incoming { producer, batch })
}

fn collect<'a>(schema: &Schema, texts: impl ExactSizeIterator<Item = &'a [u8]>) -> Records {
    Records::collect(Widths::of(schema), texts.map(|text| record(schema, text).map_err(told)))
}

fn record(schema: &Schema, text: &[u8]) -> Result<Record, Vec<Fault>> {
    let value: Loose =
        serde_json::from_slice(text).map_err(|error| vec![Fault::new("", format!("not JSON: {error}"))])?;
    let Loose::Object(members) = value else {
        return Err(vec![Fault::new("", format!("got {value}, expected an object of state and actions"))]);
    };
    let mut fields = Fields::default();
    members.into_iter().for_each(|(name, value)| fields.take(name, value));
    let Fields { state, actions, entry, count, mut faults } = fields;
    let state = keep(object("/state", state).and_then(|members| state_values(schema, members)), &mut faults);
    let actions = keep(object("/actions", actions).and_then(|members| action_values(schema, members)), &mut faults);
    let entry = keep(entry_of(entry), &mut faults);
    let count = keep(count_of(count), &mut faults);
    match (state, actions, entry, count) {
        (Some(state), Some(actions), Some(entry), Some(count)) if faults.is_empty() => {
            Ok(Record { state, actions, entry, count })
        }
        _ => Err(faults),
    }
}

/// The members of a transition, each at most once.
#[derive(Default)]
struct Fields {
    state: Option<Loose>,
    actions: Option<Loose>,
    entry: Option<Loose>,
    count: Option<Loose>,
    faults: Vec<Fault>,
}

impl Fields {
    fn take(&mut self, name: String, value: Loose) {
        let field = match name.as_str() {
            "state" => &mut self.state,
            "actions" => &mut self.actions,
            "entry" => &mut self.entry,
            "count" => &mut self.count,
            _ => {
                let detail = "unknown field, expected state, actions, entry or count";
                return self.faults.push(Fault::new(pointer(&name), detail));
            }
        };
        if field.replace(value).is_some() {
            self.faults.push(Fault::new(pointer(&name), "given twice, expected once"));
        }
    }
}

/// Returns the value, or `None` after adding its faults to the rest.
fn keep<T>(checked: Result<T, Vec<Fault>>, faults: &mut Vec<Fault>) -> Option<T> {
    checked.map_err(|more| faults.extend(more)).ok()
}

fn object(at: &str, value: Option<Loose>) -> Result<Vec<(String, Loose)>, Vec<Fault>> {
    match value {
        Some(Loose::Object(members)) => Ok(members),
        Some(other) => Err(vec![Fault::new(at, format!("got {other}, expected an object"))]),
        None => Err(vec![Fault::new(at, "missing, expected an object")]),
    }
}

fn state_values(schema: &Schema, members: Vec<(String, Loose)>) -> Result<Vec<f32>, Vec<Fault>> {
    schema.state_values(&named(members)).map_err(|faults| under("/state", faults))
}

fn action_values(schema: &Schema, members: Vec<(String, Loose)>) -> Result<Vec<f32>, Vec<Fault>> {
    let mut seen = HashSet::new();
    let doubled = members.iter().filter(|(agent, _)| !seen.insert(agent.as_str()));
    let mut faults: Vec<Fault> =
        doubled.map(|(agent, _)| Fault::new(pointer(agent), "given twice, expected once")).collect();
    let actions: Vec<_> = members.into_iter().map(|(agent, action)| (agent, action.into_action())).collect();
    let values = keep(schema.action_values(&actions), &mut faults);
    values.filter(|_| faults.is_empty()).ok_or_else(|| under("/actions", faults))
}

fn under(prefix: &str, faults: Vec<Fault>) -> Vec<Fault> {
    faults.into_iter().map(|fault| fault.under(prefix)).collect()
}

fn entry_of(value: Option<Loose>) -> Result<Entry, Vec<Fault>> {
    match value {
        None => Ok(Entry::Unknown),
        Some(Loose::Bool(flag)) => Ok(Entry::from(Some(flag))),
        Some(other) => Err(vec![Fault::new("/entry", format!("got {other}, expected true or false"))]),
    }
}

fn count_of(value: Option<Loose>) -> Result<u64, Vec<Fault>> {
    /// Above it, f64 does not tell neighbouring whole numbers apart.
    const LARGEST_EXACT: f64 = 9_007_199_254_740_992.0;
    match value {
        None => Ok(1),
        Some(Loose::Whole(count)) if count >= 1 => Ok(count),
        // JSON knows no integers: some writers say 2.0.
        Some(Loose::Number(count)) if count.fract() == 0.0 && (1.0..=LARGEST_EXACT).contains(&count) => {
            Ok(count as u64)
        }
        Some(other) => Err(vec![Fault::new("/count", format!("got {other}, expected a whole number, at least 1"))]),
    }
}

/// Joins the faults of one record: the first one's place, and what is wrong, briefly, because receipts are kept.
fn told(faults: Vec<Fault>) -> (String, String) {
    const TOLD: usize = 4;
    const LONGEST: usize = 200;
    let brief = |text: &str| text.chars().take(LONGEST).collect::<String>();
    let mut parts: Vec<String> = faults.iter().take(1).map(|first| brief(&first.detail)).collect();
    parts.extend(faults.iter().take(TOLD).skip(1).map(|fault| brief(&fault.to_string())));
    if faults.len() > TOLD {
        parts.push(format!("and {} more", faults.len() - TOLD));
    }
    (faults.first().map(|first| brief(&first.pointer)).unwrap_or_default(), parts.join("; "))
}

#[cfg(test)]
mod tests;
