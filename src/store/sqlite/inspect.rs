//! Read-only inspection of a database, without its lock: beside a service that has it open, or of a
//! copy.

use std::path::Path;
use std::sync::{Arc, Mutex};

use futures::TryStreamExt;
use sqlx::{Row, SqlitePool};

use super::checksums;
use super::closing::Closing;
use super::error::{aborted, is_damage, made_by_newer, opening, unopenable, unreadable};
use super::handle::SqliteStore;
use super::load;
use super::lock::Identity;
use super::memory::Memory;
use super::open::{readers, writing};
use super::options::Options;
use super::tables::{self, Tables};
use super::writer::Writer;
use crate::domain::EnvironmentId;
use crate::store::StoreError;

/// The most lines of SQLite's own check that are told.
const MOST_TOLD: usize = 100;

/// Opens a database for reading. Every call that would write fails.
pub(super) async fn inspect(path: &Path, options: Options) -> Result<SqliteStore, StoreError> {
    let file = Identity::of_file(path)?;
    let closing = Closing::default();
    let readers = readers(&file, &closing)
        .await
        .map_err(|error| unseen(path, error))?;
    let memory = Arc::new(Memory::new(options.cache_cells, options.look_again_after));

    let mut reader = readers
        .acquire()
        .await
        .map_err(|error| unseen(path, error))?;
    match tables::look(&mut reader)
        .await
        .map_err(|error| unseen(path, error))?
    {
        Tables::None | Tables::Foreign | Tables::Ours(0) => {
            return Err(unopenable(
                path,
                "it is no database of nudge; name its directory with --data",
            ));
        }
        Tables::Newer => return Err(made_by_newer(path)),
        Tables::Damaged(what) => return Err(StoreError::Damaged(what)),
        Tables::Ours(_) => memory
            .directory
            .replace(load::environments(&mut reader).await?),
    }
    drop(reader);

    let writer = Writer::new(writing(path), file, Arc::clone(&memory));
    writer.close().await.map_err(aborted)?;
    let (path, quotas, lock) = (path.to_owned(), options.quotas, Mutex::new(None));
    Ok(SqliteStore {
        path,
        quotas,
        memory,
        writer,
        readers,
        closing,
        fold_from: options.fold_from,
        compacting: tokio::sync::Mutex::default(),
        lock,
    })
}

/// An error while looking: damage is what was looked for, and everything else keeps from looking.
fn unseen(path: &Path, error: sqlx::Error) -> StoreError {
    if is_damage(&error) {
        unreadable(error)
    } else {
        opening(path, &error)
    }
}

/// Returns what is wrong with the database as a whole. Empty where all is well.
pub(super) async fn integrity(readers: &SqlitePool) -> Result<Vec<String>, StoreError> {
    let mut lines = pages(readers, "pragma integrity_check(100)").await?;
    if lines.is_empty() && has_table(readers, "packed").await? {
        lines.extend(strays(readers).await?);
    }
    Ok(lines)
}

/// Returns how many rows of counts are in no environment's block, where there are any: whoever is
/// given that block would take them for its own.
async fn strays(readers: &SqlitePool) -> Result<Option<String>, StoreError> {
    let text = "select count(*) from packed
         where id >> 44 not in (select block from environments where block is not null)";
    let strays: i64 = sqlx::query_scalar(text)
        .fetch_one(readers)
        .await
        .map_err(unreadable)?;
    Ok((strays > 0).then(|| format!("{strays} rows of counts belong to no environment")))
}

/// Returns what SQLite's own check finds: pages, indices, types and constraints, of one table or of
/// all.
pub(super) async fn pages(
    readers: &SqlitePool,
    check: &'static str,
) -> Result<Vec<String>, StoreError> {
    let rows = sqlx::query(check).fetch_all(readers).await;

    let lines = rows.and_then(|rows| {
        rows.iter()
            .map(|row| row.try_get::<String, _>(0))
            .collect::<Result<Vec<_>, _>>()
    });
    match lines.map_err(unreadable) {
        Ok(lines) if lines == ["ok"] => Ok(Vec::new()),
        Ok(lines) => Ok(lines
            .iter()
            .flat_map(|line| line.lines())
            .take(MOST_TOLD)
            .map(str::to_owned)
            .collect()),
        Err(StoreError::Damaged(why)) => Ok(vec![why]),
        Err(error) => Err(error),
    }
}

/// Returns whether a database has a table.
pub(super) async fn has_table(readers: &SqlitePool, name: &str) -> Result<bool, StoreError> {
    let found =
        sqlx::query("select 1 from sqlite_schema where type = 'table' and name = ?").bind(name);
    Ok(found
        .fetch_optional(readers)
        .await
        .map_err(unreadable)?
        .is_some())
}

/// Returns which rows of an environment are not as they were written, of those that are not told to
/// be damaged where they are read: its producers, and the last version of its networks.
pub(super) async fn damaged_rows(
    readers: &SqlitePool,
    id: EnvironmentId,
) -> Result<Vec<String>, StoreError> {
    let mut damaged = Vec::new();
    let text = "select * from producers where environment = ? order by id";
    let mut producers = sqlx::query(text).bind(id.0).fetch(readers);
    while let Some(row) = producers.try_next().await.map_err(unreadable)? {
        if !checksums::is_sound_producer(&row).map_err(unreadable)? {
            let name: &str = row.try_get("name").map_err(unreadable)?;
            damaged.push(format!("producer `{name}`: it is not as it was written"));
        }
    }
    drop(producers);
    damaged.truncate(MOST_TOLD);

    if has_table(readers, "model_versions").await? {
        let text = "select * from model_versions where environment = ?";
        let row = sqlx::query(text).bind(id.0).fetch_optional(readers).await;
        let row = row.map_err(unreadable)?;
        let is_sound = row.as_ref().map(checksums::is_sound_last_version);
        let is_sound = is_sound.transpose().map_err(unreadable)?;
        if is_sound == Some(false) || is_last_passed(readers, id).await? {
            damaged.push("the last version of its networks is not as it was written".to_owned());
        }
    }
    Ok(damaged)
}

/// Returns whether an environment has a network of a later version than its last: the row that says
/// which that is may have become another's, or nobody's.
async fn is_last_passed(readers: &SqlitePool, id: EnvironmentId) -> Result<bool, StoreError> {
    let text = "select exists (select 1 from models where environment = ?1 and version > coalesce(
             (select last from model_versions where environment = ?1), 0))";
    let passed = sqlx::query_scalar(text).bind(id.0).fetch_one(readers).await;
    passed.map_err(unreadable)
}
