//! Batches of transitions: a document, or a transition a line.
//!
//! What is wrong with a batch itself fails it as a whole. What is wrong with one transition rejects
//! that record and keeps its place, so every transition is first cut out as text and then read on
//! its own.

use std::collections::BTreeMap;

use nudge_core::domain::{Batch, ProducerId, Records, Schema, Widths};
use nudge_core::error::{Fault, Problem};
use serde::Deserialize;
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::decode;
use super::record::record;
use super::whole::whole;
use crate::grpc;

/// A numbered batch of transitions, counted as a whole or not at all.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of producer, environment_uid, sequence, segment and transitions"
)]
pub struct Transitions<'a> {
    /// Who sends: 1 to 128 of A-Z, a-z, 0-9, '.', '_', ':', '@' and '-', beginning with a letter or
    /// a digit.
    #[schema(example = "game-7", pattern = "^[A-Za-z0-9][A-Za-z0-9._:@-]{0,127}$")]
    pub producer: String,
    /// The environment's uid if the sender knows it: refused with 409 if the environment was
    /// deleted and made again since. Absent to take it as it is.
    pub environment_uid: Option<String>,
    /// 1, 2, 3, ... per environment and producer.
    #[serde(deserialize_with = "whole")]
    #[schema(example = 1, minimum = 1, maximum = 9_223_372_036_854_775_807_i64)]
    pub sequence: u64,
    /// Where its transitions come from: a trial, a split, a policy version. Absent or empty for no
    /// segment.
    #[schema(example = "trial-3", max_length = 64)]
    pub segment: Option<String>,
    /// The transitions, at most 10,000.
    #[serde(borrow)]
    #[schema(value_type = Vec<Transition>, max_items = 10_000)]
    pub transitions: Vec<&'a RawValue>,
}

/// One transition: a state and what every agent did there. Also a line of `application/x-ndjson`.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Transition {
    /// A value a feature.
    #[schema(example = json!({"distance": 1.2, "held": "onion"}))]
    pub state: BTreeMap<String, FeatureValue>,
    /// An action an agent; null for one that took none, where it may be absent.
    #[schema(example = json!({"robot": {"turn": 0.1, "speed": 0}, "human": "stay"}))]
    pub actions: BTreeMap<String, Action>,
    /// What was observed some steps later, a value an outcome; those that are absent or null were
    /// not observed.
    #[serde(default)]
    #[schema(nullable, example = json!({"human@1": "stay"}))]
    pub outcomes: BTreeMap<String, Action>,
    /// Whether this step entered its state (true) or a stay goes on (false); absent if the sender
    /// does not say.
    pub entry: Option<bool>,
    /// How often it was observed, for counts that were merged elsewhere; absent for once.
    #[schema(minimum = 1, maximum = 9_223_372_036_854_775_807_i64)]
    pub count: Option<u64>,
    /// The track that it is a step of, a game say, by a number of the sender's own. Steps of a track
    /// come in the order of time, and where `entry` is absent the service decides it, from the steps
    /// of that track in the same batch; `count` is 1 then.
    #[schema(minimum = 0, example = 7)]
    pub track: Option<u64>,
}

/// The value of a feature.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum FeatureValue {
    /// In the feature's unit; for labels the one that reads as this number, or its index from 0
    /// where none reads as a number.
    Number(f64),
    /// A label by its very characters; else what the same text is in a query string: a number.
    Label(String),
    /// The label `true` or `false`.
    Truth(bool),
}

/// An agent's action, or the value of an outcome.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum Action {
    /// The value of its only feature.
    Bare(FeatureValue),
    /// A value a feature.
    Features(BTreeMap<String, FeatureValue>),
    /// Null: not taken, or not observed.
    Absent(()),
}

/// What stands beside the transitions of a batch, unchecked.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Head {
    /// Who sends.
    pub producer: String,
    /// The environment's uid.
    pub environment_uid: Option<String>,
    /// The batch's number.
    pub sequence: u64,
    /// Where its transitions come from.
    pub segment: Option<String>,
}

/// A decoded batch and who sent it.
#[derive(Debug, Clone, PartialEq)]
pub struct Incoming {
    /// Who sent it.
    pub producer: ProducerId,
    /// The uid of the environment that it is for; empty for whichever has the name.
    pub environment_uid: String,
    /// The batch.
    pub batch: Batch,
}

/// Decodes a batch that is one JSON document.
pub fn batch_of_json(schema: &Schema, body: &[u8]) -> Result<Incoming, Problem> {
    let Transitions {
        producer,
        environment_uid,
        sequence,
        segment,
        transitions,
    } = decode("batch", body)?;
    grpc::within_limit(transitions.len())?;
    let texts = transitions
        .into_iter()
        .map(|transition| transition.get().as_bytes());

    incoming(
        Head {
            producer,
            environment_uid,
            sequence,
            segment,
        },
        collect(schema, texts),
    )
}

/// Decodes a batch that is a transition a line; lines that are empty are passed over.
pub fn batch_of_lines(schema: &Schema, head: Head, body: &[u8]) -> Result<Incoming, Problem> {
    let lines: Vec<&[u8]> = body
        .split(|byte| *byte == b'\n')
        .map(<[u8]>::trim_ascii)
        .filter(|line| !line.is_empty())
        .collect();
    grpc::within_limit(lines.len())?;
    incoming(head, collect(schema, lines.into_iter()))
}

fn incoming(head: Head, records: Records) -> Result<Incoming, Problem> {
    let Head {
        producer,
        environment_uid,
        sequence,
        segment,
    } = head;
    let producer = producer.parse().map_err(|detail: String| {
        Problem::invalid("batch", vec![Fault::new("/producer", detail)])
    })?;
    let segment = grpc::segment(&segment.unwrap_or_default())?;
    let batch = Batch {
        sequence: grpc::sequence(sequence)?,
        segment,
        records,
    };

    Ok(Incoming {
        producer,
        environment_uid: environment_uid.unwrap_or_default(),
        batch,
    })
}

fn collect<'a>(schema: &Schema, texts: impl ExactSizeIterator<Item = &'a [u8]>) -> Records {
    Records::collect(
        Widths::of_schema(schema),
        texts.map(|text| record(schema, text)),
    )
}

#[cfg(test)]
mod tests;
