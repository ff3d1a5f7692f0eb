//! The schema hash: BLAKE3 of an unambiguous encoding of state and agents.
//!
//! Every text and list is preceded by its length and every kind by its own letter, so no two
//! schemas encode alike. What is added to schemas later must encode to nothing where it is absent:
//! hashes are kept for ever.

use std::fmt;

use super::{Agent, Angle, Feature, FeatureKind};

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

pub(super) fn schema_hash(state: &[Feature], agents: &[Agent]) -> SchemaHash {
    let mut bytes = b"nudge.schema.v1".to_vec();
    features(&mut bytes, state);
    number(&mut bytes, agents.len() as u64);
    for agent in agents {
        text(&mut bytes, agent.name.as_str());
        features(&mut bytes, &agent.action);
    }
    SchemaHash(*blake3::hash(&bytes).as_bytes())
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
