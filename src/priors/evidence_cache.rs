//! A cache of evidence: what the counts of single states support by one fit, for those who ask
//! again before anything more was counted there. Least recently used states go first.

use std::sync::{Mutex, PoisonError};

use lru::LruCache;

use crate::domain::{Evidence, StateKey, Tally, Within};
use crate::evidence::Believed;

/// States remembered: as many as one question may have.
const KEPT: std::num::NonZeroUsize =
    std::num::NonZeroUsize::new(crate::domain::MOST_STATES).expect("not zero");

/// A cache of the evidence on the states that were asked about last.
pub struct EvidenceCache(Mutex<LruCache<StateKey, Entry>>);

/// The evidence on a state, as it is answered and as it decides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StateEvidence {
    /// What is told.
    pub evidence: Evidence,
    /// What decides.
    pub believed: Believed,
}

/// What evidence is computed from, by which a cached entry is valid or stale. Counts only grow, so
/// that the same sum stands for the same counts: of the state, and of the environment, whose habits
/// count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EvidenceInputs {
    /// The sum of the state's counts.
    pub tally: Tally,
    /// How many transitions the environment had.
    pub revision: u64,
    /// The threshold, in nats.
    pub threshold: f64,
    /// What is compared within each segment alone.
    pub within: Within,
}

#[derive(Clone, Copy)]
struct Entry {
    inputs: EvidenceInputs,
    found: StateEvidence,
}

impl Default for EvidenceCache {
    fn default() -> Self {
        Self(Mutex::new(LruCache::new(KEPT)))
    }
}

impl EvidenceCache {
    /// Returns what was found about a state from the same inputs, or finds and remembers it.
    pub fn get_or_find(
        &self,
        key: &StateKey,
        inputs: EvidenceInputs,
        find: impl FnOnce() -> StateEvidence,
    ) -> StateEvidence {
        let remembered = self
            .lock()
            .get(key)
            .filter(|entry| entry.inputs == inputs)
            .map(|entry| entry.found);
        remembered.unwrap_or_else(|| {
            let found = find();
            self.lock().put(key.clone(), Entry { inputs, found });
            found
        })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, LruCache<StateKey, Entry>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
