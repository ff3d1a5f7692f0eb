//! Removing an environment: at once for everybody, and then its rows in small steps, so that the commits of others need not wait for millions of them.
//!
//! Without a name and without totals it is gone: no commit and no read finds it. Rows that were left by an interrupted removal go when the store is
//! opened.

use sqlx::sqlite::SqliteConnection;

use super::error::aborted;
use super::known::Known;
use super::writer::{Memory, Writer};
use crate::domain::EnvironmentId;
use crate::store::StoreError;

/// Removes an environment with its counts, receipts, watermarks and models.
pub(super) async fn delete(writer: &Writer, id: EnvironmentId) -> Result<(), StoreError> {
    let mut transaction = writer.begin().await?;
    if !hide(transaction.connection(), id).await.map_err(aborted)? {
        transaction.end().await?;
        return Err(StoreError::UnknownEnvironment);
    }
    let forget = |memory: &Memory, known: &mut Known| {
        memory.directory.remove(id);
        memory.cache.forget(id);
        memory.actions.forget(id);
        known.forget(id);
    };
    transaction.commit(forget).await?;
    if let Err(error) = sweep(writer).await {
        tracing::warn!(%error, "the rows of a removed environment are left; they go at the next start");
    }
    Ok(())
}

/// Removes the rows of environments that are gone.
pub(super) async fn sweep(writer: &Writer) -> Result<(), StoreError> {
    loop {
        let mut transaction = writer.begin().await?;
        let Some(id) = next_gone(transaction.connection()).await.map_err(aborted)? else {
            return transaction.end().await;
        };
        step(transaction.connection(), id).await.map_err(aborted)?;
        transaction.commit(|_, _| ()).await?;
    }
}

async fn hide(connection: &mut SqliteConnection, id: EnvironmentId) -> Result<bool, sqlx::Error> {
    let text = "update environments set name = null where id = ? and name is not null";
    let found = sqlx::query(text).bind(id.0).execute(&mut *connection).await?.rows_affected() == 1;
    sqlx::query("delete from totals where environment = ?").bind(id.0).execute(connection).await?;
    Ok(found)
}

async fn next_gone(connection: &mut SqliteConnection) -> Result<Option<i64>, sqlx::Error> {
    sqlx::query_scalar("select id from environments where name is null limit 1").fetch_optional(connection).await
}

/// Removes some rows, those first that refer to others. The first part with something left is all of a step.
async fn step(connection: &mut SqliteConnection, id: i64) -> Result<(), sqlx::Error> {
    const PARTS: [&[&str]; 4] = [
        &[
            "delete from cells where state in (select id from states where environment = ? order by key limit 500)",
            "delete from states where id in (select id from states where environment = ? order by key limit 500)",
        ],
        &[
            "delete from batches where producer in
             (select id from producers where environment = ? order by name limit 20)",
            "delete from producers where id in (select id from producers where environment = ? order by name limit 20)",
        ],
        // Few: a model may have some MiB.
        &["delete from models where rowid in
           (select rowid from models where environment = ? order by version limit 5)"],
        &[
            "delete from model_versions where environment = ?",
            "delete from fits where environment = ?",
            "delete from segments where environment = ?",
            "delete from environments where id = ?",
        ],
    ];
    for part in PARTS {
        let mut removed = 0;
        for text in part {
            removed = sqlx::query(*text).bind(id).execute(&mut *connection).await?.rows_affected();
        }
        if removed > 0 {
            return Ok(());
        }
    }
    Ok(())
}
