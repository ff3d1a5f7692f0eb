//! Opening a database: its directory, its lock, its migrations, its connection pool.

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{ConnectOptions, Connection, SqlitePool};

use super::closing::Closing;
use super::error::{damaged, made_by_newer, opening, unopenable};
use super::handle::SqliteStore;
use super::lock::{Identity, Lock};
use super::memory::Memory;
use super::migrations::{MIGRATIONS, make_records};
use super::options::Options;
use super::stored_forms;
use super::tables::{self, Tables};
use super::writer::Writer;
use crate::store::{Stage, StoreError};

/// Connections that read.
const READERS: u32 = 3;

/// Kibibytes of pages that the writer keeps. More is faster only while many cells are new.
const WRITER_CACHE_KIB: u32 = 24 * 1024;
const READER_CACHE_KIB: u32 = 4 * 1024;

/// Journal pages after which a commit moves them into the database: 16 MiB.
const CHECKPOINT_PAGES: u32 = 4_096;
/// What is left of the journal file after a large commit.
const JOURNAL_BYTES: u32 = 64 << 20;

pub(super) async fn open(
    path: &Path,
    options: Options,
    stage: &Stage,
) -> Result<SqliteStore, StoreError> {
    if let Some(directory) = path.parent() {
        std::fs::create_dir_all(directory)
            .map_err(|error| unopenable(path, format!("cannot make its directory: {error}")))?;
    }

    // Before anything else touches the file.
    let lock = Lock::take(path)?;
    let writing = writing(path);
    migrate(path, &writing, stage).await?;

    let memory = Arc::new(Memory::new(options.cache_cells, options.look_again_after));
    let writer = Writer::new(writing, lock.identity().clone(), Arc::clone(&memory));
    // The first transaction fills memory.
    let filled = async { writer.begin().await?.end().await };
    filled.await.map_err(|error| match error {
        StoreError::Damaged(what) => unopenable(path, damaged(&what)),
        error => error,
    })?;

    // A disk that is full keeps nobody from asking: what is wrong is told by readiness.
    let _ = writer.prove(Duration::ZERO).await;

    let closing = Closing::default();
    let readers = readers(lock.identity(), &closing)
        .await
        .map_err(|error| opening(path, &error))?;
    writer.share().await;

    let lock = Mutex::new(Some(lock));
    Ok(SqliteStore {
        path: path.to_owned(),
        quotas: options.quotas,
        memory,
        writer,
        readers,
        closing,
        fold_from: options.fold_from,
        compacting: tokio::sync::Mutex::default(),
        lock,
    })
}

async fn migrate(
    path: &Path,
    options: &SqliteConnectOptions,
    stage: &Stage,
) -> Result<(), StoreError> {
    // Whose it is comes first: another's is left as it is, its journal too.
    let looked = async {
        let mut looking = connecting(path, WRITER_CACHE_KIB)
            .create_if_missing(true)
            .connect()
            .await?;
        let tables = tables::look(&mut looking).await?;
        looking.close().await?;
        Ok(tables)
    };
    let applied = match looked.await.map_err(|error| opening(path, &error))? {
        Tables::Foreign => {
            return Err(unopenable(
                path,
                "it is another program's database; choose another --data directory",
            ));
        }
        Tables::Newer => return Err(made_by_newer(path)),
        Tables::Damaged(what) => return Err(unopenable(path, damaged(&what))),
        Tables::None => 0,
        Tables::Ours(applied) => applied,
    };

    let mut connection = options
        .connect()
        .await
        .map_err(|error| opening(path, &error))?;
    run_migrations(&mut connection, applied, stage)
        .await
        .map_err(|error| opening(path, &error))?;

    connection
        .close()
        .await
        .map_err(|error| opening(path, &error))
}

/// Brings the tables up to date after so many migrations, one transaction each. Interrupted
/// anywhere, the next opening goes on.
async fn run_migrations(
    connection: &mut SqliteConnection,
    applied: usize,
    stage: &Stage,
) -> Result<(), sqlx::Error> {
    let missing = &MIGRATIONS[applied..];
    // A new database is made at once, and nobody need be told.
    let Some(last) = MIGRATIONS[..applied].last() else {
        make_records(connection).await?;
        for migration in missing {
            migration.apply(connection).await?;
        }
        return Ok(());
    };

    let started = Instant::now();
    for (step, migration) in missing.iter().enumerate() {
        let (step, steps) = (step + 1, missing.len());
        stage.begin_step(format!("migrating the database, step {step} of {steps}"));
        let (from, to) = (last.version, migration.version);
        tracing::info!(from, to, "migrating the database");
        migration.apply(connection).await?;
    }

    if !missing.is_empty() {
        let duration_ms = started.elapsed().as_millis() as u64;
        tracing::info!(duration_ms, "the database is up to date");
    }
    stage.begin_step("opening the database");
    Ok(())
}

fn connecting(path: &Path, cache_kib: u32) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .busy_timeout(Duration::from_secs(5))
        .pragma("cache_size", format!("-{cache_kib}"))
        .pragma("temp_store", "memory")
        .collation("bins", stored_forms::compare_keys)
        .thread_name(|number| format!("nudge-sqlite-{number}"))
        .disable_statement_logging()
}

/// `synchronous = full` makes a commit wait for the disk; `normal` would lose acknowledged batches
/// in a power cut.
pub(super) fn writing(path: &Path) -> SqliteConnectOptions {
    connecting(path, WRITER_CACHE_KIB)
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .pragma("wal_autocheckpoint", CHECKPOINT_PAGES.to_string())
        .pragma("journal_size_limit", JOURNAL_BYTES.to_string())
}

/// A file that took the name of the database since is no reader's.
pub(super) async fn readers(file: &Identity, closing: &Closing) -> Result<SqlitePool, sqlx::Error> {
    let (opened, closing) = (file.clone(), closing.clone());
    SqlitePoolOptions::new()
        .after_connect(move |connection, _| {
            let found = opened.check().map_err(sqlx::Error::Protocol);
            let watching = closing.clone().watch(connection);
            Box::pin(async {
                found?;
                watching.await
            })
        })
        .min_connections(1)
        .max_connections(READERS)
        .test_before_acquire(false)
        .idle_timeout(None)
        .max_lifetime(None)
        .connect_with(
            connecting(file.path(), READER_CACHE_KIB)
                .read_only(true)
                .row_buffer_size(1_024),
        )
        .await
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn pragma(connection: &mut SqliteConnection, text: &'static str) -> i64 {
        sqlx::query_scalar(text)
            .fetch_one(connection)
            .await
            .expect("a number")
    }

    #[tokio::test]
    async fn commits_wait_for_the_disk_and_memory_is_bounded() {
        let directory = tempfile::tempdir().expect("a directory");
        let mut writer = writing(&directory.path().join("test.db"))
            .connect()
            .await
            .expect("a connection");
        let mode: String = sqlx::query_scalar("pragma journal_mode")
            .fetch_one(&mut writer)
            .await
            .expect("a word");
        assert_eq!(mode, "wal");
        assert_eq!(
            pragma(&mut writer, "pragma synchronous").await,
            2,
            "2 is full"
        );
        assert_eq!(pragma(&mut writer, "pragma foreign_keys").await, 1);
        assert_eq!(pragma(&mut writer, "pragma cache_size").await, -24 * 1024);
        assert_eq!(
            pragma(&mut writer, "pragma wal_autocheckpoint").await,
            4_096
        );
    }
}
