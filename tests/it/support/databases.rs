//! Databases for tests: each in a directory of its own, gone with the test.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Weak};
use std::time::Duration;

use nudge::domain::{ActionTotals, Environment};
use nudge::store::{Cursor, Options, Quotas, SqliteStore, Store};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use tempfile::TempDir;
use tokio::sync::Mutex;
use tokio::task::JoinHandle;

use super::batches::{of_outcomes, of_too_many_states};

/// A place where a store can be opened, dropped, and opened again with what it held.
#[async_trait::async_trait]
pub trait Database: Send + Sync {
    /// Opens the store.
    async fn open(&self, quotas: Quotas) -> Arc<dyn Store>;
}

/// A SQLite file.
pub struct SqliteFile {
    directory: TempDir,
    /// The size of the cache of counts.
    pub cache_cells: usize,
    /// Cells in the journal from which on it is folded, if somebody folds it.
    pub fold_from: usize,
    /// Who puts the journal into rows, if anybody does.
    compaction: Option<Mutex<Option<JoinHandle<()>>>>,
}

impl SqliteFile {
    /// Makes a place for a file.
    pub fn new() -> Self {
        Self {
            directory: tempfile::tempdir().expect("a directory"),
            cache_cells: 100_000,
            fold_from: Options::default().fold_from,
            compaction: None,
        }
    }

    /// Makes a place for a file whose journal is put into rows at once, beside everything else.
    pub fn compacted() -> Self {
        Self {
            fold_from: 1,
            compaction: Some(Mutex::default()),
            ..Self::new()
        }
    }

    /// The same, with states that are numbered by a table: see [`of_too_many_states`].
    pub fn listed() -> Self {
        of_too_many_states();
        Self::compacted()
    }

    /// Makes a place for a file whose environments observe outcomes: see [`of_outcomes`].
    pub fn observed() -> Self {
        of_outcomes(true);
        Self::new()
    }

    /// The same, with a journal that is put into rows at once, and states that are numbered by a
    /// table.
    pub fn observed_listed() -> Self {
        of_outcomes(true);
        Self::listed()
    }

    /// Folds all of the journal into rows, and moves what an earlier build counted. Nobody may have
    /// the file open.
    pub async fn compact_all(&self) {
        let options = self.options(Quotas::default());
        compact_all(&self.path(), options).await;
    }

    /// Returns the file.
    pub fn path(&self) -> PathBuf {
        self.directory.path().join("data").join("nudge.db")
    }

    /// Returns how the file is opened.
    pub fn options(&self, quotas: Quotas) -> Options {
        Options {
            quotas,
            cache_cells: self.cache_cells,
            fold_from: self.fold_from,
            look_again_after: Duration::ZERO,
        }
    }
}

/// What is in no row yet: entries of the journal, and environments in the tables of an earlier build.
pub const LEFT: &str = "select (select coalesce(sum(unmoved), 0) from totals) + (
    select count(*) from journal join totals using (environment)
    where journal.id > totals.folded or totals.fold_row is not null)";

/// Opens a database and closes it once all of its counts are in rows.
pub async fn compact_all(path: &Path, options: Options) {
    let options = Options {
        fold_from: 1,
        ..options
    };
    let opened = SqliteStore::open(path, options).await;
    let store = opened.expect("a store that can be opened");
    while number(path, LEFT).await > 0 {
        store.compact().await.expect("a step");
    }
    store.close().await;
}

/// Asks a database for a number, whoever has it open.
pub async fn number(path: &Path, sql: &'static str) -> i64 {
    let options = SqliteConnectOptions::new().filename(path).read_only(true);
    let mut raw = options.connect().await.expect("a connection");
    let number = sqlx::query_scalar(sql).fetch_one(&mut raw).await;
    raw.close().await.expect("closed");
    number.expect("a number")
}

/// Changes a database behind the store's back: no rule of its holds.
pub async fn execute(path: &Path, sql: &'static str) {
    let options = SqliteConnectOptions::new()
        .filename(path)
        .foreign_keys(false);
    let mut raw = options.connect().await.expect("a connection");
    let done = sqlx::raw_sql(sql).execute(&mut raw).await;
    done.expect("a statement that works");
    raw.close().await.expect("closed");
}

async fn compact(store: Weak<SqliteStore>) {
    while let Some(store) = store.upgrade() {
        if store.compact().await.is_err() {
            tokio::task::yield_now().await;
        }
    }
}

#[async_trait::async_trait]
impl Database for SqliteFile {
    async fn open(&self, quotas: Quotas) -> Arc<dyn Store> {
        let mut compaction = match &self.compaction {
            Some(compaction) => Some(compaction.lock().await),
            None => None,
        };
        if let Some(before) = compaction.as_mut().and_then(|before| before.take()) {
            before.abort();
            before.await.ok();
        }
        let opened = SqliteStore::open(&self.path(), self.options(quotas)).await;
        let store = Arc::new(opened.expect("a store that can be opened"));
        if let Some(mut compaction) = compaction {
            *compaction = Some(tokio::spawn(compact(Arc::downgrade(&store))));
        }
        store
    }
}

/// Returns how often each agent took each action, by adding up every state. Nobody may commit
/// meanwhile.
pub async fn actions_by_scan(store: &dyn Store, environment: &Environment) -> ActionTotals {
    let mut totals = ActionTotals::new(&environment.schema);
    let mut cursor = Cursor::default();
    loop {
        let page = store
            .scan(environment.id, cursor, 1_000)
            .await
            .expect("a page");
        let cells = page.iter().flat_map(|state| state.counts.cells());
        cells.for_each(|cell| totals.add(cell.joint, cell.tally));
        for family in environment.schema.families().skip(1) {
            let cells = page.iter().flat_map(|state| state.counts.of_family(family));
            cells.for_each(|cell| totals.add_value(family, cell.joint, cell.tally));
        }
        match page.last() {
            Some(last) => cursor = last.cursor,
            None => return totals,
        }
    }
}
