//! What to expect where little or nothing was counted: networks trained from the counts, judged by
//! the counts of states that they did not learn from, kept and served.
//!
//! ```text
//! train    store.scan -> dataset (tables, evidence) -> training (learner) -> ensemble -> judge -> card -> registry
//! answer   registry -> network -> prediction
//! ```
//!
//! | room | for |
//! |---|---|
//! | `dataset` | the states with their tables and what the evidence says of them, and the same with the other's actions shuffled |
//! | `encoder`, `member` | from a state to inputs, from inputs to what both agents do: the forward pass that is served |
//! | `learner`, `training`, `worth` | gradients, by the training library and nobody else; when to stop; whether more than chance was learned |
//! | `calibrate`, `score`, `back_off`, `court`, `judge` | from mutual information to a probability, and how good it is beside what it has to beat |
//! | `file`, `text`, `registry`, `network`, `told` | kept as safetensors with a card, listed, switched, ready to answer, and what was answered |
//! | `seen` | the bins that a network was trained on, outside which it gives no verdict |
//! | `jobs`, `upkeep`, `spare_time` | trainings that were asked for, or are due by themselves, and the thread that does them |
//!
//! Absent on purpose: nothing here decides a verdict by counts, and no wire format is known here
//! but that of a file of weights.

mod back_off;
mod calibrate;
mod court;
mod dataset;
mod encoder;
mod file;
mod jobs;
mod judge;
mod learner;
mod member;
mod network;
mod registry;
mod score;
mod seen;
mod spare_time;
mod store_errors;
mod text;
mod told;
mod training;
mod upkeep;
mod worth;

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tracing::{Instrument, instrument};

use self::encoder::{Encoder, MOST_INPUTS};
use self::jobs::Jobs;
use self::judge::Origin;
use self::registry::Registry;
use self::seen::Seen;
use self::spare_time::in_spare_time;
use self::store_errors::logged;
use self::training::{Ensemble, TrainingError};
use crate::domain::draft::TrainingDraft;
use crate::domain::{
    Card, Environment, EnvironmentId, Job, JobState, Model, ModelId, ModelKind, Models, Pair,
    Training, is_same_threshold, page_size,
};
use crate::error::{ErrorKind, Fault, Problem};
use crate::evidence::MOST_CELLS;
use crate::priors::PriorRegistry;
use crate::store::Store;
use crate::telemetry;
use crate::work::STOPPING;

pub use back_off::BackOff;
pub use dataset::{Dataset, Example};
pub use network::{Network, Prediction};

/// The networks of every environment. Cloning is cheap.
#[derive(Clone)]
pub struct Networks {
    store: Arc<dyn Store>,
    fits: PriorRegistry,
    registry: Registry,
    jobs: Jobs,
    /// One training at a time: in the order of asking.
    turn: Arc<tokio::sync::Mutex<()>>,
    ending: CancellationToken,
    running: TaskTracker,
}

impl Networks {
    /// Makes a handle on the networks of a store, judged by the priors fitted to it.
    pub fn new(store: Arc<dyn Store>, fits: PriorRegistry) -> Self {
        Self {
            registry: Registry::new(store.clone()),
            store,
            fits,
            jobs: Jobs::since(SystemTime::now()),
            turn: Arc::default(),
            ending: CancellationToken::new(),
            running: TaskTracker::new(),
        }
    }

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
        let order = Order {
            job: job.id,
            environment: environment.clone(),
            pair,
            training,
            activate: draft.activate,
            end,
        };
        tracing::info!(environment = %environment.name, job = job.id, ego = job.ego, other = job.other, "a training was asked for");
        self.running
            .spawn(self.clone().carry_out(order).in_current_span());
        Ok(job)
    }

    /// Returns every version, and the jobs asked for since the service started.
    pub async fn list(&self, environment: &Environment) -> Result<Models, Problem> {
        let (models, jobs) = (
            self.registry.list(environment).await?,
            self.jobs.of(environment.id),
        );
        Ok(Models {
            models,
            jobs,
            next_page_token: None,
        })
    }

    /// Returns a page of versions, with the jobs on the first; a size of 0 takes the largest.
    pub async fn page(
        &self,
        environment: &Environment,
        asked: u64,
        page_token: Option<&str>,
    ) -> Result<Models, Problem> {
        let size = page_size(if asked == 0 { 1_000 } else { asked })?;
        let after = page_token.map(place).transpose()?;
        let page = self
            .registry
            .page(environment, after.unwrap_or(0), size)
            .await?;
        let last = page
            .items
            .last()
            .filter(|_| page.has_more)
            .map(|model| model.version.to_string());
        let jobs = if after.is_none() {
            self.jobs.of(environment.id)
        } else {
            Vec::new()
        };
        Ok(Models {
            models: page.items,
            jobs,
            next_page_token: last,
        })
    }

    /// Returns one version.
    pub async fn get(&self, environment: &Environment, version: u64) -> Result<Model, Problem> {
        self.registry.get(environment, version).await
    }

    /// Returns how many trainings wait for their turn, and how many are being done.
    pub fn at_work(&self) -> [usize; 2] {
        [JobState::Queued, JobState::Running].map(|state| self.jobs.number(state))
    }

    /// Returns a job.
    pub fn job(&self, environment: &Environment, id: u64) -> Result<Job, Problem> {
        self.jobs.get(environment.id, id)
    }

    /// Returns a job once it is over.
    pub async fn finished(&self, environment: &Environment, id: u64) -> Result<Job, Problem> {
        self.jobs.finished(environment.id, id).await
    }

    /// Makes a version the one that answers for its pair. Refused where it cannot answer by the
    /// environment's rule.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn activate(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Model, Problem> {
        let model = self.registry.activate(environment, version).await?;
        tracing::info!(environment = %environment.name, version, "a network was made active");
        Ok(model)
    }

    /// Takes a version back: the one that was active before answers again, or none. Returns that
    /// one.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn roll_back(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Option<Model>, Problem> {
        let instead = self.registry.roll_back(environment, version).await?;
        let active = instead.as_ref().map(|model| model.version);
        tracing::info!(environment = %environment.name, version, active, "a network was taken back");
        Ok(instead)
    }

    /// Removes a version that is not active, or ends a job.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn delete(&self, environment: &Environment, id: ModelId) -> Result<(), Problem> {
        match id {
            ModelId::Version(version) => {
                self.registry.delete(environment, version).await?;
                tracing::info!(environment = %environment.name, version, "a network was deleted");
            }
            ModelId::Job(job) => {
                self.jobs.end(environment.id, job)?;
                tracing::info!(environment = %environment.name, job, "a training was told to end");
            }
        }
        Ok(())
    }

    /// Returns a version as a safetensors file: its weights in PyTorch's layout, with its card.
    pub async fn export(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Vec<u8>, Problem> {
        self.registry.export(environment, version).await
    }

    /// Keeps a network that was trained elsewhere: a safetensors file as [`export`](Self::export)
    /// writes it. It is judged by the counts here, and not made active. With the card of an export
    /// it says of every state what it said before; without one, or for a rule with another
    /// threshold, it is calibrated here.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn import(
        &self,
        environment: &Arc<Environment>,
        file: Vec<u8>,
    ) -> Result<Model, Problem> {
        let read = {
            let environment = environment.clone();
            tokio::task::spawn_blocking(move || file::imported(&environment, &file)).await
        };
        let (mut content, exported) = read.map_err(|error| internal(&error))??;
        self.registry.check_room(environment).await?;
        let width = content
            .members
            .first()
            .map_or(0, |member| member.trunk.shape().1);
        let members = content.members.len();
        let foreign = Training {
            kind: content.kind,
            width,
            members,
            epochs: 0,
            ..Training::default()
        };
        let training = exported.as_ref().map_or(foreign, |card| card.training);
        check_size(environment, &content.pair, &training)?;
        let turn = self.turn.clone().lock_owned().await;
        let dataset = self.dataset(environment, &content.pair).await?;
        if content.kind == ModelKind::Joint
            && !is_same_threshold(content.threshold, dataset.threshold)
        {
            // It is calibrated here, for the rule as it is.
            content.threshold = dataset.threshold;
        }
        if !is_same_threshold(content.threshold, dataset.threshold) {
            let detail = format!(
                "got {}, expected that of the rule, {} nats",
                content.threshold, dataset.threshold
            );
            return Err(Problem::invalid(
                "network",
                vec![Fault::new("/metadata/threshold", detail)],
            ));
        }
        training::check(&dataset, &training).map_err(|error| no_network(&error))?;
        if content.seen.is_none() {
            // Who does not say what it was trained on is believed where something is counted, as it
            // is where it comes from.
            content.seen = Some(self.registry.counted(environment).await?);
        }
        let judged = tokio::task::spawn_blocking(move || {
            // The next has its turn when this one is judged, even if nobody waits for it any more.
            let _turn = turn;
            let (encoder, members) = (content.encoder.clone(), content.members.clone());
            let (epochs, dropout) = exported
                .as_ref()
                .map_or_else(Default::default, |card| (card.epochs.clone(), card.dropout));
            let ensemble = Ensemble {
                encoder,
                members,
                epochs,
                dropout,
            };
            let origin = exported.as_ref().map_or(Origin::Foreign, Origin::Exported);
            let card = in_spare_time(|| judge::card(&dataset, training, &ensemble, &origin));
            (content, card)
        });
        let (content, card) = judged.await.map_err(|error| internal(&error))?;
        if !(card.calibration.intercept.is_finite() && card.calibration.slope.is_finite()) {
            let detail = "its outputs are no numbers on the states here";
            return Err(Problem::invalid(
                "network",
                vec![Fault::new("/members", detail)],
            ));
        }
        let version = self.registry.keep(environment, &content, &card).await?;
        tracing::info!(environment = %environment.name, version, "a network was imported");
        self.get(environment, version).await
    }

    /// Returns the network that answers for a pair; none where other agents are held fixed.
    pub async fn active(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Network>>, Problem> {
        if pair.given.is_empty() {
            self.registry.active(environment, pair).await
        } else {
            Ok(None)
        }
    }

    /// Returns the active network of a pair, for callers who want it and nothing else: an error
    /// where it cannot be read.
    pub async fn served(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Network>>, Problem> {
        self.registry.served(environment, pair).await
    }

    /// Says in the log which versions cannot be read, and why.
    pub async fn tell_unreadable(&self) {
        for environment in self.store.environments() {
            // Listing looks at each version, and tells.
            if let Err(problem) = self.registry.list(&environment).await {
                tracing::warn!(%problem, environment = %environment.name, "the networks could not be looked at");
            }
        }
    }

    /// Returns a version ready to answer, active or not.
    pub async fn network(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Arc<Network>, Problem> {
        self.registry.network(environment, version).await
    }

    /// Tells what is trained for an environment that was deleted to end.
    pub fn end_of(&self, environment: EnvironmentId) {
        self.jobs.end_all(environment);
    }

    /// Tells what is trained to end.
    pub fn end(&self) {
        self.ending.cancel();
    }

    /// Ends what is trained, and waits until it has ended.
    pub async fn close(&self) {
        self.end();
        self.running.close();
        self.running.wait().await;
    }

    /// Reads what a network of a pair would learn from, as it is counted now.
    pub async fn dataset(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Dataset, Problem> {
        let read = Dataset::read(&*self.store, &self.fits, environment, pair).await?;
        read.ok_or_else(|| {
            Problem::new(
                ErrorKind::TooLarge,
                "TOO_MANY_ACTIONS",
                "the agents have too many actions for evidence",
            )
        })
    }

    /// Waits for its turn, trains, and tells what came out.
    async fn carry_out(self, order: Order) {
        let turn = order.end.run_until_cancelled(self.turn.lock()).await;
        let started = Instant::now();
        let result = match turn {
            Some(_turn) => self.carried_out(&order).await,
            None => Err(no_network(&TrainingError::Cancelled)),
        };
        let (state, message, version) = match result {
            Ok(model) => (JobState::Done, outcome(&model), Some(model.version)),
            // A stop of the service ends the fit that a training begins with before it tells the
            // training.
            Err(problem) if order.end.is_cancelled() || problem.reason == STOPPING => (
                JobState::Cancelled,
                "cancelled; no network is made".to_owned(),
                None,
            ),
            Err(problem) => (JobState::Failed, problem.message, None),
        };
        telemetry::trained(state.as_str(), started.elapsed());
        tracing::info!(environment = %order.environment.name, job = order.job, state = state.as_str(), message, version, "a training is over");
        self.jobs.update(order.job, |job| {
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

    async fn carried_out(&self, order: &Order) -> Result<Model, Problem> {
        let Order { pair, training, .. } = order;
        // It may have waited for long: the rule is that of now.
        let environment = &self.current(&order.environment)?;
        self.tell(order, 0.0, "reads the states and fits the prior");
        let dataset = order
            .end
            .run_until_cancelled(self.dataset(environment, pair))
            .await;
        let dataset = dataset.unwrap_or_else(|| Err(no_network(&TrainingError::Cancelled)))?;
        let seen = Seen::of(
            &environment.schema,
            training::learned(&dataset, training).map(|example| &example.key),
        );
        let (networks, order_there) = (self.clone(), order.clone());
        let trained = tokio::task::spawn_blocking(move || {
            in_spare_time(|| networks.trained(&order_there, &dataset))
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
        if order.activate || card.not_better_than.is_empty() {
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

    /// Trains an ensemble and its shuffled twin, and judges them.
    fn trained(&self, order: &Order, dataset: &Dataset) -> Result<(Ensemble, Card), TrainingError> {
        /// Of the whole, what each of the two takes; the rest is for judging.
        const SHARE: f64 = 0.48;
        let training = &order.training;
        let seen = dataset
            .examples
            .iter()
            .map(|example| (&example.key, example.table.total() as f64));
        let encoder = Encoder::fitted(&order.environment.schema, seen);
        let train = |dataset: &Dataset, from: f64, what: &str| {
            let mut watch = |done: f64| {
                self.tell(order, from + SHARE * done, what);
                if order.end.is_cancelled() {
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
        if order.end.is_cancelled() {
            return Err(TrainingError::Cancelled);
        }
        self.tell(order, 0.02 + 2.0 * SHARE, "is judged beside its baselines");
        let card = judge::card(dataset, *training, &ensemble, &Origin::Trained(&twin));
        Ok((ensemble, card))
    }

    fn tell(&self, order: &Order, progress: f64, message: &str) {
        self.jobs.update(order.job, |job| {
            *job = Job {
                state: JobState::Running,
                progress,
                message: message.to_owned(),
                ..job.clone()
            };
        });
    }
}

/// A training that was asked for.
#[derive(Clone)]
struct Order {
    job: u64,
    environment: Arc<Environment>,
    pair: Pair,
    training: Training,
    activate: bool,
    end: CancellationToken,
}

/// Reads a page's token: the version that it comes after.
fn place(token: &str) -> Result<u64, Problem> {
    let version = token
        .parse()
        .ok()
        .filter(|version: &u64| version.to_string() == token);
    let fault = || {
        Fault::new(
            "/page_token",
            format!("got {token:?}, expected the `next_page_token` of a page"),
        )
    };
    version.ok_or_else(|| Problem::invalid("page", vec![fault()]))
}

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

/// Says what is too large for a network.
fn check_size(environment: &Environment, pair: &Pair, training: &Training) -> Result<(), Problem> {
    let (inputs, cells) = (
        encoder::width(&environment.schema),
        pair.alphabet(&environment.schema),
    );
    let too_large = |message: String| {
        Err(Problem::new(
            ErrorKind::TooLarge,
            "NETWORK_TOO_LARGE",
            message,
        ))
    };
    if inputs > MOST_INPUTS {
        return too_large(format!(
            "a state is {inputs} numbers, more than the {MOST_INPUTS} that a network takes"
        ));
    }
    if cells.rows.saturating_mul(cells.columns) > MOST_CELLS {
        return too_large(format!(
            "the agents have {} x {} actions, more than {MOST_CELLS} pairs",
            cells.rows, cells.columns
        ));
    }
    let outputs: usize = member::heads(training.kind, cells)
        .iter()
        .map(|(_, outputs)| outputs)
        .sum();
    let numbers = training.members * (training.width * (inputs + outputs + 1) + outputs);
    // A part of the file is for names and the card.
    if numbers * size_of::<f32>() > file::MOST_BYTES - (1 << 20) {
        return too_large(format!(
            "it would have {numbers} weights; take fewer members or a smaller width"
        ));
    }
    Ok(())
}

fn no_network(error: &TrainingError) -> Problem {
    let (kind, reason) = match error {
        TrainingError::TooFew(_) => (ErrorKind::Conflict, "TOO_FEW_DATA"),
        TrainingError::Diverged(_) => (ErrorKind::Conflict, "TRAINING_DIVERGED"),
        TrainingError::Cancelled => (ErrorKind::Conflict, "CANCELLED"),
        TrainingError::Library(_) => (ErrorKind::Internal, "INTERNAL"),
    };
    Problem::new(kind, reason, format!("no network is made: {error}"))
}

fn internal(error: &dyn std::fmt::Display) -> Problem {
    tracing::error!(%error, "a training ended unexpectedly");
    Problem::new(
        ErrorKind::Internal,
        "INTERNAL",
        "the training ended unexpectedly; the cause is in the service's log",
    )
}
