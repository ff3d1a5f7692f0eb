//! The priors that evidence stands on: fitted to all states of an environment, one for each pair of
//! agents, in the background and on request.
//!
//! A fit is made of the counts as they are when it begins, and answers name it. It is not made anew
//! with each commit: by then a tenth more must have been counted, and somebody must have asked for
//! it within the last hour.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use lru::LruCache;

use tokio_util::sync::CancellationToken;

use crate::domain::{Environment, EnvironmentId, FitId, Pair, Schema, StateKey, Within};
use crate::error::{ErrorKind, Problem};
use crate::evidence::{self, Beliefs, Ego, Fit, Fitter, Habits, Prior, Uses};
use crate::information::{Alphabet, Table};
use crate::store::form::Unreadable;
use crate::store::{FitRecord, Scanned, Store, StoreError};
use crate::work::{Gate, Progress, Stopped};

mod asked;
mod evidence_cache;
mod sample;
mod scan;
mod stored_forms;
mod tables;

pub use scan::Pages;
pub use tables::{Observations, Tables};

pub use evidence_cache::{EvidenceInputs, StateEvidence};

use asked::Asked;
use evidence_cache::EvidenceCache;
pub use sample::Sample;

/// Fits kept in memory.
const KEPT: std::num::NonZeroUsize = std::num::NonZeroUsize::new(256).expect("not zero");

/// How much must have been counted since the last fit, as a share of what it was made from.
const GROWTH: f64 = 0.1;

/// The rest after a fit, as a multiple of the time it took: fitting takes a twentieth of one core
/// at most.
const REST: u32 = 20;

/// A fit with what is computed from it.
pub struct Fitted {
    /// Its version and revision.
    pub id: FitId,
    /// The last version that was given to the pair, also to a fit that cannot be read any more:
    /// answers have named it, so it is not used again.
    last_version: u64,
    /// When it was made; `None` where that was before the start.
    made: Option<Instant>,
    /// The fit itself.
    pub fit: Fit,
    /// What answers are computed with.
    pub prior: Prior,
    /// What was found about single states.
    pub evidence_cache: EvidenceCache,
    /// The last threshold asked for, and what is believed of it without counts: nearly all
    /// questions have the same.
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

    /// Returns the prior for figures that look at every pair of actions many times; `None` where
    /// there are too many pairs for them.
    pub fn in_detail(&self) -> Option<&Prior> {
        let Alphabet { rows, columns } = self.fit.alphabet;
        (rows * columns <= evidence::MOST_CELLS).then_some(&self.prior)
    }
}

/// Returns where the ego of a pair stands in the tables of its observations.
pub fn ego(pair: &Pair) -> Ego {
    if pair.ego < pair.other {
        Ego::Rows
    } else {
        Ego::Columns
    }
}

type Key = (EnvironmentId, Pair);

/// The fits of every environment. Cloning is cheap.
#[derive(Clone)]
pub struct PriorRegistry {
    store: Arc<dyn Store>,
    kept: Arc<Mutex<LruCache<Key, Arc<Fitted>>>>,
    asked: Arc<Asked>,
    making: Arc<tokio::sync::Mutex<()>>,
    gate: Gate,
}

impl PriorRegistry {
    /// Keeps the fits of a store, made on a thread of their own.
    pub fn new(store: Arc<dyn Store>) -> Self {
        Self::made_in(
            Gate::new("fit", 1, Gate::ENDLESS, CancellationToken::new()),
            store,
        )
    }

    /// Keeps the fits of a store, made behind a gate.
    pub fn made_in(gate: Gate, store: Arc<dyn Store>) -> Self {
        let kept = Arc::new(Mutex::new(LruCache::new(KEPT)));
        Self {
            store,
            kept,
            asked: Arc::default(),
            making: Arc::default(),
            gate,
        }
    }

    /// Returns the last fit of a pair, or the prior that nothing was fitted to; `None` where the
    /// alphabets are too large for evidence.
    pub async fn get(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Fitted>>, StoreError> {
        let pair = pair.undirected();
        let Some(alphabet) = alphabet(&environment.schema, &pair) else {
            return Ok(None);
        };
        let key = (environment.id, pair);
        if let Some(fitted) = self.lock().get(&key) {
            return Ok(Some(fitted.clone()));
        }
        let records = self.store.fits(environment.id).await?;
        let record = records
            .into_iter()
            .find(|record| record.pair == stored_forms::write_pair(&key.1));
        let last_version = record.as_ref().map_or(0, |record| record.id.version);

        // One that cannot be read was told at the start, and is made again. Until then answers say
        // that nothing was fitted.
        let stored = record.and_then(|record| {
            Some((
                record.id,
                stored_forms::read_fit(&record.body, alphabet).ok()?,
            ))
        });
        let (id, fit) = stored.unwrap_or_else(|| (FitId::default(), Fit::cold(alphabet)));
        Ok(Some(self.keep(key, id, last_version, None, fit)))
    }

    /// Returns the last fit of a pair with the habits of the environment by now; `None` where the
    /// alphabets are too large for evidence. Whoever asks has it kept up for an hour.
    pub async fn informed(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Informed>, StoreError> {
        self.asked
            .note((environment.id, pair.undirected()), Instant::now());
        let Some(fitted) = self.get(environment, pair).await? else {
            return Ok(None);
        };
        let totals = self.store.actions(environment).await?;
        let Pair { ego, other, .. } = pair.undirected();
        let habits = Arc::new(Habits::new(&totals.draws(ego), &totals.draws(other)));
        Ok(Some(Informed {
            fitted,
            habits,
            revision: totals.revision,
        }))
    }

    /// Fits a pair to the counts as they are now; `None` where the alphabets are too large for
    /// evidence. Whoever asks has it kept up for an hour.
    pub async fn fit(
        &self,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Fitted>>, Problem> {
        self.fit_telling(&Progress::default(), environment, pair)
            .await
    }

    /// Fits a pair and tells how far it is.
    pub async fn fit_telling(
        &self,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Fitted>>, Problem> {
        self.asked
            .note((environment.id, pair.undirected()), Instant::now());
        self.make(progress, environment, pair).await
    }

    async fn make(
        &self,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<Arc<Fitted>>, Problem> {
        let pair = pair.undirected();
        let Some(alphabet) = alphabet(&environment.schema, &pair) else {
            return Ok(None);
        };
        let _turn = self.making.lock().await;
        let last = self
            .get(environment, &pair)
            .await
            .map_err(logged)?
            .map_or(0, |fitted| fitted.last_version);
        if last >= i64::MAX.unsigned_abs() {
            return Err(logged(StoreError::VersionsUsedUp("fit")));
        }
        let (version, totals) = (
            last + 1,
            self.store.totals(environment.id).await.map_err(logged)?,
        );
        progress.begin("states read", totals.states);
        let (uses, states) = self.states(progress, environment, &pair, alphabet).await?;

        progress.begin("states looked at, and then fitted", states.len() as u64);
        let telling = progress.clone();
        let fitting = self.gate.run(move |stop| {
            let mut fitter = Fitter::new(alphabet, &uses);
            for (_, observations) in &states {
                stop.check()?;
                fitter.add(observations.counted());
                telling.add(1);
            }
            fitter.fit_while(&|| stop.goes_on()).ok_or(Stopped)
        });
        let fit = fitting.await?;
        let id = FitId {
            version,
            revision: totals.transitions,
        };
        let record = FitRecord {
            pair: stored_forms::write_pair(&pair),
            id,
            body: stored_forms::write_fit(&fit),
        };
        self.store
            .keep_fit(environment.id, &record)
            .await
            .map_err(logged)?;
        tracing::debug!(environment = %environment.name, pair = record.pair, version, states = fit.states, "fitted");
        Ok(Some(self.keep(
            (environment.id, pair),
            id,
            version,
            Some(Instant::now()),
            fit,
        )))
    }

    /// Returns the oldest fit of an environment that was asked for within the hour before `now`:
    /// the revision that it stands on, and when it was made if that was since the start. `None`
    /// where nothing was fitted yet.
    pub fn oldest(
        &self,
        environment: EnvironmentId,
        now: Instant,
    ) -> Option<(u64, Option<Instant>)> {
        let pairs = self.asked.lately(environment, now);
        let kept = self.lock();
        let fitted = pairs
            .into_iter()
            .filter_map(|pair| kept.peek(&(environment, pair)));
        let oldest = fitted
            .filter(|fitted| fitted.id.version > 0)
            .min_by_key(|fitted| fitted.id.revision)?;
        Some((oldest.id.revision, oldest.made))
    }

    /// Says in the log which fits cannot be read, and why. [`PriorRegistry::keep_up`] and
    /// [`PriorRegistry::fit`] make others.
    pub async fn tell_unreadable(&self) {
        for environment in self.store.environments() {
            match self.store.fits(environment.id).await {
                Ok(records) => records.iter().for_each(|record| tell(&environment, record)),
                // Somebody may have removed it meanwhile.
                Err(StoreError::UnknownEnvironment) => {}
                Err(error) => {
                    tracing::warn!(%error, environment = %environment.name, "the fits could not be read")
                }
            }
        }
    }

    /// Returns every fit that this build cannot read. What the store cannot read is left out.
    pub async fn unreadable(&self) -> Vec<UnreadableFit> {
        let mut found = Vec::new();
        for environment in self.store.environments() {
            let records = self.store.fits(environment.id).await.unwrap_or_default();
            let unread = |record: FitRecord| {
                let why = unreadable(&environment.schema, &record)?;
                Some(UnreadableFit {
                    environment: environment.name.to_string(),
                    pair: record.pair,
                    why,
                })
            };
            found.extend(records.into_iter().filter_map(unread));
        }
        found
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
                    Ok(false) => {}
                    // Somebody may have removed it meanwhile.
                    Err(problem) if problem.kind == ErrorKind::NotFound => {}
                    Err(problem) => {
                        tracing::warn!(%problem, environment = %environment.name, "a prior was not fitted")
                    }
                }
            }
        }
    }

    async fn fit_if_due(&self, environment: &Environment, pair: &Pair) -> Result<bool, Problem> {
        let Some(fitted) = self.get(environment, pair).await? else {
            return Ok(false);
        };
        let counted = self.store.totals(environment.id).await?.transitions;
        let due = fitted.id.revision as f64 * (1.0 + GROWTH);
        if counted == fitted.id.revision || (counted as f64) < due {
            return Ok(false);
        }
        Ok(self
            .make(&Progress::default(), environment, pair)
            .await?
            .is_some())
    }

    /// Returns how all states use the actions of both agents, and the observations of the states that can
    /// tell dependence from independence, in order of key.
    async fn states(
        &self,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
        alphabet: Alphabet,
    ) -> Result<(Uses, Vec<(StateKey, Observations<'static>)>), Problem> {
        let mut read = Read {
            schema: environment.schema.clone(),
            pair: pair.clone(),
            uses: Uses::new(alphabet),
            sample: Sample::default(),
        };
        let mut pages = Pages::new(&*self.store, environment.id);
        while let Some(page) = pages.next().await.map_err(logged)? {
            let states = page.len() as u64;
            read = self
                .gate
                .run(move |stop| {
                    for scanned in page {
                        stop.check()?;
                        read.add(scanned);
                    }
                    Ok(read)
                })
                .await?;
            progress.add(states);
        }
        Ok((read.uses, read.sample.sorted()))
    }

    fn keep(
        &self,
        key: Key,
        id: FitId,
        last_version: u64,
        made: Option<Instant>,
        fit: Fit,
    ) -> Arc<Fitted> {
        let (prior, evidence_cache, unseen) =
            (Prior::new(&fit), EvidenceCache::default(), Mutex::default());
        let fitted = Arc::new(Fitted {
            id,
            last_version,
            made,
            prior,
            fit,
            evidence_cache,
            unseen,
        });
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

/// What a fit is made from, as far as it is read.
struct Read {
    schema: Schema,
    pair: Pair,
    uses: Uses,
    sample: Sample<Observations<'static>>,
}

impl Read {
    fn add(&mut self, scanned: Scanned) {
        let cells = scanned.counts.cells().iter();
        let tables = Tables::new(&self.schema, &self.pair, cells.clone());
        let observations = tables.observations(&self.schema, &self.pair, Within::Auto, cells);
        self.uses.add(observations.counted());
        if !observations.strata.iter().all(Table::is_line) {
            let tables = observations.tables();
            self.sample
                .add(scanned.key, observations.into_owned(), tables);
        }
    }
}

fn logged(error: StoreError) -> Problem {
    tracing::error!(%error, "a prior could not be fitted");
    error.into()
}

/// A fit that cannot be read.
pub struct UnreadableFit {
    /// The environment's name.
    pub environment: String,
    /// The pair, as it is stored.
    pub pair: String,
    /// Why.
    pub why: Unreadable,
}

impl UnreadableFit {
    /// Returns whether nothing is wrong with it but its age: another is made from the same counts.
    pub fn is_older(&self) -> bool {
        matches!(self.why, Unreadable::Older(_))
    }
}

/// Says in the log why a fit cannot be read, if it cannot.
fn tell(environment: &Environment, record: &FitRecord) {
    let Some(why) = unreadable(&environment.schema, record) else {
        return;
    };
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
    let known = |pair: &Pair| {
        [pair.ego, pair.other]
            .iter()
            .chain(&pair.given)
            .all(|agent| agents.contains(agent))
    };
    match stored_forms::read_pair(&record.pair)
        .filter(known)
        .and_then(|pair| alphabet(schema, &pair))
    {
        Some(alphabet) => stored_forms::read_fit(&record.body, alphabet).err(),
        None => Some(Unreadable::spoiled("nothing is fitted to this pair")),
    }
}

/// Returns how many actions the two have; `None` where that is too many for evidence.
fn alphabet(schema: &Schema, pair: &Pair) -> Option<Alphabet> {
    let alphabet = pair.alphabet(schema);
    (alphabet.rows.max(alphabet.columns) <= evidence::MOST_LETTERS).then_some(alphabet)
}
