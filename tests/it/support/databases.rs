//! Databases for tests: each in a directory of its own, gone with the test.

use std::path::PathBuf;
use std::sync::{Arc, Weak};

use nudge::domain::{ActionTotals, Environment};
use nudge::store::{Cursor, Options, Quotas, SqliteStore, Store};
use tempfile::TempDir;
use tokio::sync::Mutex;
use tokio::task::JoinHandle;

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
        }
    }
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
        match page.last() {
            Some(last) => cursor = last.cursor,
            None => return totals,
        }
    }
}
