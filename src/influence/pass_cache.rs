//! A stale-while-revalidate cache of what is made in a pass over all states of an environment:
//! kept, and made again when more was counted.
//!
//! Where that is quick it is made while the caller waits, so that every acknowledged transition is
//! seen. Where it is not (a large environment, or one whose states take long), it is told as it was
//! made last, while the next is made in the background, and says of which revision it is.

use std::hash::Hash;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use lru::LruCache;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::error::Problem;
use crate::store::Totals;
use crate::work::{Jobs, Progress};

/// Cells up to which something is made while the caller waits, as long as that is [`QUICK`].
const SMALL: u64 = 100_000;

/// What took longer than this is told as it was made last: whoever counts all the time would
/// otherwise never see it.
const QUICK: Duration = Duration::from_secs(5);

/// Results kept, of a kind.
const KEPT: NonZeroUsize = NonZeroUsize::new(16).expect("not zero");

/// The result of a pass over all states.
pub struct PassResult<T> {
    /// What was made.
    pub value: T,
    /// How many transitions the environment had when the pass over its states began.
    pub as_of: u64,
    /// How long it took.
    took: Duration,
}

impl<T> std::ops::Deref for PassResult<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

/// A cache of the results of one kind of pass. Cloning shares it.
pub struct PassCache<K, T> {
    jobs: Jobs<K, Arc<PassResult<T>>>,
    kept: Arc<Mutex<LruCache<K, Arc<PassResult<T>>>>>,
}

impl<K, T> Clone for PassCache<K, T> {
    fn clone(&self) -> Self {
        Self {
            jobs: self.jobs.clone(),
            kept: self.kept.clone(),
        }
    }
}

impl<K, T> PassCache<K, T>
where
    K: Clone + Eq + Hash + Send + Sync + 'static,
    T: Send + Sync + 'static,
{
    /// Keeps results of a kind, `what` in words.
    pub fn new(what: &'static str, stopping: CancellationToken) -> Self {
        let jobs = Jobs::new(what, Duration::ZERO, stopping);
        Self {
            jobs,
            kept: Arc::new(Mutex::new(LruCache::new(KEPT))),
        }
    }

    /// Returns a result: of this moment where it is quickly made, else the last one. `is_current`
    /// says whether it rests on what is asked about now.
    pub async fn get<F>(
        &self,
        key: K,
        totals: Totals,
        is_current: impl Fn(&T) -> bool,
        make: impl Fn(Progress) -> F,
    ) -> Result<Arc<PassResult<T>>, Problem>
    where
        F: Future<Output = Result<(T, u64), Problem>> + Send + 'static,
    {
        let is_fresh =
            |made: &PassResult<T>| made.as_of >= totals.transitions && is_current(&made.value);
        let is_slow = |made: &PassResult<T>| totals.cells > SMALL || made.took > QUICK;
        match self.last(&key) {
            Some(made) if is_fresh(&made) => return Ok(made),
            Some(stale) if is_slow(&stale) => {
                self.jobs.begin(key.clone(), |progress| {
                    self.clone().making(key, make(progress))
                });
                return Ok(stale);
            }
            _ => {}
        }
        let ask = || {
            self.jobs.ask(key.clone(), |progress| {
                self.clone().making(key.clone(), make(progress))
            })
        };
        joined(ask, |made| is_fresh(made) || is_slow(made)).await
    }

    /// Returns a result that is as new as those totals to another job, which waits for it.
    pub async fn get_for<F>(
        &self,
        other: &Progress,
        key: K,
        totals: Totals,
        is_current: impl Fn(&T) -> bool,
        make: impl Fn(Progress) -> F,
    ) -> Result<Arc<PassResult<T>>, Problem>
    where
        F: Future<Output = Result<(T, u64), Problem>> + Send + 'static,
    {
        let is_fresh =
            |made: &PassResult<T>| made.as_of >= totals.transitions && is_current(&made.value);
        if let Some(made) = self.last(&key).filter(|made| is_fresh(made)) {
            return Ok(made);
        }
        let ask = || {
            self.jobs.ask_for(other, key.clone(), |progress| {
                self.clone().making(key.clone(), make(progress))
            })
        };
        joined(ask, is_fresh).await
    }

    /// Returns the last result that was made, if it is kept.
    pub fn last(&self, key: &K) -> Option<Arc<PassResult<T>>> {
        self.kept
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get(key)
            .cloned()
    }

    async fn making(
        self,
        key: K,
        make: impl Future<Output = Result<(T, u64), Problem>>,
    ) -> Result<Arc<PassResult<T>>, Problem> {
        let began = Instant::now();
        let (value, as_of) = make.await?;
        let made = Arc::new(PassResult {
            value,
            as_of,
            took: began.elapsed(),
        });
        self.kept
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .put(key, made.clone());
        Ok(made)
    }
}

/// Asks for what is made, and once more where that will not do: a job that was joined may have
/// begun before the question was asked, the next cannot have.
async fn joined<T, F>(
    ask: impl Fn() -> F,
    will_do: impl Fn(&PassResult<T>) -> bool,
) -> Result<Arc<PassResult<T>>, Problem>
where
    F: Future<Output = Result<Arc<PassResult<T>>, Problem>>,
{
    let made = ask().await?;
    if will_do(&made) {
        Ok(made)
    } else {
        ask().await
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::*;

    fn totals(transitions: u64, cells: u64) -> Totals {
        Totals {
            transitions,
            cells,
            ..Totals::default()
        }
    }

    /// Makes 1, 2, 3, ..., of that revision, in that time.
    struct Maker(AtomicU64);

    impl Maker {
        async fn get(
            &self,
            shared: &PassCache<(), u64>,
            counted: Totals,
            took: Duration,
        ) -> (u64, u64) {
            let make = |_| {
                let made = self.0.fetch_add(1, Ordering::Relaxed) + 1;
                async move {
                    tokio::time::sleep(took).await;
                    Ok((made, counted.transitions))
                }
            };
            let made = shared.get((), counted, |_| true, make).await.expect("made");
            (made.value, made.as_of)
        }
    }

    const SECOND: Duration = Duration::from_secs(1);

    #[tokio::test(start_paused = true)]
    async fn what_is_quick_is_of_this_moment() {
        let (shared, maker) = (
            PassCache::new("it", CancellationToken::new()),
            Maker(AtomicU64::new(0)),
        );
        assert_eq!(maker.get(&shared, totals(5, 1), SECOND).await, (1, 5));
        assert_eq!(
            maker.get(&shared, totals(5, 1), SECOND).await,
            (1, 5),
            "nothing was counted since"
        );
        assert_eq!(maker.get(&shared, totals(6, 1), SECOND).await, (2, 6));
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_slow_is_told_as_it_was_while_the_next_is_made() {
        for (cells, took) in [(1, QUICK + SECOND), (SMALL + 1, SECOND)] {
            let (shared, maker) = (
                PassCache::new("it", CancellationToken::new()),
                Maker(AtomicU64::new(0)),
            );
            assert_eq!(maker.get(&shared, totals(5, cells), took).await, (1, 5));
            for _ in 0..3 {
                assert_eq!(maker.get(&shared, totals(6, cells), took).await, (1, 5));
            }
            tokio::time::sleep(took + SECOND).await;
            assert_eq!(
                maker.get(&shared, totals(6, cells), took).await,
                (2, 6),
                "one was made for all three"
            );
        }
    }

    #[tokio::test(start_paused = true)]
    async fn who_joins_what_began_before_waits_for_another() {
        let (shared, maker) = (
            PassCache::new("it", CancellationToken::new()),
            Maker(AtomicU64::new(0)),
        );
        let (first, second) = tokio::join!(
            maker.get(&shared, totals(5, 1), SECOND),
            maker.get(&shared, totals(6, 1), SECOND)
        );
        assert_eq!((first, second), ((1, 5), (2, 6)));
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_made_anew_behind_a_stale_answer_is_given_up_where_nobody_asks_again() {
        let (shared, maker) = (
            PassCache::new("it", CancellationToken::new()),
            Maker(AtomicU64::new(0)),
        );
        let many = SMALL + 1;
        maker.get(&shared, totals(5, many), SECOND).await;
        let hour = SECOND * 3_600;
        assert_eq!(maker.get(&shared, totals(6, many), hour).await, (1, 5));
        // Whoever asks meanwhile keeps it going.
        tokio::time::sleep(SECOND * 100).await;
        assert_eq!(maker.get(&shared, totals(6, many), hour).await, (1, 5));
        tokio::time::sleep(SECOND * 110).await;
        assert_eq!(maker.get(&shared, totals(6, many), hour).await, (1, 5));
        assert_eq!(maker.0.load(Ordering::Relaxed), 2, "it goes on");
        tokio::time::sleep(SECOND * 130).await;
        assert_eq!(maker.get(&shared, totals(6, many), hour).await, (1, 5));
        assert_eq!(
            maker.0.load(Ordering::Relaxed),
            3,
            "it was given up, and begins anew"
        );
    }
}
