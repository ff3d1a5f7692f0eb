//! Entry flags for one track sent in order.

use super::{Entry, Record, Schema, StateKey};

/// Follows one track, the consecutive steps of one game or of one pair, and says which of them
/// entered their state.
///
/// Steps of one stay are not independent draws, so the service counts entries beside visits. What
/// is compared is the discretised state: moving within a bin is a stay. Take a new `Track` for
/// every game, and wherever a step was not observed.
#[derive(Debug, Clone)]
pub struct Track {
    schema: Schema,
    last: Option<StateKey>,
}

impl Track {
    /// Begins a track in an environment of that schema.
    pub fn new(schema: &Schema) -> Self {
        Self {
            schema: schema.clone(),
            last: None,
        }
    }

    /// Returns the next step as a transition with its entry flag.
    pub fn record(&mut self, state: Vec<f32>, actions: Vec<f32>) -> Record {
        let entry = self.entry(&state);
        Record {
            entry,
            ..Record::new(state, actions)
        }
    }

    /// Returns whether the next step, which is in `state`, entered it. The first one did.
    ///
    /// A state that has no key is an entry: the service will reject that step, and the step after
    /// it comes from somewhere else.
    pub fn entry(&mut self, state: &[f32]) -> Entry {
        let key = self.schema.key_of_values(state).ok();
        let stayed = key.is_some() && key == self.last;
        self.last = key;
        if stayed {
            Entry::Stayed
        } else {
            Entry::Entered
        }
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

    #[test]
    fn a_step_enters_when_its_bin_is_another() {
        let mut track = Track::new(&schema());
        let flags = [0.1, 0.9, 1.0, 1.5, 0.5, 0.5].map(|distance| track.entry(&[distance]));
        use Entry::{Entered, Stayed};
        assert_eq!(flags, [Entered, Stayed, Entered, Stayed, Entered, Stayed]);
    }

    #[test]
    fn after_a_state_without_a_key_the_next_step_enters() {
        let mut track = Track::new(&schema());
        let flags = [0.5, f32::NAN, f32::NAN, 0.5].map(|distance| track.entry(&[distance]));
        assert_eq!(flags, [Entry::Entered; 4]);
    }
}
