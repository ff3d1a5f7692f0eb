//! The ids of the states that are written to, so that hot states need no lookup.
//!
//! Two generations bound it: what is used moves to the young one, and when that is full the old one is dropped. This costs one look into a map,
//! where a list in order of use would be rewritten at every look.

use super::Map;
use crate::domain::{EnvironmentId, StateKey};

/// States a generation. A state takes about 100 bytes.
const GENERATION: usize = 65_536;

type Ids = Map<EnvironmentId, Map<StateKey, i64>>;

/// A bounded memory of state ids. It belongs to the writer, and is emptied when a transaction fails.
#[derive(Default)]
pub(super) struct StateIds {
    young: Ids,
    old: Ids,
    len: usize,
}

impl StateIds {
    /// Returns the id of a state, where it is remembered.
    pub(super) fn get(&mut self, environment: EnvironmentId, key: &StateKey) -> Option<i64> {
        if let Some(id) = self.young.get(&environment).and_then(|ids| ids.get(key)) {
            return Some(*id);
        }
        let (key, id) = self.old.get_mut(&environment)?.remove_entry(key)?;
        self.insert(environment, key, id);
        Some(id)
    }

    /// Remembers the id of a state.
    pub(super) fn insert(&mut self, environment: EnvironmentId, key: StateKey, id: i64) {
        if self.len == GENERATION {
            self.old = std::mem::take(&mut self.young);
            self.len = 0;
        }
        self.len += usize::from(self.young.entry(environment).or_default().insert(key, id).is_none());
    }

    /// Forgets the states of an environment.
    pub(super) fn forget(&mut self, environment: EnvironmentId) {
        self.old.remove(&environment);
        self.len -= self.young.remove(&environment).map_or(0, |ids| ids.len());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_bounded_and_keeps_what_is_used() {
        let mut ids = StateIds::default();
        let environment = EnvironmentId(1);
        let key = |n: u32| StateKey::new(&[n]);
        for n in 0..(3 * GENERATION as u32) {
            ids.insert(environment, key(n), i64::from(n));
            assert_eq!(ids.get(environment, &key(0)), Some(0));
        }
        assert_eq!(ids.get(environment, &key(1)), None);
        assert!(ids.young[&environment].len() + ids.old[&environment].len() <= 2 * GENERATION);
        ids.forget(environment);
        assert_eq!((ids.get(environment, &key(0)), ids.len), (None, 0));
    }
}
