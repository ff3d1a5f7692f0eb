//! Persistence of fits: the last prior that was fitted (empirical Bayes) to each pair of agents.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqlitePool};

use super::checksums;
use super::directory::Directory;
use super::error::{aborted, unreadable};
use super::writer::Writer;
use crate::domain::{EnvironmentId, FitId};
use crate::store::{FitRecord, StoreError};

/// Returns the fits of an environment, in order of pair.
pub(super) async fn fits(
    readers: &SqlitePool,
    id: EnvironmentId,
) -> Result<Vec<FitRecord>, StoreError> {
    let rows = sqlx::query("select * from fits where environment = ? order by pair")
        .bind(id.0)
        .fetch_all(readers)
        .await
        .map_err(unreadable)?;
    rows.iter()
        .map(|row| read_fit(row).map_err(unreadable))
        .collect()
}

fn read_fit(row: &SqliteRow) -> Result<FitRecord, sqlx::Error> {
    let whole = |name| row.try_get::<i64, _>(name).map(i64::unsigned_abs);
    let mut fit = FitRecord {
        pair: row.try_get("pair")?,
        id: FitId {
            version: whole("version")?,
            revision: whole("revision")?,
        },
        body: row.try_get("body")?,
        is_sound: true,
    };
    fit.is_sound = checksums::is_sound(row, |row| Ok(checksum(row.try_get("environment")?, &fit)))?;
    Ok(fit)
}

fn checksum(environment: i64, fit: &FitRecord) -> i64 {
    let numbers = [fit.id.version, fit.id.revision].map(u64::cast_signed);
    checksums::fit(environment, &fit.pair, numbers, &fit.body)
}

/// Keeps a fit in place of the one of its pair.
pub(super) async fn keep(
    writer: &Writer,
    directory: &Directory,
    id: EnvironmentId,
    fit: &FitRecord,
) -> Result<(), StoreError> {
    let mut transaction = writer.begin().await?;
    // Looked up after `begin`: an environment that is gone must not get rows again.
    if directory.of_id(id).is_none() {
        transaction.end().await?;
        return Err(StoreError::UnknownEnvironment);
    }

    let text = "insert or replace into fits (environment, pair, version, revision, body, checksum)
         values (?, ?, ?, ?, ?, ?)";
    sqlx::query(text)
        .bind(id.0)
        .bind(&fit.pair)
        .bind(fit.id.version.cast_signed())
        .bind(fit.id.revision.cast_signed())
        .bind(&fit.body)
        .bind(checksum(id.0, fit))
        .execute(transaction.connection())
        .await
        .map_err(aborted)?;
    transaction.commit(|_, _| ()).await
}
