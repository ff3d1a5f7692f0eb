//! Caches of evidence (memoisation): what counts support by one fit. What was used least recently
//! goes first.
//!
//! * By state, for those who ask again before anything more was counted there.
//! * By counts, for a pass over all states: most of a large environment were seen a few times, and
//!   many of them saw the same.

use std::sync::{Mutex, PoisonError};

use foldhash::fast::RandomState;
use lru::LruCache;

use crate::domain::{Cell, Evidence, SegmentId, StateKey, Tally, Within};
use crate::evidence::{Believed, Ego};
use crate::information::ExpectedMethod;

/// States remembered: as many as one question may have.
const KEPT: usize = crate::domain::MOST_STATES;

/// Counts remembered in a pass, and the most cells that they have: larger ones are hardly met twice.
const KEPT_OF_A_PASS: std::num::NonZeroUsize =
    std::num::NonZeroUsize::new(1 << 15).expect("not zero");
const MOST_CELLS: usize = 8;

/// A cache of the evidence on the states that were asked about last.
pub struct EvidenceCache(Mutex<LruCache<StateKey, Entry, RandomState>>);

/// A cache of the evidence on counts, for one pass by one question: what else evidence is computed
/// from is the same for all of them.
pub struct PassEvidence(Mutex<LruCache<Box<[Cell]>, StateEvidence, RandomState>>);

/// The evidence on a state, as it is answered and as it decides, with what its tables show by
/// themselves, in nats.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StateEvidence {
    /// How many segments have visits here.
    pub segments: u64,
    /// Plug-in mutual information.
    pub plug_in: f64,
    /// Its mean under independence, and how that was computed.
    pub expected: (f64, ExpectedMethod),
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
    /// Which of the two is the ego: by it plug-in figures are summed in another order.
    pub ego: Ego,
}

#[derive(Clone, Copy)]
struct Entry {
    inputs: EvidenceInputs,
    found: StateEvidence,
}

impl Default for EvidenceCache {
    fn default() -> Self {
        // Not with a capacity, which would be reserved at once, for each of hundreds of priors.
        let kept = LruCache::unbounded_with_hasher(RandomState::default());
        Self(Mutex::new(kept))
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
            let mut kept = self.lock();
            kept.put(key.clone(), Entry { inputs, found });
            if kept.len() > KEPT {
                kept.pop_lru();
            }
            found
        })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, LruCache<StateKey, Entry, RandomState>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Default for PassEvidence {
    fn default() -> Self {
        let kept = LruCache::with_hasher(KEPT_OF_A_PASS, RandomState::default());
        Self(Mutex::new(kept))
    }
}

impl PassEvidence {
    /// Returns what was found about a state with the same cells, or finds and remembers it.
    pub fn get_or_find<'c>(
        &self,
        cells: impl Iterator<Item = &'c Cell>,
        find: impl FnOnce() -> StateEvidence,
    ) -> StateEvidence {
        let mut cells: Box<[Cell]> = cells.copied().collect();
        if cells.len() > MOST_CELLS {
            return find();
        }

        number_segments(&mut cells);
        let remembered = self.lock().get(&cells).copied();
        remembered.unwrap_or_else(|| {
            let found = find();
            self.lock().put(cells, found);
            found
        })
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, LruCache<Box<[Cell]>, StateEvidence, RandomState>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Names segments by their order among those of the state: which they are changes nothing.
fn number_segments(cells: &mut [Cell]) {
    let mut named: Vec<SegmentId> = cells.iter().map(|cell| cell.segment).collect();
    named.sort_unstable();
    named.dedup();
    for cell in cells {
        let at = named.partition_point(|segment| *segment < cell.segment);
        cell.segment = SegmentId(at as i64);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::{Dependence, Probability};
    use crate::evidence::Beliefs;

    fn cells(cells: &[(u64, i64, u64)]) -> Vec<Cell> {
        let cell = |&(joint, segment, n): &(u64, i64, u64)| Cell {
            joint,
            segment: SegmentId(segment),
            tally: Tally { n, entries: None },
        };
        cells.iter().map(cell).collect()
    }

    /// Found at that many findings before.
    fn found(before: usize) -> StateEvidence {
        let beliefs = Beliefs {
            dependent: 0.0,
            above: 0.0,
            above_if_dependent: 0.0,
        };
        StateEvidence {
            segments: 1,
            plug_in: before as f64,
            expected: (0.0, ExpectedMethod::Hypergeometric),
            evidence: Evidence {
                dependence: Dependence::Open,
                probability: Probability {
                    dependent: 0.0,
                    above_threshold: 0.0,
                },
                posterior_mean: 0.0,
                interval: [0.0; 2],
                differ: None,
                pooled: None,
            },
            believed: Believed::new(beliefs, beliefs, &[]),
        }
    }

    #[test]
    fn equal_counts_are_weighed_once_in_a_pass() {
        let (memory, mut finds) = (PassEvidence::default(), 0);
        let mut is_found_anew = |asked: &[(u64, i64, u64)]| {
            let before = finds;
            memory.get_or_find(cells(asked).iter(), || {
                finds += 1;
                found(before)
            });
            finds > before
        };

        assert!(is_found_anew(&[]));
        assert!(is_found_anew(&[(3, 1, 1), (4, 7, 2)]));
        assert!(!is_found_anew(&[]));
        assert!(!is_found_anew(&[(3, 1, 1), (4, 7, 2)]));
        assert!(
            !is_found_anew(&[(3, 2, 1), (4, 9, 2)]),
            "which two segments they are changes nothing"
        );
        for other in [
            [(3, 7, 1), (4, 1, 2)],
            [(3, 1, 1), (4, 1, 2)],
            [(3, 1, 2), (4, 7, 1)],
            [(3, 1, 1), (5, 7, 2)],
        ] {
            assert!(is_found_anew(&other), "{other:?}");
        }
    }

    #[test]
    fn many_cells_are_not_kept() {
        let memory = PassEvidence::default();
        let many: Vec<(u64, i64, u64)> =
            (0..=MOST_CELLS as u64).map(|joint| (joint, 1, 1)).collect();
        for number in 0..2 {
            let told = memory.get_or_find(cells(&many).iter(), || found(number));
            assert_eq!(told, found(number));
        }
    }
}
