//! A service of an experiment's own, in a temporary directory: one environment, which is filled and
//! asked as any other is.

use std::fmt::Display;
use std::sync::Arc;

use tempfile::TempDir;

use crate::app::Upkeep;
use crate::domain::draft::{PairDraft, QuestionDraft, SchemaDraft, StatesDraft, TrainingDraft};
use crate::domain::{
    Acknowledged, Answer, Batch, Environment, Job, JobState, Label, Pair, ProducerId, Question,
    Receipt, Record, Records, Sequence, StateKey, Widths,
};
use crate::error::{ErrorKind, Problem};
use crate::model::Dataset;
use crate::serve::{Running, Settings, Starting};
use crate::store::{Options, SqliteStore};

/// Records of one batch.
const BATCH: usize = 10_000;

/// States of one question.
const ASKED_TOGETHER: usize = 250;

/// A service with one environment.
pub struct Service {
    running: Running,
    environment: Arc<Environment>,
    sequence: Sequence,
    /// Removed with the service.
    directory: TempDir,
}

impl Service {
    /// Opens a service with an empty environment.
    pub async fn open(schema: &SchemaDraft) -> Result<Self, Problem> {
        let directory = tempfile::tempdir()
            .map_err(|error| unavailable("make a temporary directory", error))?;
        let store = SqliteStore::open(&directory.path().join("nudge.db"), Options::default()).await;
        let store = store.map_err(|error| unavailable("open a temporary database", error))?;
        // It listens nowhere: whoever measures calls its rooms.
        let running = Starting::new(Settings::default())
            .open(Arc::new(store), Upkeep::default())
            .await
            .map_err(|error| unavailable("start a service", error))?;

        let (environment, _) = running
            .app
            .environments
            .apply("experiment", schema.clone().into())
            .await?;
        Ok(Self {
            running,
            environment,
            sequence: Sequence::NONE,
            directory,
        })
    }

    /// Sends records under a segment, or under none, and waits until they are counted.
    pub async fn count(
        &mut self,
        segment: Option<&Label>,
        records: &[Record],
    ) -> Result<(), Problem> {
        let producer: ProducerId = "experiment".parse().expect("a producer id");
        let widths = Widths::of_schema(&self.environment.schema);

        for records in records.chunks(BATCH) {
            self.sequence = self.sequence.next();
            let records = Records::collect(widths.clone(), records.iter().cloned().map(Ok));
            let batch = Batch {
                sequence: self.sequence,
                segment: segment.cloned(),
                records,
            };
            match self
                .running
                .app
                .ingest
                .write(&self.environment, producer.clone(), batch)
                .await?
            {
                Acknowledged::Applied(Receipt {
                    rejected_count: 0, ..
                }) => {}
                told => return Err(internal(format!("not all counted: {told:?}"))),
            }
        }

        Ok(())
    }

    /// Fits the priors to what is counted.
    pub async fn fit(&self) -> Result<(), Problem> {
        self.running
            .app
            .influence
            .fit(&self.environment, None)
            .await
            .map(drop)
    }

    /// Trains a network and waits until it answers.
    pub async fn train(&self, draft: &TrainingDraft) -> Result<(), Problem> {
        let networks = &self.running.app.networks;
        let Job { id, .. } = networks.train(&self.environment, draft).await?;
        match networks.finished(&self.environment, id).await? {
            Job {
                state: JobState::Done,
                ..
            } => Ok(()),
            Job { message, .. } => Err(internal(message)),
        }
    }

    /// Returns what networks of the first two agents learn from.
    pub async fn dataset(&self) -> Result<Dataset, Problem> {
        let pair = Pair::named(&self.environment.schema, &PairDraft::default());
        let pair = pair.map_err(|faults| Problem::invalid("question", faults))?;
        self.running
            .app
            .networks
            .dataset(&self.environment, &pair)
            .await
    }

    /// Returns the key of a state that is given by its values.
    pub fn key(&self, state: &[f32]) -> Result<StateKey, Problem> {
        self.environment
            .schema
            .key_of_values(state)
            .map_err(|faults| Problem::invalid("question", faults))
    }

    /// Asks the same about many states, each given by its values, and returns an answer each.
    pub async fn ask(
        &self,
        states: &[Vec<f32>],
        question: &QuestionDraft,
    ) -> Result<Vec<Answer>, Problem> {
        let mut answers = Vec::with_capacity(states.len());
        // One after another: each is answered by every core.
        for states in states.chunks(ASKED_TOGETHER) {
            let draft = QuestionDraft {
                states: StatesDraft::Positional(states.to_vec()),
                ..question.clone()
            };
            let question = Question::new(&self.environment, &draft)?;
            answers.extend(
                self.running
                    .app
                    .influence
                    .answer(&self.environment, question)
                    .await?
                    .answers,
            );
        }
        Ok(answers)
    }

    /// Closes the service and forgets what it counted.
    pub async fn close(self) -> Result<(), Problem> {
        self.running
            .shutdown()
            .await
            .map_err(|error| unavailable("stop a service", error))?;
        self.directory
            .close()
            .map_err(|error| unavailable("remove a temporary directory", error))
    }
}

fn unavailable(what: &str, error: impl Display) -> Problem {
    Problem::new(
        ErrorKind::Unavailable,
        "NO_TEMPORARY_SERVICE",
        format!("cannot {what}: {error}"),
    )
}

fn internal(detail: String) -> Problem {
    Problem::new(ErrorKind::Internal, "INTERNAL", detail)
}
