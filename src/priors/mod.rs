//! The priors that evidence stands on: fitted to all states of an environment, one for each pair of agents, in the background and on request.
//!
//! A fit is made of the counts as they are when it begins, and answers name it. It is not made anew with each commit: by then a tenth more must have
//! been counted, and somebody must have asked for it within the last hour.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;

use crate::domain::{Environment, EnvironmentId, FitId, Pair, Schema, StateKey, Within};
use crate::evidence::{self, Beliefs, Ego, Fit, Fitter, Habits, Prior, Uses};
use crate::information::{Alphabet, Table};
use crate::store::form::Unreadable;
use crate::store::{FitRecord, Store, StoreError};

mod asked;
mod known;
mod sample;
mod scan;
mod tables;
mod text;

pub use scan::Pages;
pub use tables::{Draws, Tables};

pub use known::{Found, Ground};

use asked::Asked;
use known::Known;
pub use sample::Sample;

/// Fits kept in memory.
const KEPT: std::num::NonZeroUsize = std::num::NonZeroUsize::new(256).expect("not zero");

/// How much must have been counted since the last fit, as a share of what it was made from.
const GROWTH: f64 = 0.1;

/// The rest after a fit, as a multiple of the time it took: fitting takes a twentieth of one core at most.
const REST: u32 = 20;

/// A fit with what is computed from it.
pub struct Fitted {
    /// Its version and revision.
    pub id: FitId,
    /// The last version that was given to the pair, also to a fit that cannot be read any more: answers have named it, so it is not used again.
    last_version: u64,
    /// The fit itself.
    pub fit: Fit,
    /// What answers are computed with.
    pub prior: Prior,
    /// What was found about single states.
    pub known: Known,
    /// The last threshold asked for, and what is believed of it without counts: nearly all questions have the same.
    unseen: Mutex<Option<(f64, Beliefs)>>,
}

/// A fitted prior with the habits of its environment by now: what evidence rests on.
#[derive(Clone)]
pub struct Informed {
    /// The fit.
    pub fitted: Arc<Fitted>,
    /// How the environment uses the actions of both agents.
    pub habits: Arc<Habits>,
    /// How many transitions the environment had when they were read.
    pub revision: u64,
}

impl std::ops::Deref for Informed {
    type Target = Fitted;

    fn deref(&self) -> &Fitted {
        &self.fitted
    }
}

impl Fitted {
    /// Returns what is believed of a state that was never seen, at a threshold in nats.
    pub fn unseen(&self, nats: f64) -> Beliefs {
        let mut last = self.unseen.lock().unwrap_or_else(PoisonError::into_inner);
        match *last {
            Some((threshold, beliefs)) if threshold == nats => beliefs,
            _ => last.insert((nats, self.prior.unseen().beliefs(nats))).1,
        }
    }

    /// Returns the prior for figures that look at every pair of actions many times; `None` where there are too many pairs for them.
    pub fn in_detail(&self) -> Option<&Prior> {
        let Alphabet { rows, columns } = self.fit.alphabet;
        (rows * columns <= evidence::MOST_CELLS).then_some(&self.prior)
    }
}

/// Returns where the ego of a pair stands in the tables of its draws.
pub fn ego(pair: &Pair) -> Ego {
    if pair.ego < pair.other { Ego::Rows } else { Ego::Columns }
}

type Key = (EnvironmentId, Pair);

/// The fits of every environment. Cloning is cheap.
#[derive(Clone)]
pub struct Fits {
    store: Arc<dyn Store>,
    kept: Arc<Mutex<LruCache<Key, Arc<Fitted>>>>,
    asked: Arc<Asked>,
    making: Arc<tokio::sync::Mutex<()>>,
}

impl Fits {
    /// Keeps the fits of a store.
    pub fn new(store: Arc<dyn Store>) -> Self {
        Self { store, kept: Arc::new(Mutex::new(LruCache::new(KEPT))), asked: Arc::default(), making: Arc::default() }
    }

    /// Returns the last fit of a pair, or the prior that nothing was fitted to; `None` where the alphabets are too large for evidence.
    pub async fn get(&self, environment: &Environment, pair: &Pair) -> Result<Option<Arc<Fitted>>, StoreError> {
        let pair = pair.undirected();
        let Some(alphabet) = alphabet(&environment.schema, &pair) else { return Ok(None) };
        let key = (environment.id, pair);
        if let Some(fitted) = self.lock().get(&key) {
            return Ok(Some(fitted.clone()));
        }
        let records = self.store.fits(environment.id).await?;
        let record = records.into_iter().find(|record| record.pair == text::of_pair(&key.1));
        let last_version = record.as_ref().map_or(0, |record| record.id.version);

        // One that cannot be read was told at the start, and is made again. Until then answers say that nothing was fitted.
        let stored = record.and_then(|record| Some((record.id, text::fit(&record.body, alphabet).ok()?)));
        let (id, fit) = stored.unwrap_or_else(|| (FitId::default(), Fit::cold(alphabet)));
        Ok(Some(self.keep(key, id, last_version, fit)))
    }

    /// Returns the last fit of a pair with the habits of the environment by now; `None` where the alphabets are too large for evidence. Whoever asks has it
    /// kept up for an hour.
    pub async fn informed(&self, environment: &Environment, pair: &Pair) -> Result<Option<Informed>, StoreError> {
        self.asked.note((environment.id, pair.undirected()), Instant::now());
        let Some(fitted) = self.get(environment, pair).await? else { return Ok(None) };
        let totals = self.store.actions(environment).await?;
        let Pair { ego, other, .. } = pair.undirected();
        let habits = Arc::new(Habits::new(&totals.draws(ego), &totals.draws(other)));
        Ok(Some(Informed { fitted, habits, revision: totals.revision }))
    }

    /// Fits a pair to the counts as they are now; `None` where the alphabets are too large for evidence. Whoever asks has it kept up for an hour.
    pub async fn fit(&self, environment: &Environment, pair: &Pair) -> Result<Option<Arc<Fitted>>, StoreError> {
        self.asked.note((environment.id, pair.undirected()), Instant::now());
        self.make(environment, pair).await
    }

    async fn make(&self, environment: &Environment, pair: &Pair) -> Result<Option<Arc<Fitted>>, StoreError> {
        let pair = pair.undirected();
        let Some(alphabet) = alphabet(&environment.schema, &pair) else { return Ok(None) };
        let _turn = self.making.lock().await;
        let last = self.get(environment, &pair).await?.map_or(0, |fitted| fitted.last_version);
        if last >= i64::MAX.unsigned_abs() {
            return Err(StoreError::VersionsUsedUp("fit"));
        }
        let version = last + 1;
        let revision = self.store.totals(environment.id).await?.transitions;
        let (uses, states) = self.states(environment, &pair, alphabet).await?;
        let fitting = move || {
            let mut fitter = Fitter::new(alphabet, &uses);
            states.iter().for_each(|(_, draws)| fitter.add(draws.counted()));
            fitter.fit()
        };
        let fit = tokio::task::spawn_blocking(fitting).await;
        let fit = fit.map_err(|error| StoreError::Unreadable(error.to_string()))?;
        let id = FitId { version, revision };
        let record = FitRecord { pair: text::of_pair(&pair), id, body: text::of_fit(&fit) };
        self.store.keep_fit(environment.id, &record).await?;
        tracing::debug!(environment = %environment.name, pair = record.pair, version, states = fit.states, "fitted");
        Ok(Some(self.keep((environment.id, pair), id, version, fit)))
    }

    /// Says in the log which fits cannot be read, and why. [`Fits::keep_up`] and [`Fits::fit`] make others.
    pub async fn tell_unreadable(&self) {
        for environment in self.store.environments() {
            match self.store.fits(environment.id).await {
                Ok(records) => records.iter().for_each(|record| tell(&environment, record)),
                // Somebody may have removed it meanwhile.
                Err(StoreError::UnknownEnvironment) => {}
                Err(error) => tracing::warn!(%error, environment = %environment.name, "the fits could not be read"),
            }
        }
    }

    /// Fits what has grown enough, for ever: what was asked for within the last hour.
    pub async fn keep_up(self, every: Duration) {
        loop {
            tokio::time::sleep(every).await;
            self.keep_up_once(Instant::now()).await;
        }
    }

    /// Fits what has grown enough and was asked for within the hour before `now`.
    pub async fn keep_up_once(&self, now: Instant) {
        for environment in self.store.environments() {
            for pair in self.asked.lately(environment.id, now) {
                let started = Instant::now();
                match self.fit_if_due(&environment, &pair).await {
                    Ok(true) => tokio::time::sleep(started.elapsed() * REST).await,
                    // Somebody may have removed it meanwhile.
                    Ok(false) | Err(StoreError::UnknownEnvironment) => {}
                    Err(error) => tracing::warn!(%error, environment = %environment.name, "a prior was not fitted"),
                }
            }
        }
    }

    async fn fit_if_due(&self, environment: &Environment, pair: &Pair) -> Result<bool, StoreError> {
        let Some(fitted) = self.get(environment, pair).await? else { return Ok(false) };
        let counted = self.store.totals(environment.id).await?.transitions;
        let due = fitted.id.revision as f64 * (1.0 + GROWTH);
        if counted == fitted.id.revision || (counted as f64) < due {
            return Ok(false);
        }
        Ok(self.make(environment, pair).await?.is_some())
    }

    /// Returns how all states use the actions of both agents, and the draws of the states that can tell dependence from independence, in order of key.
    async fn states(
        &self,
        environment: &Environment,
        pair: &Pair,
        alphabet: Alphabet,
    ) -> Result<(Uses, Vec<(StateKey, Draws<'static>)>), StoreError> {
        let mut uses = Uses::new(alphabet);
        let mut sample = Sample::default();
        let mut pages = Pages::new(&*self.store, environment.id);
        while let Some(page) = pages.next().await? {
            for scanned in page {
                let cells = scanned.counts.cells().iter();
                let tables = Tables::new(&environment.schema, pair, cells.clone());
                let draws = tables.evidence(&environment.schema, pair, Within::Auto, cells);
                uses.add(draws.counted());
                if !draws.slices.iter().all(Table::is_line) {
                    let tables = draws.tables();
                    sample.add(scanned.key, draws.into_owned(), tables);
                }
            }
        }
        Ok((uses, sample.sorted()))
    }

    fn keep(&self, key: Key, id: FitId, last_version: u64, fit: Fit) -> Arc<Fitted> {
        let (prior, known, unseen) = (Prior::new(&fit), Known::default(), Mutex::default());
        let fitted = Arc::new(Fitted { id, last_version, prior, fit, known, unseen });
        let mut kept = self.lock();
        match kept.get(&key) {
            // Read from the store by one while another made the next.
            Some(newer) if newer.last_version > last_version => newer.clone(),
            _ => {
                kept.put(key, fitted.clone());
                fitted
            }
        }
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, LruCache<Key, Arc<Fitted>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Says in the log why a fit cannot be read, if it cannot.
fn tell(environment: &Environment, record: &FitRecord) {
    let Some(why) = unreadable(&environment.schema, record) else { return };
    let (environment, pair, version) = (&environment.name, &record.pair, record.id.version);
    match why {
        // Nothing is wrong: another can be made from the same counts.
        Unreadable::Older(_) => {
            tracing::info!(%environment, pair, version, %why, "a fit is not used: version 0 answers until another is made, by --fit-every or POST .../fit")
        }
        _ => {
            tracing::warn!(%environment, pair, version, %why, "a fit cannot be read: version 0 answers until another is made, by --fit-every or POST .../fit")
        }
    }
}

/// Returns why a fit cannot be read, if it cannot.
fn unreadable(schema: &Schema, record: &FitRecord) -> Option<Unreadable> {
    let agents = 0..schema.agents().len();
    let known = |pair: &Pair| [pair.ego, pair.other].iter().chain(&pair.given).all(|agent| agents.contains(agent));
    match text::pair(&record.pair).filter(known).and_then(|pair| alphabet(schema, &pair)) {
        Some(alphabet) => text::fit(&record.body, alphabet).err(),
        None => Some(Unreadable::spoiled("nothing is fitted to this pair")),
    }
}

/// Returns how many actions the two have; `None` where that is too many for evidence.
fn alphabet(schema: &Schema, pair: &Pair) -> Option<Alphabet> {
    let alphabet = pair.alphabet(schema);
    (alphabet.rows.max(alphabet.columns) <= evidence::MOST_LETTERS).then_some(alphabet)
}
