//! Removing an environment: a tombstone at once, and then garbage collection of its rows in steps,
//! so small that the commits of others hardly wait.
//!
//! Without a name and without totals it is gone: no commit and no read finds it, and its name is
//! free. What is left of it is remembered with the other memory of the database, so that whatever
//! interrupts a removal, a failed transaction or kill -9, the next connection finds what is to be
//! done.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use futures::TryStreamExt;
use sqlx::sqlite::{SqliteConnection, SqliteRow};
use sqlx::{Row, SqlitePool};

use super::error::{aborted, unreadable};
use super::layout::{Layout, Numbering};
use super::leftovers::{Removal, Removals, Step};
use super::memory::Memory;
use super::row_id_cache::RowIdCache;
use super::stored_forms;
use super::walk::cells_of;
use super::writer::Writer;
use crate::domain::EnvironmentId;
use crate::store::StoreError;
use crate::store::packed::checked;
use crate::store::packed::run::Run;

/// Removes an environment for everybody, and leaves its rows to [`sweep`]: so many states, where
/// that is known.
pub(super) async fn delete(
    writer: &Writer,
    id: EnvironmentId,
    states: Option<u64>,
) -> Result<(), StoreError> {
    let mut transaction = writer.begin().await?;
    let Some(left) = hide(transaction.connection(), id, states)
        .await
        .map_err(aborted)?
    else {
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
    states: Option<u64>,
) -> Result<Option<Removal>, sqlx::Error> {
    let text = "update environments set name = null, checksum = null where id = ? and name is not null returning uid";
    let Some(uid) = sqlx::query_scalar(text)
        .bind(id.0)
        .fetch_optional(&mut *connection)
        .await?
    else {
        return Ok(None);
    };
    let text = "delete from totals where environment = ?";
    sqlx::query(text).bind(id.0).execute(connection).await?;
    Ok(Some(Removal {
        states,
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
            // Only told: where it cannot be counted, the removal itself says why.
            removal.states = count(readers, removal.id).await.ok();
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

/// Counts the states of rows, of the journal and of the old table. What the journal has that is in
/// rows already is there once.
async fn count(readers: &SqlitePool, id: i64) -> Result<u64, StoreError> {
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    let in_table = sqlx::query_scalar("select count(*) from states where environment = ?");
    let in_table: i64 = in_table
        .bind(id)
        .fetch_one(&mut *reader)
        .await
        .map_err(unreadable)?;
    if is_listed(&mut reader, id).await.map_err(unreadable)? {
        return Ok(in_table.unsigned_abs());
    }

    let mut states = BTreeSet::new();
    let text = "select packed.id, packed.cells, environments.block, null
         from environments cross join packed
             on packed.id between environments.block << 44 and (environments.block << 44) + (1 << 44) - 1
         where environments.id = ?1
         union all select journal.id, null, null, cells from journal where environment = ?1";
    let mut blobs = sqlx::query(text).bind(id).fetch(&mut *reader);
    while let Some(row) = blobs.try_next().await.map_err(unreadable)? {
        states.extend(states_of(&row, id).map_err(unreadable)?);
        tokio::task::consume_budget().await;
    }
    Ok(states.len() as u64 + in_table.unsigned_abs())
}

/// Returns the states of a row or of an entry of the journal; none where it is damaged.
fn states_of(row: &SqliteRow, environment: i64) -> Result<BTreeSet<u64>, sqlx::Error> {
    let number: i64 = row.try_get(0)?;
    let cells = match row.try_get::<Option<i64>, _>(2)? {
        Some(block) => {
            let layout = Layout::new(EnvironmentId(environment), block);
            cells_of(layout.name(number), row.try_get(1)?).unwrap_or_default()
        }
        None => {
            let run = checked::cells([environment, number], row.try_get(3)?).and_then(Run::read);
            run.map_or_else(|_| Vec::new(), |run| run.from(0).flatten().collect())
        }
    };
    Ok(cells.into_iter().map(|(place, _)| place.state).collect())
}

/// Returns whether the states of an environment are those of the table of states. One whose schema
/// cannot be read has none that are told.
async fn is_listed(connection: &mut SqliteConnection, id: i64) -> Result<bool, sqlx::Error> {
    let text = "select schema from environments where id = ?";
    let schema: String = sqlx::query_scalar(text)
        .bind(id)
        .fetch_one(connection)
        .await?;
    let schema = stored_forms::read_schema(&schema);
    Ok(schema.is_ok_and(|schema| Numbering::of(&schema) == Numbering::Listed))
}

/// What is removed together: those first that refer to others. Of each at most so many rows; a
/// model may have some MiB.
const PARTS: [&[&str]; 8] = [
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
const STATES: usize = 1;

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
    let is_listed = is_listed(transaction.connection(), id)
        .await
        .map_err(aborted)?;
    let removed = remove_rows(transaction.connection(), id, rows).await?;
    if removed.rows > 0 {
        step.states = if is_listed { 0 } else { removed.states };
        step.took = started.elapsed();
        step.is_last = false;
        transaction.commit(|_, _| ()).await?;
        return Ok(step);
    }

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

/// Rows of states that were removed.
#[derive(Default)]
struct RemovedRows {
    rows: u64,
    states: u64,
}

/// Removes rows of states, and tells how many states they had.
async fn remove_rows(
    connection: &mut SqliteConnection,
    id: i64,
    rows: u32,
) -> Result<RemovedRows, StoreError> {
    // Where damage lets it have another's block, the rows are the other's.
    let text = "delete from packed where id in (
             select packed.id from environments cross join packed
                 on packed.id between environments.block << 44 and (environments.block << 44) + (1 << 44) - 1
             where environments.id = ?1 and not exists (
                 select 1 from environments as others where others.id <> ?1 and others.block = environments.block
             ) limit ?2)
         returning id, cells, (select block from environments where environments.id = ?1)";
    let blobs = sqlx::query(text).bind(id).bind(rows).fetch_all(connection);
    let mut removed = RemovedRows::default();
    for row in blobs.await.map_err(aborted)? {
        removed.rows += 1;
        removed.states += states_of(&row, id).map_err(aborted)?.len() as u64;
    }
    Ok(removed)
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
