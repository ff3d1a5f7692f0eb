//! Neural networks for states with few counts or none: trained from the counts, evaluated on
//! held-out states (cross-validation), kept with a card, and served.
//!
//! ```text
//! train    store.scan -> dataset (tables, evidence) -> training (learner) -> ensemble ->
//! card_builder -> registry answer   registry -> network -> prediction
//! ```
//!
//! | room | for |
//! |---|---|
//! | `training_requests`, `import`, `versions`, `inference` | the door: trainings, networks of elsewhere, the registry's versions, and what answers; `refusals` says why not |
//! | `jobs`, `upkeep`, `idle_priority` | the queue of trainings, those that are due by themselves, and the thread that does them |
//! | `dataset` | observations: the states with their tables and what the evidence says of them, and the same with the other's actions shuffled |
//! | `encoder`, `letters`, `member` | features to inputs, the alphabets of what is predicted, and a multilayer perceptron's forward pass as it is served |
//! | `learner`, `loss`, `adam` | back-propagation with dropout, log loss, AdamW |
//! | `training`, `permutation_test` | an ensemble over folds with early stopping; whether more than chance was learned |
//! | `calibration`, `score`, `back_off`, `held_out_evaluation`, `card_builder` | Platt scaling, and how good a network is on held-out states beside its baselines |
//! | `file`, `stored_forms`, `registry` | kept as safetensors with a card, listed and switched |
//! | `network`, `prediction_cache`, `seen` | a version ready to predict, what it said, and the range that it was trained on, outside which it gives no verdict |
//!
//! Absent on purpose: nothing here decides a verdict by counts, and no wire format is known here
//! but that of a file of weights.

mod adam;
mod back_off;
mod calibration;
mod card_builder;
mod dataset;
mod encoder;
mod file;
mod held_out_evaluation;
mod idle_priority;
mod import;
mod inference;
mod jobs;
mod learner;
mod letters;
mod loss;
mod member;
mod network;
mod permutation_test;
mod prediction_cache;
mod refusals;
mod registry;
mod score;
mod seen;
mod store_errors;
mod stored_forms;
mod training;
mod training_requests;
mod upkeep;
mod versions;

use std::sync::Arc;
use std::time::SystemTime;

use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use self::jobs::Jobs;
use self::registry::Registry;
use crate::domain::{EnvironmentId, JobState};
use crate::priors::PriorRegistry;
use crate::store::Store;

pub use back_off::BackOff;
pub use dataset::{Dataset, Example};
pub use network::{Network, Prediction};

/// The networks of every environment. Cloning is cheap: every request does.
#[derive(Clone)]
pub struct Networks(Arc<Handles>);

/// What all clones share.
pub struct Handles {
    store: Arc<dyn Store>,
    fits: PriorRegistry,
    registry: Registry,
    jobs: Jobs,
    /// One training at a time: in the order of asking.
    turn: Arc<tokio::sync::Mutex<()>>,
    ending: CancellationToken,
    running: TaskTracker,
}

impl std::ops::Deref for Networks {
    type Target = Handles;

    fn deref(&self) -> &Handles {
        &self.0
    }
}

impl Networks {
    /// Makes a handle on the networks of a store, judged by the priors fitted to it.
    pub fn new(store: Arc<dyn Store>, fits: PriorRegistry) -> Self {
        Self(Arc::new(Handles {
            registry: Registry::new(store.clone()),
            store,
            fits,
            jobs: Jobs::since(SystemTime::now()),
            turn: Arc::default(),
            ending: CancellationToken::new(),
            running: TaskTracker::new(),
        }))
    }

    /// Returns how many trainings wait for their turn, and how many are being done.
    pub fn at_work(&self) -> [usize; 2] {
        [JobState::Queued, JobState::Running].map(|state| self.jobs.number(state))
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
}
