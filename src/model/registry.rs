//! The model registry: which versions there are, and which is active for each pair. Kept by the
//! store, cached ready to answer.
//!
//! A version that this build cannot read stays listed, with the reason. That it cannot be read is
//! remembered, for a version never changes; that the store could not be read is not, for that
//! passes.
//!
//! Who asks for the active network reads a map that is replaced as a whole, so a switch disturbs
//! nobody: each request has either the one or the other. Loading and switching take turns, so that
//! what is remembered is never older than what the store says.

use std::sync::Arc;

use arc_swap::ArcSwap;
use foldhash::HashMap;
use lru::LruCache;
use tokio::sync::Mutex;

use super::network::Network;
use super::seen::{Seeing, Seen};
use super::store_errors::logged;
use super::{file, stored_forms};
use crate::api::{self, Page, proto};
use crate::domain::{Card, Environment, EnvironmentId, Model, Pair, is_same_threshold};
use crate::error::{ErrorKind, Problem};
use crate::priors::Pages;
use crate::store::{ModelRecord, NewModel, Store, StoreError};

/// The reason word of a version that cannot answer by the rule.
pub const STALE: &str = "MODEL_STALE";

/// The reason word of a version that this build cannot read.
const UNREADABLE: &str = "MODEL_UNREADABLE";

/// The reason word of a version that there is not.
const UNKNOWN: &str = "MODEL_NOT_FOUND";

/// Why a version cannot be read whose weights are gone.
const WITHOUT_WEIGHTS: &str = "its weights: they are missing";

/// Why a version cannot be read that is damaged.
const SPOILED: &str = "it is not as it was written: its checksum is another";

/// A pair of agents of an environment: the ego, the other, and where it is observed later the
/// outcome that its action is.
type Place = (EnvironmentId, usize, usize, Option<usize>);

/// A version ready to answer, or why this build cannot read it.
type Loaded = Result<Arc<Network>, String>;

/// The versions that answer; `None` where it is known that there is none.
type Active = HashMap<Place, Option<(u64, Loaded)>>;

/// Versions that are kept ready without being active.
const READY: std::num::NonZeroUsize = std::num::NonZeroUsize::new(8).expect("not zero");

/// Versions that were asked for, ready to answer.
type Ready = std::sync::Mutex<LruCache<(EnvironmentId, u64), Arc<Network>>>;

/// Versions that were looked at: why each cannot be read, if it cannot.
type LookedAt = std::sync::Mutex<HashMap<(EnvironmentId, u64), Option<String>>>;

/// The versions of every environment. Cloning is cheap.
#[derive(Clone)]
pub struct Registry {
    store: Arc<dyn Store>,
    active: Arc<ArcSwap<Active>>,
    ready: Arc<Ready>,
    looked_at: Arc<LookedAt>,
    turn: Arc<Mutex<()>>,
}

impl Registry {
    /// Makes a handle on the versions of a store.
    pub fn new(store: Arc<dyn Store>) -> Self {
        let ready = Arc::new(Ready::new(LruCache::new(READY)));
        Self {
            store,
            active: Arc::default(),
            ready,
            looked_at: Arc::default(),
            turn: Arc::default(),
        }
    }

    /// Returns every version, in order. One that cannot be read says why; the first time, so does
    /// the log.
    pub async fn list(&self, environment: &Environment) -> Result<Vec<Model>, Problem> {
        let records = self.store.models(environment.id).await.map_err(logged)?;
        let mut models = Vec::with_capacity(records.len());
        for record in records {
            let card = self.card(environment, &record).await?;
            models.push(model(environment, &record, card));
        }
        Ok(models)
    }

    /// Returns the versions above one, in order, as many as a page of that size may have and fit
    /// into a message; and whether there are more.
    pub async fn page(
        &self,
        environment: &Environment,
        after: u64,
        size: usize,
    ) -> Result<Page<Model>, Problem> {
        let mut records = self.store.models(environment.id).await.map_err(logged)?;
        records.retain(|record| record.version > after);
        // One more tells that there is another page. Those beyond need not be looked at.
        records.truncate(size + 1);

        let mut models = Vec::with_capacity(records.len());
        for record in records {
            let card = self.card(environment, &record).await?;
            models.push(model(environment, &record, card));
        }
        Ok(api::page(models, size, 0, |model| {
            proto::Model::from(model.clone())
        }))
    }

    /// Returns one version.
    pub async fn get(&self, environment: &Environment, version: u64) -> Result<Model, Problem> {
        let models = self.list(environment).await?;
        let found = models
            .iter()
            .find(|model| model.version == version)
            .cloned();
        found.ok_or_else(|| unknown(version, models.iter().map(|model| model.version)))
    }

    /// Returns one version as it is kept.
    async fn record(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<(ModelRecord, Vec<u8>), Problem> {
        if let Some(found) = self
            .store
            .model(environment.id, version)
            .await
            .map_err(logged)?
        {
            return Ok(found);
        }

        let known = self.store.models(environment.id).await.map_err(logged)?;
        Err(unknown(
            version,
            known.into_iter().map(|record| record.version),
        ))
    }

    /// Refuses where an environment has as many versions as it may have.
    pub async fn check_room(&self, environment: &Environment) -> Result<(), Problem> {
        let limit = self.store.quotas().models;
        let versions = self
            .store
            .models(environment.id)
            .await
            .map_err(logged)?
            .len();
        if (versions as u64) < limit {
            Ok(())
        } else {
            Err(StoreError::too_many_models(limit).into())
        }
    }

    /// Keeps a network with its card.
    pub async fn keep(
        &self,
        environment: &Environment,
        content: &file::Content,
        card: &Card,
    ) -> Result<u64, Problem> {
        let text = stored_forms::write_card(card);
        let weights = file::write_network(environment, content, &text);
        if weights.len() > file::MOST_BYTES {
            let message = format!(
                "the network takes {} bytes, more than {}; make it narrower",
                weights.len(),
                file::MOST_BYTES
            );
            return Err(Problem::new(
                ErrorKind::TooLarge,
                "NETWORK_TOO_LARGE",
                message,
            ));
        }

        // JSON has no word for infinity, and a file no weights beyond a limit: nothing is kept that
        // could not be read again.
        if let Err(why) = parse(environment, &content.pair, &text, &weights) {
            let message = format!("no network is made: {why}");
            return Err(Problem::new(
                ErrorKind::Conflict,
                "TRAINING_DIVERGED",
                message,
            ));
        }

        let model = NewModel {
            ego: content.pair.ego,
            other: stored_forms::write_other(&environment.schema, &content.pair),
            kind: content.kind.as_str().to_owned(),
            card: text,
            weights,
        };
        let version = self
            .store
            .keep_model(environment.id, &model)
            .await
            .map_err(logged)?;
        self.note(environment, version, None);
        Ok(version)
    }

    /// Makes a version the one that answers for its pair.
    pub async fn activate(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Model, Problem> {
        let model = self.get(environment, version).await?;
        let card = model
            .card
            .as_ref()
            .map_err(|why| unreadable(version, why))?;
        if model.stale {
            let pair = model
                .pair(&environment.schema)
                .expect("a version that can be read is of a pair");
            let rule = environment.rule_of(&pair).threshold_nats();
            let message = format!(
                "version {version} answers at a threshold of {} nats only, and the rule's is {rule}: train another",
                card.threshold
            );
            return Err(Problem::new(ErrorKind::Conflict, STALE, message));
        }

        {
            let _switch = self.switch(environment).await;
            self.store
                .activate_model(environment.id, version)
                .await
                .map_err(logged)?;
        }
        self.get(environment, version).await
    }

    /// Takes a version back, and returns the one that answers for its pair instead.
    pub async fn roll_back(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Option<Model>, Problem> {
        let switch = self.switch(environment).await;
        let model = self.get(environment, version).await?;
        if !model.active {
            let message = format!("version {version} is not active");
            return Err(Problem::new(
                ErrorKind::Conflict,
                "MODEL_NOT_ACTIVE",
                message,
            ));
        }

        self.store
            .deactivate_model(environment.id, version)
            .await
            .map_err(logged)?;
        drop(switch);

        let same_pair = |one: &Model| one.active && one.is_of_pair_of(&model);
        Ok(self.list(environment).await?.into_iter().find(same_pair))
    }

    /// Removes a version that is not active.
    pub async fn delete(&self, environment: &Environment, version: u64) -> Result<(), Problem> {
        let _switch = self.switch(environment).await;
        if self.get(environment, version).await?.active {
            let message = format!(
                "version {version} is active: activate another, or take it back, before you delete it"
            );
            return Err(Problem::new(ErrorKind::Conflict, "MODEL_ACTIVE", message));
        }

        self.store
            .delete_model(environment.id, version)
            .await
            .map_err(logged)?;

        self.ready().pop(&(environment.id, version));
        self.looked_at().remove(&(environment.id, version));
        Ok(())
    }

    /// Returns a version as a file.
    pub async fn export(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Vec<u8>, Problem> {
        let (record, weights) = self.record(environment, version).await?;
        if weights.is_empty() {
            return Err(unreadable(version, WITHOUT_WEIGHTS));
        }
        if !record.is_sound {
            return Err(unreadable(version, SPOILED));
        }
        Ok(weights)
    }

    /// Returns a version ready to answer.
    pub async fn network(
        &self,
        environment: &Environment,
        version: u64,
    ) -> Result<Arc<Network>, Problem> {
        let active = self.active.load();
        let mut ready = active
            .values()
            .flatten()
            .filter_map(|(_, loaded)| loaded.as_ref().ok());
        if let Some(network) = ready.find(|network| network.is_of(environment.id, version)) {
            return Ok(network.clone());
        }

        let _turn = self.turn.lock().await;
        self.load(environment, version)
            .await?
            .map_err(|why| unreadable(version, &why))
    }

    /// Returns the network that answers for a pair; none where the active version cannot be read,
    /// for then counts answer alone.
    pub async fn active(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Network>>, Problem> {
        Ok(self
            .standing(environment, pair)
            .await?
            .and_then(|(_, loaded)| loaded.ok()))
    }

    /// Returns the network that is active for a pair; an error where it cannot be read, for callers
    /// who want it and nothing else.
    pub async fn served(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Network>>, Problem> {
        let network =
            |(version, loaded): (u64, Loaded)| loaded.map_err(|why| unreadable(version, &why));
        self.standing(environment, pair)
            .await?
            .map(network)
            .transpose()
    }

    /// Returns the active version of a pair. Only what the store has said is remembered: if it
    /// could not be read, it is asked again next time.
    async fn standing(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<(u64, Loaded)>, Problem> {
        let place = (environment.id, pair.ego, pair.other, pair.later);
        if let Some(known) = self.active.load().get(&place) {
            return Ok(known.clone());
        }

        let _turn = self.turn.lock().await;
        // Whoever had the turn before may have asked for the same.
        if let Some(known) = self.active.load().get(&place) {
            return Ok(known.clone());
        }

        let records = self.store.models(environment.id).await.map_err(logged)?;
        let stored = (
            pair.ego,
            stored_forms::write_other(&environment.schema, pair),
        );
        let record = records
            .into_iter()
            .find(|one| one.active && (one.ego, one.other) == stored);
        let standing = match record {
            Some(record) => Some((
                record.version,
                self.load(environment, record.version).await?,
            )),
            None => None,
        };

        self.remember(place, standing.clone());
        Ok(standing)
    }

    /// Returns a version that is ready, or makes it so. Only called by who has the turn: else one
    /// that is deleted meanwhile would stay.
    async fn load(&self, environment: &Environment, version: u64) -> Result<Loaded, Problem> {
        let key = (environment.id, version);
        if let Some(network) = self.ready().get(&key) {
            return Ok(Ok(network.clone()));
        }
        let (record, weights) = self.record(environment, version).await?;

        let parsed = parse_record(environment, &record, &weights);
        self.note(environment, version, parsed.as_ref().err().cloned());

        let (mut content, card) = match parsed {
            Ok(read) => read,
            Err(why) => return Ok(Err(why)),
        };
        if content.seen.is_none() {
            content.seen = Some(self.counted(environment).await?);
        }

        let network = Arc::new(Network::new(environment, version, content, &card));
        self.ready().put(key, network.clone());
        Ok(Ok(network))
    }

    /// Returns the card of a version, or why the version cannot be read: its card, or its weights,
    /// which are looked at once.
    async fn card(
        &self,
        environment: &Environment,
        record: &ModelRecord,
    ) -> Result<Result<Card, String>, Problem> {
        let key = (environment.id, record.version);
        let noted = self.looked_at().get(&key).cloned();
        if let Some(why) = noted {
            return Ok(why.map_or_else(|| card(environment, record), Err));
        }

        let found = self
            .store
            .model(environment.id, record.version)
            .await
            .map_err(logged)?;
        // One that is deleted meanwhile is listed as it was.
        let Some((record, weights)) = found else {
            return Ok(card(environment, record));
        };

        let parsed = parse_record(environment, &record, &weights).map(|(_, card)| card);
        self.note(environment, record.version, parsed.as_ref().err().cloned());
        Ok(parsed)
    }

    /// Notes that a version was looked at, and says in the log if it cannot be read.
    fn note(&self, environment: &Environment, version: u64, why: Option<String>) {
        let before = self
            .looked_at()
            .insert((environment.id, version), why.clone());
        if let (None, Some(why)) = (before, why) {
            tracing::warn!(environment = %environment.name, version, why, "a network cannot be read: it answers nothing");
        }
    }

    fn looked_at(
        &self,
    ) -> std::sync::MutexGuard<'_, HashMap<(EnvironmentId, u64), Option<String>>> {
        self.looked_at
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Returns the bins of the states that are counted now: what a version of an earlier build,
    /// which does not say what it was trained on, is believed in. Of very many states the later
    /// ones count as not seen, which costs verdicts and no more.
    pub async fn counted(&self, environment: &Environment) -> Result<Seen, Problem> {
        /// Pages that are read: a million states, in some seconds, once for each such version.
        const MOST_PAGES: usize = 1_000;

        let mut seeing = Seeing::new(&environment.schema);
        let mut pages = Pages::new(&*self.store, environment.id);
        for _ in 0..MOST_PAGES {
            let Some(page) = pages.next().await.map_err(logged)? else {
                break;
            };
            page.iter().for_each(|scanned| seeing.add(&scanned.key));
        }
        Ok(seeing.seen())
    }

    fn ready(&self) -> std::sync::MutexGuard<'_, LruCache<(EnvironmentId, u64), Arc<Network>>> {
        self.ready
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Takes the turn to change what is active in an environment.
    async fn switch(&self, environment: &Environment) -> Switch<'_> {
        Switch {
            _turn: self.turn.lock().await,
            registry: self,
            environment: environment.id,
        }
    }

    /// Only called by who has the turn, as is `forget`.
    fn remember(&self, place: Place, standing: Option<(u64, Loaded)>) {
        let mut active = Active::clone(&self.active.load());

        // Environments that are gone do not come back: their numbers are never used again.
        let known = self.store.environments();
        let is_known = |id: EnvironmentId| known.iter().any(|environment| environment.id == id);
        active.retain(|(id, ..), _| is_known(*id));
        self.looked_at().retain(|(id, _), _| is_known(*id));

        active.insert(place, standing);
        self.active.store(Arc::new(active));
    }

    fn forget(&self, environment: EnvironmentId) {
        let mut active = Active::clone(&self.active.load());
        active.retain(|(id, ..), _| *id != environment);
        self.active.store(Arc::new(active));
    }
}

/// The turn to change what is active. However it ends, also when its caller is gone before the
/// store has answered, what was remembered is forgotten.
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

/// Returns a version as it is listed.
fn model(environment: &Environment, record: &ModelRecord, card: Result<Card, String>) -> Model {
    let schema = &environment.schema;
    let agent = |at: usize| {
        let agent = schema.agents().get(at);
        agent.map_or(format!("#{at}"), |agent| agent.name.to_string())
    };
    let pair = stored_forms::read_pair(schema, record.ego, record.other);
    let (other, lag) = pair
        .as_ref()
        .map_or((record.other, 0), |pair| (pair.other, pair.lag(schema)));
    // Only asked of one that can be read: of any other the pair may be none of this environment.
    let is_stale = |card: &Card| {
        let rule = pair.as_ref().map(|pair| environment.rule_of(pair));
        rule.is_ok_and(|rule| !is_same_threshold(card.threshold, rule.threshold_nats()))
    };

    Model {
        version: record.version,
        ego: agent(record.ego),
        other: agent(other),
        lag,
        active: record.active,
        stale: card.as_ref().is_ok_and(is_stale),
        card,
    }
}

/// Reads a version as it is kept, or says which part cannot be read, and why.
fn parse_record(
    environment: &Environment,
    record: &ModelRecord,
    weights: &[u8],
) -> Result<(file::Content, Card), String> {
    check_sound(record)?;
    let pair = stored_forms::read_pair(&environment.schema, record.ego, record.other)?;
    parse(environment, &pair, &record.card, weights)
}

fn check_sound(record: &ModelRecord) -> Result<(), String> {
    match record.is_sound {
        true => Ok(()),
        false => Err(SPOILED.to_owned()),
    }
}

/// Reads a version by its parts.
fn parse(
    environment: &Environment,
    pair: &Pair,
    card: &str,
    weights: &[u8],
) -> Result<(file::Content, Card), String> {
    let card = read_card(environment, pair, card)?;
    if weights.is_empty() {
        return Err(WITHOUT_WEIGHTS.to_owned());
    }

    let content = file::read_network(environment, weights)
        .map_err(|problem| format!("its weights: {problem}"))?;
    if content.pair != *pair {
        let positions = |pair: &Pair| {
            let other = stored_forms::write_other(&environment.schema, pair);
            format!("{:?}", (pair.ego, other))
        };
        let [got, trained] = [pair, &content.pair].map(positions);
        return Err(format!(
            "its agents: got positions {got}, expected those of its weights, {trained}"
        ));
    }
    Ok((content, card))
}

/// Reads the card of a version whose weights were looked at before.
fn card(environment: &Environment, record: &ModelRecord) -> Result<Card, String> {
    check_sound(record)?;
    let pair = stored_forms::read_pair(&environment.schema, record.ego, record.other)?;
    read_card(environment, &pair, &record.card)
}

/// Reads a card, which has to be of its version's lag.
fn read_card(environment: &Environment, pair: &Pair, text: &str) -> Result<Card, String> {
    let card = stored_forms::read_card(text).map_err(|why| format!("its card: {why}"))?;
    stored_forms::check_lag(&card, &environment.schema, pair)
        .map_err(|why| format!("its card: {why}"))?;
    Ok(card)
}

/// Says which versions there are, of which the one that is asked for is none.
fn unknown(version: u64, known: impl Iterator<Item = u64>) -> Problem {
    /// More are told by the first and the last.
    const FEW: usize = 8;

    let known: Vec<u64> = known.collect();
    let known = match &known[..] {
        [] => "there is none".into(),
        [first, .., last] if known.len() > FEW => format!("its versions go from {first} to {last}"),
        few => format!(
            "known: {}",
            few.iter()
                .map(u64::to_string)
                .collect::<Vec<_>>()
                .join(", ")
        ),
    };

    Problem::new(
        ErrorKind::NotFound,
        UNKNOWN,
        format!("{}; {known}", StoreError::UnknownModel(version)),
    )
}

fn unreadable(version: u64, why: &str) -> Problem {
    let message = format!(
        "version {version} cannot be read: {why}; use the build that wrote it, or train another"
    );
    Problem::new(ErrorKind::Conflict, UNREADABLE, message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn which_versions_there_are_is_said() {
        let said = |known: std::ops::Range<u64>| unknown(99, known).message;
        assert_eq!(said(0..0), "unknown model version 99; there is none");
        assert_eq!(said(1..4), "unknown model version 99; known: 1, 2, 3");
        assert_eq!(
            said(3..40),
            "unknown model version 99; its versions go from 3 to 39"
        );
    }
}
