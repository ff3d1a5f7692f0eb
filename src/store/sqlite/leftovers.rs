//! The queue of garbage collection: which deleted environments wait for their rows to be removed,
//! and how many rows go at a time (a pace that adapts to how long a step holds up the commits).

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};
use tokio::sync::Notify;

use crate::store::{Leftovers, StoreError};

/// An environment that is gone and has rows left.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Removal {
    pub(super) id: i64,
    pub(super) uid: String,
    /// Its states that are left; unknown until they are counted.
    pub(super) states: Option<u64>,
    /// Whether the log was told that it goes on.
    pub(super) begun: bool,
    /// Whether the log was told that it does not.
    pub(super) failed: bool,
}

impl Removal {
    /// Makes one of which nothing is counted yet.
    pub(super) fn new(id: i64, uid: String) -> Self {
        Self {
            id,
            uid,
            states: None,
            begun: false,
            failed: false,
        }
    }
}

/// Returns the environments that are gone and have rows left.
pub(super) async fn gone(connection: &mut SqliteConnection) -> Result<Vec<Removal>, sqlx::Error> {
    let rows = sqlx::query("select id, uid from environments where name is null order by id")
        .fetch_all(connection)
        .await?;
    rows.iter().map(read_removal).collect()
}

fn read_removal(row: &SqliteRow) -> Result<Removal, sqlx::Error> {
    Ok(Removal::new(row.try_get("id")?, row.try_get("uid")?))
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
        let states = inner
            .queue
            .iter()
            .filter_map(|removal| removal.states)
            .sum();
        Leftovers {
            environments: inner.queue.len() as u64,
            states,
        }
    }

    /// Replaces all by what the database holds.
    pub(super) fn replace(&self, gone: Vec<Removal>) {
        let mut inner = self.inner();
        inner
            .queue
            .retain(|known| gone.iter().any(|removal| removal.id == known.id));

        let unknown = |removal: &Removal| inner.queue.iter().all(|known| known.id != removal.id);
        let new: Vec<Removal> = gone.into_iter().filter(unknown).collect();
        inner.queue.extend(new);

        drop(inner);
        self.added.notify_one();
    }

    /// Adds an environment that is gone now.
    pub(super) fn add(&self, removal: Removal) {
        self.inner().queue.push_back(removal);
        self.added.notify_one();
    }

    /// Waits until there is one, and returns the one whose turn it is.
    pub(super) async fn next(&self) -> Removal {
        loop {
            if let Some(removal) = self.inner().queue.front() {
                return removal.clone();
            }
            self.added.notified().await;
        }
    }

    /// Returns how many rows the next step may have.
    pub(super) fn rows(&self) -> u32 {
        self.inner().pace.rows
    }

    /// Returns those of which the log was not told.
    pub(super) fn unbegun(&self) -> Vec<Removal> {
        self.inner()
            .queue
            .iter()
            .filter(|removal| !removal.begun)
            .cloned()
            .collect()
    }

    /// Notes that the log was told of one, and its states.
    pub(super) fn begun(&self, counted: Removal) {
        self.change(counted.id, |removal| {
            *removal = Removal {
                begun: true,
                ..counted
            }
        });
    }

    /// Notes what a step removed.
    pub(super) fn swept(&self, id: i64, step: &Step) {
        self.inner().pace.after(step.took);
        self.change(id, |removal| {
            removal.states = removal
                .states
                .map(|states| states.saturating_sub(step.states));
            if std::mem::take(&mut removal.failed) {
                tracing::info!(
                    uid = removal.uid,
                    "what a deleted environment has left can be removed again"
                );
            }
        });

        if !step.is_last {
            return;
        }

        let mut inner = self.inner();
        let at = inner.queue.iter().position(|removal| removal.id == id);
        if let Some(removal) = at.and_then(|at| inner.queue.remove(at)) {
            tracing::info!(
                uid = removal.uid,
                "nothing is left of a deleted environment"
            );
        }
    }

    /// Says once what is wrong, and lets the others go first: what one has left may be damaged.
    pub(super) fn failed(&self, id: i64, error: &StoreError) {
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
        if let Some(removal) = self
            .inner()
            .queue
            .iter_mut()
            .find(|removal| removal.id == id)
        {
            change(removal);
        }
    }

    fn inner(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a step removed.
pub(super) struct Step {
    /// How many states.
    pub(super) states: u64,
    /// How long the others could not write, but for the disk.
    pub(super) took: Duration,
    /// Whether nothing is left.
    pub(super) is_last: bool,
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
    use crate::store::sqlite::error::aborted;

    fn removal(id: i64, states: Option<u64>) -> Removal {
        Removal {
            states,
            ..Removal::new(id, format!("uid-{id}"))
        }
    }

    fn ids(removals: &Removals) -> Vec<i64> {
        removals
            .inner()
            .queue
            .iter()
            .map(|removal| removal.id)
            .collect()
    }

    #[test]
    fn steps_become_smaller_while_they_take_long_and_larger_while_they_do_not() {
        let mut pace = Pace::default();
        let mut rows = |milliseconds: &[u64]| {
            milliseconds
                .iter()
                .for_each(|took| pace.after(Duration::from_millis(*took)));
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
        removals.swept(
            3,
            &Step {
                states: 4,
                took: Duration::ZERO,
                is_last: false,
            },
        );
        assert_eq!(
            removals.left(),
            Leftovers {
                environments: 2,
                states: 13
            }
        );

        // A new connection says which are there: one more, whose states nobody has counted.
        removals.replace(vec![removal(3, None), removal(5, None), removal(8, None)]);
        assert_eq!(
            removals.left(),
            Leftovers {
                environments: 3,
                states: 13
            }
        );
        removals.begun(removal(8, Some(100)));
        assert_eq!(
            removals.left(),
            Leftovers {
                environments: 3,
                states: 113
            }
        );
        removals.replace(vec![removal(5, None)]);
        assert_eq!(
            (removals.left(), ids(&removals)),
            (
                Leftovers {
                    environments: 1,
                    states: 7
                },
                vec![5]
            )
        );
        removals.swept(
            5,
            &Step {
                states: 9,
                took: Duration::ZERO,
                is_last: true,
            },
        );
        assert_eq!(removals.left(), Leftovers::default());
    }

    #[test]
    fn one_that_fails_lets_the_others_go_first() {
        let removals = Removals::default();
        [1, 2, 3]
            .into_iter()
            .for_each(|id| removals.add(removal(id, None)));
        let error = aborted("disk I/O error");
        removals.failed(1, &error);
        assert_eq!(ids(&removals), [2, 3, 1]);
        removals.failed(1, &error);
        assert_eq!(ids(&removals), [2, 3, 1], "it has waited already");
    }
}
