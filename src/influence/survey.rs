//! One pass over every state of an environment for one pair: where influence is highest, and what all states say together.
//!
//! A survey of a small environment is made anew whenever something was counted since, so it sees every acknowledged transition. A large one is
//! served as it is while the next is made in the background, and says of which revision it is.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use lru::LruCache;

use super::tables::Tables;
use crate::domain::{Environment, EnvironmentId, Pair, SegmentId, StateKey};
use crate::information::plug_in;
use crate::store::{Cursor, Store, StoreError};

/// Cells up to which a survey is made while the caller waits.
const SMALL: u64 = 100_000;

/// States read at a time, so that no read transaction is long.
const STEP: u32 = 1_000;

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
}

/// The rows of one environment, pair and choice of segments.
pub struct Survey {
    /// Every state seen, in order of key.
    pub rows: Vec<Row>,
    /// How many transitions the environment had when the pass began.
    pub as_of: u64,
    orders: [OnceLock<Vec<u32>>; 4],
}

/// What rows are ordered by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OrderBy {
    /// How often a state was seen.
    Visits,
    /// Plug-in mutual information.
    PlugIn,
}

/// An order of rows; equal rows are in order of key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Order {
    /// What counts.
    pub by: OrderBy,
    /// Largest first.
    pub descending: bool,
}

impl Order {
    /// Returns a number that orders rows as this order does. Figures are not negative, so their bits are in their order.
    pub fn rank(self, row: &Row) -> u64 {
        let value = match self.by {
            OrderBy::Visits => row.visits,
            OrderBy::PlugIn => row.plug_in.to_bits(),
        };
        if self.descending { !value } else { value }
    }
}

impl Survey {
    /// Returns the positions of all rows in an order, sorted at its first use.
    pub fn ordered(&self, order: Order) -> &[u32] {
        let slot = usize::from(order.by == OrderBy::PlugIn) * 2 + usize::from(order.descending);
        self.orders[slot].get_or_init(|| {
            let mut positions: Vec<u32> = (0..self.rows.len() as u32).collect();
            // Rows are in order of key and the sort is stable, so equal ranks stay in order of key.
            positions.sort_by_key(|position| order.rank(&self.rows[*position as usize]));
            positions
        })
    }
}

type Key = (EnvironmentId, Pair, Option<Vec<SegmentId>>);

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

impl Surveys {
    /// Keeps surveys of a store.
    pub fn new(store: Arc<dyn Store>) -> Self {
        Self { store, kept: Arc::new(Mutex::new(LruCache::new(KEPT))) }
    }

    /// Returns a survey: of this moment if the environment is small, else the last one made.
    pub async fn get(
        &self,
        environment: &Arc<Environment>,
        pair: &Pair,
        segments: Option<Vec<SegmentId>>,
    ) -> Result<Arc<Survey>, StoreError> {
        let key = (environment.id, pair.clone(), segments);
        let totals = self.store.totals(environment.id).await?;
        let Kept { survey, making } = self.kept(&key);
        match survey {
            Some(survey) if survey.as_of >= totals.transitions => Ok(survey),
            Some(stale) if totals.cells > SMALL => {
                if let Ok(turn) = making.try_lock_owned() {
                    self.refresh(environment.clone(), key, turn);
                }
                Ok(stale)
            }
            _ => self.make_now(environment, key, making, totals.transitions).await,
        }
    }

    async fn make_now(
        &self,
        environment: &Environment,
        key: Key,
        making: Arc<tokio::sync::Mutex<()>>,
        revision: u64,
    ) -> Result<Arc<Survey>, StoreError> {
        let _turn = making.lock().await;
        // Somebody else may have made it while this caller waited for its turn.
        if let Some(survey) = self.kept(&key).survey.filter(|survey| survey.as_of >= revision) {
            return Ok(survey);
        }
        let survey = Arc::new(make(&*self.store, environment, &key).await?);
        self.keep(key, survey.clone());
        Ok(survey)
    }

    fn refresh(&self, environment: Arc<Environment>, key: Key, turn: tokio::sync::OwnedMutexGuard<()>) {
        let surveys = self.clone();
        tokio::spawn(async move {
            match make(&*surveys.store, &environment, &key).await {
                Ok(survey) => surveys.keep(key, Arc::new(survey)),
                Err(error) => {
                    tracing::warn!(%error, environment = %environment.name, "a survey could not be refreshed")
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

async fn make(store: &dyn Store, environment: &Environment, key: &Key) -> Result<Survey, StoreError> {
    let (id, pair, segments) = key;
    let as_of = store.totals(*id).await?.transitions;
    let mut rows = Vec::new();
    let mut cursor = Cursor::default();
    loop {
        let page = store.scan(*id, cursor, STEP).await?;
        let Some(last) = page.last() else { break };
        cursor = last.cursor;
        rows.extend(page.into_iter().filter_map(|scanned| {
            let tables = Tables::new(&environment.schema, pair, scanned.counts.of_segments(segments.as_deref()));
            let visits = tables.whole.total();
            let expected = tables.expected_if_independent().0;
            (visits > 0).then(|| Row { key: scanned.key, visits, plug_in: tables.figure(plug_in), expected })
        }));
        // Between steps others have their turn.
        tokio::task::yield_now().await;
    }
    rows.sort_unstable_by(|a, b| a.key.cmp(&b.key));
    Ok(Survey { rows, as_of, orders: Default::default() })
}
