//! Training requests: each waits for its turn, is carried out beside everything else, and its job
//! tells what came out.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use tokio_util::sync::CancellationToken;
use tracing::{Instrument, instrument};

use super::card_builder::{self, Origin};
use super::dataset::Dataset;
use super::encoder::Encoder;
use super::idle_priority::at_idle_priority;
use super::refusals::{check_size, internal, no_network};
use super::seen::Seen;
use super::training::{self, Ensemble, TrainingError};
use super::{Networks, file, registry};
use crate::domain::draft::TrainingDraft;
use crate::domain::{Card, Environment, Job, JobState, Model, Pair, Training};
use crate::error::{ErrorKind, Problem};
use crate::store::ENVIRONMENT_NOT_FOUND;
use crate::telemetry;
use crate::work::STOPPING;

/// A training that was asked for.
#[derive(Clone)]
struct TrainingRequest {
    job: u64,
    environment: Arc<Environment>,
    pair: Pair,
    training: Training,
    activate: bool,
    end: CancellationToken,
}

impl Networks {
    /// Asks for a training, which begins when those asked for before are over.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn train(
        &self,
        environment: &Arc<Environment>,
        draft: &TrainingDraft,
    ) -> Result<Job, Problem> {
        let (pair, training) = Training::new(&environment.schema, draft)?;
        check_size(environment, &pair, &training)?;
        self.registry.check_room(environment).await?;

        let end = self.ending.child_token();
        let job = self.jobs.add(environment, &pair, end.clone())?;
        let request = TrainingRequest {
            job: job.id,
            environment: environment.clone(),
            pair,
            training,
            activate: draft.activate,
            end,
        };

        tracing::info!(environment = %environment.name, job = job.id, ego = job.ego, other = job.other, "a training was asked for");
        self.running
            .spawn(self.clone().carry_out(request).in_current_span());
        Ok(job)
    }

    /// Reads what a network of a pair would learn from, as it is counted now.
    pub async fn dataset(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Dataset, Problem> {
        let dataset = Dataset::from_store(&*self.store, &self.fits, environment, pair).await?;

        dataset.ok_or_else(|| {
            Problem::new(
                ErrorKind::TooLarge,
                "TOO_MANY_ACTIONS",
                "the agents have too many actions for evidence",
            )
        })
    }

    /// Waits for its turn, trains, and tells what came out.
    async fn carry_out(self, request: TrainingRequest) {
        let turn = request.end.run_until_cancelled(self.turn.lock()).await;
        let started = Instant::now();
        let result = match turn {
            Some(_turn) => self.train_and_keep(&request).await,
            None => Err(no_network(&TrainingError::Cancelled)),
        };

        let (state, message, version) = match result {
            Ok(model) => (JobState::Done, outcome(&model), Some(model.version)),
            Err(problem) if request.end.is_cancelled() || is_cancellation(&problem) => (
                JobState::Cancelled,
                "cancelled; no network is made".to_owned(),
                None,
            ),
            Err(problem) => (JobState::Failed, problem.message, None),
        };

        telemetry::trained(state.as_str(), started.elapsed());
        tracing::info!(environment = %request.environment.name, job = request.job, state = state.as_str(), message, version, "a training is over");

        self.jobs.update(request.job, |job| {
            let progress = if state == JobState::Done {
                1.0
            } else {
                job.progress
            };
            *job = Job {
                state,
                message,
                version,
                progress,
                ..job.clone()
            };
        });
    }

    /// Trains by the counts and the rule of now, and keeps what came out.
    async fn train_and_keep(&self, request: &TrainingRequest) -> Result<Model, Problem> {
        let TrainingRequest { pair, training, .. } = request;
        // It may have waited for long, and rules change.
        let environment = &self.current(&request.environment)?;

        self.tell(request, 0.0, "reads the states and fits the prior");
        let dataset = request
            .end
            .run_until_cancelled(self.dataset(environment, pair))
            .await;
        let dataset = dataset.unwrap_or_else(|| Err(no_network(&TrainingError::Cancelled)))?;

        let seen = Seen::in_states(
            &environment.schema,
            training::learned(&dataset, training).map(|example| &example.key),
        );

        let (networks, request_there) = (self.clone(), request.clone());
        let trained = tokio::task::spawn_blocking(move || {
            at_idle_priority(|| networks.train_with_twin(&request_there, &dataset))
        })
        .await;
        let (ensemble, card) = trained
            .map_err(|error| internal(&error))?
            .map_err(|error| no_network(&error))?;

        let content = file::Content {
            kind: training.kind,
            pair: pair.clone(),
            threshold: card.threshold,
            encoder: ensemble.encoder,
            members: ensemble.members,
            seen: Some(seen),
        };
        let version = self.registry.keep(environment, &content, &card).await?;

        let environment = &self.current(environment)?;
        if request.activate || card.not_better_than.is_empty() {
            match self.activate(environment, version).await {
                // The rule has changed meanwhile: then it is kept, and says that it is stale.
                Err(problem) if problem.reason == registry::STALE => {}
                activated => drop(activated?),
            }
        }
        self.get(environment, version).await
    }

    /// Returns an environment as it is now.
    fn current(&self, environment: &Environment) -> Result<Arc<Environment>, Problem> {
        let found = self
            .store
            .environment(environment.name.as_str())
            .filter(|found| found.id == environment.id);
        found.ok_or_else(|| crate::store::StoreError::UnknownEnvironment.into())
    }

    /// Trains an ensemble, and a twin on shuffled counts as the control, and evaluates both.
    fn train_with_twin(
        &self,
        request: &TrainingRequest,
        dataset: &Dataset,
    ) -> Result<(Ensemble, Card), TrainingError> {
        /// Of the whole, what each of the two takes; the rest is for evaluation.
        const SHARE: f64 = 0.48;

        let training = &request.training;
        let seen = dataset
            .examples
            .iter()
            .map(|example| (&example.key, example.table.total() as f64));
        let encoder = Encoder::fitted(&request.environment.schema, seen);

        let train = |dataset: &Dataset, from: f64, what: &str| {
            let mut watch = |done: f64| {
                self.tell(request, from + SHARE * done, what);
                if request.end.is_cancelled() {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            };
            training::train(dataset, &encoder, training, &mut watch)
        };

        let ensemble = train(dataset, 0.02, "learns from the counts")?;
        let shuffled = dataset.shuffled(training.seed);
        let twin = train(
            &shuffled,
            0.02 + SHARE,
            "learns from shuffled counts, for comparison",
        )?;

        if request.end.is_cancelled() {
            return Err(TrainingError::Cancelled);
        }

        self.tell(
            request,
            0.02 + 2.0 * SHARE,
            "is judged beside its baselines",
        );
        let card = card_builder::build_card(dataset, *training, &ensemble, &Origin::Trained(&twin));
        Ok((ensemble, card))
    }

    fn tell(&self, request: &TrainingRequest, progress: f64, message: &str) {
        self.jobs.update(request.job, |job| {
            *job = Job {
                state: JobState::Running,
                progress,
                message: message.to_owned(),
                ..job.clone()
            };
        });
    }
}

/// Returns whether a training that failed of this was cancelled, though nobody has told it to end
/// yet: a stop of the service ends the fit that a training begins with before it tells the training,
/// and an environment is gone before its trainings are told.
fn is_cancellation(problem: &Problem) -> bool {
    [STOPPING, ENVIRONMENT_NOT_FOUND].contains(&problem.reason)
}

/// Says in a sentence what became of a network that was trained.
fn outcome(model: &Model) -> String {
    let unbeaten = model
        .card
        .as_ref()
        .map_or(&[][..], |card| &card.not_better_than);
    let worse = unbeaten.join(", ");

    match (model.active, worse.is_empty()) {
        (true, true) => format!("version {} is active", model.version),
        (true, false) => {
            format!(
                "version {} is active as was asked for, though it is not better than {worse}",
                model.version
            )
        }
        (false, false) => format!(
            "version {} is kept, not active: it is not better than {worse}",
            model.version
        ),
        (false, true) => format!(
            "version {} is kept, not active: the rule has changed meanwhile",
            model.version
        ),
    }
}
