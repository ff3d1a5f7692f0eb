//! What the journal has and rows have not, in memory: one [`Unfolded`] an environment.
//!
//! The writer changes it after each COMMIT, before anybody else can begin. Whoever reads takes a
//! [`View`] first and asks the database afterwards: see [`Unfolded`] for why that is right. While
//! nobody knows what was committed there is no view in memory, and readers load the journal
//! themselves.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;
use tokio::time::timeout;

use super::layout::Layout;
use crate::domain::EnvironmentId;
use crate::store::map::Map;
use crate::store::packed::run::Run;
use crate::store::packed::size::Size;
use crate::store::packed::unfolded::{Mark, Unfolded};

/// What the counts of an environment are, beside its rows.
#[derive(Debug, Clone)]
pub(super) struct View {
    /// What rows have not.
    pub(super) unfolded: Arc<Unfolded>,
    /// How many transitions the environment has, with these.
    pub(super) revision: u64,
    /// Where its rows are; `None` where nothing was counted yet.
    pub(super) layout: Option<Layout>,
    /// Whether the tables of states and cells have counts that are not in rows.
    pub(super) unmoved: bool,
    /// How many cells are in rows.
    pub(super) stored: u64,
    /// How many cells of the journal are in no row.
    pub(super) fresh: Fresh,
}

/// A bound of how many cells of the journal are in no row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Fresh {
    /// At most so many.
    pub(super) cells: u64,
    /// Whether it is exactly so many.
    pub(super) is_exact: bool,
}

impl View {
    /// Returns how many cells of the journal are in no row, at most: as many as were added, or as
    /// are left since equal ones of several commits were merged.
    pub(super) fn most_fresh(&self) -> u64 {
        self.fresh.cells.min(self.unfolded.len() as u64)
    }
}

/// From how many cells on the journal is folded into rows, and how many it may have.
#[derive(Debug, Clone, Copy)]
pub(super) struct FoldLimits {
    /// From how many on it is folded, of all environments together; it may have twice as many.
    pub(super) from: usize,
    /// The most cells that an environment may have.
    pub(super) quota: u64,
}

/// The limits of one environment are less where its quota leaves less room: all that waits may be
/// new to it, and once that could pass the quota, each commit has to read rows to know.
impl FoldLimits {
    fn from(&self, view: &View) -> usize {
        (self.room(view) / 4).clamp(self.least(), self.from)
    }

    fn most(&self, view: &View) -> usize {
        (self.room(view) / 8 * 7).clamp(2 * self.least(), 2 * self.from)
    }

    fn room(&self, view: &View) -> usize {
        usize::try_from(self.quota.saturating_sub(view.stored)).unwrap_or(usize::MAX)
    }

    /// A fold for each commit would cost more than it saves.
    fn least(&self) -> usize {
        self.from.div_ceil(32)
    }
}

impl Fresh {
    /// Nothing is in the journal.
    pub(super) const NONE: Self = Self {
        cells: 0,
        is_exact: true,
    };

    fn add(&mut self, cells: u64, is_exact: bool) {
        self.cells += cells;
        self.is_exact &= is_exact;
    }
}

/// An entry of the journal that was committed.
pub(super) struct Entry {
    pub(super) id: i64,
    pub(super) run: Run,
    /// How many of its cells were nowhere before, where that was counted.
    pub(super) fresh: Option<u64>,
    pub(super) layout: Layout,
    pub(super) revision: u64,
}

/// The journal of every environment, in memory.
#[derive(Default)]
pub(super) struct Pending {
    inner: Mutex<Inner>,
    grown: Notify,
}

#[derive(Default)]
struct Inner {
    /// None while nobody knows what was committed.
    views: Option<Map<EnvironmentId, View>>,
    /// What was measured last, of each environment where anything was.
    measured: Map<EnvironmentId, Measured>,
    last_entry: i64,
    /// When a fold last ended; none did yet where there is none.
    last_fold: Option<Instant>,
}

/// How many states and cells an environment was found to have, in rows and journal together. Folds do
/// not change it, and it never falls.
struct Measured {
    size: Size,
    /// The last entry of the journal that is in it.
    last: i64,
}

/// How long cells wait in the journal at most where nothing else is to be done: what waits is read
/// again at every start.
const LONGEST_WAIT: Duration = Duration::from_secs(30);

/// Something to be done in the background, so that reads stay fast and the journal short.
#[derive(Debug)]
pub(super) enum Task {
    /// Runs of a tier are to be merged.
    Merge(EnvironmentId, usize, Vec<Run>),
    /// The old tables are to be moved into rows.
    Move(EnvironmentId),
    /// The journal is to be folded into rows.
    Fold(EnvironmentId),
}

impl Pending {
    /// Returns what is known of an environment; `None` where nothing is.
    pub(super) fn view(&self, id: EnvironmentId) -> Option<View> {
        self.inner().views.as_ref()?.get(&id).cloned()
    }

    /// Returns whether more cells wait to be folded than may, of one environment or of all but those
    /// left alone.
    pub(super) fn is_full(
        &self,
        limits: FoldLimits,
        left_alone: impl Fn(EnvironmentId) -> bool,
    ) -> bool {
        let inner = self.inner();
        let views = inner.views.iter().flatten();
        let tended = views.filter(|(id, _)| !left_alone(**id));

        let mut all = 0;
        for (_, view) in tended {
            let cells = view.unfolded.len();
            all += cells;
            if cells > limits.most(view) {
                return true;
            }
        }
        all > 2 * limits.from
    }

    /// Returns the id of the next entry.
    pub(super) fn next_entry(&self) -> i64 {
        self.inner().last_entry + 1
    }

    /// Adds an environment that was made now.
    pub(super) fn begin(&self, id: EnvironmentId) {
        let view = View {
            unfolded: Arc::default(),
            revision: 0,
            layout: None,
            unmoved: false,
            stored: 0,
            fresh: Fresh::NONE,
        };
        self.change_all(|views| views.insert(id, view));
    }

    /// Adds what was committed.
    pub(super) fn push(&self, id: EnvironmentId, entry: &Entry) {
        self.inner().last_entry = entry.id;
        self.change(id, |view| {
            let cells = entry.fresh.unwrap_or(entry.run.len() as u64);
            view.fresh.add(cells, entry.fresh.is_some());
            view.layout = Some(entry.layout);
            view.revision = entry.revision;
            Arc::make_mut(&mut view.unfolded).push(entry.id, entry.run.clone());
        });
        self.grown.notify_one();
    }

    /// Forgets an environment that is gone.
    pub(super) fn forget(&self, id: EnvironmentId) {
        self.change_all(|views| views.remove(&id));
        self.inner().measured.remove(&id);
    }

    /// Notes how many states and cells an environment was found to have, with the journal of a view.
    pub(super) fn measured(&self, id: EnvironmentId, view: &View, size: Size) {
        let last = view.unfolded.last();
        let mut inner = self.inner();
        let before = inner.measured.get(&id);
        // Somebody may have measured more meanwhile, or it may be gone.
        let is_gone = inner
            .views
            .as_ref()
            .is_some_and(|views| !views.contains_key(&id));
        if !is_gone && before.is_none_or(|before| before.last < last) {
            inner.measured.insert(id, Measured { size, last });
        }
    }

    /// Returns how many states and cells an environment has, where that was measured with the same
    /// journal.
    pub(super) fn size(&self, id: EnvironmentId, view: &View) -> Option<Size> {
        let inner = self.inner();
        let measured = inner.measured.get(&id);
        let measured = measured.filter(|measured| measured.last == view.unfolded.last());
        measured.map(|measured| measured.size)
    }

    /// Returns how many states and cells an environment has at least, where that was ever measured.
    pub(super) fn least_size(&self, id: EnvironmentId) -> Option<Size> {
        self.inner().measured.get(&id).map(|measured| measured.size)
    }

    /// Knows nothing until [`Pending::replace`].
    pub(super) fn suspend(&self) {
        self.inner().views = None;
    }

    /// Returns whether nothing is known.
    pub(super) fn is_suspended(&self) -> bool {
        self.inner().views.is_none()
    }

    /// Begins anew with what the database has.
    pub(super) fn replace(&self, views: Map<EnvironmentId, View>, last_entry: i64) {
        let mut inner = self.inner();
        inner.views = Some(views);
        inner.last_fold.get_or_insert_with(Instant::now);
        inner.last_entry = inner.last_entry.max(last_entry);
        drop(inner);
        self.grown.notify_one();
    }

    /// Notes exactly how many cells of an environment are in no row, of those that it had.
    pub(super) fn counted(&self, id: EnvironmentId, cells: u64, last: i64) {
        self.change(id, |view| {
            if view.unfolded.last() == last {
                view.fresh = Fresh {
                    cells,
                    is_exact: true,
                };
            }
        });
    }

    /// Freezes what an environment has for a fold, where none is under way, and returns that with
    /// where the fold stands.
    pub(super) fn freeze(&self, id: EnvironmentId) -> Option<(View, Mark)> {
        let mut inner = self.inner();
        let view = inner.views.as_mut()?.get_mut(&id)?;
        let mark = Arc::make_mut(&mut view.unfolded).freeze();
        Some((view.clone(), mark))
    }

    /// Notes how far a fold is, and that so many cells are in rows now that were not.
    pub(super) fn folded(&self, id: EnvironmentId, mark: Mark, new_cells: u64) {
        if mark.next_row.is_none() {
            self.inner().last_fold = Some(Instant::now());
        }
        self.change(id, |view| {
            Arc::make_mut(&mut view.unfolded).folded(mark);
            view.stored += new_cells;
            view.fresh.cells = view.fresh.cells.saturating_sub(new_cells);
            // What was folded was counted once for each entry; what is left is known better.
            if mark.next_row.is_none() && !view.fresh.is_exact {
                view.fresh.cells = view.unfolded.len() as u64;
                view.fresh.is_exact = view.unfolded.is_empty();
            }
        });
    }

    /// Puts the merge of the first runs of a tier in their place, if they are still there.
    pub(super) fn merged(&self, id: EnvironmentId, tier: usize, runs: &[Run], merged: Run) {
        self.change(id, |view| {
            Arc::make_mut(&mut view.unfolded).merged(tier, runs, merged);
        });
    }

    /// Notes where an environment has its rows, or that all of it is there.
    pub(super) fn moved(&self, id: EnvironmentId, layout: Layout, unmoved: bool) {
        self.change(id, |view| {
            view.layout = Some(layout);
            view.unmoved = unmoved;
        });
    }

    /// Returns what is most urgent, if anything is: of merges, moves and, from a limit on, folds.
    /// Environments that must be left alone are.
    pub(super) fn task(
        &self,
        limits: FoldLimits,
        left_alone: impl Fn(EnvironmentId) -> bool,
    ) -> Option<Task> {
        let inner = self.inner();
        let views = inner.views.as_ref()?;
        let tended = || views.iter().filter(|(id, _)| !left_alone(**id));

        let mut under_way = tended().filter(|(_, view)| view.unfolded.is_folding());
        let under_way = under_way.next().map(|(id, _)| *id);
        // Not after merges: a fold that begins merges all that there is, whatever was merged before.
        let due = match under_way {
            Some(_) => None,
            None => inner.due(limits, tended()),
        };
        let mut full = tended().filter_map(|(id, view)| Some((*id, view.unfolded.full_tier()?)));
        if let (None, Some((id, (tier, runs)))) = (due, full.next()) {
            return Some(Task::Merge(id, tier, runs));
        }

        if let Some(id) = due.or(under_way) {
            return Some(fold(id, &views[&id]));
        }
        let mut unmoved = tended().filter(|(_, view)| view.unmoved);
        unmoved.next().map(|(id, _)| Task::Move(*id))
    }

    /// Waits until something was added, or has waited long.
    pub(super) async fn grown(&self) {
        timeout(LONGEST_WAIT, self.grown.notified()).await.ok();
    }

    fn change(&self, id: EnvironmentId, change: impl FnOnce(&mut View)) {
        self.change_all(|views| views.get_mut(&id).map(change));
    }

    fn change_all<T>(&self, change: impl FnOnce(&mut Map<EnvironmentId, View>) -> T) {
        self.inner().views.as_mut().map(change);
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// Returns the environment whose journal is to be folded next, where one is due: the largest, of
    /// those beyond their limits first.
    fn due<'v>(
        &self,
        limits: FoldLimits,
        views: impl Iterator<Item = (&'v EnvironmentId, &'v View)>,
    ) -> Option<EnvironmentId> {
        let (mut largest, mut all) = (None, 0);
        for (id, view) in views {
            let cells = view.unfolded.len();
            all += cells;
            largest = largest.max(Some((cells >= limits.from(view), cells, *id)));
        }
        let is_due = all >= limits.from || (all > 0 && self.has_waited_long());
        let largest = largest.filter(|(is_large, ..)| is_due || *is_large);
        largest.map(|(.., id)| id)
    }

    fn has_waited_long(&self) -> bool {
        self.last_fold
            .is_none_or(|last| last.elapsed() >= LONGEST_WAIT)
    }
}

/// What is in the old tables must be in rows before a fold counts which cells are new.
fn fold(id: EnvironmentId, view: &View) -> Task {
    if view.unmoved {
        Task::Move(id)
    } else {
        Task::Fold(id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::Tally;
    use crate::store::packed::cells::Place;

    const LIMITS: FoldLimits = FoldLimits {
        from: 3_200,
        quota: 12_800,
    };

    /// The journal of environments with so many cells in rows and in the journal.
    fn holding(environments: &[(u64, u64)]) -> Pending {
        let pending = Pending::default();
        pending.replace(Map::default(), 0);
        for (id, (stored, waiting)) in (1..).map(EnvironmentId).zip(environments) {
            pending.begin(id);
            pending.folded(id, Mark::default(), *stored);
            let cell = |state| {
                let place = Place {
                    state,
                    segment: 1,
                    family: 0,
                    joint: 0,
                };
                (
                    place,
                    Tally {
                        n: 1,
                        entries: None,
                    },
                )
            };
            let entry = Entry {
                id: id.0,
                run: Run::of((0..*waiting).map(cell)),
                fresh: None,
                layout: Layout::new(id, 0),
                revision: *waiting,
            };
            pending.push(id, &entry);
        }
        pending
    }

    fn folds(environments: &[(u64, u64)]) -> Option<i64> {
        match holding(environments).task(LIMITS, |_| false) {
            Some(Task::Fold(id)) => Some(id.0),
            Some(other) => panic!("expected a fold: {other:?}"),
            None => None,
        }
    }

    fn is_full(environments: &[(u64, u64)]) -> bool {
        holding(environments).is_full(LIMITS, |_| false)
    }

    #[test]
    fn a_fold_begins_sooner_where_a_quota_leaves_less_room() {
        assert_eq!(folds(&[(0, 3_199)]), None);
        assert_eq!(folds(&[(0, 3_200)]), Some(1));

        assert_eq!(folds(&[(6_800, 1_499)]), None, "a quarter of 6,000");
        assert_eq!(folds(&[(6_800, 1_500)]), Some(1));
        for stored in [12_500, 12_800, u64::MAX] {
            assert_eq!(
                folds(&[(stored, 99)]),
                None,
                "not for each commit: {stored}"
            );
            assert_eq!(folds(&[(stored, 100)]), Some(1), "{stored}");
        }

        assert_eq!(folds(&[(0, 1_600), (0, 1_601)]), Some(2), "of all together");
        assert_eq!(
            folds(&[(0, 1_500), (11_600, 400)]),
            Some(2),
            "what must go first"
        );
    }

    #[test]
    fn a_journal_is_full_before_it_could_pass_the_quota() {
        for (environments, full) in [
            (&[(0, 6_400)][..], false),
            (&[(0, 6_401)], true),
            (&[(6_800, 5_250)], false),
            (&[(6_800, 5_251)], true),
            (&[(0, 3_200), (0, 3_201)], true),
            (&[(0, 10), (12_800, 201)], true),
        ] {
            assert_eq!(is_full(environments), full, "{environments:?}");
        }
        assert!(
            !holding(&[(0, 6_401)]).is_full(LIMITS, |_| true),
            "left alone"
        );
    }
}
