//! Admission control by semaphores: so many workers, so many that may wait for one, and a refusal
//! (load shedding) for everybody else.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};
use tokio_util::sync::CancellationToken;

use super::priority;
use super::stop::{Stop, Stopped};
use crate::error::{ErrorKind, Problem};

/// After how long one who was refused should ask again.
const RETRY_AFTER: Duration = Duration::from_secs(2);

/// The reason word of work that a stop of the service ended.
pub const STOPPING: &str = "STOPPING";

/// A thread pool of bounded size behind a bounded queue. Cloning shares it.
///
/// Its threads give way to those that serve connections and commit. They are the gate's own: what
/// computes in parallel within a turn shares them, and a process that ends does not wait for them.
#[derive(Clone)]
pub struct Gate(Arc<Inner>);

struct Inner {
    /// For everybody who works or waits.
    places: Arc<Semaphore>,
    /// How many there are.
    all: usize,
    /// For everybody who works.
    workers: Arc<Semaphore>,
    /// How many may work at once.
    most: usize,
    /// `None` where the system has no thread left: turns then take threads of the runtime.
    pool: Option<rayon::ThreadPool>,
    stopping: CancellationToken,
}

/// A permit for one worker, until it is dropped or what it runs has ended.
pub struct Turn {
    gate: Gate,
    held: [OwnedSemaphorePermit; 2],
}

impl Gate {
    /// Waiting without a bound, for those whose number is bounded before.
    pub const ENDLESS: usize = Semaphore::MAX_PERMITS >> 1;

    /// Opens a gate with so many workers and so many places to wait. What it lets in is stopped
    /// when `stopping` is cancelled.
    pub fn new(
        name: &'static str,
        workers: usize,
        waiting: usize,
        stopping: CancellationToken,
    ) -> Self {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(workers)
            .thread_name(move |at| format!("{name}-{at}"))
            .start_handler(|_| priority::lower())
            .build();

        let all = workers + waiting;
        let most = workers;
        let [places, workers] = [all, workers].map(|permits| Arc::new(Semaphore::new(permits)));

        Self(Arc::new(Inner {
            places,
            all,
            workers,
            most,
            pool: pool.ok(),
            stopping,
        }))
    }

    /// Waits for a worker; refuses at once where too many wait already.
    pub async fn enter(&self) -> Result<Turn, Problem> {
        let Inner {
            places,
            workers,
            stopping,
            ..
        } = &*self.0;
        let place = places
            .clone()
            .try_acquire_owned()
            .map_err(|_| overloaded())?;

        let worker = stopping
            .run_until_cancelled(workers.clone().acquire_owned())
            .await;
        let worker = worker.and_then(Result::ok).ok_or_else(stopped)?;
        Ok(Turn {
            gate: self.clone(),
            held: [place, worker],
        })
    }

    /// Waits for a worker and does the work; see [`Turn::run`].
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Stop) -> Result<T, Stopped> + Send + 'static,
    ) -> Result<T, Problem> {
        self.enter().await?.run(work).await
    }

    /// Returns how many work at once.
    pub fn workers(&self) -> usize {
        self.0
            .pool
            .as_ref()
            .map_or(1, rayon::ThreadPool::current_num_threads)
    }

    /// Returns how many work or wait for their turn.
    pub fn busy(&self) -> usize {
        self.0.all - self.0.places.available_permits()
    }

    /// Returns how many wait for their turn.
    pub fn waiting(&self) -> usize {
        let working = self.0.most - self.0.workers.available_permits();
        self.busy().saturating_sub(working)
    }
}

impl Turn {
    /// Does the work on a thread of the gate. It is told to stop when this future is dropped, and
    /// when the service stops. Its place is free again when it has ended, not before: what was told
    /// to stop may take a moment to notice.
    pub async fn run<T: Send + 'static>(
        self,
        work: impl FnOnce(&Stop) -> Result<T, Stopped> + Send + 'static,
    ) -> Result<T, Problem> {
        let Self { gate, held } = self;
        let stopping = &gate.0.stopping;
        let stop = StopOnDrop(Stop::under(stopping));
        let (tell, told) = oneshot::channel();
        let stop_there = stop.0.clone();

        let work = move || {
            let done = catch_unwind(AssertUnwindSafe(|| {
                stop_there.check().and_then(|()| work(&stop_there))
            }));
            drop(held);
            // Nobody may be left to be told.
            let _ = tell.send(done.map_err(drop));
        };
        match &gate.0.pool {
            Some(pool) => pool.spawn(work),
            None => drop(tokio::task::spawn_blocking(work)),
        }

        match stopping.run_until_cancelled(told).await {
            None | Some(Ok(Ok(Err(Stopped)))) => Err(stopped()),
            Some(Ok(Ok(Ok(done)))) => Ok(done),
            // The panic itself is in the log.
            Some(Ok(Err(())) | Err(_)) => Err(Problem::new(
                ErrorKind::Internal,
                "INTERNAL",
                "the service failed; the cause is in its log",
            )),
        }
    }
}

/// Stops what a caller waited for when the caller has left.
struct StopOnDrop(Stop);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        self.0.stop();
    }
}

fn overloaded() -> Problem {
    let message = "too many questions wait for an answer already; ask again in a moment";
    Problem::new(ErrorKind::Overloaded, "OVERLOADED", message).retry_after(RETRY_AFTER)
}

/// Says that the service stops.
pub(super) fn stopped() -> Problem {
    Problem::new(
        ErrorKind::Unavailable,
        STOPPING,
        "the service is stopping; ask again when it is back",
    )
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    fn gate(workers: usize, waiting: usize) -> (Gate, CancellationToken) {
        let stopping = CancellationToken::new();
        (
            Gate::new("test", workers, waiting, stopping.clone()),
            stopping,
        )
    }

    /// Work that says when it begins, and goes on until it is told to stop.
    fn endless(begun: mpsc::Sender<()>) -> impl FnOnce(&Stop) -> Result<(), Stopped> + Send {
        move |stop| {
            begun.send(()).expect("somebody looks");
            loop {
                stop.check()?;
                std::thread::yield_now();
            }
        }
    }

    async fn until(mut is_so: impl FnMut() -> bool) {
        while !is_so() {
            tokio::task::yield_now().await;
        }
    }

    /// Has a gate of one worker and one place work on and on, and another wait for its turn.
    async fn full(gate: &Gate) -> [tokio::task::JoinHandle<Result<(), Problem>>; 2] {
        let (begun, begins) = mpsc::channel();
        let working = tokio::spawn({
            let gate = gate.clone();
            async move { gate.run(endless(begun)).await }
        });
        until(|| begins.try_recv().is_ok()).await;
        let waiting = tokio::spawn({
            let gate = gate.clone();
            async move { gate.run(|_| Ok(())).await }
        });
        until(|| gate.busy() == 2).await;
        [working, waiting]
    }

    #[tokio::test]
    async fn work_is_done_on_a_thread_of_the_gate() {
        let (gate, _stopping) = gate(1, 0);
        let name = gate
            .run(|_| Ok(std::thread::current().name().map(ToOwned::to_owned)))
            .await;
        assert_eq!(name, Ok(Some("test-0".to_owned())));
    }

    #[tokio::test]
    async fn who_finds_no_place_is_told_when_to_ask_again() {
        let (gate, _stopping) = gate(1, 1);
        let [working, waiting] = full(&gate).await;

        let refused = gate.run(|_| Ok(())).await.expect_err("full");
        assert_eq!(
            (refused.kind, refused.retry_after),
            (ErrorKind::Overloaded, Some(RETRY_AFTER))
        );
        working.abort();
        assert_eq!(
            waiting.await.expect("it ends"),
            Ok(()),
            "the next has its turn"
        );
        until(|| gate.busy() == 0).await;
    }

    #[tokio::test]
    async fn who_leaves_while_waiting_leaves_nothing() {
        let (gate, _stopping) = gate(1, 1);
        let turn = gate.enter().await.expect("free");
        let waiting = tokio::spawn({
            let gate = gate.clone();
            async move { gate.run(|_| Ok(())).await }
        });
        until(|| gate.busy() == 2).await;
        waiting.abort();
        until(|| gate.busy() == 1).await;
        drop(turn);
        assert_eq!(gate.busy(), 0);
    }

    #[tokio::test]
    async fn the_service_that_stops_stops_those_who_work_and_those_who_wait() {
        let (gate, stopping) = gate(1, 1);
        let [working, waiting] = full(&gate).await;
        stopping.cancel();
        for stopped in [working, waiting] {
            assert_eq!(
                stopped.await.expect("it ends").expect_err("stopped").reason,
                "STOPPING"
            );
        }
        until(|| gate.busy() == 0).await;
        assert_eq!(
            gate.run(|_| Ok(())).await.expect_err("it is over").reason,
            "STOPPING"
        );
    }

    #[tokio::test]
    async fn a_panic_is_told_and_its_place_is_free() {
        let (gate, _stopping) = gate(1, 0);
        let refused = gate
            .run(|_| -> Result<(), Stopped> { panic!("on purpose") })
            .await
            .expect_err("it panicked");
        assert_eq!(refused.kind, ErrorKind::Internal);
        assert_eq!(gate.run(|_| Ok(7)).await, Ok(7));
    }
}
