//! Removing an environment: a tombstone at once, and then garbage collection of its rows in steps,
//! so small that the commits of others hardly wait.
//!
//! Without a name and without totals it is gone: no commit and no read finds it, and its name is
//! free. What is left of it is remembered with the other memory of the database, so that whatever
//! interrupts a removal, a failed transaction or kill -9, the next connection finds what is to be
//! done.

use std::time::{Duration, Instant};

use sqlx::SqlitePool;
use sqlx::sqlite::SqliteConnection;

use super::error::aborted;
use super::leftovers::{Removal, Removals, Step};
use super::memory::Memory;
use super::row_id_cache::RowIdCache;
use super::writer::Writer;
use crate::domain::EnvironmentId;
use crate::store::StoreError;

/// Removes an environment for everybody, and leaves its rows to [`sweep`].
pub(super) async fn delete(writer: &Writer, id: EnvironmentId) -> Result<(), StoreError> {
    let mut transaction = writer.begin().await?;
    let Some(left) = hide(transaction.connection(), id).await.map_err(aborted)? else {
        transaction.end().await?;
        return Err(StoreError::UnknownEnvironment);
    };
    let forget = |memory: &Memory, row_ids: &mut RowIdCache| {
        memory.directory.remove(id);
        memory.cache.forget(id);
        memory.actions.forget(id);
        memory.pending.forget(id);
        row_ids.forget(id);
        memory.removals.add(left);
    };
    transaction.commit(forget).await
}

async fn hide(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<Option<Removal>, sqlx::Error> {
    let text =
        "update environments set name = null where id = ? and name is not null returning uid";
    let Some(uid) = sqlx::query_scalar(text)
        .bind(id.0)
        .fetch_optional(&mut *connection)
        .await?
    else {
        return Ok(None);
    };
    let text = "delete from totals where environment = ? returning states";
    let states: Option<i64> = sqlx::query_scalar(text)
        .bind(id.0)
        .fetch_optional(connection)
        .await?;
    Ok(Some(Removal {
        states: states.map(i64::unsigned_abs),
        ..Removal::new(id.0, uid)
    }))
}

/// Waits until an environment is gone and has rows left, and removes some of them.
pub(super) async fn sweep(
    writer: &Writer,
    readers: &SqlitePool,
    removals: &Removals,
) -> Result<(), StoreError> {
    let removal = removals.next().await;
    if !removal.begun {
        begin(readers, removals).await;
    }
    let swept = step(writer, removal.id, removals.rows()).await;
    match &swept {
        Ok(step) => {
            removals.swept(removal.id, step);
            // Where it fails, a commit does it.
            writer.checkpoint().await.ok();
        }
        Err(error) => removals.failed(removal.id, error),
    }
    swept.map(drop)
}

/// Says in the log what is to be removed, and counts it where that is not known.
async fn begin(readers: &SqlitePool, removals: &Removals) {
    for mut removal in removals.unbegun() {
        if removal.states.is_none() {
            let counted = sqlx::query_scalar("select count(*) from states where environment = ?")
                .bind(removal.id);
            // Only told: where it cannot be counted, the removal itself says why.
            removal.states = counted.fetch_one(readers).await.ok().map(i64::unsigned_abs);
        }
        let Removal { uid, states, .. } = &removal;
        tracing::info!(
            uid,
            states,
            "removing what a deleted environment has left, in the background"
        );
        removals.begun(removal);
    }
}

/// What is removed together: those first that refer to others. Of each at most so many rows; a
/// model may have some MiB.
const PARTS: [&[&str]; 9] = [
    &["delete from packed where id in (
             select packed.id from environments cross join packed
                 on packed.id between environments.block << 44 and (environments.block << 44) + (1 << 44) - 1
             where environments.id = ?1 limit ?2)"],
    &["delete from journal where id in (
             select id from journal where environment = ?1 order by id limit min(?2, 16))"],
    &[
        "delete from cells where (state, segment, joint) in (
             select state, segment, joint from cells
             where state in (select id from states where environment = ?1 order by key limit ?2) limit ?2)",
        "delete from states where id in (select id from states where environment = ?1 order by key limit ?2)",
    ],
    &[
        "delete from batches where (producer, sequence) in (
             select producer, sequence from batches
             where producer in (select id from producers where environment = ?1 order by name limit ?2) limit ?2)",
        "delete from producers where id in (select id from producers where environment = ?1 order by name limit ?2)",
    ],
    &["delete from models where rowid in
           (select rowid from models where environment = ?1 order by version limit min(?2, 1))"],
    &["delete from segments where id in (select id from segments where environment = ?1 order by label limit ?2)"],
    &["delete from fits where environment = ?1 and pair in
           (select pair from fits where environment = ?1 order by pair limit ?2)"],
    &["delete from model_versions where environment = ?1 and ?2 > 0"],
    &["delete from environments where id = ?1 and name is null and ?2 > 0"],
];

/// The part of [`PARTS`] that has the table of states.
const STATES: usize = 2;

/// Removes the first part with something left, or some of it.
async fn step(writer: &Writer, id: i64, rows: u32) -> Result<Step, StoreError> {
    let mut transaction = writer.begin().await?;
    let started = Instant::now();
    // Where nothing at all is left, that was it.
    let mut step = Step {
        states: 0,
        took: Duration::ZERO,
        is_last: true,
    };
    for (at, part) in PARTS.iter().enumerate() {
        let removed = remove(transaction.connection(), part, id, rows)
            .await
            .map_err(aborted)?;
        if removed.iter().any(|removed| *removed > 0) {
            step.states = if at == STATES { removed[1] } else { 0 };
            step.is_last = at + 1 == PARTS.len();
            break;
        }
    }
    step.took = started.elapsed();
    transaction.commit(|_, _| ()).await?;
    Ok(step)
}

/// Runs the statements of a part, as far as one before has left nothing that refers to what the
/// next removes.
async fn remove(
    connection: &mut SqliteConnection,
    part: &[&'static str],
    id: i64,
    rows: u32,
) -> Result<[u64; 2], sqlx::Error> {
    let mut removed = [0; 2];
    for (text, removed) in part.iter().zip(&mut removed) {
        *removed = sqlx::query(*text)
            .bind(id)
            .bind(rows)
            .execute(&mut *connection)
            .await?
            .rows_affected();
        if *removed == u64::from(rows) {
            break;
        }
    }
    Ok(removed)
}
