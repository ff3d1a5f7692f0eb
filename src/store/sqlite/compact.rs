//! Compaction, in the background: merging runs in memory, folding the journal into rows, and moving
//! what an earlier build counted into rows. Each step is short; whatever interrupts it, the next one
//! goes on.

use std::sync::{Arc, LazyLock};

use sqlx::sqlite::SqliteConnection;
use sqlx::{Row, SqlitePool};

use super::error::{aborted, spoiled, unreadable};
use super::journal;
use super::layout::Layout;
use super::memory::Memory;
use super::rows::ManyRows;
use super::stored_forms;
use super::writer::{Transaction, Writer};
use crate::domain::EnvironmentId;
use crate::store::StoreError;
use crate::store::map::Map;
use crate::store::packed::fold::{Folded, RowDelta};
use crate::store::packed::run::Run;
use crate::store::packed::size::Size;
use crate::store::packed::unfolded::Mark;

/// Rows that a step writes: a commit waits for them at most.
const ROWS: usize = 1_024;

/// Merges runs of a tier into one of the next.
pub(super) async fn merge(
    memory: &Memory,
    id: EnvironmentId,
    tier: usize,
    runs: Vec<Run>,
) -> Result<(), StoreError> {
    let merged = {
        let runs = runs.clone();
        apart(move || Run::merge(&runs)).await?
    };
    let merged = merged.map_err(|_| spoiled("the journal of counts"))?;
    memory.pending.merged(id, tier, &runs, merged);
    Ok(())
}

/// Folds some rows of an environment's journal, and returns whether the fold goes on.
pub(super) async fn fold(
    writer: &Writer,
    readers: &SqlitePool,
    memory: &Memory,
    id: EnvironmentId,
) -> Result<bool, StoreError> {
    let Some((view, mark)) = memory.pending.freeze(id) else {
        return Ok(false);
    };
    let Some(layout) = view.layout else {
        return Ok(false);
    };
    // What an earlier fold has left would be taken for this one's after a restart.
    if mark.next_row == Some(0) {
        trim(writer, id).await?;
    }
    let unfolded = Arc::clone(&view.unfolded);
    let slice = apart(move || unfolded.slice(ROWS)).await?;
    let slice = slice.map_err(|_| spoiled("the journal of counts"))?;
    let folded = onto_rows(readers, layout, slice.rows).await?;

    let mut transaction = writer.begin().await?;
    let begun = memory
        .pending
        .view(id)
        .and_then(|view| view.unfolded.mark());
    if begun != Some(mark) {
        // The environment is gone, or memory began anew meanwhile.
        transaction.end().await?;
        return Ok(true);
    }
    write(transaction.connection(), layout, &folded)
        .await
        .map_err(aborted)?;
    let mut new = Size::default();
    folded.iter().for_each(|(_, row)| new += row.new);
    note(&mut transaction, id, slice.mark, new)
        .await
        .map_err(aborted)?;
    let remember = |memory: &Memory| memory.pending.folded(id, slice.mark, new.cells);
    transaction.commit(|memory, _| remember(memory)).await?;
    if slice.mark.next_row.is_none() {
        trim(writer, id).await?;
    }
    Ok(slice.mark.next_row.is_some())
}

/// Computes beside the threads that serve.
async fn apart<T: Send + 'static>(
    compute: impl FnOnce() -> T + Send + 'static,
) -> Result<T, StoreError> {
    let computed = tokio::task::spawn_blocking(compute).await;
    computed.map_err(|error| StoreError::Unreadable(error.to_string()))
}

/// Reads the rows as they are, and adds to each. Nobody else changes rows.
pub(super) async fn onto_rows(
    readers: &SqlitePool,
    layout: Layout,
    deltas: Vec<RowDelta>,
) -> Result<Vec<(i64, Folded)>, StoreError> {
    let ids: Vec<i64> = deltas.iter().map(|delta| layout.id(delta.row)).collect();
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    let mut stored = select(&mut reader, &ids).await?;
    drop(reader);
    apart(move || {
        let mut folded = Vec::with_capacity(deltas.len());
        for (id, delta) in ids.into_iter().zip(deltas) {
            folded.push((id, onto(layout, id, &delta, stored.remove(&id))?));
        }
        Ok(folded)
    })
    .await?
}

/// Adds to a row.
pub(super) fn onto(
    layout: Layout,
    id: i64,
    delta: &RowDelta,
    stored: Option<Vec<u8>>,
) -> Result<Folded, StoreError> {
    let environment = layout.name(id).environment;
    let folded = delta.onto(environment, stored.as_deref());
    folded.map_err(|_| spoiled(&format!("row {} of the counts", delta.row)))
}

/// Returns rows by their ids.
pub(super) async fn select(
    connection: &mut SqliteConnection,
    ids: &[i64],
) -> Result<Map<i64, Vec<u8>>, StoreError> {
    let text = "select id, cells from packed where id in (select value from json_each(?))";
    let rows = sqlx::query(text)
        .bind(stored_forms::json_numbers(ids.iter().copied()))
        .fetch_all(connection)
        .await
        .map_err(unreadable)?;
    let mut stored = Map::default();
    for row in rows {
        let id = row.try_get(0).map_err(unreadable)?;
        stored.insert(id, row.try_get(1).map_err(unreadable)?);
    }
    Ok(stored)
}

/// Writes rows.
pub(super) async fn write(
    connection: &mut SqliteConnection,
    layout: Layout,
    rows: &[(i64, Folded)],
) -> Result<(), sqlx::Error> {
    static UPSERT: LazyLock<ManyRows> = LazyLock::new(|| {
        ManyRows::new(
            "insert into packed (id, cells) values",
            "(?, ?)",
            "on conflict do update set cells = excluded.cells",
        )
    });
    debug_assert!(
        rows.iter()
            .all(|(id, _)| (layout.first()..=layout.last()).contains(id))
    );
    for (text, chunk) in UPSERT.chunks(rows) {
        let mut query = sqlx::query(text);
        for (id, row) in chunk {
            query = query.bind(*id).bind(&row.bytes[..]);
        }
        query.execute(&mut *connection).await?;
    }
    Ok(())
}

/// Writes how far the fold is, and what is new.
async fn note(
    transaction: &mut Transaction<'_>,
    id: EnvironmentId,
    mark: Mark,
    new: Size,
) -> Result<(), sqlx::Error> {
    let text = "update totals set folded = ?, fold_row = ?, states = states + ?, cells = cells + ? where environment = ?";
    sqlx::query(text)
        .bind(mark.upto)
        .bind(mark.next_row.map(|row| row as i64))
        .bind(new.states as i64)
        .bind(new.cells as i64)
        .bind(id.0)
        .execute(transaction.connection())
        .await?;
    Ok(())
}

/// Removes entries of the journal that are in rows, by and by.
async fn trim(writer: &Writer, id: EnvironmentId) -> Result<(), StoreError> {
    loop {
        let mut transaction = writer.begin().await?;
        let removed = journal::trim(transaction.connection(), id).await;
        match removed.map_err(aborted)? {
            0 => return transaction.end().await,
            _ => transaction.commit(|_, _| ()).await?,
        }
    }
}
