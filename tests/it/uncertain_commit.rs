//! A store that commits and then reports failure: nothing may be acknowledged, and resuming finds that it was counted once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use async_trait::async_trait;
use nudge::api::proto;
use nudge::domain::{
    Environment, EnvironmentId, Label, Name, ProducerId, Schema, SegmentId, Sequence, StateKey, WrittenRule,
};
use nudge::store::{
    Audit, Cursor, FitRecord, ModelRecord, NewModel, Numbered, Options, Outcome, Scanned, StateCounts, Store,
    StoreError, Totals,
};
use tempfile::TempDir;
use tonic::Code;

use crate::support::{RawStream, TestApp, hello, open, reason, row, rows};

/// How the next commit fails.
#[derive(Clone, Copy, PartialEq)]
enum Failure {
    /// It takes effect and says that it did not.
    AfterCommit,
    /// It does not take effect.
    BeforeCommit,
}

/// Passes everything on, and fails one commit when it is armed.
struct Lying {
    store: Arc<dyn Store>,
    failure: Failure,
    armed: AtomicBool,
}

#[async_trait]
impl Store for Lying {
    async fn commit(&self, batches: &[Numbered]) -> Result<Vec<Outcome>, StoreError> {
        if !self.armed.swap(false, Ordering::SeqCst) {
            return self.store.commit(batches).await;
        }
        if self.failure == Failure::BeforeCommit {
            return Err(StoreError::Aborted("the disk is full".into()));
        }
        self.store.commit(batches).await?;
        Err(StoreError::OutcomeUnknown("fsync: input/output error".into()))
    }

    fn environments(&self) -> Vec<Arc<Environment>> {
        self.store.environments()
    }
    fn environment(&self, name: &str) -> Option<Arc<Environment>> {
        self.store.environment(name)
    }
    async fn create(&self, name: &Name, schema: &Schema, rule: WrittenRule) -> Result<Arc<Environment>, StoreError> {
        self.store.create(name, schema, rule).await
    }
    async fn set_rule(&self, id: EnvironmentId, rule: WrittenRule) -> Result<Arc<Environment>, StoreError> {
        self.store.set_rule(id, rule).await
    }
    async fn delete(&self, id: EnvironmentId) -> Result<(), StoreError> {
        self.store.delete(id).await
    }
    async fn watermark(&self, id: EnvironmentId, producer: &ProducerId) -> Result<Sequence, StoreError> {
        self.store.watermark(id, producer).await
    }
    async fn counts(&self, id: EnvironmentId, keys: &[StateKey]) -> Result<Vec<StateCounts>, StoreError> {
        self.store.counts(id, keys).await
    }
    async fn scan(&self, id: EnvironmentId, after: Cursor, states: u32) -> Result<Vec<Scanned>, StoreError> {
        self.store.scan(id, after, states).await
    }
    async fn segments(&self, id: EnvironmentId) -> Result<Vec<(SegmentId, Option<Label>)>, StoreError> {
        self.store.segments(id).await
    }
    async fn totals(&self, id: EnvironmentId) -> Result<Totals, StoreError> {
        self.store.totals(id).await
    }
    async fn fits(&self, id: EnvironmentId) -> Result<Vec<FitRecord>, StoreError> {
        self.store.fits(id).await
    }
    async fn keep_fit(&self, id: EnvironmentId, fit: &FitRecord) -> Result<(), StoreError> {
        self.store.keep_fit(id, fit).await
    }
    async fn models(&self, id: EnvironmentId) -> Result<Vec<ModelRecord>, StoreError> {
        self.store.models(id).await
    }
    async fn model(&self, id: EnvironmentId, version: u64) -> Result<Option<(ModelRecord, Vec<u8>)>, StoreError> {
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
    async fn ready(&self) -> Result<(), StoreError> {
        self.store.ready().await
    }
    async fn bytes(&self) -> Result<u64, StoreError> {
        self.store.bytes().await
    }
    async fn close(&self) {
        self.store.close().await;
    }
}

async fn resumes_after(failure: Failure, committed: u64) {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let lying = Arc::new(Lying { store, failure, armed: AtomicBool::new(false) });
    let app = TestApp::with(directory, lying.clone()).await;
    app.lane().await;
    let one = |sequence| rows(sequence, vec![row([0.1, 0.0], [0.0, 2.0])]);
    let (_, mut stream) = RawStream::open(app.ingest().await, hello("p")).await.expect("welcome");
    stream.send(one(1)).await.expect("open");
    stream.acknowledged().await.expect("committed");
    lying.armed.store(true, Ordering::SeqCst);
    stream.send(one(2)).await.expect("open");
    let end = stream.acknowledged().await.expect_err("it must not be acknowledged");
    assert_eq!(end.code(), Code::Unavailable, "{end}");
    assert!(["OUTCOME_UNKNOWN", "STORE_UNAVAILABLE"].contains(&reason(&end).as_str()));
    let (welcome, stream) = RawStream::open(app.ingest().await, hello("p")).await.expect("welcome");
    assert_eq!(welcome.committed_sequence, committed);
    for sequence in committed + 1..=3 {
        stream.send(one(sequence)).await.expect("open");
    }
    let (receipts, _) = stream.finish().await;
    assert_eq!(receipts.len() as u64, 3 - committed);
    assert_eq!(app.cells("0.0").await, [(vec![0, 2], String::new(), 3, None)]);
    let resent = proto::WriteRequest {
        environment: "lane".into(),
        producer: "p".into(),
        batch: Some(one(2)),
        ..Default::default()
    };
    let resent = app.ingest().await.write(resent).await.expect("a duplicate").into_inner();
    assert_eq!(resent.receipt.expect("present").status(), proto::BatchStatus::Duplicate);
    assert_eq!(app.cells("0.0").await[0].2, 3);
}

#[tokio::test]
async fn a_commit_that_lies_about_failing_is_found_by_resuming() {
    resumes_after(Failure::AfterCommit, 2).await;
}

#[tokio::test]
async fn a_commit_that_failed_is_sent_again() {
    resumes_after(Failure::BeforeCommit, 1).await;
}
