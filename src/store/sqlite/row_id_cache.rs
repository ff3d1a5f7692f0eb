//! Write-through cache of the row ids of states, so that writing to hot ones needs no look-up. It
//! belongs to the writer, and a transaction that fails empties it.

use super::recent::Recent;
use crate::domain::{EnvironmentId, StateKey};

/// States a generation: about 100 bytes each.
const GENERATION: usize = 65_536;

/// A bounded cache of rows that exist.
pub(super) struct RowIdCache {
    states: Recent<(EnvironmentId, StateKey), i64>,
}

impl Default for RowIdCache {
    fn default() -> Self {
        Self {
            states: Recent::new(GENERATION),
        }
    }
}

impl RowIdCache {
    /// Returns the id of a state, where it is remembered.
    pub(super) fn state_id(&mut self, environment: EnvironmentId, key: &StateKey) -> Option<i64> {
        self.states.get(&(environment, key.clone()))
    }

    /// Remembers the id of a state.
    pub(super) fn add_state(&mut self, environment: EnvironmentId, key: &StateKey, id: i64) {
        self.states.insert((environment, key.clone()), id);
    }

    /// Forgets the states of an environment.
    pub(super) fn forget(&mut self, environment: EnvironmentId) {
        self.states.retain(|(of, _)| *of != environment);
    }
}
