//! Entry flags for one track sent in order.

use super::EntryRule;
use crate::domain::{Agent, Entry, Record, Schema, StateKey};

/// Follows one track, the consecutive steps of one game or of one pair, and says which of them
/// count as entries of their state: see [`EntryRule`].
///
/// What is compared is the discretised state and actions: moving within a bin is a stay. Take a new
/// `Track` for every game, and say where a step was not observed ([`gap`](Self::gap)).
#[derive(Debug, Clone)]
pub struct Track {
    schema: Schema,
    rule: EntryRule<StateKey>,
}

impl Track {
    /// Begins a track in an environment of that schema.
    pub fn new(schema: &Schema) -> Self {
        Self {
            schema: schema.clone(),
            rule: EntryRule::new(schema.agents().iter().map(Agent::actions)),
        }
    }

    /// Returns the next step as a transition with its entry flag.
    pub fn record(&mut self, state: Vec<f32>, actions: Vec<f32>) -> Record {
        let entry = self.entry(&state, &actions);
        Record {
            entry,
            ..Record::new(state, actions)
        }
    }

    /// Passes over steps that were not observed.
    pub fn gap(&mut self) {
        self.rule.gap();
    }

    /// Returns whether the next step counts as an entry. The first one does.
    ///
    /// So does a step that has a value without a bin, which the service will reject; the step after
    /// it comes from somewhere else.
    fn entry(&mut self, state: &[f32], actions: &[f32]) -> Entry {
        let key = self.schema.key_of_values(state).ok();
        let (Some(key), Some(joint)) = (key, self.schema.joint_action(actions)) else {
            self.rule.gap();
            return Entry::Entered;
        };
        let agents = 0..self.schema.agents().len();
        let actions: Vec<Option<u64>> = agents
            .map(|agent| Some(self.schema.action_of(joint, agent)))
            .collect();
        self.rule.entry(&key, &actions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

    fn schema() -> Schema {
        let feature = |name: &str, kind| FeatureDraft {
            name: name.into(),
            unit: None,
            kinds: vec![kind],
        };
        let agent = |name: &str| AgentDraft {
            name: name.into(),
            action: vec![feature("go", KindDraft::Integer(0, 1))],
            ..AgentDraft::default()
        };
        let draft = SchemaDraft {
            state: vec![feature("distance", KindDraft::Continuous(vec![1.0, 2.0]))],
            agents: vec![agent("a"), agent("b")],
            ..SchemaDraft::default()
        };
        Schema::try_from(&draft).expect("valid")
    }

    /// Returns the flags of steps at these distances, where both agents change their actions at
    /// each.
    fn flags<const N: usize>(distances: [f32; N]) -> [Entry; N] {
        let mut track = Track::new(&schema());
        let mut action = 0.0;
        distances.map(|distance| {
            action = 1.0 - action;
            track.record(vec![distance], vec![action; 2]).entry
        })
    }

    #[test]
    fn a_step_enters_when_its_bin_is_another() {
        use Entry::{Entered, Stayed};
        let flags = flags([0.1, 0.9, 1.0, 1.5, 0.5, 0.5]);
        assert_eq!(flags, [Entered, Stayed, Entered, Stayed, Entered, Stayed]);
    }

    #[test]
    fn after_a_state_without_a_key_the_next_step_enters() {
        assert_eq!(flags([0.5, f32::NAN, f32::NAN, 0.5]), [Entry::Entered; 4]);
    }

    #[test]
    fn what_has_no_bin_is_nobodys_action() {
        let mut track = Track::new(&schema());
        let mut entry = |distance, actions: [f32; 2]| {
            track.record(vec![distance], actions.to_vec()).entry == Entry::Entered
        };
        assert!(entry(0.5, [0.0, 0.0]));
        assert!(entry(0.5, [7.0, 1.0]), "it will be rejected");
        assert!(!entry(0.5, [0.0, 0.0]), "both hold what they did before it");
        assert!(entry(1.5, [1.0, 1.0]));
        assert!(entry(0.5, [1.0, 1.0]));
    }
}
