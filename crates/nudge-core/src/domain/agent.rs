//! Who acts: an agent and its action space.

use super::outcome::{letter_label, letters};
use super::{Feature, Name};

/// One decision maker with its action space.
#[derive(Debug, Clone, PartialEq)]
pub struct Agent {
    /// Unique among the features, agents and outcomes of its environment.
    pub name: Name,
    /// The coordinates of its action; the first is most significant in the action's index.
    pub action: Vec<Feature>,
    /// Whether a transition may be without its action: where agents take turns, or die.
    pub may_be_absent: bool,
}

impl Agent {
    /// What stands in the place of the label of an action that was not taken.
    pub const ABSENT: &'static str = "(absent)";

    /// Returns the number of actions.
    pub fn actions(&self) -> u64 {
        letters(&self.action)
    }

    /// Returns the number of letters that the agent has in a joint action: its actions, and one
    /// more behind them for its absence where it may be absent.
    pub fn letters(&self) -> u64 {
        self.actions() + u64::from(self.may_be_absent)
    }

    /// Returns the letter of its absence, which is no action.
    pub fn absence(&self) -> u64 {
        self.actions()
    }

    /// Returns the labels of an action's features joined by "/", or that it was not taken.
    pub fn action_label(&self, index: u64) -> String {
        match index < self.absence() {
            true => letter_label(&self.action, index),
            false => Self::ABSENT.to_owned(),
        }
    }
}
