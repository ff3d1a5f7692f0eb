//! Databases for tests: each in a directory of its own, gone with the test.

use std::path::PathBuf;
use std::sync::Arc;

use nudge::domain::{ActionTotals, Environment};
use nudge::store::{Cursor, Options, Quotas, SqliteStore, Store};
use tempfile::TempDir;

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
}

impl SqliteFile {
    /// Makes a place for a file.
    pub fn new() -> Self {
        Self {
            directory: tempfile::tempdir().expect("a directory"),
            cache_cells: 100_000,
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
        }
    }
}

#[async_trait::async_trait]
impl Database for SqliteFile {
    async fn open(&self, quotas: Quotas) -> Arc<dyn Store> {
        let opened = SqliteStore::open(&self.path(), self.options(quotas)).await;
        Arc::new(opened.expect("a store that can be opened"))
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
