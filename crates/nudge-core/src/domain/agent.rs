//! Who acts: an agent and its action space.

use super::{Feature, Name};

/// One decision maker with its action space.
#[derive(Debug, Clone, PartialEq)]
pub struct Agent {
    /// Unique among the features and agents of its environment.
    pub name: Name,
    /// The coordinates of its action; the first is most significant in the action's index.
    pub action: Vec<Feature>,
}

impl Agent {
    /// Returns the number of actions.
    pub fn actions(&self) -> u64 {
        self.action
            .iter()
            .map(|feature| u64::from(feature.kind.bins()))
            .product()
    }

    /// Returns the labels of an action's features joined by "/".
    pub fn action_label(&self, index: u64) -> String {
        let mut rest = index;
        let mut labels = Vec::with_capacity(self.action.len());
        for feature in self.action.iter().rev() {
            let bins = u64::from(feature.kind.bins());
            labels.push(feature.kind.bin_label((rest % bins) as u32));
            rest /= bins;
        }
        labels.reverse();
        labels.join("/")
    }
}
