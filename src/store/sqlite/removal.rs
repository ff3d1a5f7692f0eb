//! Removing an environment: a tombstone at once, and then garbage collection of its rows in steps, so small that the commits of others hardly wait.
//!
//! Without a name and without totals it is gone: no commit and no read finds it, and its name is free. What is left of it is remembered with the other
//! memory of the database, so that whatever interrupts a removal, a failed transaction or kill -9, the next connection finds what is to be done.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sqlx::sqlite::{SqliteConnection, SqliteRow};
use sqlx::{Row, SqlitePool};
use tokio::sync::Notify;

use super::error::aborted;
use super::known::Known;
use super::writer::{Memory, Writer};
use crate::domain::EnvironmentId;
use crate::store::{Leftovers, StoreError};

/// Removes an environment for everybody, and leaves its rows to [`sweep`].
pub(super) async fn delete(writer: &Writer, id: EnvironmentId) -> Result<(), StoreError> {
    let mut transaction = writer.begin().await?;
    let Some(left) = hide(transaction.connection(), id).await.map_err(aborted)? else {
        transaction.end().await?;
        return Err(StoreError::UnknownEnvironment);
    };
    let forget = |memory: &Memory, known: &mut Known| {
        memory.directory.remove(id);
        memory.cache.forget(id);
        memory.actions.forget(id);
        known.forget(id);
        memory.removals.add(left);
    };
    transaction.commit(forget).await
}

async fn hide(connection: &mut SqliteConnection, id: EnvironmentId) -> Result<Option<Removal>, sqlx::Error> {
    let text = "update environments set name = null where id = ? and name is not null returning uid";
    let Some(uid) = sqlx::query_scalar(text).bind(id.0).fetch_optional(&mut *connection).await? else {
        return Ok(None);
    };
    let text = "delete from totals where environment = ? returning states";
    let states: Option<i64> = sqlx::query_scalar(text).bind(id.0).fetch_optional(connection).await?;
    Ok(Some(Removal { states: states.map(i64::unsigned_abs), ..Removal::new(id.0, uid) }))
}

/// Returns the environments that are gone and have rows left.
pub(super) async fn gone(connection: &mut SqliteConnection) -> Result<Vec<Removal>, sqlx::Error> {
    let rows = sqlx::query("select id, uid from environments where name is null order by id").fetch_all(connection);
    let read = |row: &SqliteRow| Ok(Removal::new(row.try_get("id")?, row.try_get("uid")?));
    rows.await?.iter().map(read).collect()
}

/// Waits until an environment is gone and has rows left, and removes some of them.
pub(super) async fn sweep(writer: &Writer, readers: &SqlitePool, removals: &Removals) -> Result<(), StoreError> {
    let removal = removals.next().await;
    if !removal.begun {
        begin(readers, removals).await;
    }
    let swept = step(writer, removal.id, removals.rows()).await;
    match &swept {
        Ok(step) => {
            removals.swept(removal.id, step);
            // Where it fails, a commit does it.
            writer.checkpoint().await.ok();
        }
        Err(error) => removals.failed(removal.id, error),
    }
    swept.map(drop)
}

/// Says in the log what is to be removed, and counts it where that is not known.
async fn begin(readers: &SqlitePool, removals: &Removals) {
    for mut removal in removals.unbegun() {
        if removal.states.is_none() {
            let counted = sqlx::query_scalar("select count(*) from states where environment = ?").bind(removal.id);
            // Only told: where it cannot be counted, the removal itself says why.
            removal.states = counted.fetch_one(readers).await.ok().map(i64::unsigned_abs);
        }
        let Removal { uid, states, .. } = &removal;
        tracing::info!(uid, states, "removing what a deleted environment has left, in the background");
        removals.begun(removal);
    }
}

/// What a step removed.
struct Step {
    states: u64,
    /// How long the others could not write, but for the disk.
    took: Duration,
    is_last: bool,
}

/// What is removed together: those first that refer to others. Of each at most so many rows; a model may have some MiB.
const PARTS: [&[&str]; 7] = [
    &[
        "delete from cells where (state, segment, joint) in (
             select state, segment, joint from cells
             where state in (select id from states where environment = ?1 order by key limit ?2) limit ?2)",
        "delete from states where id in (select id from states where environment = ?1 order by key limit ?2)",
    ],
    &[
        "delete from batches where (producer, sequence) in (
             select producer, sequence from batches
             where producer in (select id from producers where environment = ?1 order by name limit ?2) limit ?2)",
        "delete from producers where id in (select id from producers where environment = ?1 order by name limit ?2)",
    ],
    &["delete from models where rowid in
           (select rowid from models where environment = ?1 order by version limit min(?2, 1))"],
    &["delete from segments where id in (select id from segments where environment = ?1 order by label limit ?2)"],
    &["delete from fits where environment = ?1 and pair in
           (select pair from fits where environment = ?1 order by pair limit ?2)"],
    &["delete from model_versions where environment = ?1 and ?2 > 0"],
    &["delete from environments where id = ?1 and name is null and ?2 > 0"],
];

/// The part of [`PARTS`] that has the states.
const STATES: usize = 0;

/// Removes the first part with something left, or some of it.
async fn step(writer: &Writer, id: i64, rows: u32) -> Result<Step, StoreError> {
    let mut transaction = writer.begin().await?;
    let started = Instant::now();
    // Where nothing at all is left, that was it.
    let mut step = Step { states: 0, took: Duration::ZERO, is_last: true };
    for (at, part) in PARTS.iter().enumerate() {
        let removed = remove(transaction.connection(), part, id, rows).await.map_err(aborted)?;
        if removed.iter().any(|removed| *removed > 0) {
            step.states = if at == STATES { removed[1] } else { 0 };
            step.is_last = at + 1 == PARTS.len();
            break;
        }
    }
    step.took = started.elapsed();
    transaction.commit(|_, _| ()).await?;
    Ok(step)
}

/// Runs the statements of a part, as far as one before has left nothing that refers to what the next removes.
async fn remove(
    connection: &mut SqliteConnection,
    part: &[&'static str],
    id: i64,
    rows: u32,
) -> Result<[u64; 2], sqlx::Error> {
    let mut removed = [0; 2];
    for (text, removed) in part.iter().zip(&mut removed) {
        *removed = sqlx::query(*text).bind(id).bind(rows).execute(&mut *connection).await?.rows_affected();
        if *removed == u64::from(rows) {
            break;
        }
    }
    Ok(removed)
}

/// An environment that is gone and has rows left.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Removal {
    id: i64,
    uid: String,
    /// Its states that are left; unknown until they are counted.
    states: Option<u64>,
    /// Whether the log was told that it goes on.
    begun: bool,
    /// Whether the log was told that it does not.
    failed: bool,
}

impl Removal {
    fn new(id: i64, uid: String) -> Self {
        Self { id, uid, states: None, begun: false, failed: false }
    }
}

/// The environments that are gone and have rows left: one after another is removed.
#[derive(Default)]
pub(super) struct Removals {
    inner: Mutex<Inner>,
    added: Notify,
}

#[derive(Default)]
struct Inner {
    queue: VecDeque<Removal>,
    pace: Pace,
}

impl Removals {
    /// Returns what is left.
    pub(super) fn left(&self) -> Leftovers {
        let inner = self.inner();
        let states = inner.queue.iter().filter_map(|removal| removal.states).sum();
        Leftovers { environments: inner.queue.len() as u64, states }
    }

    /// Replaces all by what the database holds.
    pub(super) fn replace(&self, gone: Vec<Removal>) {
        let mut inner = self.inner();
        inner.queue.retain(|known| gone.iter().any(|removal| removal.id == known.id));
        let unknown = |removal: &Removal| inner.queue.iter().all(|known| known.id != removal.id);
        let new: Vec<Removal> = gone.into_iter().filter(unknown).collect();
        inner.queue.extend(new);
        drop(inner);
        self.added.notify_one();
    }

    fn add(&self, removal: Removal) {
        self.inner().queue.push_back(removal);
        self.added.notify_one();
    }

    async fn next(&self) -> Removal {
        loop {
            if let Some(removal) = self.inner().queue.front() {
                return removal.clone();
            }
            self.added.notified().await;
        }
    }

    fn rows(&self) -> u32 {
        self.inner().pace.rows
    }

    fn unbegun(&self) -> Vec<Removal> {
        self.inner().queue.iter().filter(|removal| !removal.begun).cloned().collect()
    }

    fn begun(&self, counted: Removal) {
        self.change(counted.id, |removal| *removal = Removal { begun: true, ..counted });
    }

    fn swept(&self, id: i64, step: &Step) {
        self.inner().pace.after(step.took);
        self.change(id, |removal| {
            removal.states = removal.states.map(|states| states.saturating_sub(step.states));
            if std::mem::take(&mut removal.failed) {
                tracing::info!(uid = removal.uid, "what a deleted environment has left can be removed again");
            }
        });
        if !step.is_last {
            return;
        }
        let mut inner = self.inner();
        let at = inner.queue.iter().position(|removal| removal.id == id);
        if let Some(removal) = at.and_then(|at| inner.queue.remove(at)) {
            tracing::info!(uid = removal.uid, "nothing is left of a deleted environment");
        }
    }

    /// Says once what is wrong, and lets the others go first: what one has left may be damaged.
    fn failed(&self, id: i64, error: &StoreError) {
        self.change(id, |removal| {
            if !std::mem::replace(&mut removal.failed, true) {
                tracing::warn!(uid = removal.uid, %error, "what a deleted environment has left cannot be removed: it is tried again until it can");
            }
        });
        let mut inner = self.inner();
        if inner.queue.front().is_some_and(|removal| removal.id == id) {
            inner.queue.rotate_left(1);
        }
    }

    fn change(&self, id: i64, change: impl FnOnce(&mut Removal)) {
        if let Some(removal) = self.inner().queue.iter_mut().find(|removal| removal.id == id) {
            change(removal);
        }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// How many rows a step may have: so many as take some milliseconds, which a commit waits at most.
#[derive(Debug, PartialEq)]
struct Pace {
    rows: u32,
}

impl Pace {
    const FEWEST: u32 = 16;
    /// More would be written to the disk for longer than they take here.
    const MOST: u32 = 512;
    const LONG: Duration = Duration::from_millis(6);
    const SHORT: Duration = Duration::from_millis(2);

    fn after(&mut self, took: Duration) {
        if took > Self::LONG {
            self.rows = (self.rows / 2).max(Self::FEWEST);
        } else if took < Self::SHORT {
            self.rows = (self.rows * 2).min(Self::MOST);
        }
    }
}

impl Default for Pace {
    fn default() -> Self {
        Self { rows: 256 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn removal(id: i64, states: Option<u64>) -> Removal {
        Removal { states, ..Removal::new(id, format!("uid-{id}")) }
    }

    fn ids(removals: &Removals) -> Vec<i64> {
        removals.inner().queue.iter().map(|removal| removal.id).collect()
    }

    #[test]
    fn steps_become_smaller_while_they_take_long_and_larger_while_they_do_not() {
        let mut pace = Pace::default();
        let mut rows = |milliseconds: &[u64]| {
            milliseconds.iter().for_each(|took| pace.after(Duration::from_millis(*took)));
            pace.rows
        };
        assert_eq!(rows(&[7]), 128);
        assert_eq!(rows(&[3, 6, 4]), 128);
        assert_eq!(rows(&[1]), 256);
        assert_eq!(rows(&[100; 50]), Pace::FEWEST);
        assert_eq!(rows(&[0; 50]), Pace::MOST);
    }

    #[test]
    fn what_is_left_is_known_through_failed_transactions() {
        let removals = Removals::default();
        removals.add(removal(3, Some(10)));
        removals.add(removal(5, Some(7)));
        removals.swept(3, &Step { states: 4, took: Duration::ZERO, is_last: false });
        assert_eq!(removals.left(), Leftovers { environments: 2, states: 13 });

        // A new connection says which are there: one more, whose states nobody has counted.
        removals.replace(vec![removal(3, None), removal(5, None), removal(8, None)]);
        assert_eq!(removals.left(), Leftovers { environments: 3, states: 13 });
        removals.begun(removal(8, Some(100)));
        assert_eq!(removals.left(), Leftovers { environments: 3, states: 113 });
        removals.replace(vec![removal(5, None)]);
        assert_eq!((removals.left(), ids(&removals)), (Leftovers { environments: 1, states: 7 }, vec![5]));
        removals.swept(5, &Step { states: 9, took: Duration::ZERO, is_last: true });
        assert_eq!(removals.left(), Leftovers::default());
    }

    #[test]
    fn one_that_fails_lets_the_others_go_first() {
        let removals = Removals::default();
        [1, 2, 3].into_iter().for_each(|id| removals.add(removal(id, None)));
        let error = aborted("disk I/O error");
        removals.failed(1, &error);
        assert_eq!(ids(&removals), [2, 3, 1]);
        removals.failed(1, &error);
        assert_eq!(ids(&removals), [2, 3, 1], "it has waited already");
    }
}
