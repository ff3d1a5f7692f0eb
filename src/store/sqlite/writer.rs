//! The single writer: the one connection that writes, and its transactions.
//!
//! A transaction takes the connection out of its place and puts it back only after a clean end. So
//! whatever ends it otherwise (an error, a dropped future) drops the connection, and the database
//! rolls back what it had not committed. The next transaction then opens a new connection, and its
//! `begin immediate` waits until the old one is gone: from there on it is known what was committed,
//! and memory is brought up to date.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection};
use tokio::sync::{Mutex, MutexGuard};

use super::error::{aborted, fault_of_io, uncommitted};
use super::health::Health;
use super::lock::Identity;
use super::memory::Memory;
use super::row_id_cache::RowIdCache;
use super::{journal, leftovers, load};
use crate::store::{Cause, StorageFault, StoreError};

/// The door to the writing connection: one transaction at a time.
pub(super) struct Writer {
    options: SqliteConnectOptions,
    memory: Arc<Memory>,
    /// The file that was locked.
    file: Identity,
    /// What became of the last writes.
    pub(super) health: Health,
    place: Mutex<Place>,
    /// Held by whoever proves that it can be written.
    proving: Mutex<()>,
    /// A connection that moves the journal beside the one that writes.
    aside: Mutex<Option<SqliteConnection>>,
}

/// What a commit needs on a disk that was full before it is believed to have room again: small
/// commits would fit long before.
const ROOM: usize = 4 << 20;

#[derive(Default)]
struct Place {
    connection: Option<SqliteConnection>,
    /// The journal that the connection writes, which is lost with the process once it has no name.
    /// SQLite makes another one only after every connection was closed: a new connection that finds
    /// another beside those that are open would mix the two.
    journal: Option<Identity>,
    row_ids: RowIdCache,
    closed: bool,
    /// Whether a connection was dropped, which goes on closing for a while.
    has_dropped: bool,
}

/// A transaction that has the write lock. Dropped without [`Transaction::commit`], it changes
/// nothing.
pub(super) struct Transaction<'a> {
    place: MutexGuard<'a, Place>,
    connection: Option<SqliteConnection>,
    memory: &'a Memory,
    file: &'a Identity,
    health: &'a Health,
}

impl Place {
    /// Fails where the database or its journal is not the file at its path.
    fn check(&self, file: &Identity) -> Result<(), Cause> {
        let found = file
            .check()
            .and_then(|()| self.journal.as_ref().map_or(Ok(()), Identity::check));
        found.map_err(moved)
    }

    /// Remembers the journal that a new connection has just opened. Only a journal of another kind
    /// than ours has no file.
    async fn remember_journal(
        &mut self,
        file: &Identity,
        connection: &mut SqliteConnection,
    ) -> Result<(), StoreError> {
        let mode: String = sqlx::query_scalar("pragma journal_mode")
            .fetch_one(connection)
            .await
            .map_err(aborted)?;

        if self.journal.is_none() && mode == "wal" {
            self.journal =
                Some(Identity::of_journal(file.path()).map_err(|why| aborted(moved(why)))?);
        }

        // It was there before the connection opened it, and is now: so it is what was opened.
        self.check(file).map_err(aborted)
    }
}

fn moved(why: String) -> Cause {
    Cause::new(StorageFault::Moved, why)
}

impl Writer {
    /// Makes a writer that connects at its first use.
    pub(super) fn new(options: SqliteConnectOptions, file: Identity, memory: Arc<Memory>) -> Self {
        Self {
            options,
            memory,
            file,
            health: Health::new(),
            place: Mutex::default(),
            proving: Mutex::default(),
            aside: Mutex::default(),
        }
    }

    /// Waits for the transaction before, and begins: once more where that meets damage, which may be
    /// a read that failed.
    pub(super) async fn begin(&self) -> Result<Transaction<'_>, StoreError> {
        match self.begin_in(self.place.lock().await).await {
            Err(StoreError::Damaged(why)) => {
                tracing::warn!(why, "a transaction met damage: it is begun anew");
                self.begin_in(self.place.lock().await).await
            }
            begun => begun,
        }
    }

    /// Returns the file that was locked.
    pub(super) fn file(&self) -> &Identity {
        &self.file
    }

    /// Reads again what is remembered of the database, by a new connection.
    pub(super) async fn renew(&self) -> Result<(), StoreError> {
        drop(self.begin().await?);
        self.begin().await?.end().await
    }

    /// Lets memory take counts in again, which it does from the next transaction on. Where one is
    /// under way, that is it.
    pub(super) async fn settle(&self) -> Result<(), StoreError> {
        match self.place.try_lock() {
            Ok(place) => self.begin_in(place).await?.end().await,
            Err(_) => Ok(()),
        }
    }

    /// Proves that a commit would succeed by one that changes nothing, unless a write ended so
    /// short a time ago.
    pub(super) async fn prove(&self, oldest: Duration) -> Result<(), StoreError> {
        // One at a time: whoever waited for another's finds it new enough.
        let _proving = self.proving.lock().await;
        if !self.health.wants_proof(oldest, Instant::now()) {
            return Ok(());
        }

        let proven = self.write_a_page().await;
        if let Err(error) = &proven {
            self.health.heed(error);
        }

        // The database only says that it failed to write; the directory knows better why.
        if self.health.fault() == Some(StorageFault::InputOutput)
            && let Err(error) = try_to_write(self.file.path(), 1).await
        {
            self.health.diagnosed(fault_of_io(error.kind()));
        }
        proven
    }

    /// Writes one page, and waits until the disk has it: that of the header, with a number of the
    /// user's that stays what it is.
    async fn write_a_page(&self) -> Result<(), StoreError> {
        let place = self.place.lock().await;
        // Nobody else can write now, so nobody fails because of the room that is taken for a
        // moment.
        if self.health.fault() == Some(StorageFault::DiskFull) && !place.closed {
            try_to_write(self.file.path(), ROOM)
                .await
                .map_err(aborted)?;
        }

        let mut transaction = self.begin_in(place).await?;
        let connection = transaction.connection();
        let same: i64 = sqlx::query_scalar("pragma user_version")
            .fetch_one(&mut *connection)
            .await
            .map_err(aborted)?;
        let text = AssertSqlSafe(format!("pragma user_version = {same}"));
        sqlx::query(text)
            .execute(connection)
            .await
            .map_err(aborted)?;
        transaction.commit(|_, _| ()).await
    }

    /// Moves the journal into the database while others write. A commit that finds it long does so
    /// itself, and whoever comes next waits for that.
    pub(super) async fn checkpoint(&self) -> Result<(), sqlx::Error> {
        let mut aside = self.aside.lock().await;
        let mut connection = match aside.take() {
            Some(connection) => connection,
            None => self.connect_aside().await?,
        };

        sqlx::query("pragma wal_checkpoint(passive)")
            .execute(&mut connection)
            .await?;
        *aside = Some(connection);
        Ok(())
    }

    /// Connects where the journal is ours: another one would be moved into the database by the
    /// index of ours.
    async fn connect_aside(&self) -> Result<SqliteConnection, sqlx::Error> {
        let place = self.place.lock().await;
        place
            .check(&self.file)
            .map_err(|cause| sqlx::Error::Protocol(cause.to_string()))?;
        self.options.connect().await
    }

    /// Lets the next connection bring its journal where the last one was dropped, which may have
    /// taken its own along: SQLite deletes it with the last connection. To be called when the
    /// readers connect, after which none is the last.
    pub(super) async fn share(&self) {
        let mut place = self.place.lock().await;
        if place.connection.is_none() {
            place.journal = None;
        }
    }

    /// Moves the journal into the database and closes the connections for ever.
    pub(super) async fn close(&self) -> Result<(), sqlx::Error> {
        if let Some(aside) = self.aside.lock().await.take() {
            aside.close().await?;
        }
        let mut place = self.place.lock().await;
        place.closed = true;
        let Some(mut connection) = place.connection.take() else {
            return Ok(());
        };

        sqlx::query("pragma wal_checkpoint(truncate)")
            .execute(&mut connection)
            .await?;
        connection.close().await
    }

    /// Returns whether it is known that every connection was closed.
    pub(super) async fn has_closed_all(&self) -> bool {
        let place = self.place.lock().await;
        place.closed && place.connection.is_none() && !place.has_dropped
    }

    async fn begin_in<'a>(
        &'a self,
        place: MutexGuard<'a, Place>,
    ) -> Result<Transaction<'a>, StoreError> {
        if place.closed {
            return Err(aborted("the store is closed"));
        }
        self.try_to_begin(place)
            .await
            .inspect_err(|error| self.health.heed(error))
    }

    async fn try_to_begin<'a>(
        &'a self,
        mut place: MutexGuard<'a, Place>,
    ) -> Result<Transaction<'a>, StoreError> {
        // What would be acknowledged into a file without a name would be lost with the process, and
        // a new connection would open another file. The one that is kept is still right when the
        // file is back, and moves its journal into the database if the service is stopped before.
        place.check(&self.file).map_err(aborted)?;

        let kept = place.connection.take();
        let is_new = kept.is_none();
        let connection = match kept {
            Some(connection) => connection,
            None => self.options.connect().await.map_err(aborted)?,
        };

        let (file, health) = (&self.file, &self.health);
        let mut transaction = Transaction {
            place,
            connection: Some(connection),
            memory: &self.memory,
            file,
            health,
        };
        sqlx::query("begin immediate")
            .execute(transaction.connection())
            .await
            .map_err(aborted)?;

        // From here on it is known what was committed.
        if is_new {
            transaction.remember_journal().await?;
            let all = load::environments(transaction.connection()).await?;
            let gone = leftovers::gone(transaction.connection())
                .await
                .map_err(aborted)?;
            let journal = journal::load(transaction.connection(), None)
                .await
                .map_err(aborted)?;
            self.memory.directory.replace(all);
            let mut views = journal.views;
            for (id, why) in journal.damaged {
                self.memory.directory.make_read_only(id, &why);
                // What it counted is not all known: whoever asks is told so, by the journal itself.
                views.remove(&id);
            }
            self.memory.pending.replace(views, journal.last_entry);
            self.memory.removals.replace(gone);
            self.memory.resume();
        }
        Ok(transaction)
    }
}

/// Writes so many bytes beside a database and takes them away again. They need not reach the disk:
/// a file system says at once whether it has room.
async fn try_to_write(database: &Path, bytes: usize) -> std::io::Result<()> {
    let mut name = database.as_os_str().to_owned();
    name.push(".room");
    let written = tokio::fs::write(&name, vec![0; bytes]).await;
    let removed = tokio::fs::remove_file(&name).await;
    written.and(removed)
}

impl Transaction<'_> {
    /// Returns the connection.
    pub(super) fn connection(&mut self) -> &mut SqliteConnection {
        self.connection
            .as_mut()
            .expect("it is taken only when the transaction ends")
    }

    /// Returns what is remembered of the database.
    pub(super) fn memory(&self) -> &Memory {
        self.memory
    }

    /// Returns the connection and the row ids cached beside it.
    pub(super) fn parts(&mut self) -> (&mut SqliteConnection, &mut RowIdCache) {
        let connection = self
            .connection
            .as_mut()
            .expect("it is taken only when the transaction ends");
        (connection, &mut self.place.row_ids)
    }

    async fn remember_journal(&mut self) -> Result<(), StoreError> {
        let connection = self
            .connection
            .as_mut()
            .expect("it is taken only when the transaction ends");
        self.place.remember_journal(self.file, connection).await
    }

    /// Commits, and lets `remember` bring memory up to date before anybody else can begin.
    pub(super) async fn commit(
        mut self,
        remember: impl FnOnce(&Memory, &mut RowIdCache),
    ) -> Result<(), StoreError> {
        let committed = sqlx::query("commit")
            .execute(self.connection())
            .await
            .map_err(uncommitted);
        committed.inspect_err(|error| self.health.heed(error))?;
        remember(self.memory, &mut self.place.row_ids);
        self.place.connection = self.connection.take();

        // For this process it is committed. Whether the next one finds it, only the file that was
        // written knows.
        let kept = self
            .place
            .check(self.file)
            .map_err(StoreError::OutcomeUnknown);
        match &kept {
            Ok(()) => self.health.succeeded(Instant::now()),
            Err(error) => self.health.heed(error),
        }
        kept
    }

    /// Ends a transaction that wrote nothing.
    pub(super) async fn end(mut self) -> Result<(), StoreError> {
        sqlx::query("rollback")
            .execute(self.connection())
            .await
            .map_err(aborted)?;
        self.place.connection = self.connection.take();
        Ok(())
    }
}

impl Drop for Transaction<'_> {
    fn drop(&mut self) {
        if let Some(connection) = self.connection.take() {
            // Memory first: once the connection is gone, its last COMMIT may come true at any
            // moment.
            self.memory.suspend();
            self.place.row_ids = RowIdCache::default();
            self.place.has_dropped = true;
            drop(connection);
        }
    }
}

#[cfg(test)]
mod tests;
