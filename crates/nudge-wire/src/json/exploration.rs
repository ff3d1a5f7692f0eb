//! Exploration: which action to try in which state next, by expected information gain.

use serde::Serialize;
use utoipa::ToSchema;

use super::{Fit, Labels, State};
use crate::proto;

/// Where one more visit is worth most.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Exploration {
    /// Whose influence on whom: names alone, as nothing here has an index of the other's.
    pub labels: Labels,
    /// How many steps later the other is observed; 0 for the same tick.
    pub lag: u32,
    /// States and actions, the most valuable first.
    pub trials: Vec<Trial>,
    /// The states that were looked at: those whose verdict is the most uncertain.
    pub considered: u64,
    /// The revision this was made from: how many transitions the environment had.
    pub as_of: u64,
    /// The fit of the prior that this was made by.
    pub fit: Fit,
}

/// An action to try in a state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Trial {
    /// The state.
    pub state: State,
    /// How often it was seen.
    pub visits: u64,
    /// The ego's action by its label.
    pub action: String,
    /// The ego's action by its index.
    pub index: u64,
    /// How often it was taken in this state.
    pub action_visits: u64,
    /// By how much one more visit with this action is expected to lower the entropy of "MI is above
    /// the threshold", in nats.
    pub information_gain: f64,
    /// P(MI > threshold) as it is.
    pub above_threshold: f64,
}

impl From<proto::ExploreResponse> for Exploration {
    fn from(response: proto::ExploreResponse) -> Self {
        Self {
            labels: response.labels.map(Into::into).unwrap_or_default(),
            lag: response.lag,
            trials: response.trials.into_iter().map(Into::into).collect(),
            considered: response.considered,
            as_of: response.as_of,
            fit: response.fit.map(Into::into).unwrap_or_default(),
        }
    }
}

impl From<proto::Trial> for Trial {
    fn from(trial: proto::Trial) -> Self {
        Self {
            state: trial.state.map(Into::into).unwrap_or_default(),
            visits: trial.visits,
            action: trial.action,
            index: trial.index,
            action_visits: trial.action_visits,
            information_gain: trial.information_gain,
            above_threshold: trial.above_threshold,
        }
    }
}
