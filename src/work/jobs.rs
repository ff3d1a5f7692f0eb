//! Single flight: results that are shared by what they are made from. Who asks for one that is
//! being made waits for the same, and it goes on when who asked has left.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{Notify, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::deadline::Deadline;
use super::gate::stopped;
use super::progress::Progress;
use crate::error::{ErrorKind, Problem};

/// The idle timeout: a job that nobody has asked about for so long is given up.
const ABANDONED: Duration = Duration::from_secs(2 * 60);

/// Jobs of one kind that go on although nobody waits for them. When another is asked for, those go
/// that were longest left alone: who asks for many and leaves keeps nobody waiting.
const MOST_UNASKED: usize = 4;

/// Jobs of one kind that may go on at once.
const MOST: usize = 32;

/// A single-flight group: the jobs of one kind, by key. Cloning shares them.
pub struct Jobs<K, T>(Arc<Inner<K, T>>);

impl<K, T> Clone for Jobs<K, T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

struct Inner<K, T> {
    /// What is made, in words: "the ranking".
    what: &'static str,
    /// For how long a result is kept that nobody was told.
    kept: Duration,
    entries: Mutex<HashMap<K, Arc<Entry<T>>>>,
    stopping: CancellationToken,
}

/// What came out of a job.
type Outcome<T> = Option<Result<T, Problem>>;

struct Entry<T> {
    progress: Progress,
    outcome: watch::Sender<Outcome<T>>,
    asked: Mutex<Asked>,
    /// Told whenever one who waited has left.
    left: Notify,
    /// Cancelled where it has to make room.
    given_up: CancellationToken,
}

struct Asked {
    waiting: usize,
    /// When a caller last asked, or left.
    last: Instant,
}

/// Who waits for a job.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Who {
    Caller,
    /// One that is asked about itself: what it waits for is left alone since it was.
    Job,
}

impl<T> Entry<T> {
    fn asked(&self) -> MutexGuard<'_, Asked> {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_over(&self) -> bool {
        self.outcome.borrow().is_some()
    }

    fn goes_on(&self) -> bool {
        !self.is_over() && !self.given_up.is_cancelled()
    }
}

/// One who waits for a job.
struct Waiting<T> {
    entry: Arc<Entry<T>>,
    who: Who,
}

impl<T> Waiting<T> {
    fn new(entry: &Arc<Entry<T>>, who: Who) -> Self {
        entry.asked().waiting += 1;
        Self {
            entry: entry.clone(),
            who,
        }
    }
}

impl<T: Clone> Waiting<T> {
    async fn outcome(&self) -> Result<T, Problem> {
        let mut outcome = self.entry.outcome.subscribe();
        let made = outcome
            .wait_for(Option::is_some)
            .await
            .ok()
            .and_then(|outcome| outcome.clone());
        made.unwrap_or_else(|| Err(stopped()))
    }
}

impl<T> Drop for Waiting<T> {
    fn drop(&mut self) {
        let mut asked = self.entry.asked();
        asked.waiting -= 1;
        if self.who == Who::Caller {
            asked.last = Instant::now();
        }
        drop(asked);
        self.entry.left.notify_one();
    }
}

impl<K, T> Jobs<K, T>
where
    K: Clone + Eq + Hash + Send + Sync + 'static,
    T: Clone + Send + Sync + 'static,
{
    /// Makes results of a kind, `what` in words, until `stopping` is cancelled. One that nobody was
    /// told is kept for so long: whoever asked and left finds it when it comes back.
    pub fn new(what: &'static str, kept: Duration, stopping: CancellationToken) -> Self {
        Self(Arc::new(Inner {
            what,
            kept,
            entries: Mutex::default(),
            stopping,
        }))
    }

    /// Returns what a job of this key makes: of the one that goes on, or of one that begins now.
    /// Where the caller's patience ends before, it is told how far the job is, which goes on.
    pub async fn ask<F>(&self, key: K, make: impl FnOnce(Progress) -> F) -> Result<T, Problem>
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        let waiting = self.join(key, Who::Caller, make)?;
        match Deadline::current() {
            None => waiting.outcome().await,
            Some(Deadline { patience, .. }) => {
                let outcome = tokio::time::timeout_at(patience, waiting.outcome()).await;
                outcome.unwrap_or_else(|_| Err(self.goes_on(&waiting.entry.progress)))
            }
        }
    }

    /// Returns the same to another job, which waits for as long as it takes and tells how far this
    /// one is.
    pub async fn ask_for<F>(
        &self,
        other: &Progress,
        key: K,
        make: impl FnOnce(Progress) -> F,
    ) -> Result<T, Problem>
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        let waiting = self.join(key, Who::Job, make)?;
        other.follow(waiting.entry.progress.clone());
        waiting.outcome().await
    }

    /// Begins a job that nobody waits for, unless it goes on already or there is no room for it.
    pub fn begin<F>(&self, key: K, make: impl FnOnce(Progress) -> F)
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        // Whoever waits for it later is told of what is wrong with it.
        drop(self.join(key, Who::Caller, make));
    }

    fn join<F>(
        &self,
        key: K,
        who: Who,
        make: impl FnOnce(Progress) -> F,
    ) -> Result<Waiting<T>, Problem>
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        let mut entries = self.entries();
        // One that was given up is begun anew.
        if let Some(entry) = entries
            .get(&key)
            .filter(|entry| !entry.given_up.is_cancelled())
        {
            let waiting = Waiting::new(entry, who);
            if entry.is_over() {
                // It is told now, and is not kept for another.
                entries.remove(&key);
            }
            return Ok(waiting);
        }
        make_room(&entries);
        if entries.values().filter(|entry| entry.goes_on()).count() >= MOST {
            return Err(self.overloaded());
        }
        let asked = Mutex::new(Asked {
            waiting: 0,
            last: Instant::now(),
        });
        let entry = Arc::new(Entry {
            progress: Progress::default(),
            outcome: watch::Sender::new(None),
            asked,
            left: Notify::new(),
            given_up: CancellationToken::new(),
        });
        let waiting = Waiting::new(&entry, who);
        entries.insert(key.clone(), entry.clone());
        drop(entries);

        let made = make(entry.progress.clone());
        tokio::spawn(self.clone().carry_out(key, entry, made));
        Ok(waiting)
    }

    /// Makes a result and tells it to everybody who waits.
    async fn carry_out(
        self,
        key: K,
        entry: Arc<Entry<T>>,
        made: impl Future<Output = Result<T, Problem>> + Send,
    ) {
        // Whatever happens, nobody may find a job that has ended without an outcome.
        let mut ending = Ending {
            jobs: self,
            key,
            entry,
            is_kept: false,
        };

        let Ending { jobs, entry, .. } = &ending;
        let outcome = tokio::select! {
            // The stop first: what is made may fail of it too, as by a closed database, and would
            // say so in the log.
            biased;
            () = jobs.0.stopping.cancelled() => Err(stopped()),
            made = made => made,
            () = entry.given_up.cancelled() => Err(jobs.given_up()),
            () = abandoned(entry) => Err(jobs.given_up()),
        };

        ending.is_kept = ending.publish(outcome);
        if ending.is_kept {
            let Ending { jobs, .. } = &ending;
            jobs.0
                .stopping
                .run_until_cancelled(tokio::time::sleep(jobs.0.kept))
                .await;
            ending.is_kept = false;
        }
    }

    fn entries(&self) -> MutexGuard<'_, HashMap<K, Arc<Entry<T>>>> {
        self.0
            .entries
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    fn goes_on(&self, progress: &Progress) -> Problem {
        let (done, total, step) = progress.snapshot();
        let far = if total == 0 {
            "it has just begun".to_owned()
        } else {
            format!("{done} of {total} {step}")
        };
        let message = format!(
            "{} is still being made: {far}; it goes on, ask again",
            self.0.what
        );
        let problem = Problem::new(ErrorKind::Unavailable, "STILL_WORKING", message);
        problem.with("done", done).with("total", total)
    }

    fn overloaded(&self) -> Problem {
        let message = format!(
            "{MOST} others like {} are being made already; ask again in a moment",
            self.0.what
        );
        Problem::new(ErrorKind::Overloaded, "OVERLOADED", message)
    }

    fn given_up(&self) -> Problem {
        let message = format!(
            "{} was given up: nobody asked about it for long; ask again",
            self.0.what
        );
        Problem::new(ErrorKind::Unavailable, "ABANDONED", message)
    }
}

/// Gives up those jobs that were longest left alone, but for a few.
fn make_room<K, T>(entries: &HashMap<K, Arc<Entry<T>>>) {
    let is_unasked = |entry: &&Arc<Entry<T>>| entry.goes_on() && entry.asked().waiting == 0;
    let mut unasked: Vec<&Arc<Entry<T>>> = entries.values().filter(is_unasked).collect();
    unasked.sort_by_key(|entry| std::cmp::Reverse(entry.asked().last));
    unasked
        .into_iter()
        .skip(MOST_UNASKED)
        .for_each(|entry| entry.given_up.cancel());
}

/// Waits until nobody has waited for a job, or asked about it, for long.
async fn abandoned<T>(entry: &Entry<T>) {
    loop {
        let until = {
            let asked = entry.asked();
            (asked.waiting == 0).then_some(asked.last + ABANDONED)
        };
        match until {
            None => entry.left.notified().await,
            Some(until) if until <= Instant::now() => return,
            Some(until) => tokio::time::sleep_until(until).await,
        }
    }
}

/// Takes a job that is over from the list of those that go on.
struct Ending<K: Eq + Hash, T> {
    jobs: Jobs<K, T>,
    key: K,
    entry: Arc<Entry<T>>,
    is_kept: bool,
}

impl<K: Eq + Hash, T> Ending<K, T> {
    /// Tells what came out, and returns whether it is kept, since nobody waited for it.
    fn publish(&self, outcome: Result<T, Problem>) -> bool {
        // Whoever asks meanwhile finds it going on, or over, but never neither.
        let mut entries = self
            .jobs
            .0
            .entries
            .lock()
            .unwrap_or_else(PoisonError::into_inner);

        let is_kept =
            outcome.is_ok() && self.entry.asked().waiting == 0 && !self.jobs.0.kept.is_zero();
        self.entry.outcome.send_replace(Some(outcome));
        if !is_kept {
            self.remove(&mut entries);
        }
        is_kept
    }

    fn remove(&self, entries: &mut HashMap<K, Arc<Entry<T>>>) {
        if entries
            .get(&self.key)
            .is_some_and(|entry| Arc::ptr_eq(entry, &self.entry))
        {
            entries.remove(&self.key);
        }
    }
}

impl<K: Eq + Hash, T> Drop for Ending<K, T> {
    fn drop(&mut self) {
        self.remove(
            &mut self
                .jobs
                .0
                .entries
                .lock()
                .unwrap_or_else(PoisonError::into_inner),
        );
        if !self.entry.is_over() {
            // It panicked, or the runtime ends.
            self.entry.outcome.send_replace(Some(Err(Problem::new(
                ErrorKind::Internal,
                "INTERNAL",
                "the service failed; the cause is in its log",
            ))));
        }
    }
}

#[cfg(test)]
mod tests;
