//! Sending a simulated hallway to a service, so that every transition counts once however often it
//! is done.

use std::time::Duration;

use clap::ValueEnum;
use tokio::time::{Instant, sleep_until};

use super::observed::{description, observed};
use crate::cli::Failure;
use crate::cli::lags::Lags;
use crate::cli::making::make;
use crate::client::{Connection, Producer, Totals};
use crate::simulation::hallway::{Hallway, Protocol};
use crate::simulation::observation::{Observation, Observations};

/// What is part of every producer id: another way to cut the same trials into batches must take
/// another.
const WAY: &str = "hallway.1";

/// Transitions of a batch at most; see [`WAY`].
const BATCH_SIZE: usize = 1_000;

/// How fast simulated time passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum Pace {
    /// As fast as it goes
    Fast,
    /// A simulated second takes a second
    RealTime,
}

/// A hallway on its way into an environment.
#[derive(Debug, Clone)]
pub(in crate::cli) struct Run {
    /// Whose trials are sent.
    pub(in crate::cli) hallway: Hallway,
    /// The name of the environment, which is made if it is missing.
    pub(in crate::cli) environment: String,
    /// The lags of what is sent.
    pub(in crate::cli) lags: Lags,
    /// How fast simulated time passes.
    pub(in crate::cli) pace: Pace,
}

/// How far a run is.
#[derive(Debug, Clone, Copy)]
pub(in crate::cli) struct Moment {
    /// The trial, from 1.
    pub(in crate::cli) trial: u32,
    /// Seconds since it began.
    pub(in crate::cli) time: f64,
    /// Transitions handed over so far, those of earlier runs included.
    pub(in crate::cli) transitions: u64,
}

impl Run {
    /// Sends what the service has not committed yet, a segment a trial, and says every simulated
    /// second how far it is.
    ///
    /// A batch closes with its second, its trial or when it is full, whatever the pace: so a run
    /// may be interrupted and go on at another pace. More trials of the same hallway go on behind
    /// the ones that were sent.
    pub(in crate::cli) async fn send(
        &self,
        connection: &Connection,
        mut progress: impl FnMut(Moment),
    ) -> Result<Totals, Failure> {
        make(connection, &self.environment, description(&self.lags)?).await?;
        let producer = connection
            .producer(&self.environment, &self.producer())
            .batch_size(BATCH_SIZE)
            .replay();
        let mut stream = Stream::begin(producer.open().await?, self);
        for number in 1..=self.hallway.protocol().trials {
            let observations = observed(&self.hallway, number, stream.producer.schema())?;
            stream.trial(number, observations, &mut progress).await?;
        }

        stream.end().await
    }

    /// Returns the name of the producer: a digest of every parameter but the number of trials,
    /// which does not change a trial.
    fn producer(&self) -> String {
        let protocol = Protocol {
            trials: 0,
            ..self.hallway.protocol().clone()
        };
        // The derived text has every field by name, and each number as the shortest text that reads
        // back as the same.
        let digest = blake3::hash(format!("{protocol:?}").as_bytes()).to_hex();
        format!("{WAY}:{}", &digest[..32])
    }
}

/// The stream of one run.
struct Stream {
    producer: Producer,
    pace: Pace,
    seed: u64,
    record_interval: Duration,
    records_per_second: usize,
    transitions: u64,
    batches: u64,
    /// When the present simulated second is over, in real time.
    due: Instant,
}

impl Stream {
    fn begin(producer: Producer, run: &Run) -> Self {
        let record_interval = Duration::from_secs_f64(run.hallway.protocol().record_interval);
        Self {
            producer,
            pace: run.pace,
            seed: run.hallway.protocol().seed,
            record_interval,
            records_per_second: (1.0 / record_interval.as_secs_f64()).round().max(1.0) as usize,
            transitions: 0,
            batches: 0,
            due: Instant::now(),
        }
    }

    /// Sends one trial, second after second.
    async fn trial(
        &mut self,
        number: u32,
        mut observations: Observations,
        progress: &mut impl FnMut(Moment),
    ) -> Result<(), Failure> {
        self.producer
            .segment(Some(&format!("seed-{}.trial-{number}", self.seed)))
            .await?;
        let mut passed = Duration::ZERO;
        loop {
            // Other tasks of this thread go elsewhere while a large crowd walks.
            let second = || {
                observations
                    .by_ref()
                    .take(self.records_per_second)
                    .collect::<Vec<_>>()
            };
            let second = tokio::task::block_in_place(second);
            if second.is_empty() {
                return Ok(());
            }
            let lasts = self.record_interval * second.len() as u32;
            passed += lasts;
            self.second(lasts, second.into_iter().flatten().collect())
                .await?;
            progress(Moment {
                trial: number,
                time: passed.as_secs_f64(),
                transitions: self.transitions,
            });
        }
    }

    /// Sends a second when it is over. What the service holds already is passed over without
    /// waiting.
    async fn second(
        &mut self,
        lasts: Duration,
        observations: Vec<Observation>,
    ) -> Result<(), Failure> {
        self.transitions += observations.len() as u64;
        self.batches += observations.len().div_ceil(BATCH_SIZE) as u64;
        if self.pace == Pace::RealTime && self.batches > self.producer.resume_point() {
            self.due += lasts;
            sleep_until(self.due).await;
        }

        for observation in observations {
            self.producer.send(observation.transition).await?;
        }

        Ok(self.producer.cut().await?)
    }

    async fn end(mut self) -> Result<Totals, Failure> {
        let totals = self.producer.flush().await?;
        // After a run of more trials the service holds more than this one sent, which closing would
        // call a contradiction.
        if self.producer.resume_point() <= totals.last_sequence {
            self.producer.close().await?;
        }
        Ok(totals)
    }
}
