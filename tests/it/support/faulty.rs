//! Fault injection: a store that passes everything on, and fails when it is told to.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use nudge::domain::{
    ActionTotals, Change, Environment, EnvironmentId, Label, Name, ProducerId, Schema, SegmentId,
    Sequence, StateKey, UnreadableEnvironment,
};
use nudge::store::{
    Audit, ByVisits, Cause, Cursor, FitRecord, Held, Leftovers, ModelRecord, NewModel, Numbered,
    Outcome, Quotas, Scanned, StateCounts, Store, StoreError, Totals,
};
use tokio::sync::Notify;

/// Which call fails, and how.
#[derive(Clone, Copy, PartialEq)]
pub enum Failure {
    /// A commit takes effect and says that it did not.
    AfterCommit,
    /// A commit does not take effect.
    BeforeCommit,
    /// A commit waits until it is disarmed.
    Held,
    /// What deleted environments have left cannot be removed, until it is disarmed.
    Sweep,
    /// The list of models cannot be read, until it is disarmed.
    Models,
    /// A model with its weights cannot be read, until it is disarmed.
    Model,
}

/// Passes everything on, and fails when it is armed: a commit once, a read until it is disarmed.
pub struct Faulty {
    store: Arc<dyn Store>,
    failure: Failure,
    armed: AtomicBool,
    disarmed: Notify,
}

impl Faulty {
    /// Makes a store that can fail so.
    pub fn new(store: Arc<dyn Store>, failure: Failure) -> Arc<Self> {
        Arc::new(Self {
            store,
            failure,
            armed: AtomicBool::new(false),
            disarmed: Notify::new(),
        })
    }

    /// Lets calls fail from now on.
    pub fn arm(&self) {
        self.armed.store(true, Ordering::SeqCst);
    }

    /// Lets calls fail no more.
    pub fn disarm(&self) {
        self.armed.store(false, Ordering::SeqCst);
        self.disarmed.notify_waiters();
    }

    fn commit_fails(&self) -> bool {
        [Failure::AfterCommit, Failure::BeforeCommit].contains(&self.failure)
            && self.armed.swap(false, Ordering::SeqCst)
    }

    fn check_read(&self, failure: Failure) -> Result<(), StoreError> {
        match self.failure == failure && self.armed.load(Ordering::SeqCst) {
            true => Err(StoreError::Unreadable("disk I/O error".into())),
            false => Ok(()),
        }
    }
}

#[async_trait]
impl Store for Faulty {
    async fn commit(&self, batches: &[Numbered]) -> Result<Vec<Outcome>, StoreError> {
        if self.failure == Failure::Held {
            let disarmed = self.disarmed.notified();
            if self.armed.load(Ordering::SeqCst) {
                disarmed.await;
            }
        }
        if !self.commit_fails() {
            return self.store.commit(batches).await;
        }
        if self.failure == Failure::BeforeCommit {
            return Err(StoreError::Aborted("the disk is full".into()));
        }
        self.store.commit(batches).await?;
        Err(StoreError::OutcomeUnknown(
            "fsync: input/output error".into(),
        ))
    }

    fn environments(&self) -> Vec<Arc<Environment>> {
        self.store.environments()
    }
    fn unreadable(&self) -> Vec<Arc<UnreadableEnvironment>> {
        self.store.unreadable()
    }
    fn environment(&self, name: &str) -> Option<Arc<Environment>> {
        self.store.environment(name)
    }
    async fn create(
        &self,
        name: &Name,
        schema: &Schema,
        change: &Change,
    ) -> Result<Arc<Environment>, StoreError> {
        self.store.create(name, schema, change).await
    }
    async fn change(
        &self,
        id: EnvironmentId,
        change: &Change,
    ) -> Result<Arc<Environment>, StoreError> {
        self.store.change(id, change).await
    }
    async fn delete(&self, id: EnvironmentId) -> Result<(), StoreError> {
        self.store.delete(id).await
    }
    async fn sweep(&self) -> Result<(), StoreError> {
        self.check_read(Failure::Sweep)?;
        self.store.sweep().await
    }
    async fn compact(&self) -> Result<(), StoreError> {
        self.store.compact().await
    }
    fn leftovers(&self) -> Leftovers {
        self.store.leftovers()
    }
    async fn owner(
        &self,
        id: EnvironmentId,
        producer: &ProducerId,
    ) -> Result<Option<Name>, StoreError> {
        self.store.owner(id, producer).await
    }

    async fn watermark(
        &self,
        id: EnvironmentId,
        producer: &ProducerId,
    ) -> Result<Sequence, StoreError> {
        self.store.watermark(id, producer).await
    }
    async fn counts(
        &self,
        id: EnvironmentId,
        keys: &[StateKey],
    ) -> Result<Vec<StateCounts>, StoreError> {
        self.store.counts(id, keys).await
    }
    async fn scan(
        &self,
        id: EnvironmentId,
        after: Cursor,
        states: u32,
    ) -> Result<Vec<Scanned>, StoreError> {
        self.store.scan(id, after, states).await
    }
    async fn by_visits(
        &self,
        id: EnvironmentId,
        wanted: &ByVisits,
    ) -> Result<(Vec<Scanned>, u64), StoreError> {
        self.store.by_visits(id, wanted).await
    }
    async fn segments(
        &self,
        id: EnvironmentId,
    ) -> Result<Vec<(SegmentId, Option<Label>)>, StoreError> {
        self.store.segments(id).await
    }
    async fn totals(&self, id: EnvironmentId) -> Result<Totals, StoreError> {
        self.store.totals(id).await
    }
    async fn actions(&self, environment: &Environment) -> Result<Arc<ActionTotals>, StoreError> {
        self.store.actions(environment).await
    }
    async fn fits(&self, id: EnvironmentId) -> Result<Vec<FitRecord>, StoreError> {
        self.store.fits(id).await
    }
    async fn keep_fit(&self, id: EnvironmentId, fit: &FitRecord) -> Result<(), StoreError> {
        self.store.keep_fit(id, fit).await
    }
    fn quotas(&self) -> Quotas {
        self.store.quotas()
    }
    async fn models(&self, id: EnvironmentId) -> Result<Vec<ModelRecord>, StoreError> {
        self.check_read(Failure::Models)?;
        self.store.models(id).await
    }
    async fn model(
        &self,
        id: EnvironmentId,
        version: u64,
    ) -> Result<Option<(ModelRecord, Vec<u8>)>, StoreError> {
        self.check_read(Failure::Model)?;
        self.store.model(id, version).await
    }
    async fn keep_model(&self, id: EnvironmentId, model: &NewModel) -> Result<u64, StoreError> {
        self.store.keep_model(id, model).await
    }
    async fn activate_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError> {
        self.store.activate_model(id, version).await
    }
    async fn deactivate_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError> {
        self.store.deactivate_model(id, version).await
    }
    async fn delete_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError> {
        self.store.delete_model(id, version).await
    }
    async fn audit(&self) -> Result<Vec<Audit>, StoreError> {
        self.store.audit().await
    }
    async fn look_again(&self) {
        self.store.look_again().await;
    }
    fn read_only(&self) -> Vec<(Name, String)> {
        self.store.read_only()
    }
    async fn ready(&self) -> Result<(), Cause> {
        self.store.ready().await
    }
    async fn prove(&self, oldest: Duration) -> Result<(), StoreError> {
        self.store.prove(oldest).await
    }
    async fn bytes(&self) -> Result<u64, StoreError> {
        self.store.bytes().await
    }
    async fn disk(&self) -> Result<[u64; 2], StoreError> {
        self.store.disk().await
    }
    async fn held(&self) -> Result<Vec<(EnvironmentId, Held)>, StoreError> {
        self.store.held().await
    }
    async fn close(&self) {
        self.store.close().await;
    }
}
