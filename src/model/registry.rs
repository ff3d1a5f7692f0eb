//! Which versions there are, and which answers for each pair: kept by the store, remembered ready to answer.
//!
//! Who asks for the active network reads a map that is replaced as a whole, so a switch disturbs nobody: each request has either the one or the other.
//! Loading and switching take turns, so that what is remembered is never older than what the store says.

use std::sync::Arc;

use arc_swap::ArcSwap;
use foldhash::HashMap;
use lru::LruCache;
use tokio::sync::Mutex;

use super::file;
use super::network::Network;
use super::seen::{Seeing, Seen};
use crate::domain::{Card, Environment, EnvironmentId, Model, Pair, is_same_threshold};
use crate::error::{ErrorKind, Problem};
use crate::priors::Pages;
use crate::store::{ModelRecord, NewModel, Store, StoreError};

/// The reason word of a version that cannot answer by the rule.
pub const STALE: &str = "MODEL_STALE";

/// A pair of agents of an environment: the ego and the other.
type Place = (EnvironmentId, usize, usize);

/// The networks that answer; `None` where it is known that there is none.
type Active = HashMap<Place, Option<Arc<Network>>>;

/// Versions that are kept ready without being active.
const READY: std::num::NonZeroUsize = std::num::NonZeroUsize::new(8).expect("not zero");

/// Versions that were asked for, ready to answer.
type Ready = std::sync::Mutex<LruCache<(EnvironmentId, u64), Arc<Network>>>;

/// The versions of every environment. Cloning is cheap.
#[derive(Clone)]
pub struct Registry {
    store: Arc<dyn Store>,
    active: Arc<ArcSwap<Active>>,
    ready: Arc<Ready>,
    turn: Arc<Mutex<()>>,
}

impl Registry {
    /// Makes a handle on the versions of a store.
    pub fn new(store: Arc<dyn Store>) -> Self {
        let ready = Arc::new(Ready::new(LruCache::new(READY)));
        Self { store, active: Arc::default(), ready, turn: Arc::default() }
    }

    /// Returns every version, in order. One whose card cannot be read is left out, and told in the log.
    pub async fn list(&self, environment: &Environment) -> Result<Vec<Model>, Problem> {
        let records = self.store.models(environment.id).await.map_err(logged)?;
        Ok(records.into_iter().filter_map(|record| model(environment, record)).collect())
    }

    /// Returns one version.
    pub async fn get(&self, environment: &Environment, version: u64) -> Result<Model, Problem> {
        let found = self.list(environment).await?.into_iter().find(|model| model.version == version);
        found.ok_or_else(|| StoreError::UnknownModel(version).into())
    }

    /// Keeps a network with its card.
    pub async fn keep(&self, environment: &Environment, content: &file::Content, card: &Card) -> Result<u64, Problem> {
        let text = serde_json::to_string(card).expect("a card is JSON");
        let weights = file::write(environment, content, &text);
        if weights.len() > file::MOST_BYTES {
            let message =
                format!("the network takes {} bytes, more than {}; make it narrower", weights.len(), file::MOST_BYTES);
            return Err(Problem::new(ErrorKind::TooLarge, "NETWORK_TOO_LARGE", message));
        }
        let Pair { ego, other, .. } = content.pair;
        let model = NewModel { ego, other, kind: content.kind.as_str().to_owned(), card: text, weights };
        self.store.keep_model(environment.id, &model).await.map_err(logged)
    }

    /// Makes a version the one that answers for its pair.
    pub async fn activate(&self, environment: &Environment, version: u64) -> Result<Model, Problem> {
        let model = self.get(environment, version).await?;
        if model.stale {
            let rule = environment.rule.threshold_nats();
            let message = format!(
                "version {version} answers at a threshold of {} nats only, and the rule's is {rule}: train another",
                model.card.threshold
            );
            return Err(Problem::new(ErrorKind::Conflict, STALE, message));
        }
        {
            let _switch = self.switch(environment).await;
            self.store.activate_model(environment.id, version).await.map_err(logged)?;
        }
        self.get(environment, version).await
    }

    /// Takes a version back, and returns the one that answers for its pair instead.
    pub async fn roll_back(&self, environment: &Environment, version: u64) -> Result<Option<Model>, Problem> {
        let switch = self.switch(environment).await;
        let model = self.get(environment, version).await?;
        if !model.active {
            let message = format!("version {version} is not active");
            return Err(Problem::new(ErrorKind::Conflict, "MODEL_NOT_ACTIVE", message));
        }
        self.store.deactivate_model(environment.id, version).await.map_err(logged)?;
        drop(switch);
        let same_pair = |one: &Model| one.active && one.ego == model.ego && one.other == model.other;
        Ok(self.list(environment).await?.into_iter().find(same_pair))
    }

    /// Removes a version that is not active.
    pub async fn delete(&self, environment: &Environment, version: u64) -> Result<(), Problem> {
        let _switch = self.switch(environment).await;
        if self.get(environment, version).await?.active {
            let message =
                format!("version {version} is active: activate another, or take it back, before you delete it");
            return Err(Problem::new(ErrorKind::Conflict, "MODEL_ACTIVE", message));
        }
        self.store.delete_model(environment.id, version).await.map_err(logged)?;
        self.ready().pop(&(environment.id, version));
        Ok(())
    }

    /// Returns a version as a file.
    pub async fn export(&self, environment: &Environment, version: u64) -> Result<Vec<u8>, Problem> {
        let found = self.store.model(environment.id, version).await.map_err(logged)?;
        found.map(|(_, weights)| weights).ok_or_else(|| StoreError::UnknownModel(version).into())
    }

    /// Returns a version ready to answer.
    pub async fn network(&self, environment: &Environment, version: u64) -> Result<Arc<Network>, Problem> {
        let remembered =
            self.active.load().values().flatten().find(|network| network.is_of(environment.id, version)).cloned();
        if let Some(network) = remembered {
            return Ok(network);
        }
        let _turn = self.turn.lock().await;
        self.load(environment, version).await
    }

    /// Returns the network that answers for a pair.
    pub async fn active(&self, environment: &Environment, pair: &Pair) -> Result<Option<Arc<Network>>, Problem> {
        let place = (environment.id, pair.ego, pair.other);
        if let Some(known) = self.active.load().get(&place) {
            return Ok(known.clone());
        }
        let _turn = self.turn.lock().await;
        if let Some(known) = self.active.load().get(&place) {
            return Ok(known.clone());
        }
        let records = self.store.models(environment.id).await.map_err(logged)?;
        let record = records.into_iter().find(|one| one.active && (one.ego, one.other) == (pair.ego, pair.other));
        let network = match record {
            // One that cannot be read is told in the log; the counts answer without it.
            Some(record) => self.load(environment, record.version).await.ok(),
            None => None,
        };
        self.remember(place, network.clone());
        Ok(network)
    }

    /// Returns a version that is ready, or makes it so. Only called by who has the turn: else one that is deleted meanwhile would stay.
    async fn load(&self, environment: &Environment, version: u64) -> Result<Arc<Network>, Problem> {
        let key = (environment.id, version);
        if let Some(network) = self.ready().get(&key) {
            return Ok(network.clone());
        }
        let found = self.store.model(environment.id, version).await.map_err(logged)?;
        let (record, weights) = found.ok_or(StoreError::UnknownModel(version))?;
        let mut content =
            file::read(environment, &weights).inspect_err(|error| unreadable(environment, version, error))?;
        let card = serde_json::from_str(&record.card).map_err(|error| {
            unreadable(environment, version, &error);
            Problem::new(ErrorKind::Internal, "INTERNAL", format!("version {version} cannot be read"))
        })?;
        if content.seen.is_none() {
            content.seen = Some(self.counted(environment).await?);
        }
        let network = Arc::new(Network::new(environment.id, version, content, &card));
        self.ready().put(key, network.clone());
        Ok(network)
    }

    /// Returns the bins of the states that are counted now: what a version of an earlier build, which does not say what it was trained on, is believed in.
    /// Of very many states the later ones count as not seen, which costs verdicts and no more.
    async fn counted(&self, environment: &Environment) -> Result<Seen, Problem> {
        /// Pages that are read: a million states, in some seconds, once for each such version.
        const MOST_PAGES: usize = 1_000;
        let mut seeing = Seeing::new(&environment.schema);
        let mut pages = Pages::new(&*self.store, environment.id);
        for _ in 0..MOST_PAGES {
            let Some(page) = pages.next().await.map_err(logged)? else { break };
            page.iter().for_each(|scanned| seeing.add(&scanned.key));
        }
        Ok(seeing.seen())
    }

    fn ready(&self) -> std::sync::MutexGuard<'_, LruCache<(EnvironmentId, u64), Arc<Network>>> {
        self.ready.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Takes the turn to change what is active in an environment.
    async fn switch(&self, environment: &Environment) -> Switch<'_> {
        Switch { _turn: self.turn.lock().await, registry: self, environment: environment.id }
    }

    /// Only called by who has the turn, as is `forget`.
    fn remember(&self, place: Place, network: Option<Arc<Network>>) {
        let mut active = Active::clone(&self.active.load());
        // Environments that are gone do not come back: their numbers are never used again.
        let known = self.store.environments();
        active.retain(|(id, ..), _| known.iter().any(|environment| environment.id == *id));
        active.insert(place, network);
        self.active.store(Arc::new(active));
    }

    fn forget(&self, environment: EnvironmentId) {
        let mut active = Active::clone(&self.active.load());
        active.retain(|(id, ..), _| *id != environment);
        self.active.store(Arc::new(active));
    }
}

/// The turn to change what is active. However it ends, also when its caller is gone before the store has answered, what was remembered is forgotten.
struct Switch<'a> {
    _turn: tokio::sync::MutexGuard<'a, ()>,
    registry: &'a Registry,
    environment: EnvironmentId,
}

impl Drop for Switch<'_> {
    fn drop(&mut self) {
        self.registry.forget(self.environment);
    }
}

fn model(environment: &Environment, record: ModelRecord) -> Option<Model> {
    let card: Card =
        serde_json::from_str(&record.card).inspect_err(|error| unreadable(environment, record.version, error)).ok()?;
    let agent = |at: usize| environment.schema.agents().get(at).map(|agent| agent.name.to_string());
    let stale = !is_same_threshold(card.threshold, environment.rule.threshold_nats());
    Some(Model {
        version: record.version,
        ego: agent(record.ego)?,
        other: agent(record.other)?,
        active: record.active,
        stale,
        card,
    })
}

fn unreadable(environment: &Environment, version: u64, error: &dyn std::fmt::Display) {
    tracing::warn!(%error, environment = %environment.name, version, "a network cannot be read");
}

/// Notes an error of the store, and tells it in words about networks.
pub fn logged(error: StoreError) -> Problem {
    match error {
        StoreError::UnknownModel(_) | StoreError::UnknownEnvironment => error.into(),
        StoreError::Aborted(_) | StoreError::OutcomeUnknown(_) => {
            tracing::error!(%error, "the registry of networks could not be changed");
            let message = "the database did not confirm the change: list the networks before you try again";
            Problem::new(ErrorKind::Unavailable, "STORE_UNAVAILABLE", message)
        }
        _ => {
            tracing::error!(%error, "the registry of networks could not be read");
            error.into()
        }
    }
}
