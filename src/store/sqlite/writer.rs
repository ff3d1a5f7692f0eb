//! The one connection that writes, and its transactions.
//!
//! A transaction takes the connection out of its place and puts it back only after a clean end. So whatever ends it otherwise (an error, a dropped
//! future) drops the connection, and the database rolls back what it had not committed. The next transaction then opens a new connection, and its
//! `begin immediate` waits until the old one is gone: from there on it is known what was committed, and memory is brought up to date.

use std::sync::Arc;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions, Connection};
use tokio::sync::{Mutex, MutexGuard};

use super::actions::ActionsMemory;
use super::cache::CountsCache;
use super::directory::Directory;
use super::environments;
use super::error::{aborted, outcome_unknown, unreadable};
use super::known::Known;
use super::removal::{self, Removals};
use crate::store::StoreError;

/// What is remembered of the database, and changed after each commit.
pub(super) struct Memory {
    /// The environments.
    pub(super) directory: Directory,
    /// The counts of states.
    pub(super) cache: CountsCache,
    /// How often each action was taken.
    pub(super) actions: ActionsMemory,
    /// What deleted environments have left.
    pub(super) removals: Removals,
}

impl Memory {
    /// Remembers nothing yet; the first transaction lets it begin.
    pub(super) fn new(cache_cells: usize) -> Self {
        let cache = CountsCache::new(cache_cells);
        let (directory, actions, removals) = Default::default();
        Self { directory, cache, actions, removals }
    }

    /// Drops the counts, and takes none in until it is known what was committed.
    fn suspend(&self) {
        self.cache.suspend();
        self.actions.suspend();
    }

    /// Takes counts in again.
    fn resume(&self) {
        self.cache.resume();
        self.actions.resume();
    }
}

/// The door to the writing connection: one transaction at a time.
pub(super) struct Writer {
    options: SqliteConnectOptions,
    memory: Arc<Memory>,
    place: Mutex<Place>,
    /// A connection that moves the journal beside the one that writes.
    aside: Mutex<Option<SqliteConnection>>,
}

#[derive(Default)]
struct Place {
    connection: Option<SqliteConnection>,
    known: Known,
    closed: bool,
}

/// A transaction that has the write lock. Dropped without [`Transaction::commit`], it changes nothing.
pub(super) struct Transaction<'a> {
    place: MutexGuard<'a, Place>,
    connection: Option<SqliteConnection>,
    memory: &'a Memory,
}

impl Writer {
    /// Makes a writer that connects at its first use.
    pub(super) fn new(options: SqliteConnectOptions, memory: Arc<Memory>) -> Self {
        Self { options, memory, place: Mutex::default(), aside: Mutex::default() }
    }

    /// Waits for the transaction before, and begins.
    pub(super) async fn begin(&self) -> Result<Transaction<'_>, StoreError> {
        self.begin_in(self.place.lock().await).await
    }

    /// Returns whether a transaction can begin. One that is under way says that it could.
    pub(super) async fn ready(&self) -> Result<(), StoreError> {
        match self.place.try_lock() {
            Ok(place) => self.begin_in(place).await?.end().await,
            Err(_) => Ok(()),
        }
    }

    /// Moves the journal into the database while others write. A commit that finds it long does so itself, and whoever comes next waits for that.
    pub(super) async fn checkpoint(&self) -> Result<(), sqlx::Error> {
        let mut aside = self.aside.lock().await;
        let mut connection = match aside.take() {
            Some(connection) => connection,
            None => self.options.connect().await?,
        };
        sqlx::query("pragma wal_checkpoint(passive)").execute(&mut connection).await?;
        *aside = Some(connection);
        Ok(())
    }

    /// Moves the journal into the database and closes the connections for ever.
    pub(super) async fn close(&self) -> Result<(), sqlx::Error> {
        if let Some(aside) = self.aside.lock().await.take() {
            aside.close().await?;
        }
        let mut place = self.place.lock().await;
        place.closed = true;
        let Some(mut connection) = place.connection.take() else { return Ok(()) };
        sqlx::query("pragma wal_checkpoint(truncate)").execute(&mut connection).await?;
        connection.close().await
    }

    async fn begin_in<'a>(&'a self, mut place: MutexGuard<'a, Place>) -> Result<Transaction<'a>, StoreError> {
        if place.closed {
            return Err(aborted("the store is closed"));
        }
        let kept = place.connection.take();
        let is_new = kept.is_none();
        let connection = match kept {
            Some(connection) => connection,
            None => self.options.connect().await.map_err(aborted)?,
        };
        let mut transaction = Transaction { place, connection: Some(connection), memory: &self.memory };
        sqlx::query("begin immediate").execute(transaction.connection()).await.map_err(aborted)?;
        if is_new {
            let all = environments::load(transaction.connection()).await?;
            let gone = removal::gone(transaction.connection()).await.map_err(unreadable)?;
            self.memory.directory.replace(all);
            self.memory.removals.replace(gone);
            self.memory.resume();
        }
        Ok(transaction)
    }
}

impl Transaction<'_> {
    /// Returns the connection.
    pub(super) fn connection(&mut self) -> &mut SqliteConnection {
        self.connection.as_mut().expect("it is taken only when the transaction ends")
    }

    /// Returns the connection and what is known to exist beside it.
    pub(super) fn parts(&mut self) -> (&mut SqliteConnection, &mut Known) {
        let connection = self.connection.as_mut().expect("it is taken only when the transaction ends");
        (connection, &mut self.place.known)
    }

    /// Commits, and lets `remember` bring memory up to date before anybody else can begin.
    pub(super) async fn commit(mut self, remember: impl FnOnce(&Memory, &mut Known)) -> Result<(), StoreError> {
        sqlx::query("commit").execute(self.connection()).await.map_err(outcome_unknown)?;
        remember(self.memory, &mut self.place.known);
        self.place.connection = self.connection.take();
        Ok(())
    }

    /// Ends a transaction that wrote nothing.
    pub(super) async fn end(mut self) -> Result<(), StoreError> {
        sqlx::query("rollback").execute(self.connection()).await.map_err(aborted)?;
        self.place.connection = self.connection.take();
        Ok(())
    }
}

impl Drop for Transaction<'_> {
    fn drop(&mut self) {
        if let Some(connection) = self.connection.take() {
            // Memory first: once the connection is gone, its last COMMIT may come true at any moment.
            self.memory.suspend();
            self.place.known = Known::default();
            drop(connection);
        }
    }
}

#[cfg(test)]
mod tests;
