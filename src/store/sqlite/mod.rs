//! The store in one SQLite file, in write-ahead-log mode: a single writer, a small pool of readers,
//! and caches that are brought up to date with each commit.
//!
//! `open` makes a `handle` on it by its `options`, `tables` says whose it is, `migrations` brings
//! it up to date, `inspect` and `receipts` look at it from outside, `lock` says that it is in use,
//! `writer` owns the connection that writes, `health` says whether it would, `closing` interrupts
//! those that read. `commit` writes counts into the `journal`, `compact` folds that into rows, and
//! `moving` puts `old_cells` there too. `read`, `marginals` and `audit` look, by a `walk` over rows or
//! a `lookup` of states; `fresh` is what only the journal has; `recheck` looks again at what seemed
//! damaged. `load`, `environments`, `fits`, `models`, `removal` and its `leftovers` keep the worlds.
//! In `memory` are `pending` entries of the journal, `actions`, `cache` and `directory`, beside the
//! writer is the `row_id_cache`, which is `recent`. `layout` says where rows are, `stored_forms`,
//! `rows` and `columns` how things are written, `checksums` whether they are as they were, `error`
//! what its errors mean.

use std::path::Path;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};

use async_trait::async_trait;

use super::{
    Audit, ByVisits, Cause, Cursor, FitRecord, Held, Leftovers, ModelRecord, NewModel, Numbered,
    Outcome, Quotas, Scanned, Stage, StateCounts, Store, StoreError, Totals,
};
use crate::domain::{
    ActionTotals, Change, Environment, EnvironmentId, Label, Name, ProducerId, Schema, SegmentId,
    Sequence, StateKey, UnreadableEnvironment,
};

mod actions;
mod audit;
mod cache;
mod checksums;
mod closing;
mod columns;
mod commit;
mod compact;
mod directory;
mod environments;
mod error;
mod fits;
mod fresh;
mod handle;
mod health;
mod inspect;
mod journal;
mod layout;
mod leftovers;
mod load;
mod lock;
mod lookup;
mod marginals;
mod memory;
mod migrations;
mod models;
mod moving;
mod old_cells;
mod open;
mod options;
mod pending;
mod read;
mod receipts;
mod recent;
mod recheck;
mod removal;
mod row_id_cache;
mod rows;
mod stored_forms;
mod tables;
mod walk;
mod writer;

use self::pending::{FoldLimits, Task};

pub use handle::SqliteStore;
pub use options::Options;

impl SqliteStore {
    /// Opens the database of that file, or makes it with its directories. Nobody else can open it
    /// while the store lives.
    pub async fn open(path: &Path, options: Options) -> Result<Self, StoreError> {
        Self::open_telling(path, options, &Stage::default()).await
    }

    /// Opens the database of that file as [`SqliteStore::open`] does, and tells meanwhile how far
    /// it is.
    pub async fn open_telling(
        path: &Path,
        options: Options,
        stage: &Stage,
    ) -> Result<Self, StoreError> {
        open::open(path, options, stage).await
    }

    /// Fails where an environment is gone. To be asked after a read: what was read while it was
    /// there was whole, for its rows go later.
    fn present(&self, id: EnvironmentId) -> Result<(), StoreError> {
        if self.memory.directory.has(id) {
            Ok(())
        } else {
            Err(StoreError::UnknownEnvironment)
        }
    }

    fn known(&self, id: EnvironmentId) -> Result<Arc<Environment>, StoreError> {
        self.memory
            .directory
            .of_id(id)
            .ok_or(StoreError::UnknownEnvironment)
    }

    /// Moves all that an earlier build counted in an environment into rows: whoever reads all of it
    /// waits for that.
    async fn move_all(&self, environment: &Environment) -> Result<(), StoreError> {
        let _one_at_a_time = self.compacting.lock().await;
        let mut cursor = Some(0);
        while let Some(after) = cursor
            && self
                .memory
                .pending
                .view(environment.id)
                .is_some_and(|view| view.unmoved)
        {
            let step = || moving::step(&self.writer, environment, after);
            cursor = self.twice(environment.id, step).await?;
        }
        Ok(())
    }

    /// Does what is most urgent of what keeps reads fast and the journal short, or waits for
    /// something to do.
    async fn compact_when_due(&self) -> Result<(), StoreError> {
        let is_left_alone = |id| self.memory.directory.is_read_only(id);
        // After a transaction that failed nothing is known before the next one, and nobody else may
        // have anything to write.
        if self.memory.pending.is_suspended() {
            return self.writer.begin().await?.end().await;
        }
        let Some(task) = self.memory.pending.task(self.fold_limits(), is_left_alone) else {
            self.memory.pending.grown().await;
            return Ok(());
        };
        match task {
            Task::Merge(id, tier, runs) => compact::merge(&self.memory, id, tier, runs).await,
            Task::Move(id) => {
                let environment = self.known(id)?;
                self.move_all(&environment).await
            }
            Task::Fold(id) => self.fold(id).await.map(drop),
        }
    }

    /// Back-pressure: where the journal grows faster than it is folded, whoever commits folds.
    async fn wait_for_room(&self) -> Result<(), StoreError> {
        let is_left_alone = |id| self.memory.directory.is_read_only(id);
        let limits = self.fold_limits();
        while self.memory.pending.is_full(limits, is_left_alone) {
            self.compact_when_due().await?;
        }
        Ok(())
    }

    fn fold_limits(&self) -> FoldLimits {
        FoldLimits {
            from: self.fold_from,
            quota: self.quotas.cells,
        }
    }

    /// Folds some of the journal of an environment, and returns whether that goes on.
    async fn fold(&self, id: EnvironmentId) -> Result<bool, StoreError> {
        let _one_at_a_time = self.compacting.lock().await;
        let fold = || compact::fold(&self.writer, &self.readers, &self.memory, id);
        let folded = self.twice(id, fold).await?;
        // Where it fails, a commit does it.
        self.writer.checkpoint().await.ok();
        Ok(folded)
    }

    /// Opens the database of that file to look at it: changes nothing, takes no lock, and may be
    /// done while a service has it open. Calls that would write fail.
    pub async fn inspect(path: &Path, options: Options) -> Result<Self, StoreError> {
        inspect::inspect(path, options).await
    }

    /// Returns what SQLite's own integrity check finds, the first hundred lines; empty where all is
    /// well.
    pub async fn integrity(&self) -> Result<Vec<String>, StoreError> {
        inspect::integrity(&self.readers).await
    }

    /// Returns what is wrong with the numbers and receipts of an environment's batches, the first
    /// hundred faults; empty where all is well.
    pub async fn receipts(&self, id: EnvironmentId) -> Result<Vec<String>, StoreError> {
        receipts::faults(&self.readers, id).await
    }

    /// Returns which rows of an environment are not as they were written, of those that are not told
    /// to be damaged where they are read, as descriptions, fits and networks are; empty where all is
    /// well.
    pub async fn damaged_rows(&self, id: EnvironmentId) -> Result<Vec<String>, StoreError> {
        inspect::damaged_rows(&self.readers, id).await
    }

    /// Returns whether the database has a table: one of an older build that is only looked at may
    /// lack it.
    pub async fn has_table(&self, name: &str) -> Result<bool, StoreError> {
        inspect::has_table(&self.readers, name).await
    }

    /// Does something with an environment, once more where that meets damage: it may be a read that
    /// failed, and nothing was changed by then. Damage that is met twice is believed.
    async fn twice<T, F>(
        &self,
        id: EnvironmentId,
        work: impl Fn() -> F + Send,
    ) -> Result<T, StoreError>
    where
        F: Future<Output = Result<T, StoreError>> + Send,
    {
        let mut done = work().await;
        if let Err(StoreError::Damaged(why)) = &done
            && !self.memory.directory.is_read_only(id)
        {
            tracing::warn!(why, "damage was met: it is looked at again");
            done = work().await;
        }
        self.noted(Some(id), done)
    }

    /// Reads all of an environment again, and by connections that know nothing of what was read before
    /// if all of it is sound.
    async fn recheck(&self, id: EnvironmentId) -> Result<(), StoreError> {
        let (file, directory) = (self.writer.file(), &self.memory.directory);
        recheck::recheck(file, &self.closing, directory, id).await?;
        recheck::forget_pages(&self.readers).await?;
        self.writer.renew().await
    }

    /// Keeps in mind what an error says of the environment that it is about, or of the next write.
    fn noted<T>(
        &self,
        id: Option<EnvironmentId>,
        result: Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        match (&result, id) {
            (Err(StoreError::Damaged(why)), Some(id)) => {
                self.memory.directory.make_read_only(id, why);
            }
            (Err(error), _) => self.writer.health.heed(error),
            (Ok(_), _) => {}
        }
        result
    }
}

#[async_trait]
impl Store for SqliteStore {
    fn environments(&self) -> Vec<Arc<Environment>> {
        self.memory.directory.all()
    }

    fn environment(&self, name: &str) -> Option<Arc<Environment>> {
        self.memory.directory.named(name)
    }

    fn unreadable(&self) -> Vec<Arc<UnreadableEnvironment>> {
        self.memory.directory.unreadable()
    }

    async fn create(
        &self,
        name: &Name,
        schema: &Schema,
        change: &Change,
    ) -> Result<Arc<Environment>, StoreError> {
        self.noted(
            None,
            environments::create(&self.writer, self.quotas, name, schema, change).await,
        )
    }

    async fn change(
        &self,
        id: EnvironmentId,
        change: &Change,
    ) -> Result<Arc<Environment>, StoreError> {
        let set = || environments::change(&self.writer, &self.memory.directory, id, change);
        self.twice(id, set).await
    }

    async fn delete(&self, id: EnvironmentId) -> Result<(), StoreError> {
        // Only told: it is deleted whether they can be counted or not.
        let totals = self.totals(id).await;
        let states = totals.ok().map(|totals| totals.states);
        self.twice(id, || removal::delete(&self.writer, id, states))
            .await
    }

    async fn sweep(&self) -> Result<(), StoreError> {
        removal::sweep(&self.writer, &self.readers, &self.memory.removals).await
    }

    async fn compact(&self) -> Result<(), StoreError> {
        self.compact_when_due().await
    }

    fn leftovers(&self) -> Leftovers {
        self.memory.removals.left()
    }

    async fn watermark(
        &self,
        id: EnvironmentId,
        producer: &ProducerId,
    ) -> Result<Sequence, StoreError> {
        let read = async || {
            // That none can be begun is no fault of the environment's.
            let mut transaction = match self.writer.begin().await {
                Ok(transaction) => transaction,
                Err(error) => return Ok(Err(error)),
            };
            let watermark = read::watermark(transaction.connection(), id, producer).await?;
            transaction.end().await.map(|()| Ok(watermark))
        };
        let watermark = self.twice(id, || async { read().await.map_err(error::of_commit) });
        watermark.await??.ok_or(StoreError::UnknownEnvironment)
    }

    async fn owner(
        &self,
        id: EnvironmentId,
        producer: &ProducerId,
    ) -> Result<Option<Name>, StoreError> {
        let read = async || {
            // That none can be begun is no fault of the environment's.
            let mut transaction = match self.writer.begin().await {
                Ok(transaction) => transaction,
                Err(error) => return Ok(Err(error)),
            };
            let owner = read::owner(transaction.connection(), id, producer).await?;
            transaction.end().await.map(|()| Ok(owner))
        };
        let owner = self.twice(id, || async { read().await.map_err(error::of_commit) });
        let owner = owner.await??;
        let name = owner.map(|owner| owner.parse().map_err(StoreError::Unreadable));
        name.transpose()
    }

    async fn commit(&self, batches: &[Numbered]) -> Result<Vec<Outcome>, StoreError> {
        let committing = async {
            self.wait_for_room().await?;
            commit::commit(&self.writer, &self.memory.directory, self.quotas, batches).await
        };
        self.noted(None, committing.await.map_err(error::of_commit))
    }

    async fn counts(
        &self,
        id: EnvironmentId,
        keys: &[StateKey],
    ) -> Result<Vec<StateCounts>, StoreError> {
        let environment = self.known(id)?;
        let read = || read::counts(&self.readers, &self.memory, &environment, keys);
        self.twice(id, read).await
    }

    async fn scan(
        &self,
        id: EnvironmentId,
        after: Cursor,
        states: u32,
    ) -> Result<Vec<Scanned>, StoreError> {
        let environment = self.known(id)?;
        self.move_all(&environment).await?;
        let read = || read::scan(&self.readers, &self.memory, &environment, after, states);
        let page = self.twice(id, read).await?;
        self.present(id).map(|()| page)
    }

    async fn by_visits(
        &self,
        id: EnvironmentId,
        wanted: &ByVisits,
    ) -> Result<(Vec<Scanned>, u64), StoreError> {
        let environment = self.known(id)?;
        self.move_all(&environment).await?;
        let read = || read::by_visits(&self.readers, &self.memory, &environment, wanted);
        let page = self.twice(id, read).await?;
        self.present(id).map(|()| page)
    }

    async fn segments(
        &self,
        id: EnvironmentId,
    ) -> Result<Vec<(SegmentId, Option<Label>)>, StoreError> {
        let segments = self.twice(id, || read::segments(&self.readers, id)).await?;
        self.present(id).map(|()| segments)
    }

    async fn totals(&self, id: EnvironmentId) -> Result<Totals, StoreError> {
        let environment = self.known(id)?;
        let read = || read::totals(&self.readers, &self.memory, &environment);
        self.twice(id, read).await
    }

    async fn actions(&self, environment: &Environment) -> Result<Arc<ActionTotals>, StoreError> {
        self.move_all(environment).await?;
        let read = || {
            let settled = self.writer.settle();
            marginals::actions(&self.readers, &self.memory, environment, settled)
        };
        self.twice(environment.id, read).await
    }

    async fn fits(&self, id: EnvironmentId) -> Result<Vec<FitRecord>, StoreError> {
        let fits = self.twice(id, || fits::fits(&self.readers, id)).await?;
        self.present(id).map(|()| fits)
    }

    async fn keep_fit(&self, id: EnvironmentId, fit: &FitRecord) -> Result<(), StoreError> {
        let keep = || fits::keep(&self.writer, &self.memory.directory, id, fit);
        self.twice(id, keep).await
    }

    fn quotas(&self) -> Quotas {
        self.quotas
    }

    async fn models(&self, id: EnvironmentId) -> Result<Vec<ModelRecord>, StoreError> {
        let models = self.twice(id, || models::models(&self.readers, id)).await?;
        self.present(id).map(|()| models)
    }

    async fn model(
        &self,
        id: EnvironmentId,
        version: u64,
    ) -> Result<Option<(ModelRecord, Vec<u8>)>, StoreError> {
        let read = || models::model(&self.readers, id, version);
        let model = self.twice(id, read).await?;
        self.present(id).map(|()| model)
    }

    async fn keep_model(&self, id: EnvironmentId, model: &NewModel) -> Result<u64, StoreError> {
        let directory = &self.memory.directory;
        let keep = || models::keep(&self.writer, directory, self.quotas, id, model);
        self.twice(id, keep).await
    }

    async fn activate_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError> {
        let change = || models::activate(&self.writer, &self.memory.directory, id, version);
        self.twice(id, change).await
    }

    async fn deactivate_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError> {
        let change = || models::deactivate(&self.writer, &self.memory.directory, id, version);
        self.twice(id, change).await
    }

    async fn delete_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError> {
        let change = || models::delete(&self.writer, &self.memory.directory, id, version);
        self.twice(id, change).await
    }

    async fn audit(&self) -> Result<Vec<Audit>, StoreError> {
        audit::audit(&self.readers, &self.memory.directory).await
    }

    async fn look_again(&self) {
        let directory = &self.memory.directory;
        let id = directory.due().await;
        match self.recheck(id).await {
            Ok(()) => directory.lift(id),
            // What is wrong with it was told when it was found.
            Err(_) => directory.put_off(id),
        }
    }

    fn read_only(&self) -> Vec<(Name, String)> {
        self.memory.directory.read_only()
    }

    async fn ready(&self) -> Result<(), Cause> {
        self.writer.health.ready(Instant::now())
    }

    async fn prove(&self, oldest: Duration) -> Result<(), StoreError> {
        self.writer.prove(oldest).await
    }

    async fn bytes(&self) -> Result<u64, StoreError> {
        read::bytes(&self.path).await
    }

    async fn disk(&self) -> Result<[u64; 2], StoreError> {
        read::disk(&self.path).await
    }

    async fn held(&self) -> Result<Vec<(EnvironmentId, Held)>, StoreError> {
        let mut all = read::held(&self.readers).await?;
        read::hold_unfolded(&self.readers, &self.memory, &mut all).await?;
        Ok(all)
    }

    async fn close(&self) {
        // Reads first: one that goes on holds up the journal.
        self.closing.interrupt();
        self.readers.close().await;

        if let Err(error) = self.writer.close().await {
            tracing::warn!(%error, "the journal was not moved into the database; the next start does it");
        }

        let lock = self
            .lock
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        match lock {
            Some(lock) if self.writer.has_closed_all().await => lock.close(),
            lock => drop(lock),
        }
    }
}
