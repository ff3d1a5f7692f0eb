//! Shared results, by what they are made from: who asks for one that is being made waits for the same, and it goes on when who asked has left.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::deadline::Deadline;
use super::gate::stopped;
use crate::error::{ErrorKind, Problem};

/// A job that nobody has asked about for so long is given up.
const ABANDONED: Duration = Duration::from_secs(2 * 60);

/// Jobs of one kind that go on although nobody waits for them. When another is asked for, those go that were longest left alone: who asks for many and leaves
/// keeps nobody waiting.
const MOST_UNASKED: usize = 4;

/// Jobs of one kind that may go on at once.
const MOST: usize = 32;

/// How far a job is. Cloning shares it.
#[derive(Debug, Clone, Default)]
pub struct Progress(Arc<Figures>);

#[derive(Debug, Default)]
struct Figures {
    step: Mutex<Step>,
    done: AtomicU64,
    total: AtomicU64,
}

#[derive(Debug, Clone)]
enum Step {
    /// Its own, in words.
    Own(&'static str),
    /// Another job, whose result is waited for.
    Of(Progress),
}

impl Default for Step {
    fn default() -> Self {
        Self::Own("")
    }
}

impl Progress {
    /// Begins a step of so many parts; `step` says in words what is done to them, "states measured".
    pub fn begin(&self, step: &'static str, total: u64) {
        *self.step() = Step::Own(step);
        self.0.done.store(0, Ordering::Relaxed);
        self.0.total.store(total, Ordering::Relaxed);
    }

    /// Tells that so many more parts are done.
    pub fn add(&self, parts: u64) {
        self.0.done.fetch_add(parts, Ordering::Relaxed);
    }

    /// Tells how far another job is, until the next step begins.
    fn follow(&self, other: Self) {
        *self.step() = Step::Of(other);
    }

    /// Returns what is done, of how many, and in words; what grows meanwhile does not pass its total.
    fn told(&self) -> (u64, u64, &'static str) {
        let step = self.step().clone();
        match step {
            Step::Of(other) => other.told(),
            Step::Own(step) => {
                let [done, total] = [&self.0.done, &self.0.total].map(|figure| figure.load(Ordering::Relaxed));
                (done.min(total), total, step)
            }
        }
    }

    fn step(&self) -> MutexGuard<'_, Step> {
        self.0.step.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The jobs of one kind. Cloning shares them.
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
    /// Cancelled where it has to make room.
    given_up: CancellationToken,
}

struct Asked {
    waiting: usize,
    last: Instant,
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
struct Waiting<T>(Arc<Entry<T>>);

impl<T> Waiting<T> {
    fn new(entry: &Arc<Entry<T>>) -> Self {
        entry.asked().waiting += 1;
        Self(entry.clone())
    }
}

impl<T: Clone> Waiting<T> {
    async fn outcome(&self) -> Result<T, Problem> {
        let mut outcome = self.0.outcome.subscribe();
        let made = outcome.wait_for(Option::is_some).await.ok().and_then(|outcome| outcome.clone());
        made.unwrap_or_else(|| Err(stopped()))
    }
}

impl<T> Drop for Waiting<T> {
    fn drop(&mut self) {
        let mut asked = self.0.asked();
        (asked.waiting, asked.last) = (asked.waiting - 1, Instant::now());
    }
}

impl<K, T> Jobs<K, T>
where
    K: Clone + Eq + Hash + Send + Sync + 'static,
    T: Clone + Send + Sync + 'static,
{
    /// Makes results of a kind, `what` in words, until `stopping` is cancelled. One that nobody was told is kept for so long: whoever asked and left finds
    /// it when it comes back.
    pub fn new(what: &'static str, kept: Duration, stopping: CancellationToken) -> Self {
        Self(Arc::new(Inner { what, kept, entries: Mutex::default(), stopping }))
    }

    /// Returns what a job of this key makes: of the one that goes on, or of one that begins now. Where the caller's patience ends before, it is told how far
    /// the job is, which goes on.
    pub async fn ask<F>(&self, key: K, make: impl FnOnce(Progress) -> F) -> Result<T, Problem>
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        let waiting = self.join(key, make)?;
        match Deadline::current() {
            None => waiting.outcome().await,
            Some(Deadline { patience, .. }) => {
                let told = tokio::time::timeout_at(patience, waiting.outcome()).await;
                told.unwrap_or_else(|_| Err(self.goes_on(&waiting.0.progress)))
            }
        }
    }

    /// Returns the same to another job, which waits for as long as it takes and tells how far this one is.
    pub async fn ask_for<F>(&self, other: &Progress, key: K, make: impl FnOnce(Progress) -> F) -> Result<T, Problem>
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        let waiting = self.join(key, make)?;
        other.follow(waiting.0.progress.clone());
        waiting.outcome().await
    }

    /// Begins a job that nobody waits for, unless it goes on already or there is no room for it.
    pub fn begin<F>(&self, key: K, make: impl FnOnce(Progress) -> F)
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        // Whoever waits for it later is told of what is wrong with it.
        drop(self.join(key, make));
    }

    fn join<F>(&self, key: K, make: impl FnOnce(Progress) -> F) -> Result<Waiting<T>, Problem>
    where
        F: Future<Output = Result<T, Problem>> + Send + 'static,
    {
        let mut entries = self.entries();
        // One that was given up is begun anew.
        if let Some(entry) = entries.get(&key).filter(|entry| !entry.given_up.is_cancelled()) {
            let waiting = Waiting::new(entry);
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
        let asked = Mutex::new(Asked { waiting: 0, last: Instant::now() });
        let entry = Arc::new(Entry {
            progress: Progress::default(),
            outcome: watch::Sender::new(None),
            asked,
            given_up: CancellationToken::new(),
        });
        let waiting = Waiting::new(&entry);
        entries.insert(key.clone(), entry.clone());
        drop(entries);

        let made = make(entry.progress.clone());
        tokio::spawn(self.clone().carry_out(key, entry, made));
        Ok(waiting)
    }

    /// Makes a result and tells it to everybody who waits.
    async fn carry_out(self, key: K, entry: Arc<Entry<T>>, made: impl Future<Output = Result<T, Problem>> + Send) {
        // Whatever happens, nobody may find a job that has ended without an outcome.
        let mut ending = Ending { jobs: self, key, entry, is_kept: false };
        let Ending { jobs, entry, .. } = &ending;
        let outcome = tokio::select! {
            // The stop first: what is made may fail of it too, as by a closed database, and would say so in the log.
            biased;
            () = jobs.0.stopping.cancelled() => Err(stopped()),
            made = made => made,
            () = entry.given_up.cancelled() => Err(jobs.given_up()),
            () = abandoned(entry) => Err(jobs.given_up()),
        };
        ending.is_kept = ending.told(outcome);
        if ending.is_kept {
            let Ending { jobs, .. } = &ending;
            jobs.0.stopping.run_until_cancelled(tokio::time::sleep(jobs.0.kept)).await;
            ending.is_kept = false;
        }
    }

    fn entries(&self) -> MutexGuard<'_, HashMap<K, Arc<Entry<T>>>> {
        self.0.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn goes_on(&self, progress: &Progress) -> Problem {
        let (done, total, step) = progress.told();
        let far = if total == 0 { "it has just begun".to_owned() } else { format!("{done} of {total} {step}") };
        let message = format!("{} is still being made: {far}; it goes on, ask again", self.0.what);
        let problem = Problem::new(ErrorKind::Unavailable, "STILL_WORKING", message);
        problem.with("done", done).with("total", total)
    }

    fn overloaded(&self) -> Problem {
        let message = format!("{MOST} others like {} are being made already; ask again in a moment", self.0.what);
        Problem::new(ErrorKind::Overloaded, "OVERLOADED", message)
    }

    fn given_up(&self) -> Problem {
        let message = format!("{} was given up: nobody asked about it for long; ask again", self.0.what);
        Problem::new(ErrorKind::Unavailable, "ABANDONED", message)
    }
}

/// Gives up those jobs that were longest left alone, but for a few.
fn make_room<K, T>(entries: &HashMap<K, Arc<Entry<T>>>) {
    let is_unasked = |entry: &&Arc<Entry<T>>| entry.goes_on() && entry.asked().waiting == 0;
    let mut unasked: Vec<&Arc<Entry<T>>> = entries.values().filter(is_unasked).collect();
    unasked.sort_by_key(|entry| std::cmp::Reverse(entry.asked().last));
    unasked.into_iter().skip(MOST_UNASKED).for_each(|entry| entry.given_up.cancel());
}

/// Waits until nobody has asked about a job for long.
async fn abandoned<T>(entry: &Entry<T>) {
    loop {
        let until = entry.asked().last + ABANDONED;
        tokio::time::sleep_until(until).await;
        let mut asked = entry.asked();
        match asked.waiting {
            0 if asked.last + ABANDONED <= Instant::now() => return,
            0 => {}
            // Somebody waits: it is looked at again when they may have left.
            _ => asked.last = Instant::now(),
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
    fn told(&self, outcome: Result<T, Problem>) -> bool {
        // Whoever asks meanwhile finds it going on, or over, but never neither.
        let mut entries = self.jobs.0.entries.lock().unwrap_or_else(PoisonError::into_inner);
        let is_kept = outcome.is_ok() && self.entry.asked().waiting == 0 && !self.jobs.0.kept.is_zero();
        self.entry.outcome.send_replace(Some(outcome));
        if !is_kept {
            self.remove(&mut entries);
        }
        is_kept
    }

    fn remove(&self, entries: &mut HashMap<K, Arc<Entry<T>>>) {
        if entries.get(&self.key).is_some_and(|entry| Arc::ptr_eq(entry, &self.entry)) {
            entries.remove(&self.key);
        }
    }
}

impl<K: Eq + Hash, T> Drop for Ending<K, T> {
    fn drop(&mut self) {
        self.remove(&mut self.jobs.0.entries.lock().unwrap_or_else(PoisonError::into_inner));
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
mod tests {
    use tokio::sync::oneshot;

    use super::super::deadline::within;
    use super::*;

    type Made = Result<u64, Problem>;

    const CALL: Duration = Duration::from_secs(30);

    fn jobs(kept: Duration) -> (Jobs<&'static str, u64>, CancellationToken) {
        let stopping = CancellationToken::new();
        (Jobs::new("the sum", kept, stopping.clone()), stopping)
    }

    /// A job that ends when the test says so.
    fn held() -> (oneshot::Sender<Made>, impl FnOnce(Progress) -> futures::future::BoxFuture<'static, Made>) {
        let (end, ended) = oneshot::channel();
        (end, |progress: Progress| {
            Box::pin(async move {
                progress.begin("parts added", 10);
                progress.add(3);
                ended.await.expect("the test ends it")
            })
        })
    }

    fn never(_: Progress) -> futures::future::BoxFuture<'static, Made> {
        panic!("it goes on already")
    }

    async fn asked(jobs: &Jobs<&'static str, u64>) -> Made {
        within(Deadline::after(CALL), jobs.ask("key", never)).await.expect("in time")
    }

    #[tokio::test(start_paused = true)]
    async fn one_job_answers_all_who_ask() {
        let (jobs, _stopping) = jobs(Duration::ZERO);
        let (end, make) = held();
        let asking = async {
            tokio::task::yield_now().await;
            end.send(Ok(7)).expect("it waits");
        };
        let told = tokio::join!(jobs.ask("key", make), jobs.ask("key", never), jobs.ask("key", never), asking);
        assert_eq!((told.0, told.1, told.2), (Ok(7), Ok(7), Ok(7)));
        assert_eq!(jobs.ask("key", |_| async { Ok(8) }).await, Ok(8), "another is made for who asks later");
    }

    #[tokio::test(start_paused = true)]
    async fn who_cannot_wait_is_told_how_far_it_is_and_finds_it_further_on() {
        let (jobs, _stopping) = jobs(Duration::ZERO);
        let (end, make) = held();
        let began = Instant::now();
        let refused = within(Deadline::after(CALL), jobs.ask("key", make)).await.expect("in time").expect_err("slow");
        assert_eq!(began.elapsed(), Duration::from_secs(25), "five seconds before its deadline");
        assert_eq!((refused.kind, refused.reason), (ErrorKind::Unavailable, "STILL_WORKING"));
        assert_eq!(refused.message, "the sum is still being made: 3 of 10 parts added; it goes on, ask again");
        assert_eq!(refused.details, [("done", "3".to_owned()), ("total", "10".to_owned())]);
        assert!(refused.retry_after.is_some());

        let again = tokio::spawn({
            let jobs = jobs.clone();
            async move { asked(&jobs).await }
        });
        tokio::time::sleep(Duration::from_secs(1)).await;
        end.send(Ok(7)).expect("it goes on");
        assert_eq!(again.await.expect("it ends"), Ok(7));
    }

    #[tokio::test]
    async fn what_fails_by_the_stop_is_not_asked_what_it_says() {
        let (jobs, stopping) = jobs(Duration::ZERO);
        let goes_on = Arc::new(AtomicU64::new(0));
        let (stop, noted) = (stopping.clone(), goes_on.clone());
        let make = |_| async move {
            stop.cancelled().await;
            noted.store(1, Ordering::Relaxed);
            Err(Problem::new(ErrorKind::Internal, "INTERNAL", "the pool is closed"))
        };
        let asking = async {
            tokio::task::yield_now().await;
            stopping.cancel();
        };
        let (told, ()) = tokio::join!(jobs.ask("key", make), asking);
        assert_eq!(told.expect_err("it stops").reason, "STOPPING");
        assert_eq!(goes_on.load(Ordering::Relaxed), 0);
    }

    #[tokio::test(start_paused = true)]
    async fn who_waits_for_another_job_is_as_far_as_that_one() {
        let (jobs, _stopping) = jobs(Duration::ZERO);
        let (end, make) = held();
        let both = jobs.clone();
        let make = |progress: Progress| async move {
            let sum = both.ask_for(&progress, "first", make).await?;
            progress.begin("sums doubled", 4);
            Ok(2 * sum)
        };
        let slow = within(Deadline::after(CALL), jobs.ask("key", make)).await.expect("in time").expect_err("slow");
        assert_eq!(slow.message, "the sum is still being made: 3 of 10 parts added; it goes on, ask again");
        end.send(Ok(7)).expect("it goes on");
        assert_eq!(jobs.ask("key", never).await, Ok(14));
    }

    #[tokio::test(start_paused = true)]
    async fn what_nobody_was_told_is_kept_for_who_comes_back_once() {
        let (jobs, _stopping) = jobs(Duration::from_secs(60));
        for wait in [59, 61] {
            let (end, make) = held();
            within(Deadline::after(CALL), jobs.ask("key", make)).await.expect("in time").expect_err("slow");
            end.send(Ok(7)).expect("it goes on");
            tokio::time::sleep(Duration::from_secs(wait)).await;
            let expected = if wait == 59 { 7 } else { 8 };
            assert_eq!(jobs.ask("key", |_| async { Ok(8) }).await, Ok(expected), "after {wait} seconds");
            assert_eq!(jobs.ask("key", |_| async { Ok(9) }).await, Ok(9), "it was told already");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_job_goes_on_without_anybody_until_it_is_abandoned() {
        let (jobs, _stopping) = jobs(Duration::ZERO);
        let (end, make) = held();
        jobs.begin("key", make);
        tokio::time::sleep(ABANDONED - Duration::from_secs(1)).await;
        assert_eq!(asked(&jobs).await.expect_err("slow").reason, "STILL_WORKING");
        // Asking began another while.
        tokio::time::sleep(ABANDONED - Duration::from_secs(1)).await;
        assert!(!end.is_closed());
        tokio::time::sleep(ABANDONED).await;
        assert!(end.is_closed(), "what it waited for was dropped");
        assert_eq!(jobs.ask("key", |_| async { Ok(8) }).await, Ok(8));
    }

    #[tokio::test(start_paused = true)]
    async fn jobs_end_with_the_service() {
        let (jobs, stopping) = jobs(Duration::from_secs(60));
        let (end, make) = held();
        let asking = tokio::spawn({
            let jobs = jobs.clone();
            async move { jobs.ask("key", make).await }
        });
        tokio::task::yield_now().await;
        stopping.cancel();
        assert_eq!(asking.await.expect("it ends").expect_err("stopped").reason, "STOPPING");
        assert!(end.is_closed());
    }

    #[tokio::test(start_paused = true)]
    async fn a_failure_is_told_and_not_kept() {
        let (jobs, _stopping) = jobs(Duration::from_secs(60));
        let failed = Problem::new(ErrorKind::Internal, "INTERNAL", "no");
        let make = {
            let failed = failed.clone();
            move |_| async move { Err::<u64, _>(failed) }
        };
        assert_eq!(jobs.ask("key", make).await, Err(failed));
        let panicking = jobs.ask("key", |_| async { panic!("on purpose") }).await;
        assert_eq!(panicking.expect_err("it panicked").kind, ErrorKind::Internal);
        assert_eq!(jobs.ask("key", |_| async { Ok(8) }).await, Ok(8));
    }

    #[tokio::test(start_paused = true)]
    async fn who_asks_for_many_and_leaves_keeps_a_few() {
        let jobs: Jobs<usize, u64> = Jobs::new("the sum", Duration::ZERO, CancellationToken::new());
        let (ends, makes): (Vec<_>, Vec<_>) = (0..10).map(|_| held()).unzip();
        for (key, make) in makes.into_iter().enumerate() {
            jobs.begin(key, make);
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        assert_eq!(jobs.ask(10, |_| async { Ok(7) }).await, Ok(7));
        tokio::time::sleep(Duration::from_millis(1)).await;
        let going_on: Vec<usize> = (0..10).filter(|key| !ends[*key].is_closed()).collect();
        assert_eq!(going_on, [6, 7, 8, 9], "those that were asked about last");
        assert_eq!(jobs.ask(0, |_| async { Ok(8) }).await, Ok(8), "one that was given up begins anew");
    }

    #[tokio::test(start_paused = true)]
    async fn too_many_jobs_are_refused() {
        let stopping = CancellationToken::new();
        let jobs: Jobs<usize, u64> = Jobs::new("the sum", Duration::ZERO, stopping.clone());
        let waiting: Vec<_> = (0..MOST).map(|key| jobs.join(key, |_| std::future::pending()).ok()).collect();
        let refused = jobs.ask(MOST, |_| async { Ok(1) }).await.expect_err("too many");
        assert_eq!(refused.kind, ErrorKind::Overloaded);
        drop(waiting);
        assert_eq!(jobs.ask(MOST, |_| async { Ok(1) }).await, Ok(1), "those that nobody waits for make room");
        stopping.cancel();
    }
}
