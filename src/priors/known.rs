//! What was found about single states by one fit, for those who ask again before anything more was
//! counted there.

use std::sync::{Mutex, PoisonError};

use lru::LruCache;

use crate::domain::{Evidence, StateKey, Tally, Within};
use crate::evidence::Believed;

/// States remembered: as many as one question may have.
const KEPT: std::num::NonZeroUsize =
    std::num::NonZeroUsize::new(crate::domain::MOST_STATES).expect("not zero");

/// The evidence on the states that were asked about last.
pub struct Known(Mutex<LruCache<StateKey, Entry>>);

/// What was found about a state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// What is told.
    pub evidence: Evidence,
    /// What decides.
    pub believed: Believed,
}

/// What evidence rests on. Counts only grow, so that the same sum stands for the same counts: of
/// the state, and of the environment, whose habits count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground {
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
    ground: Ground,
    found: Found,
}

impl Default for Known {
    fn default() -> Self {
        Self(Mutex::new(LruCache::new(KEPT)))
    }
}

impl Known {
    /// Returns what was found about a state on the same ground, or finds and remembers it.
    pub fn get_or_find(
        &self,
        key: &StateKey,
        ground: Ground,
        find: impl FnOnce() -> Found,
    ) -> Found {
        let known = self
            .lock()
            .get(key)
            .filter(|entry| entry.ground == ground)
            .map(|entry| entry.found);
        known.unwrap_or_else(|| {
            let found = find();
            self.lock().put(key.clone(), Entry { ground, found });
            found
        })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, LruCache<StateKey, Entry>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
