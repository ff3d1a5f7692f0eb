//! One pass over every state of an environment for one pair: where influence is highest, and what all states say together.
//!
//! A survey of a small environment is made anew whenever something was counted since, so it sees every acknowledged transition. A large one is
//! served as it is while the next is made in the background, and says of which revision it is.

use std::collections::HashSet;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use lru::LruCache;
use rayon::prelude::*;

use super::discoveries::{self, Found};
use super::judge::Judge;
use super::order::Order;
use crate::domain::{
    Basis, Discovery, DiscoveryMethod, Environment, EnvironmentId, Evidence, FitId, Pair, Rule, RuleKind, Scope,
    SegmentId, StateKey, Verdict, View, Within,
};
use crate::model::{Network, Prediction};
use crate::priors::{Informed, Pages};
use crate::store::{Scanned, Store, StoreError};

/// Cells up to which a survey is made while the caller waits.
const SMALL: u64 = 100_000;

/// Surveys kept.
const KEPT: std::num::NonZeroUsize = std::num::NonZeroUsize::new(16).expect("not zero");

/// What one state measures, in nats.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The state.
    pub key: StateKey,
    /// How often it was seen, at least once.
    pub visits: u64,
    /// Plug-in mutual information.
    pub plug_in: f64,
    /// Its mean under independence.
    pub expected: f64,
    /// What the counts say by the fitted prior.
    pub evidence: Option<Evidence>,
    /// The verdict.
    pub verdict: Verdict,
    /// What it rests on.
    pub basis: Basis,
}

/// The rows of one environment, pair, choice of segments and rule, within segments or not.
pub struct Survey {
    /// Every state seen, in order of key.
    pub rows: Vec<Row>,
    /// How many segments have visits in them, of those asked for.
    pub segments: u64,
    /// How many transitions the environment had when the pass began.
    pub as_of: u64,
    /// The fit that the evidence rests on.
    pub fit: FitId,
    /// The version of the network that was asked where the counts did not decide.
    pub network: Option<u64>,
    /// The share of dependent states by that fit.
    pub dependent_share: Option<f64>,
    orders: [OnceLock<Vec<u32>>; 8],
    found: tokio::sync::Mutex<LruCache<(u64, DiscoveryMethod), Arc<Found>>>,
}

impl Survey {
    /// Returns the discoveries among the rows, found at their first use.
    pub async fn discoveries(
        &self,
        store: &dyn Store,
        plan: &Plan,
        discovery: Discovery,
    ) -> Result<Arc<Found>, StoreError> {
        let mut kept = self.found.lock().await;
        let key = (discovery.fdr.to_bits(), discovery.method);
        if let Some(found) = kept.get(&key) {
            return Ok(found.clone());
        }
        let found = Arc::new(discoveries::find(store, plan, self, discovery).await?);
        kept.put(key, found.clone());
        Ok(found)
    }

    /// Returns the positions of all rows in an order, sorted at its first use.
    pub fn ordered(&self, order: Order) -> &[u32] {
        let slot = order.by as usize * 2 + usize::from(order.descending);
        self.orders[slot].get_or_init(|| {
            let mut positions: Vec<u32> = (0..self.rows.len() as u32).collect();
            // Rows are in order of key and the sort is stable, so equal ranks stay in order of key.
            positions.sort_by_key(|position| order.rank(&self.rows[*position as usize]));
            positions
        })
    }
}

/// What a survey is of: its rule by what decides, bit by bit.
type Key = (EnvironmentId, Pair, Option<Vec<SegmentId>>, Within, (RuleKind, u64, u64, u64));

fn of_rule(rule: &Rule) -> (RuleKind, u64, u64, u64) {
    (rule.kind, rule.threshold_nats().to_bits(), rule.min_visits, rule.confidence.to_bits())
}

/// The surveys made so far. Cloning is cheap.
#[derive(Clone)]
pub struct Surveys {
    store: Arc<dyn Store>,
    kept: Arc<Mutex<LruCache<Key, Kept>>>,
}

/// A survey and the right to make the next one.
#[derive(Clone, Default)]
struct Kept {
    survey: Option<Arc<Survey>>,
    making: Arc<tokio::sync::Mutex<()>>,
}

/// What a survey is made of.
#[derive(Clone)]
pub struct Plan {
    /// The environment.
    pub environment: Arc<Environment>,
    /// The pair and the rule.
    pub scope: Scope,
    /// The segments to count; all if `None`.
    pub segments: Option<Vec<SegmentId>>,
    /// The fit and the habits that the evidence rests on.
    pub informed: Option<Informed>,
    /// The network that is asked where the counts do not decide.
    pub network: Option<Arc<Network>>,
}

impl Plan {
    fn key(&self) -> Key {
        let Scope { pair, within, rule, .. } = &self.scope;
        (self.environment.id, pair.clone(), self.segments.clone(), *within, of_rule(rule))
    }

    /// Returns who judges by this plan.
    pub fn judge(&self, view: View) -> Judge<'_> {
        Judge {
            schema: &self.environment.schema,
            scope: &self.scope,
            informed: self.informed.as_ref(),
            network: self.network.as_deref(),
            view,
            remembers: self.segments.is_none(),
        }
    }

    /// Returns whether a survey was made by the same fit and the same network.
    fn is_of(&self, survey: &Survey) -> bool {
        survey.fit == self.fit() && survey.network == self.network.as_ref().map(|network| network.version)
    }

    /// Returns which fit it is.
    pub fn fit(&self) -> FitId {
        self.informed.as_ref().map(|informed| informed.id).unwrap_or_default()
    }
}

impl Surveys {
    /// Keeps surveys of a store.
    pub fn new(store: Arc<dyn Store>) -> Self {
        Self { store, kept: Arc::new(Mutex::new(LruCache::new(KEPT))) }
    }

    /// Returns a survey: of this moment if the environment is small, else the last one made.
    pub async fn get(&self, plan: &Plan) -> Result<Arc<Survey>, StoreError> {
        let totals = self.store.totals(plan.environment.id).await?;
        let Kept { survey, making } = self.kept(&plan.key());
        match survey {
            Some(survey) if survey.as_of >= totals.transitions && plan.is_of(&survey) => Ok(survey),
            Some(stale) if totals.cells > SMALL => {
                if let Ok(turn) = making.try_lock_owned() {
                    self.refresh(plan.clone(), turn);
                }
                Ok(stale)
            }
            _ => self.make_now(plan, making, totals.transitions).await,
        }
    }

    async fn make_now(
        &self,
        plan: &Plan,
        making: Arc<tokio::sync::Mutex<()>>,
        revision: u64,
    ) -> Result<Arc<Survey>, StoreError> {
        let _turn = making.lock().await;
        // Somebody else may have made it while this caller waited for its turn.
        let fresh = |survey: &Arc<Survey>| survey.as_of >= revision && plan.is_of(survey);
        if let Some(survey) = self.kept(&plan.key()).survey.filter(fresh) {
            return Ok(survey);
        }
        let survey = Arc::new(make(&*self.store, plan).await?);
        self.keep(plan.key(), survey.clone());
        Ok(survey)
    }

    fn refresh(&self, plan: Plan, turn: tokio::sync::OwnedMutexGuard<()>) {
        let surveys = self.clone();
        tokio::spawn(async move {
            match make(&*surveys.store, &plan).await {
                Ok(survey) => surveys.keep(plan.key(), Arc::new(survey)),
                // It ends with its environment.
                Err(StoreError::UnknownEnvironment) => {}
                Err(error) => {
                    tracing::warn!(%error, environment = %plan.environment.name, "a survey could not be refreshed")
                }
            }
            drop(turn);
        });
    }

    fn kept(&self, key: &Key) -> Kept {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.get_or_insert(key.clone(), Kept::default).clone()
    }

    fn keep(&self, key: Key, survey: Arc<Survey>) {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.get_or_insert_mut(key, Kept::default).survey = Some(survey);
    }
}

async fn make(store: &dyn Store, plan: &Plan) -> Result<Survey, StoreError> {
    let as_of = store.totals(plan.environment.id).await?.transitions;
    let mut rows = Vec::new();
    let mut segments = HashSet::new();
    let mut pages = Pages::new(store, plan.environment.id);
    while let Some(page) = pages.next().await? {
        let plan = plan.clone();
        let measured = tokio::task::spawn_blocking(move || (named(&plan, &page), measured(&plan, page))).await;
        let (named, measured) = measured.map_err(|error| StoreError::Unreadable(error.to_string()))?;
        segments.extend(named);
        rows.extend(measured);
    }
    rows.sort_unstable_by(|a, b| a.key.cmp(&b.key));
    let found = tokio::sync::Mutex::new(LruCache::new(KEPT));
    let dependent_share = plan.informed.as_ref().map(|informed| informed.fit.parameters.dependent);
    let network = plan.network.as_ref().map(|network| network.version);
    Ok(Survey {
        rows,
        segments: segments.len() as u64,
        as_of,
        fit: plan.fit(),
        network,
        dependent_share,
        orders: Default::default(),
        found,
    })
}

/// Returns the segments that have visits in the states of a page, of those asked for.
fn named(plan: &Plan, page: &[Scanned]) -> HashSet<SegmentId> {
    let cells = page.iter().flat_map(|scanned| scanned.counts.of_segments(plan.segments.as_deref()));
    cells.map(|cell| cell.segment).collect()
}

/// Measures the states of a page; those not seen in the segments asked for are left out.
fn measured(plan: &Plan, page: Vec<Scanned>) -> Vec<Row> {
    // All states are looked at once: nothing is worth remembering.
    let judge = Judge { remembers: false, ..plan.judge(View::Figures) };
    let keys: Vec<StateKey> = page.iter().map(|scanned| scanned.key.clone()).collect();
    let predictions = judge.predictions(&keys);
    let row = |(scanned, predicted): (Scanned, Option<Prediction>)| {
        let judged = judge.judge(&scanned.key, scanned.counts.of_segments(plan.segments.as_deref()), predicted);
        let visits = judged.tables.whole.total();
        (visits > 0).then(|| Row {
            key: scanned.key,
            visits,
            plug_in: judged.plug_in,
            expected: judged.tables.expected_if_independent().0,
            evidence: judged.evidence,
            verdict: judged.verdict,
            basis: judged.basis,
        })
    };
    page.into_par_iter().zip(predictions).filter_map(row).collect()
}
