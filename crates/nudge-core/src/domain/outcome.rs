//! Outcomes: variables that are observed some steps after a joint action, an agent's later action
//! (a lagged variable) or anything else that has values, such as a factor of the next state.

use super::{Agent, Feature};

/// The largest lag.
pub const MOST_LAG: u32 = 64;

/// One variable that is observed after the joint action. Made only by [`super::Schema::try_from`].
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// `human@3` for an agent's action; else a name like a feature's. Unique among the features,
    /// agents and outcomes of its environment.
    pub name: String,
    /// How many steps after the joint action it is observed; 1 to [`MOST_LAG`].
    pub lag: u32,
    /// The position of the agent whose action it is; `None` for any other value.
    pub agent: Option<usize>,
    /// The coordinates of its value, those of the agent's action where it is one; the first is most
    /// significant in the value's index.
    pub value: Vec<Feature>,
}

impl Outcome {
    /// Returns the name of an agent's action some steps later.
    pub fn name_of(agent: &str, lag: u32) -> String {
        format!("{agent}@{lag}")
    }

    /// Makes that of an agent's action some steps later.
    pub(super) fn of_action(at: usize, agent: &Agent, lag: u32) -> Self {
        Self {
            name: Self::name_of(agent.name.as_str(), lag),
            lag,
            agent: Some(at),
            value: agent.action.clone(),
        }
    }

    /// Returns the number of values.
    pub fn values(&self) -> u64 {
        letters(&self.value)
    }

    /// Returns the labels of a value's features joined by "/".
    pub fn value_label(&self, index: u64) -> String {
        letter_label(&self.value, index)
    }
}

/// Returns how many letters the alphabet of some features has.
pub(super) fn letters(features: &[Feature]) -> u64 {
    let bins = features.iter().map(|feature| feature.kind.bins());
    bins.map(u64::from).product()
}

/// Returns the labels of the features of a letter joined by "/".
pub(super) fn letter_label(features: &[Feature], index: u64) -> String {
    let mut rest = index;
    let mut labels = Vec::with_capacity(features.len());
    for feature in features.iter().rev() {
        let bins = u64::from(feature.kind.bins());
        labels.push(feature.kind.bin_label((rest % bins) as u32));
        rest /= bins;
    }
    labels.reverse();
    labels.join("/")
}

#[cfg(test)]
mod tests;
