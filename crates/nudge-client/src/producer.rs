//! Producers: who sends batches, each of which counts once, and waits where the service does not keep
//! up (back-pressure).

use std::time::Duration;

use nudge_core::domain::{Label, ProducerId, Record, Schema, Undecodable, Widths};
use nudge_core::tracks::{Step, Track};
use nudge_wire::proto;
use tokio::sync::{mpsc, oneshot};
use tokio_util::task::AbortOnDropHandle;

use crate::connection::{Connection, schema_of};
use crate::outbox::{Limits, Outbox};
use crate::task::{Command, Task, Terms};
use crate::{ClientError, Totals};

/// Transitions that may wait for the task, beside those in the outbox.
const COMMANDS: usize = 1_024;

/// How a producer will work. Made by [`Connection::producer`].
#[derive(Debug, Clone)]
pub struct ProducerBuilder {
    connection: Connection,
    environment: String,
    id: String,
    batch_size: usize,
    max_delay: Duration,
    outbox: usize,
    retry_for: Option<Duration>,
    step_within: Duration,
    replay: bool,
}

impl Connection {
    /// Prepares a producer of that id into that environment.
    pub fn producer(&self, environment: &str, id: &str) -> ProducerBuilder {
        Producer::builder(self, environment, id)
    }
}

impl ProducerBuilder {
    /// Closes a batch at that many transitions: 1,000 unless told. The service's limit lowers it.
    pub fn batch_size(self, transitions: usize) -> Self {
        Self {
            batch_size: transitions.max(1),
            ..self
        }
    }

    /// Closes a batch that long after its first transition: 100 ms unless told.
    pub fn max_delay(self, delay: Duration) -> Self {
        Self {
            max_delay: delay,
            ..self
        }
    }

    /// Keeps at most that many batches without an acknowledgement; [`Producer::send`] waits while
    /// they are all there. 64 unless told.
    pub fn outbox(self, batches: usize) -> Self {
        Self {
            outbox: batches.max(1),
            ..self
        }
    }

    /// Gives up when the service was away for that long while something waited: 60 s unless told.
    pub fn retry_for(self, time: Duration) -> Self {
        Self {
            retry_for: Some(time),
            ..self
        }
    }

    /// Never gives up.
    pub fn retry_for_ever(self) -> Self {
        Self {
            retry_for: None,
            ..self
        }
    }

    /// Lets a [step](Producer::step) of a track wait for room for that long, and drops what it
    /// released then: a game's tick must not wait for a service. 5 ms unless told.
    pub fn step_within(self, time: Duration) -> Self {
        Self {
            step_within: time,
            ..self
        }
    }

    /// Declares that the source makes the same transitions again, as a file does.
    ///
    /// Numbering starts at 1 and batches close by size, segment, cut and flush only, never by time:
    /// with the same content, batch size, segments, cuts and flushes, batch k is always the same.
    /// Batches that the service has committed are passed over and counted as `resumed`, so an
    /// interrupted replay goes on where it stopped and a finished one changes nothing. Choose the
    /// producer id from the content.
    pub fn replay(self) -> Self {
        Self {
            replay: true,
            ..self
        }
    }

    /// Asks the service for the environment, opens the stream and learns the resume point.
    pub async fn open(self) -> Result<Producer, ClientError> {
        let id: ProducerId = self.id.parse().map_err(ClientError::Invalid)?;
        let environment = self.connection.environment(&self.environment).await?;
        let schema = schema_of(&environment)?;

        let (sender, commands) = mpsc::channel(COMMANDS);
        let (opened, resume_point) = oneshot::channel();
        let terms = self.terms(id, environment, Widths::of_schema(&schema));
        let task = Task::new(
            terms,
            Outbox::new(self.limits(), Widths::of_schema(&schema)),
            commands,
            opened,
        );
        let task = AbortOnDropHandle::new(tokio::spawn(task.run()));

        let mut producer = Producer {
            widths: Widths::of_schema(&schema),
            schema,
            commands: sender,
            task: Some(task),
            failed: None,
            resume_point: 0,
            is_replay: self.replay,
            step_within: self.step_within,
            stepped: Stepped::default(),
        };

        match resume_point.await {
            Ok(committed) => Ok(Producer {
                resume_point: committed,
                ..producer
            }),
            Err(_) => Err(producer.failure().await),
        }
    }

    fn limits(&self) -> Limits {
        Limits {
            batch_size: self.batch_size,
            capacity: self.outbox,
            replay: self.replay,
        }
    }

    fn terms(&self, id: ProducerId, environment: proto::Environment, widths: Widths) -> Terms {
        let hello = proto::Hello {
            environment: environment.name,
            environment_uid: environment.uid,
            producer: id.to_string(),
            schema_hash: environment.schema_hash,
        };

        Terms {
            hello,
            client: self.connection.ingest(),
            widths,
            fixed_batch_size: self.replay.then_some(self.batch_size),
            max_delay: (!self.replay).then_some(self.max_delay),
            retry_for: self.retry_for,
        }
    }
}

/// Sends transitions to one environment under one id, each of which counts once.
///
/// [`close`](Self::close) it: dropping it stops at once, and what was not acknowledged by then was
/// counted or not.
#[derive(Debug)]
pub struct Producer {
    schema: Schema,
    widths: Widths,
    commands: mpsc::Sender<Command>,
    /// `None` once it has ended.
    task: Option<AbortOnDropHandle<Result<(), ClientError>>>,
    failed: Option<ClientError>,
    resume_point: u64,
    is_replay: bool,
    step_within: Duration,
    stepped: Stepped,
}

/// What became of the steps of tracks before they were sent.
#[derive(Debug, Clone, Copy, Default)]
struct Stepped {
    held_back: u64,
    dropped: u64,
}

impl Stepped {
    /// Counts steps that wait no more; a track may have taken some that this producer never saw.
    fn released(&mut self, steps: usize) {
        self.held_back = self.held_back.saturating_sub(steps as u64);
    }

    fn told(self, totals: Totals) -> Totals {
        Totals {
            held_back: self.held_back,
            dropped: self.dropped,
            ..totals
        }
    }
}

impl Producer {
    /// Prepares a producer of that id into that environment.
    pub fn builder(connection: &Connection, environment: &str, id: &str) -> ProducerBuilder {
        ProducerBuilder {
            connection: connection.clone(),
            environment: environment.into(),
            id: id.into(),
            batch_size: 1_000,
            max_delay: Duration::from_millis(100),
            outbox: 64,
            retry_for: Some(Duration::from_secs(60)),
            step_within: Duration::from_millis(5),
            replay: false,
        }
    }

    /// Returns the environment's schema.
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// Returns the last sequence that was committed when this producer was opened; 0 if there was
    /// none.
    pub fn resume_point(&self) -> u64 {
        self.resume_point
    }

    /// Hands over a transition. Waits while the outbox is full, and fails for good once the service
    /// has refused a batch.
    ///
    /// A transition with another number of values than the schema has is an error at once, and
    /// nothing else is harmed. Values that have no bin are rejected by the service, and [`Totals`]
    /// tells them.
    pub async fn send(&mut self, transition: Record) -> Result<(), ClientError> {
        same_width("state", transition.state.len(), self.widths.state)?;
        same_width("action", transition.actions.len(), self.widths.actions)?;
        let slots = self.widths.check(transition);
        let transition = slots.map_err(|Undecodable { field, reason, .. }| {
            let name = field.trim_start_matches('/');
            ClientError::Invalid(format!("{name}: {reason}"))
        })?;
        self.command(Command::Send(transition)).await
    }

    /// Begins a track, the steps of one episode in order: see [`Track`]. It knows nothing of
    /// connections, so that it goes on whatever becomes of them; there may be thousands at once.
    pub fn track(&self) -> Track {
        Track::new(&self.schema)
    }

    /// Takes the next step of a track, and hands over the transition that it releases. Where that
    /// finds no room within [`step_within`](ProducerBuilder::step_within), it is dropped, and
    /// [`Totals`] tells of it: the tick goes on.
    ///
    /// A step with another number of values than the schema has is an error, and harms nothing else.
    pub async fn step(&mut self, track: &mut Track, step: Step) -> Result<(), ClientError> {
        self.check_step(&step)?;
        let before = track.held_back();
        let released = track.step(step);
        self.stepped.held_back += track.held_back() as u64;
        self.stepped.released(before);

        match released {
            Some(transition) => self.hand_over_in_time(transition).await,
            None => Ok(()),
        }
    }

    /// Passes over steps of a track that were not observed: hands over all that it held back, as
    /// [`step`](Self::step) does.
    pub async fn gap(&mut self, track: &mut Track) -> Result<(), ClientError> {
        let released = track.gap();
        self.stepped.released(released.len());
        for transition in released {
            self.hand_over_in_time(transition).await?;
        }
        Ok(())
    }

    /// Ends a track, and hands over all that it held back; waits while the outbox is full, for no
    /// tick waits any more.
    pub async fn end(&mut self, track: Track) -> Result<(), ClientError> {
        let released = track.end();
        self.stepped.released(released.len());
        for transition in released {
            self.send(transition).await?;
        }
        Ok(())
    }

    /// Returns how many steps tracks hold back now, as [`Totals`] tells it.
    pub fn held_back(&self) -> u64 {
        self.stepped.held_back
    }

    /// Returns how many steps of tracks were dropped so far, as [`Totals`] tells it.
    pub fn dropped(&self) -> u64 {
        self.stepped.dropped
    }

    fn check_step(&self, step: &Step) -> Result<(), ClientError> {
        same_width("state", step.state.len(), self.widths.state)?;
        same_width("action", step.actions.len(), self.widths.actions)?;
        let agents = self.widths.agents.len();
        if !step.acts.is_empty() {
            same_width("acting agent", step.acts.len(), agents)?;
        }

        let other = self.schema.outcomes().iter();
        let other = other.filter(|outcome| outcome.agent.is_none());
        if !step.is_observed.is_empty() {
            same_width(
                "observed flag",
                step.is_observed.len(),
                other.clone().count(),
            )?;
        }
        if !step.observed.is_empty() {
            let width = other.map(|outcome| outcome.value.len()).sum();
            same_width("observed", step.observed.len(), width)?;
        }
        Ok(())
    }

    async fn hand_over_in_time(&mut self, transition: Record) -> Result<(), ClientError> {
        let within = self.step_within;
        match tokio::time::timeout(within, self.send(transition)).await {
            Ok(sent) => sent,
            Err(_) => {
                self.stepped.dropped += 1;
                Ok(())
            }
        }
    }

    /// Labels everything from here on with a segment, or with none; another segment closes the
    /// batch.
    pub async fn segment(&mut self, segment: Option<&str>) -> Result<(), ClientError> {
        let segment = segment
            .map(str::parse::<Label>)
            .transpose()
            .map_err(ClientError::Invalid)?;
        self.command(Command::Segment(
            segment.map(|label| label.to_string()).unwrap_or_default(),
        ))
        .await
    }

    /// Closes the batch, so that it is sent without waiting for more.
    pub async fn cut(&mut self) -> Result<(), ClientError> {
        self.command(Command::Cut).await
    }

    /// Closes the batch, waits until everything handed over is acknowledged, and returns what
    /// became of it.
    pub async fn flush(&mut self) -> Result<Totals, ClientError> {
        let (reply, totals) = oneshot::channel();
        self.command(Command::Flush(reply)).await?;
        match totals.await {
            Ok(totals) => Ok(self.stepped.told(totals)),
            Err(_) => Err(self.failure().await),
        }
    }

    /// Flushes, ends the stream and waits for the task.
    pub async fn close(mut self) -> Result<Totals, ClientError> {
        let totals = self.flush().await?;
        let Self {
            commands,
            task,
            resume_point,
            is_replay,
            ..
        } = self;
        drop(commands);
        if let Some(task) = task {
            task.await.map_err(|_| ClientError::Stopped)??;
        }

        if is_replay && totals.last_sequence < resume_point {
            let made = totals.last_sequence;
            let message = format!(
                "the service holds {resume_point} batches of this producer, this source makes {made}: it is another one"
            );
            return Err(ClientError::Disagreement(message));
        }

        Ok(totals)
    }

    async fn command(&mut self, command: Command) -> Result<(), ClientError> {
        match self.commands.send(command).await {
            Ok(()) => Ok(()),
            Err(_) => Err(self.failure().await),
        }
    }

    /// Returns why the task ended; it has, or is about to.
    async fn failure(&mut self) -> ClientError {
        if let Some(task) = self.task.take() {
            self.failed = task.await.map_err(|_| ClientError::Stopped).flatten().err();
        }
        self.failed.clone().unwrap_or(ClientError::Stopped)
    }
}

fn same_width(what: &str, got: usize, expected: usize) -> Result<(), ClientError> {
    if got == expected {
        return Ok(());
    }
    Err(ClientError::Invalid(format!(
        "got {got} {what} values, expected {expected}"
    )))
}
