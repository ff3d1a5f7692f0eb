//! A bounded least-recently-used cache of the counts of states, kept coherent with commits by
//! revisions. It never serves counts that lack an acknowledged batch, nor some that go back in
//! time.
//!
//! The only danger is a race between a reader that loads a state and a commit that changes it. A
//! **revision** settles it: an environment's number of transitions, which grows with every commit
//! that counts something. A reader's one statement reads the revision with the cells, so what it
//! loads carries its place in time. Commits come one at a time: the next one begins after this
//! cache was told of the last.
//!
//! * After COMMIT, and before the commit returns, [`CountsCache::apply`] sets `applied` to the new
//!   revision and adds the commit's delta to those cached states whose revision is lower. Since a
//!   cached state is never older than `applied` was when it came in (next rule), it lacks this one
//!   commit and no other; and a state that was loaded after COMMIT and before `apply` has the delta
//!   already, and is left alone.
//! * A reader's load comes in only where its revision is at least `floor`, the larger of `applied`
//!   and the highest revision that was loaded. Below `applied`, the delta which it lacks has passed
//!   and would be lost. Below what another reader has loaded, a state that the other saw already
//!   could go back in time. So a load never replaces a younger one either.
//! * So a cached state is that of the last applied commit or a later one, and an acknowledged
//!   commit has been applied: reads see it.
//!
//! When nobody knows whether a COMMIT took effect, the cache is emptied and stays unused until that
//! is settled; loads which began before carry an older **epoch** and are not taken in.

use std::sync::{Arc, Mutex, MutexGuard};

use lru::LruCache;

use crate::domain::{Cell, Counts, EnvironmentId, Family, StateKey};
use crate::store::StateCounts;
use crate::store::map::Map;

/// What a cached state weighs beside its cells, in cells of 40 bytes: its key, its place in the
/// list and the map, and three allocations.
const STATE_WEIGHT: usize = 6;

/// The cache.
pub(super) struct CountsCache {
    capacity: usize,
    inner: Mutex<Inner>,
}

/// Tells the loads that began before the cache was emptied from those that began after.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Epoch(u64);

struct Inner {
    entries: LruCache<(EnvironmentId, StateKey), Entry, foldhash::fast::RandomState>,
    weight: usize,
    revisions: Map<EnvironmentId, Revisions>,
    epoch: Epoch,
    suspended: bool,
}

struct Entry {
    counts: Arc<Counts>,
    revision: u64,
}

#[derive(Default, Clone, Copy)]
struct Revisions {
    applied: u64,
    floor: u64,
}

impl CountsCache {
    /// Makes a cache that holds about as much memory as this many cells.
    pub(super) fn new(cells: usize) -> Self {
        let entries = LruCache::unbounded_with_hasher(foldhash::fast::RandomState::default());
        let inner = Inner {
            entries,
            weight: 0,
            revisions: Map::default(),
            epoch: Epoch(0),
            suspended: true,
        };
        Self {
            capacity: cells,
            inner: Mutex::new(inner),
        }
    }

    /// Returns what is cached of each state, and the epoch to give back with what the caller loads.
    pub(super) fn get(
        &self,
        environment: EnvironmentId,
        keys: &[StateKey],
    ) -> (Vec<Option<StateCounts>>, Epoch) {
        let mut inner = self.inner();
        let applied = inner
            .revisions
            .get(&environment)
            .map_or(0, |revisions| revisions.applied);

        let found = keys.iter().map(|key| {
            let entry = inner.entries.get(&(environment, key.clone()))?;
            Some(StateCounts {
                counts: Arc::clone(&entry.counts),
                revision: entry.revision.max(applied),
            })
        });
        let found = found.collect();
        (found, inner.epoch)
    }

    /// Takes in states that were loaded by one statement.
    pub(super) fn insert(
        &self,
        environment: EnvironmentId,
        epoch: Epoch,
        revision: u64,
        loaded: impl Iterator<Item = (StateKey, Arc<Counts>)>,
    ) {
        let mut inner = self.inner();
        if inner.suspended || inner.epoch != epoch || !inner.raise_floor(environment, revision) {
            return;
        }

        for (key, counts) in loaded {
            inner.put((environment, key), Entry { counts, revision });
        }
        inner.shrink(self.capacity);
    }

    /// Adds a commit's delta to what is cached: its cells, those of each state together, by a number
    /// that `key` knows the state of.
    pub(super) fn apply(
        &self,
        environment: EnvironmentId,
        revision: u64,
        delta: impl Iterator<Item = (u64, (Family, Cell))>,
        key: impl Fn(u64) -> StateKey,
    ) {
        let mut inner = self.inner();
        let revisions = inner.revisions.entry(environment).or_default();
        *revisions = Revisions {
            applied: revision,
            floor: revision.max(revisions.floor),
        };
        if inner.entries.is_empty() {
            return;
        }

        let mut delta = delta.peekable();
        while let Some((state, _)) = delta.peek() {
            let state = *state;
            let mut cells = std::iter::from_fn(|| delta.next_if(|(of, _)| *of == state));
            let added = cells.by_ref().map(|(_, cell)| cell);
            inner.add((environment, key(state)), revision, added);
            // Of a state that is not cached none was taken.
            cells.for_each(drop);
        }
        inner.shrink(self.capacity);
    }

    /// Drops the states of an environment that is gone.
    pub(super) fn forget(&self, environment: EnvironmentId) {
        let mut inner = self.inner();
        let gone = inner
            .entries
            .iter()
            .map(|(key, _)| key)
            .filter(|(of, _)| *of == environment)
            .cloned();
        for key in gone.collect::<Vec<_>>() {
            inner.remove(&key);
        }

        inner.revisions.remove(&environment);
        inner.epoch.0 += 1;
    }

    /// Drops everything, and takes nothing in until [`CountsCache::resume`].
    pub(super) fn suspend(&self) {
        self.empty(true);
    }

    /// Begins anew, now that it is known what was committed.
    pub(super) fn resume(&self) {
        self.empty(false);
    }

    fn empty(&self, suspended: bool) {
        let mut inner = self.inner();
        inner.entries.clear();
        inner.weight = 0;
        inner.epoch.0 += 1;
        inner.suspended = suspended;
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner
            .lock()
            .expect("nothing panics while it holds the cache")
    }
}

impl Inner {
    /// Returns whether counts of this revision may come in, and notes that they were seen.
    fn raise_floor(&mut self, environment: EnvironmentId, revision: u64) -> bool {
        let revisions = self.revisions.entry(environment).or_default();
        let young_enough = revision >= revisions.floor;
        revisions.floor = revisions.floor.max(revision);
        young_enough
    }

    fn put(&mut self, key: (EnvironmentId, StateKey), entry: Entry) {
        self.weight += weight(&entry);
        let replaced = self.entries.put(key, entry);
        self.weight -= replaced.map_or(0, |entry| weight(&entry));
    }

    fn add(
        &mut self,
        key: (EnvironmentId, StateKey),
        revision: u64,
        cells: impl IntoIterator<Item = (Family, Cell)>,
    ) {
        let Some(entry) = self
            .entries
            .peek_mut(&key)
            .filter(|entry| entry.revision < revision)
        else {
            return;
        };

        let before = weight(entry);
        let counts = Arc::make_mut(&mut entry.counts);
        cells
            .into_iter()
            .for_each(|(family, cell)| counts.add(family, cell));
        entry.revision = revision;
        let after = weight(entry);
        self.weight = self.weight + after - before;
    }

    fn remove(&mut self, key: &(EnvironmentId, StateKey)) {
        let removed = self.entries.pop(key);
        self.weight -= removed.map_or(0, |entry| weight(&entry));
    }

    fn shrink(&mut self, capacity: usize) {
        while self.weight > capacity {
            let Some((_, entry)) = self.entries.pop_lru() else {
                return;
            };
            self.weight -= weight(&entry);
        }
    }
}

fn weight(entry: &Entry) -> usize {
    entry.counts.len() + STATE_WEIGHT
}

#[cfg(test)]
mod tests;
