//! Ingestion, how transitions become counts: validate, sequence, commit together (group commit),
//! then acknowledge. A producer's numbers make it idempotent: what is sent again counts once.
//!
//! ```text
//! Batch --validate--> Numbered --queue (bounded)--> committer --store.commit--> Acknowledged
//! ```
//!
//! The queue is bounded by transitions (back-pressure), in fair shares: single calls have a share
//! that streams cannot take. A stream waits for room, which stops the reading of its socket; a
//! single call waits for a moment, and is then refused. There is no wall clock in the protocol:
//! order comes from sequence numbers, and the truth about them from the store.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};
use tokio_util::task::TaskTracker;
use tracing::instrument;

mod committer;
mod figures;
mod room;
mod streams;
mod tracks;
mod validate;

use committer::{Command, Pending, Resume, foreign};
use figures::BatchTotals;
pub use figures::Figures;
use room::Room;
use streams::{Lease, Registration, Streams};
pub use tracks::{Step, Tracks};
pub use validate::validate;

use crate::domain::{
    Acknowledged, Batch, Environment, EnvironmentId, Principal, ProducerId, Sequence,
};
use crate::error::{ErrorKind, Problem};
use crate::store::{Numbered, Store};
use crate::telemetry;
use crate::work::aside;

/// The most questions and batches that wait, however small.
const MOST_WORK: usize = 8_192;

/// How many batches of one stream may wait for their acknowledgement.
pub const WINDOW: usize = 512;

/// The ingestion service. Cloning is cheap: every request does.
#[derive(Clone)]
pub struct Ingest {
    handles: Arc<Handles>,
    principal: Arc<Principal>,
}

/// What is the same whoever speaks.
pub struct Handles {
    queue: mpsc::Sender<Command>,
    room: Room,
    streams: Streams,
    counted: BatchTotals,
    committer: TaskTracker,
    store: Arc<dyn Store>,
}

impl std::ops::Deref for Ingest {
    type Target = Handles;

    fn deref(&self) -> &Handles {
        &self.handles
    }
}

impl Ingest {
    /// Starts the committer on a store.
    pub fn start(store: Arc<dyn Store>) -> Self {
        let (queue, work) = mpsc::channel(MOST_WORK);
        let (committer, counted) = (TaskTracker::new(), BatchTotals::default());
        committer::start(
            committer.token(),
            committer::run(store.clone(), counted.clone(), work),
        );
        committer.close();

        let handles = Handles {
            queue,
            room: Room::default(),
            streams: Streams::default(),
            counted,
            committer,
            store,
        };
        Self {
            handles: Arc::new(handles),
            principal: Arc::new(Principal::anonymous()),
        }
    }

    /// Returns a handle that speaks for a principal: producers belong to its name.
    pub fn asked_by(&self, principal: Arc<Principal>) -> Self {
        Self {
            principal,
            handles: self.handles.clone(),
        }
    }

    /// Counts one batch and returns after it is on stable storage; refuses soon, retryably, when
    /// too much waits.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name, sequence = batch.sequence.get()))]
    pub async fn write(
        &self,
        environment: &Environment,
        producer: ProducerId,
        batch: Batch,
    ) -> Result<Acknowledged, Problem> {
        let room = self
            .room
            .for_call(size_of(environment, &batch))
            .await
            .inspect_err(refused)?;
        // A single call knows no tracks but its own.
        let tracks = &mut Tracks::default();
        self.enqueue(environment, producer, batch, tracks, None, room)
            .await?
            .acknowledged()
            .await
            .map(|(_, acknowledged)| acknowledged)
    }

    /// Opens a stream of a producer: fences its older one, and asks for the resume point behind
    /// everything queued before.
    pub async fn open(
        &self,
        environment: Arc<Environment>,
        producer: ProducerId,
    ) -> Result<Session, Problem> {
        self.claim(&environment, &producer).await?;

        let owner = self.principal.name().cloned();
        let registration = self
            .streams
            .open(environment.id, producer.clone(), owner)
            .ok_or_else(|| foreign(&producer))?;

        let committed = self.committed(&environment, &producer).await?;
        Ok(Session {
            ingest: self.clone(),
            environment,
            producer,
            registration,
            committed,
            tracks: Tracks::default(),
            latest: Sequence::NONE,
        })
    }

    /// Refuses a producer that belongs to another key's name, before its stream is fenced.
    async fn claim(&self, environment: &Environment, producer: &ProducerId) -> Result<(), Problem> {
        let Some(name) = self.principal.name() else {
            return Ok(());
        };
        let owner = self.store.owner(environment.id, producer).await?;
        if owner.is_none_or(|owner| owner == *name) {
            Ok(())
        } else {
            Err(foreign(producer))
        }
    }

    /// Returns the last committed sequence of a producer, after everything queued before.
    pub async fn committed(
        &self,
        environment: &Environment,
        producer: &ProducerId,
    ) -> Result<Sequence, Problem> {
        let (reply, answer) = oneshot::channel();
        let resume = Resume {
            environment: environment.id,
            producer: producer.clone(),
            reply,
        };
        self.queue
            .send(Command::Resume(resume))
            .await
            .map_err(|_| stopped())?;
        answer.await.map_err(|_| stopped())?
    }

    /// Ends the streams into an environment that was deleted.
    pub fn end_streams(&self, environment: EnvironmentId) {
        self.streams.end_all(environment);
    }

    /// Returns how many transitions wait for their commit.
    pub fn queued(&self) -> usize {
        self.room.taken()
    }

    /// Returns what became of the batches of these environments since the start; those of all
    /// others are forgotten.
    pub fn figures(&self, environments: &[EnvironmentId]) -> Vec<Figures> {
        self.counted.figures_of(environments)
    }

    /// Returns whether the committer still takes batches.
    pub fn is_running(&self) -> bool {
        !self.queue.is_closed()
    }

    /// Commits and answers everything queued before, then stops. What is sent later is refused,
    /// retryably.
    pub async fn close(&self) {
        // An error means that the committer is stopping already.
        let _ = self.queue.send(Command::Stop).await;
        self.committer.wait().await;
    }

    async fn enqueue(
        &self,
        environment: &Environment,
        producer: ProducerId,
        batch: Batch,
        tracks: &mut Tracks,
        lease: Option<Arc<Lease>>,
        room: OwnedSemaphorePermit,
    ) -> Result<Ticket, Problem> {
        let sequence = batch.sequence;
        let (schema, environment) = (environment.schema.clone(), environment.id);
        let owner = self.principal.name().cloned();

        let records = &batch.records;
        let bytes = [&records.states, &records.actions, &records.outcomes]
            .map(|values| values.le_bytes().len())
            .into_iter()
            .sum();
        let mut followed = std::mem::take(tracks);
        let validated = aside(bytes, move || {
            let segment = batch.segment.as_ref();
            let (digest, worded) = (
                batch.records.digest(segment),
                batch.records.worded(segment).map(Box::new),
            );
            let (increment, receipt) =
                validate(&schema, batch.segment, &batch.records, &mut followed);
            let numbered = Numbered {
                environment,
                producer,
                owner,
                sequence,
                digest,
                worded,
                increment,
                receipt,
            };
            (numbered, followed)
        });

        let batch;
        (batch, *tracks) = validated.await.inspect_err(refused)?;
        let (reply, answer) = oneshot::channel();

        let pending = Pending {
            batch,
            lease,
            room,
            reply,
        };
        self.queue
            .send(Command::Batch(Box::new(pending)))
            .await
            .map_err(|_| stopped())
            .inspect_err(refused)?;
        Ok(Ticket { sequence, answer })
    }
}

/// One open stream of a producer.
pub struct Session {
    ingest: Ingest,
    environment: Arc<Environment>,
    producer: ProducerId,
    registration: Registration,
    committed: Sequence,
    /// What came before in the tracks of this stream.
    tracks: Tracks,
    /// The greatest number so far.
    latest: Sequence,
}

impl Session {
    /// Returns the resume point.
    pub fn committed(&self) -> Sequence {
        self.committed
    }

    /// Returns the environment that the stream goes into.
    pub fn environment(&self) -> &Environment {
        &self.environment
    }

    /// Queues a batch, waiting for room; the ticket is answered after its commit. Batches are
    /// validated one after the other, as they were sent. Whoever gives up waiting ends the stream.
    pub async fn submit(&mut self, batch: Batch) -> Result<Ticket, Problem> {
        self.registration.lease().check().inspect_err(refused)?;
        let room = self
            .ingest
            .room
            .for_stream(size_of(&self.environment, &batch))
            .await
            .inspect_err(refused)?;
        let lease = Some(self.registration.lease().clone());
        let producer = self.producer.clone();

        // What is sent again lies behind where the tracks are: it is judged on its own.
        let mut behind = Tracks::default();
        let tracks = match batch.sequence > self.latest {
            true => &mut self.tracks,
            false => &mut behind,
        };
        self.latest = self.latest.max(batch.sequence);

        self.ingest
            .enqueue(&self.environment, producer, batch, tracks, lease, room)
            .await
    }

    /// Waits until the stream is fenced or its environment is deleted, and returns which.
    pub async fn ended(&self) -> Problem {
        self.registration.lease().ended().await
    }
}

/// A batch that waits for its commit.
pub struct Ticket {
    sequence: Sequence,
    answer: oneshot::Receiver<Result<Acknowledged, Problem>>,
}

impl Ticket {
    /// Waits until the batch is on stable storage, or refused.
    pub async fn acknowledged(self) -> Result<(Sequence, Acknowledged), Problem> {
        let acknowledged = self.answer.await.map_err(|_| stopped())??;
        Ok((self.sequence, acknowledged))
    }
}

/// Cells of outcomes that take the room of one transition more: of each only its number is kept,
/// beside a state, a joint action and a tally.
const CELLS: usize = 8;

/// A batch takes room for each transition, more of it where outcomes are observed, and an empty one
/// for itself. None takes more than a single call may ever have.
fn size_of(environment: &Environment, batch: &Batch) -> u32 {
    let outcomes = batch.records.observed(&environment.schema);
    let room = batch.records.len * (CELLS + outcomes) / CELLS;
    room.clamp(1, room::MOST) as u32
}

/// Counts a batch that is refused before the committer sees it; the committer counts the others.
fn refused(problem: &Problem) {
    telemetry::refused(problem.reason);
}

fn stopped() -> Problem {
    Problem::new(
        ErrorKind::Unavailable,
        "STOPPING",
        "the service is stopping; resume and send it again",
    )
}
