//! Looking at a database without changing it and without its lock: beside a service that has it open, or at a copy.

use std::path::Path;
use std::sync::{Arc, Mutex};

use sqlx::sqlite::SqliteConnection;
use sqlx::{Row, SqlitePool};

use super::error::{DAMAGED, aborted, opening, unopenable, unreadable};
use super::lock::Identity;
use super::open::{Closing, MIGRATIONS, readers, writing};
use super::{Memory, Options, SqliteStore, Writer, environments};
use crate::store::StoreError;

/// The most lines of SQLite's own check that are told.
const MOST_TOLD: usize = 100;

/// Opens a database for reading. Every call that would write fails.
pub(super) async fn inspect(path: &Path, options: Options) -> Result<SqliteStore, StoreError> {
    let file = Identity::of(path)?;
    let closing = Closing::default();
    let readers = readers(&file, &closing).await.map_err(|error| unseen(path, error))?;
    let memory = Arc::new(Memory::new(options.cache_cells));
    let mut reader = readers.acquire().await.map_err(|error| unseen(path, error))?;
    let versions = versions(&mut reader).await.map_err(|error| unseen(path, error))?;
    match versions.last() {
        None => return Err(unopenable(path, "it is no database of nudge; name its directory with --data")),
        Some(last) if *last > newest() => {
            return Err(unopenable(path, "it was made by a newer nudge; use that version"));
        }
        Some(_) => memory.directory.replace(environments::load(&mut reader).await?),
    }
    drop(reader);

    let writer = Writer::new(writing(path), file, Arc::clone(&memory));
    writer.close().await.map_err(aborted)?;
    let (path, quotas, lock) = (path.to_owned(), options.quotas, Mutex::new(None));
    Ok(SqliteStore { path, quotas, memory, writer, readers, closing, lock })
}

/// An error while looking: damage is what was looked for, and everything else keeps from looking.
fn unseen(path: &Path, error: sqlx::Error) -> StoreError {
    match opening(path, &error) {
        StoreError::Unopenable { why, .. } if why == DAMAGED => unreadable(error),
        other => other,
    }
}

/// Returns what SQLite's own check finds: pages, indices, types and constraints, of every table. Empty where all is well.
pub(super) async fn integrity(readers: &SqlitePool) -> Result<Vec<String>, StoreError> {
    let rows = sqlx::query("pragma integrity_check(100)").fetch_all(readers).await;
    let lines = rows.and_then(|rows| rows.iter().map(|row| row.try_get::<String, _>(0)).collect::<Result<Vec<_>, _>>());
    match lines.map_err(unreadable) {
        Ok(lines) if lines == ["ok"] => Ok(Vec::new()),
        Ok(lines) => Ok(lines.iter().flat_map(|line| line.lines()).take(MOST_TOLD).map(str::to_owned).collect()),
        Err(StoreError::Damaged(why)) => Ok(vec![why]),
        Err(error) => Err(error),
    }
}

/// Returns whether a database has every table of this build.
pub(super) async fn is_current(readers: &SqlitePool) -> Result<bool, StoreError> {
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    Ok(versions(&mut reader).await.map_err(unreadable)?.last() == Some(&newest()))
}

fn newest() -> i64 {
    MIGRATIONS.iter().map(|migration| migration.version).max().unwrap_or_default()
}

/// Returns the versions of the migrations that were applied, in order; none where the tables are not ours.
async fn versions(reader: &mut SqliteConnection) -> Result<Vec<i64>, sqlx::Error> {
    let text = "select count(*) from sqlite_schema where name = '_sqlx_migrations'";
    let is_ours: bool = sqlx::query_scalar(text).fetch_one(&mut *reader).await?;
    match is_ours {
        true => sqlx::query_scalar("select version from _sqlx_migrations order by version").fetch_all(reader).await,
        false => Ok(Vec::new()),
    }
}
