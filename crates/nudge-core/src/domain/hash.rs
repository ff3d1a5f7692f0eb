//! The schema hash: BLAKE3 of an unambiguous encoding of state, agents and outcomes.
//!
//! Every text and list is preceded by its length and every kind by its own letter, so no two
//! schemas encode alike. What is added to schemas later must encode to nothing where it is absent:
//! hashes are kept for ever.

use std::fmt;

use super::{Agent, Angle, Feature, FeatureKind, Outcome};

/// BLAKE3 of a schema: two environments with the same hash count the same way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SchemaHash(pub [u8; 32]);

impl fmt::Display for SchemaHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl std::str::FromStr for SchemaHash {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut bytes = [0; 32];
        let wrong = || format!("got {text:?}, expected 64 hexadecimal digits");
        if text.len() != 64 || !text.is_ascii() {
            return Err(wrong());
        }
        for (byte, i) in bytes.iter_mut().zip((0..64).step_by(2)) {
            *byte = u8::from_str_radix(&text[i..i + 2], 16).map_err(|_| wrong())?;
        }
        Ok(Self(bytes))
    }
}

pub(super) fn schema_hash(state: &[Feature], agents: &[Agent], outcomes: &[Outcome]) -> SchemaHash {
    let mut bytes = b"nudge.schema.v1".to_vec();
    features(&mut bytes, state);
    number(&mut bytes, agents.len() as u64);
    for agent in agents {
        text(&mut bytes, agent.name.as_str());
        features(&mut bytes, &agent.action);
    }
    if agents.iter().any(|agent| agent.may_be_absent) {
        bytes.push(b'a');
        bytes.extend(agents.iter().map(|agent| u8::from(agent.may_be_absent)));
    }
    if !outcomes.is_empty() {
        bytes.push(b'u');
        number(&mut bytes, outcomes.len() as u64);
        outcomes.iter().for_each(|one| outcome(&mut bytes, one));
    }
    SchemaHash(*blake3::hash(&bytes).as_bytes())
}

fn outcome(bytes: &mut Vec<u8>, outcome: &Outcome) {
    text(bytes, &outcome.name);
    number(bytes, u64::from(outcome.lag));
    match outcome.agent {
        Some(agent) => {
            bytes.push(b'a');
            number(bytes, agent as u64);
        }
        None => {
            bytes.push(b'v');
            features(bytes, &outcome.value);
        }
    }
}

fn features(bytes: &mut Vec<u8>, features: &[Feature]) {
    number(bytes, features.len() as u64);
    for feature in features {
        text(bytes, feature.name.as_str());
        text(
            bytes,
            feature.unit.as_ref().map_or("", |unit| unit.as_str()),
        );
        kind(bytes, &feature.kind);
    }
}

fn kind(bytes: &mut Vec<u8>, kind: &FeatureKind) {
    match kind {
        FeatureKind::Continuous(edges) => {
            bytes.push(b'c');
            number(bytes, edges.len() as u64);
            edges
                .iter()
                .for_each(|edge| bytes.extend(edge.to_le_bytes()));
        }
        FeatureKind::Circular(bins, angle) => {
            bytes.push(match angle {
                Angle::Radians => b'o',
                Angle::Degrees => b'd',
            });
            number(bytes, u64::from(*bins));
        }
        FeatureKind::Integer(min, max) => {
            bytes.push(b'i');
            bytes.extend(min.to_le_bytes());
            bytes.extend(max.to_le_bytes());
        }
        FeatureKind::Categorical(labels) => {
            bytes.push(b'l');
            number(bytes, labels.len() as u64);
            labels.iter().for_each(|label| text(bytes, label.as_str()));
        }
    }
}

fn text(bytes: &mut Vec<u8>, text: &str) {
    number(bytes, text.len() as u64);
    bytes.extend(text.as_bytes());
}

fn number(bytes: &mut Vec<u8>, number: u64) {
    bytes.extend(number.to_le_bytes());
}
