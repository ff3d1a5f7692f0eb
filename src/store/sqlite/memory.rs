//! The write-through caches of the database, side by side.

use std::time::Duration;

use super::actions::ActionsMemory;
use super::cache::CountsCache;
use super::directory::Directory;
use super::leftovers::Removals;
use super::pending::Pending;

/// What is remembered of the database, and changed after each commit.
pub(super) struct Memory {
    /// The environments.
    pub(super) directory: Directory,
    /// The counts of states.
    pub(super) cache: CountsCache,
    /// What the journal has and rows have not.
    pub(super) pending: Pending,
    /// How often each action was taken.
    pub(super) actions: ActionsMemory,
    /// What deleted environments have left.
    pub(super) removals: Removals,
}

impl Memory {
    /// Remembers nothing yet; the first transaction lets it begin.
    pub(super) fn new(cache_cells: usize, look_again_after: Duration) -> Self {
        let (pending, actions, removals) = Default::default();
        Self {
            directory: Directory::new(look_again_after),
            cache: CountsCache::new(cache_cells),
            pending,
            actions,
            removals,
        }
    }

    /// Drops the counts, and takes none in until it is known what was committed.
    pub(super) fn suspend(&self) {
        self.cache.suspend();
        self.pending.suspend();
        self.actions.suspend();
    }

    /// Takes counts in again.
    pub(super) fn resume(&self) {
        self.cache.resume();
        self.actions.resume();
    }
}
