//! Materialised marginal counts: how often each action was taken in an environment, and how often
//! each value of an outcome was observed. Kept from an
//! environment's beginning, or read from the cells when somebody first asks, then brought up to
//! date by every commit; never on disk.
//!
//! Commits go on while the cells are read, and each must be counted once: by the read or on top of
//! it. **Revisions** settle it, as in the cache:
//!
//! * A load is announced before its snapshot is taken. So a commit that the snapshot lacks is told
//!   to [`ActionsMemory::apply`] after the announcement, and kept.
//! * The view that the load begins with says the revision of its snapshot. Of the commits only those
//!   above it are added to what was read.
//! * Totals and sum know their revision, so a commit that was seen in the database before memory
//!   was told of it is not added again.
//!
//! When nobody knows whether a COMMIT took effect, everything is dropped, the load under way too:
//! it still answers who asked, and is not kept.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, MutexGuard};

use lru::LruCache;
use tokio::sync::{Mutex as Turn, MutexGuard as InTurn};

use crate::domain::{ActionTotals, Environment, EnvironmentId, Family, Schema, Tally};

/// Environments whose totals are kept: each is at most 100 KB an agent or an outcome with values, and
/// few can be so large.
const KEPT: NonZeroUsize = NonZeroUsize::new(256).expect("not zero");

/// The totals of every environment that was asked for.
pub(super) struct ActionsMemory {
    inner: Mutex<Inner>,
    /// One load at a time: each keeps a reader for as long as it takes to read every cell, and
    /// there are few.
    turn: Turn<()>,
}

struct Inner {
    kept: LruCache<EnvironmentId, Arc<ActionTotals>, foldhash::fast::RandomState>,
    loading: Option<(EnvironmentId, Later)>,
    suspended: bool,
}

/// A cell of a family, and what is added to it.
type Counted = (Family, u64, Tally);

/// What was committed since a load was announced.
enum Later {
    /// The revision of its snapshot is not known yet: each commit by its own.
    Listed(Vec<(u64, Vec<Counted>)>),
    /// The sum of all above the snapshot.
    Summed(ActionTotals),
}

/// A load under way. Dropped without [`Load::finish`], it leaves nothing behind.
pub(super) struct Load<'a> {
    memory: &'a ActionsMemory,
    _turn: InTurn<'a, ()>,
}

impl Default for ActionsMemory {
    /// Keeps nothing until [`ActionsMemory::resume`].
    fn default() -> Self {
        let kept = LruCache::with_hasher(KEPT, foldhash::fast::RandomState::default());
        let inner = Inner {
            kept,
            loading: None,
            suspended: true,
        };
        Self {
            inner: Mutex::new(inner),
            turn: Turn::default(),
        }
    }
}

impl ActionsMemory {
    /// Keeps the totals of an environment that was made now, so that its cells need never be read
    /// for them; as long as that takes no other's place.
    pub(super) fn begin(&self, environment: &Environment) {
        let mut inner = self.inner();
        if !inner.suspended && inner.kept.len() < KEPT.get() {
            inner.kept.put(
                environment.id,
                Arc::new(ActionTotals::new(&environment.schema)),
            );
        }
    }

    /// Counts the cells of a commit, after COMMIT and before it returns.
    pub(super) fn apply(
        &self,
        environment: EnvironmentId,
        revision: u64,
        cells: impl Iterator<Item = Counted>,
    ) {
        let mut inner = self.inner();
        if let Some(totals) = inner.kept.peek_mut(&environment) {
            Arc::make_mut(totals).apply(revision, cells);
        } else if let Some(later) = inner.loading_of(environment) {
            later.apply(revision, cells);
        }
    }

    /// Drops the totals of an environment that is gone.
    pub(super) fn forget(&self, environment: EnvironmentId) {
        let mut inner = self.inner();
        inner.kept.pop(&environment);
        inner.loading.take_if(|(of, _)| *of == environment);
    }

    /// Drops everything, and keeps nothing until [`ActionsMemory::resume`].
    pub(super) fn suspend(&self) {
        let mut inner = self.inner();
        inner.kept.clear();
        inner.loading = None;
        inner.suspended = true;
    }

    /// Keeps again what is loaded from now on. A load that began before may lack what has just been
    /// settled, and was not announced.
    pub(super) fn resume(&self) {
        self.inner().suspended = false;
    }

    /// Returns the totals that are kept of an environment.
    pub(super) fn get(&self, environment: EnvironmentId) -> Option<Arc<ActionTotals>> {
        self.inner().kept.get(&environment).cloned()
    }

    /// Waits until nobody else loads.
    pub(super) async fn turn(&self) -> InTurn<'_, ()> {
        self.turn.lock().await
    }

    /// Returns whether nothing is kept until [`ActionsMemory::resume`].
    pub(super) fn is_suspended(&self) -> bool {
        self.inner().suspended
    }

    /// Begins a load. Its snapshot must be taken afterwards.
    pub(super) fn announce<'a>(
        &'a self,
        turn: InTurn<'a, ()>,
        environment: EnvironmentId,
    ) -> Load<'a> {
        let mut inner = self.inner();
        inner.loading = (!inner.suspended).then(|| (environment, Later::Listed(Vec::new())));
        Load {
            memory: self,
            _turn: turn,
        }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner
            .lock()
            .expect("nothing panics while it holds the totals")
    }
}

impl Load<'_> {
    /// Says at which revision the snapshot is.
    pub(super) fn snapshot_taken(&self, schema: &Schema, revision: u64) {
        let mut inner = self.memory.inner();
        let Some((_, later)) = &mut inner.loading else {
            return;
        };
        let mut sum = ActionTotals::new(schema);
        sum.revision = revision;
        if let Later::Listed(commits) = later {
            commits
                .drain(..)
                .for_each(|(revision, cells)| sum.apply(revision, cells.into_iter()));
        }
        *later = Later::Summed(sum);
    }

    /// Keeps what was read together with what was committed meanwhile, if nothing came in between.
    pub(super) fn finish(self, mut totals: ActionTotals) -> Arc<ActionTotals> {
        let mut inner = self.memory.inner();
        let Some((environment, Later::Summed(later))) = inner.loading.take() else {
            return Arc::new(totals);
        };
        totals.append(&later);
        let totals = Arc::new(totals);
        inner.kept.put(environment, Arc::clone(&totals));
        totals
    }
}

impl Drop for Load<'_> {
    fn drop(&mut self) {
        self.memory.inner().loading = None;
    }
}

impl Inner {
    fn loading_of(&mut self, environment: EnvironmentId) -> Option<&mut Later> {
        self.loading
            .as_mut()
            .filter(|(of, _)| *of == environment)
            .map(|(_, later)| later)
    }
}

impl Later {
    fn apply(&mut self, revision: u64, cells: impl Iterator<Item = Counted>) {
        match self {
            Self::Listed(commits) => commits.push((revision, cells.collect())),
            Self::Summed(sum) => sum.apply(revision, cells),
        }
    }
}

#[cfg(test)]
mod tests;
