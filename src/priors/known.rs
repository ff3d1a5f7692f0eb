//! What was found about single states by one fit, for those who ask again before anything more was counted there.

use std::sync::{Mutex, PoisonError};

use lru::LruCache;

use crate::domain::{Evidence, StateKey, Tally};

/// States remembered: as many as one question may have.
const KEPT: std::num::NonZeroUsize = std::num::NonZeroUsize::new(crate::domain::MOST_STATES).expect("not zero");

/// The evidence on the states that were asked about last.
pub struct Known(Mutex<LruCache<StateKey, Found>>);

/// Counts only grow, so that the same sum stands for the same counts.
#[derive(Clone, Copy)]
struct Found {
    tally: Tally,
    threshold: f64,
    evidence: Evidence,
}

impl Default for Known {
    fn default() -> Self {
        Self(Mutex::new(LruCache::new(KEPT)))
    }
}

impl Known {
    /// Returns the evidence on a state whose counts have this sum, by a threshold in nats.
    pub fn get(&self, key: &StateKey, tally: Tally, threshold: f64) -> Option<Evidence> {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = known.get(key)?;
        (found.tally == tally && found.threshold == threshold).then_some(found.evidence)
    }

    /// Remembers evidence and returns it.
    pub fn put(&self, key: &StateKey, tally: Tally, threshold: f64, evidence: Evidence) -> Evidence {
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.put(key.clone(), Found { tally, threshold, evidence });
        evidence
    }
}
