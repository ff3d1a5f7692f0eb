//! The Open Inference Protocol on the wire: one request and one answer behind its JSON, its binary
//! tensors and its proto messages.
//!
//! Which networks there are and what they say is not known here, nor is HTTP.

pub mod grpc;
#[cfg(feature = "rest")]
pub mod rest;
mod tensor;

use std::sync::Arc;

pub use tensor::{DATATYPE, MOST_ROWS, Tensor, Values};

use nudge_core::domain::{ModelKind, Schema, StateKey};
use nudge_core::error::{Fault, Problem};

/// The name of the only input.
pub const INPUT: &str = "state";

/// States to predict for, as either face decoded them.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// What the answer is to be recognised by.
    pub id: Option<String>,
    /// The tensors that were sent.
    pub inputs: Vec<Tensor>,
    /// Names of the outputs that are wanted, in order; all if empty.
    pub outputs: Vec<String>,
}

/// What a network predicts of each state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// P(MI > threshold).
    InfluenceProbability,
    /// Mutual information.
    MutualInformation,
}

/// What a network predicted, in the order of the states.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The model, as it was asked for.
    pub model: Arc<str>,
    /// The version that answered.
    pub version: u64,
    /// The `id` of the request.
    pub id: Option<String>,
    /// What was wanted, in that order.
    pub outputs: Vec<Output>,
}

/// One figure of every state.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// What is predicted.
    pub figure: Figure,
    /// The threshold that a probability is about, in nats.
    pub threshold: Option<f64>,
    /// The unit of the values, where they have one.
    pub unit: Option<&'static str>,
    /// A value a state.
    pub values: Vec<f32>,
}

/// What a model takes and answers.
#[derive(Debug, Clone, PartialEq)]
pub struct Metadata {
    /// The model, as it was asked for.
    pub model: Arc<str>,
    /// Every version that is kept for its pair of agents, in order.
    pub versions: Vec<u64>,
    /// Values a state.
    pub features: usize,
    /// What it answers.
    pub figures: &'static [Figure],
}

/// Returns the fault of a tensor, or of the request where it is empty, one of whose parameters says
/// that its values are elsewhere, or something else. Ignored, its sender would read what nobody
/// wrote there. Other parameters that are not known are ignored, as the protocol wants it.
fn unsupported(tensor: &str, has: impl Fn(&str) -> bool) -> Option<Fault> {
    const SHARED: &str = "shared memory is not supported, expected values in the message itself";
    const CLASSES: &str =
        "classes (class_count) are not supported: no output has any; expected none";
    const PARAMETERS: [(&str, &str); 5] = [
        ("shared_memory_region", SHARED),
        ("shared_memory_byte_size", SHARED),
        ("shared_memory_offset", SHARED),
        ("classification", CLASSES),
        ("class_count", CLASSES),
    ];
    let (name, why) = PARAMETERS.into_iter().find(|(name, _)| has(name))?;

    Some(Fault::new(format!("{tensor}/parameters/{name}"), why))
}

impl Request {
    /// Returns how many values were sent, read or not.
    pub fn values(&self) -> usize {
        self.inputs.iter().map(|tensor| tensor.values.len()).sum()
    }

    /// Returns the state of each row of the only input, or what is wrong with it.
    pub fn states(&self, schema: &Schema) -> Result<Vec<StateKey>, Problem> {
        let stranger = self.inputs.iter().position(|tensor| tensor.name != INPUT);
        if let Some(i) = stranger {
            let detail = format!("got {:?}, expected {INPUT}", self.inputs[i].name);
            return Err(invalid(vec![Fault::new(
                format!("/inputs/{i}/name"),
                detail,
            )]));
        }

        let [tensor] = &self.inputs[..] else {
            let detail = format!("got {} tensors, expected one, {INPUT}", self.inputs.len());
            return Err(invalid(vec![Fault::new("/inputs", detail)]));
        };

        tensor.states(schema).map_err(|faults| {
            let faults = faults.into_iter().map(|fault| fault.under("/inputs/0"));
            invalid(faults.collect())
        })
    }

    /// Returns the figures that are wanted of a network of that kind.
    pub fn figures(&self, kind: ModelKind) -> Result<Vec<Figure>, Problem> {
        let known = Figure::of_kind(kind);
        if self.outputs.is_empty() {
            return Ok(known.to_vec());
        }

        let (mut figures, mut faults) = (Vec::new(), Vec::new());
        for (i, name) in self.outputs.iter().enumerate() {
            match known.iter().find(|figure| figure.as_str() == name) {
                Some(figure) => figures.push(*figure),
                None => {
                    let names: Vec<&str> = known.iter().map(|figure| figure.as_str()).collect();
                    let detail = format!("got {name:?}, expected {}", names.join(" or "));
                    faults.push(Fault::new(format!("/outputs/{i}/name"), detail));
                }
            }
        }

        if faults.is_empty() {
            Ok(figures)
        } else {
            Err(invalid(faults))
        }
    }
}

fn invalid(faults: Vec<Fault>) -> Problem {
    Problem::invalid("inference request", faults)
}

impl Figure {
    /// Returns what networks of a kind predict.
    pub fn of_kind(kind: ModelKind) -> &'static [Self] {
        match kind {
            ModelKind::Joint => &[Self::InfluenceProbability, Self::MutualInformation],
            ModelKind::Direct => &[Self::InfluenceProbability],
        }
    }

    /// Returns the name of the output.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::InfluenceProbability => "influence_probability",
            Self::MutualInformation => "mutual_information",
        }
    }
}

impl Output {
    /// Returns the values as little-endian bytes.
    pub fn bytes(&self) -> Vec<u8> {
        self.values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect()
    }
}

#[cfg(all(test, feature = "rest"))]
mod tests;
