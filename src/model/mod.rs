//! What to expect where little or nothing was counted: networks trained from the counts, judged honestly, kept and served.

use std::sync::Arc;

use crate::domain::draft::TrainingDraft;
use crate::domain::{Environment, Job, Model, ModelAction, ModelId, ModelKind, Models, Pair, StateKey};
use crate::error::Problem;
use crate::priors::Fits;
use crate::store::Store;

/// The networks of every environment. Cloning is cheap.
#[derive(Clone)]
pub struct Networks {
    store: Arc<dyn Store>,
    fits: Fits,
}

impl Networks {
    /// Makes a handle on the networks of a store, judged by the priors fitted to it.
    pub fn new(store: Arc<dyn Store>, fits: Fits) -> Self {
        Self { store, fits }
    }

    /// Asks for a training, which begins when those asked for before are over.
    pub fn train(&self, environment: &Arc<Environment>, draft: &TrainingDraft) -> Result<Job, Problem> {
        todo!()
    }

    /// Returns every version, and the jobs asked for since the service started.
    pub async fn list(&self, environment: &Environment) -> Result<Models, Problem> {
        todo!()
    }

    /// Returns one version.
    pub async fn get(&self, environment: &Environment, version: u64) -> Result<Model, Problem> {
        todo!()
    }

    /// Returns a job.
    pub fn job(&self, environment: &Environment, id: u64) -> Result<Job, Problem> {
        todo!()
    }

    /// Makes a version the one that answers for its pair. Refused where it cannot answer by the environment's rule.
    pub async fn activate(&self, environment: &Environment, version: u64) -> Result<Model, Problem> {
        todo!()
    }

    /// Takes a version back: the one that was active before answers again, or none. Returns that one.
    pub async fn roll_back(&self, environment: &Environment, version: u64) -> Result<Option<Model>, Problem> {
        todo!()
    }

    /// Removes a version that is not active, or ends a job.
    pub async fn delete(&self, environment: &Environment, id: ModelId) -> Result<(), Problem> {
        todo!()
    }

    /// Returns a version as a safetensors file: its weights in PyTorch's layout, with its card.
    pub async fn export(&self, environment: &Environment, version: u64) -> Result<Vec<u8>, Problem> {
        todo!()
    }

    /// Keeps a network that was trained elsewhere: a safetensors file as [`export`](Self::export) writes it. It is judged by the counts here, and
    /// not made active.
    pub async fn import(&self, environment: &Arc<Environment>, file: Vec<u8>) -> Result<Model, Problem> {
        todo!()
    }

    /// Returns the network that answers for a pair.
    pub async fn active(&self, environment: &Environment, pair: &Pair) -> Result<Option<Arc<Network>>, Problem> {
        todo!()
    }

    /// Returns a version ready to answer, active or not.
    pub async fn network(&self, environment: &Environment, version: u64) -> Result<Arc<Network>, Problem> {
        todo!()
    }
}

/// A version ready to answer: shared by any number of threads.
pub struct Network {
    /// Its version.
    pub version: u64,
    /// Whose influence on whom.
    pub pair: Pair,
    /// What it predicts.
    pub kind: ModelKind,
    /// The threshold that it was trained and calibrated for, in nats.
    pub threshold: f64,
}

/// What a network says of one state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// P(MI > threshold), the mean of its members; `None` where it cannot tell at that threshold.
    pub probability: Option<f64>,
    /// Mutual information in nats, the mean of its members; `None` for a direct network.
    pub mutual_information: Option<f64>,
    /// Whether its members say the same.
    pub agrees: bool,
}

impl Network {
    /// Predicts for states, which are of the network's schema, at a threshold in nats.
    pub fn predict(&self, states: &[StateKey], threshold: f64) -> Vec<Prediction> {
        todo!()
    }

    /// Predicts what each of the ego's actions does in a state; empty for a direct network. Divergences are in nats.
    pub fn by_action(&self, environment: &Environment, state: &StateKey) -> Vec<ModelAction> {
        todo!()
    }
}
