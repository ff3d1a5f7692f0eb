//! Group commit by a single writer, on a thread of its own. It takes everything that waits, commits
//! it together, and only then answers.
//!
//! No client can cancel it, and it never talks to anything but the store.

use std::sync::Arc;
use std::thread::Builder;
use std::time::{Duration, Instant, SystemTime};

use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};
use tokio_util::task::task_tracker::TaskTrackerToken;

use super::figures::BatchTotals;
use super::streams::Lease;
use crate::domain::{Acknowledged, EnvironmentId, ProducerId, Sequence};
use crate::error::{ErrorKind, Problem};
use crate::store::{ENVIRONMENT_NOT_FOUND, Numbered, Outcome, Refusal, Store, StoreError};
use crate::telemetry::{self, Seldom};

/// The most transitions of one commit. Measured: 64,000 and 256,000 are a tenth slower.
pub const MOST_COMMIT_TRANSITIONS: usize = 128_000;

/// The most listed states of one commit, counting those of each batch: what a commit keeps in
/// memory grows with them.
const MOST_COMMIT_STATES: usize = 50_000;

/// A database that fails is asked again and again by every producer: their lines of the log are
/// few.
static FAILURES: Seldom = Seldom::every(Duration::from_secs(5));
static UNREAD: Seldom = Seldom::every(Duration::from_secs(5));

/// A command to the committer, carried out in the order of the queue.
pub enum Command {
    /// Commit a batch.
    Batch(Box<Pending>),
    /// Tell a producer how far it is, after everything that it sent before.
    Resume(Resume),
    /// Finish what was asked before, and end.
    Stop,
}

/// A batch that waits for its commit.
pub struct Pending {
    /// The batch.
    pub batch: Numbered,
    /// The stream that sent it, if one did.
    pub lease: Option<Arc<Lease>>,
    /// Its share of the queue, given back with the answer.
    pub room: OwnedSemaphorePermit,
    /// Where the answer goes.
    pub reply: oneshot::Sender<Result<Acknowledged, Problem>>,
}

/// A question for the resume point.
pub struct Resume {
    /// The environment.
    pub environment: EnvironmentId,
    /// The producer.
    pub producer: ProducerId,
    /// Where the answer goes.
    pub reply: oneshot::Sender<Result<Sequence, Problem>>,
}

/// Starts the committer on a thread of its own: it computes for milliseconds at a time, which what
/// serves connections would wait for.
pub fn start(running: TaskTrackerToken, committer: impl Future<Output = ()> + Send + 'static) {
    let runtime = Handle::current();
    let work = move || {
        runtime.block_on(committer);
        drop(running);
    };

    let started = Builder::new().name("committer".to_owned()).spawn(work);
    started.expect("a service has a thread to count with");
}

/// Runs the committer until it is told to stop or nobody can ask any more.
pub async fn run(store: Arc<dyn Store>, counted: BatchTotals, mut queue: mpsc::Receiver<Command>) {
    let mut group = Group {
        counted,
        ..Group::default()
    };

    while let Some(first) = queue.recv().await {
        let mut next = Some(first);
        while let Some(work) = next {
            match work {
                Command::Batch(pending) => group.add(*pending),
                Command::Resume(resume) => {
                    group.commit(&*store).await;
                    answer_resume(&*store, resume).await;
                }
                Command::Stop => {
                    queue.close();
                }
            }

            next = if group.is_full() {
                None
            } else {
                queue.try_recv().ok()
            };
        }
        group.commit(&*store).await;
    }
}

/// The batches of one group commit.
#[derive(Default)]
struct Group {
    counted: BatchTotals,
    batches: Vec<Numbered>,
    replies: Vec<(
        oneshot::Sender<Result<Acknowledged, Problem>>,
        OwnedSemaphorePermit,
    )>,
    transitions: usize,
    states: usize,
}

impl Group {
    fn add(&mut self, pending: Pending) {
        // A stream that was fenced while its batch waited must not count: its successor was, or
        // will be, told a resume point without it.
        if let Some(Err(problem)) = pending.lease.as_ref().map(|lease| lease.check()) {
            telemetry::refused(problem.reason);
            let _ = pending.reply.send(Err(problem));
            return;
        }
        self.transitions += pending.room.num_permits();
        self.states += pending.batch.increment.states.listed().len();
        self.batches.push(pending.batch);
        self.replies.push((pending.reply, pending.room));
    }

    fn is_full(&self) -> bool {
        self.transitions >= MOST_COMMIT_TRANSITIONS || self.states >= MOST_COMMIT_STATES
    }

    async fn commit(&mut self, store: &dyn Store) {
        if self.batches.is_empty() {
            return;
        }

        let started = Instant::now();
        let result = store.commit(&self.batches).await;
        telemetry::committed(started.elapsed(), self.transitions, result.is_ok());

        let batches = std::mem::take(&mut self.batches);
        let replies = std::mem::take(&mut self.replies);
        (self.transitions, self.states) = (0, 0);

        let answers = match result {
            Ok(outcomes) => outcomes
                .into_iter()
                .zip(&batches)
                .map(|(outcome, batch)| self.answer(batch, outcome))
                .collect(),
            Err(error) => failed(error, batches.len()),
        };

        for ((reply, room), answer) in replies.into_iter().zip(answers) {
            if let Err(problem) = &answer {
                telemetry::refused(problem.reason);
            }
            drop(room);
            // A client that went away finds its answer when it resumes.
            let _ = reply.send(answer);
        }
    }

    fn answer(&self, batch: &Numbered, outcome: Outcome) -> Result<Acknowledged, Problem> {
        match outcome {
            Outcome::Acknowledged(acknowledged) => {
                self.counted
                    .note(batch.environment, &acknowledged, SystemTime::now());
                Ok(acknowledged)
            }
            Outcome::Refused(refusal) => Err(refused(batch, refusal)),
        }
    }
}

async fn answer_resume(store: &dyn Store, resume: Resume) {
    let watermark = store.watermark(resume.environment, &resume.producer).await;
    let _ = resume.reply.send(watermark.map_err(|error| {
        if let Some(left_out) = UNREAD.admits(Instant::now()) {
            tracing::error!(%error, left_out, "a resume point could not be read");
        }
        error.into()
    }));
}

fn failed(error: StoreError, batches: usize) -> Vec<Result<Acknowledged, Problem>> {
    if let Some(left_out) = FAILURES.admits(Instant::now()) {
        tracing::error!(%error, batches, left_out, "a commit failed; its producers will resume");
    }
    let problem = error.of_batch();
    vec![Err(problem); batches]
}

/// Refuses whoever speaks for a producer that belongs to another key's name.
pub fn foreign(producer: &ProducerId) -> Problem {
    telemetry::denied("producer");
    let message =
        format!("producer `{producer}` belongs to another key; send under another producer id");
    Problem::new(ErrorKind::Forbidden, "PRODUCER_FORBIDDEN", message).with("producer", producer)
}

fn refused(batch: &Numbered, refusal: Refusal) -> Problem {
    let sequence = batch.sequence;
    match refusal {
        Refusal::Gone => Problem::new(
            ErrorKind::NotFound,
            ENVIRONMENT_NOT_FOUND,
            "the environment was deleted",
        ),
        Refusal::ReadOnly => Problem::new(
            ErrorKind::Conflict,
            "ENVIRONMENT_READ_ONLY",
            "the environment is damaged: it can be read as far as it is sound, but takes no transitions; see `/readyz?verbose`, and restore a backup",
        ),
        Refusal::Foreign => foreign(&batch.producer),
        Refusal::OutOfOrder { expected } => {
            let message = format!(
                "got sequence {sequence} of producer `{}`, expected {expected}",
                batch.producer
            );
            Problem::new(ErrorKind::OutOfOrder, "OUT_OF_ORDER", message)
                .with("expected_sequence", expected)
        }
        Refusal::Reused => {
            let message = format!(
                "sequence {sequence} of producer `{}` was used with another content",
                batch.producer
            );
            Problem::new(ErrorKind::Conflict, "SEQUENCE_REUSED", message).with("sequence", sequence)
        }
        Refusal::Quota { what, limit } => {
            let message = format!("the batch would pass the environment's quota of {limit} {what}");
            Problem::new(ErrorKind::Quota, "QUOTA_EXCEEDED", message).with("limit", limit)
        }
        Refusal::Overflow => {
            let message = "the batch would bring the environment's transitions past 2^63 - 1";
            Problem::new(ErrorKind::Quota, "COUNT_OVERFLOW", message).with("limit", i64::MAX)
        }
    }
}
