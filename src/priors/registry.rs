//! The registry of priors: the last fit of each pair, from memory or from the store.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use lru::LruCache;
use tokio_util::sync::CancellationToken;

use super::asked::Asked;
use super::evidence_cache::EvidenceCache;
use super::fitted::{Fitted, Informed, alphabet};
use super::stored_forms;
use crate::domain::{Environment, EnvironmentId, FitId, Pair};
use crate::evidence::{Fit, Prior};
use crate::information::Alphabet;
use crate::store::{Store, StoreError};
use crate::work::Gate;

/// The capacity of the cache: fits kept in memory.
const KEPT: NonZeroUsize = NonZeroUsize::new(256).expect("not zero");

/// Priors that nothing was fitted to, kept by their alphabets.
const COLD_KEPT: NonZeroUsize = NonZeroUsize::new(8).expect("not zero");

type Key = (EnvironmentId, Pair);

/// A registry of the fitted priors of every environment. Cloning is cheap.
#[derive(Clone)]
pub struct PriorRegistry {
    pub(super) store: Arc<dyn Store>,
    pub(super) kept: Arc<Mutex<LruCache<Key, Arc<Fitted>>>>,
    /// What all pairs of the same alphabets share before anything was fitted: a graph of eight
    /// agents at a lag asks about 56 of them at once, and each takes up to half a second to make.
    cold: Arc<Mutex<LruCache<Alphabet, Arc<Prior>>>>,
    pub(super) asked: Arc<Asked>,
    pub(super) making: Arc<tokio::sync::Mutex<()>>,
    pub(super) gate: Gate,
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
        let cold = Arc::new(Mutex::new(LruCache::new(COLD_KEPT)));
        Self {
            store,
            kept,
            cold,
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
                stored_forms::read_record(&record, alphabet).ok()?,
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
        let habits = fitted.habits(&totals, [ego, other]);
        Ok(Some(Informed {
            fitted,
            habits,
            revision: totals.revision,
        }))
    }

    pub(super) fn keep(
        &self,
        key: Key,
        id: FitId,
        last_version: u64,
        made: Option<Instant>,
        fit: Fit,
    ) -> Arc<Fitted> {
        let prior = if id == FitId::default() {
            self.cold_prior(&fit)
        } else {
            Arc::new(Prior::new(&fit))
        };
        let fitted = Arc::new(Fitted {
            id,
            last_version,
            made,
            prior,
            fit,
            evidence_cache: EvidenceCache::default(),
            unseen: Mutex::default(),
            habits: Mutex::default(),
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

    /// Returns the prior of a fit to nothing. Who asks for one that is being made waits for it.
    fn cold_prior(&self, fit: &Fit) -> Arc<Prior> {
        let mut cold = self.cold.lock().unwrap_or_else(PoisonError::into_inner);
        let prior = cold.get_or_insert(fit.alphabet, || Arc::new(Prior::new(fit)));
        prior.clone()
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, LruCache<Key, Arc<Fitted>>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
