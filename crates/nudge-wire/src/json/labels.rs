//! What numbers in answers stand for: the labels of actions, and the bins of a state.

use serde::{Serialize, Serializer};
use utoipa::ToSchema;

use crate::proto;

/// What indices in answers stand for.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Labels {
    /// The ego.
    pub ego: Variable,
    /// The other.
    pub other: Variable,
    /// What is held fixed: the agents named, and for an agent at a lag the other's own action one
    /// step before.
    pub given: Vec<Variable>,
}

/// A variable and the labels of its values.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Variable {
    /// Its name.
    #[schema(example = "robot")]
    pub name: String,
    /// A label an action, or a value, in index order; empty where there are more than 4,096, and
    /// beside what has no indices.
    pub actions: Vec<String>,
}

/// A state by key and bins.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct State {
    /// Bin numbers joined by dots.
    #[schema(example = "3.0.7", pattern = r"^[0-9]+(\.[0-9]+)*$")]
    pub key: String,
    /// One a feature, in the environment's order; absent in the view `verdict`.
    #[serde(skip_serializing_if = "Vec::is_empty", serialize_with = "as_object")]
    #[schema(value_type = BTreeMap<String, Bin>, required = false)]
    pub bins: Vec<(String, Bin)>,
}

/// One bin of a state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Bin {
    /// The bin's number, from 0.
    #[schema(example = 3)]
    pub bin: u32,
    /// What people call it.
    #[schema(example = "[2, 3)")]
    pub label: String,
}

/// Writes pairs as an object in their order, which a map type would lose.
fn as_object<S: Serializer>(bins: &[(String, Bin)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(bins.iter().map(|(feature, bin)| (feature, bin)))
}

impl From<proto::Labels> for Labels {
    fn from(labels: proto::Labels) -> Self {
        Self {
            ego: labels.ego.map(Into::into).unwrap_or_default(),
            other: labels.other.map(Into::into).unwrap_or_default(),
            given: labels.given.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::Variable> for Variable {
    fn from(variable: proto::Variable) -> Self {
        Self {
            name: variable.name,
            actions: variable.actions,
        }
    }
}

impl From<proto::State> for State {
    fn from(state: proto::State) -> Self {
        Self {
            key: state.key,
            bins: state.bins.into_iter().map(labelled).collect(),
        }
    }
}

/// Returns a bin by the name of its feature.
fn labelled(bin: proto::Bin) -> (String, Bin) {
    let proto::Bin {
        feature,
        bin,
        label,
    } = bin;
    (feature, Bin { bin, label })
}
