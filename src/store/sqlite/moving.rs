//! Moving what an earlier build counted, a row a cell, into rows of sixteen states: in the
//! background, some states at a time. A state is either in the old tables or in rows, so whoever
//! reads both by one statement misses nothing and counts nothing twice.

use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::error::{aborted, unreadable};
use super::layout::{Layout, Numbering};
use super::lookup;
use super::old_cells::old_cells;
use super::stored_forms;
use super::walk::Placed;
use super::writer::Writer;
use super::{checksums, compact};
use crate::domain::{Environment, EnvironmentId};
use crate::store::StoreError;
use crate::store::packed::fold::RowDelta;
use crate::store::packed::row::row_of;

/// States that are moved together.
const STATES: i64 = 128;

/// Moves some states, and returns the cursor to go on after, unless all are moved. Where states keep
/// their ids, the cursor says which were moved.
pub(super) async fn step(
    writer: &Writer,
    environment: &Environment,
    after: i64,
) -> Result<Option<i64>, StoreError> {
    let mut transaction = writer.begin().await?;
    if !transaction.memory().directory.has(environment.id) {
        transaction.end().await?;
        return Ok(None);
    }
    let connection = transaction.connection();
    let old = select(connection, environment, after).await?;
    let (is_last, next) = (
        old.len() < STATES as usize,
        old.last().map_or(after, |state| state.id),
    );
    let layout = layout(connection, environment.id).await?;

    let deltas = deltas(&old);
    let ids: Vec<i64> = deltas.iter().map(|delta| layout.id(delta.row)).collect();
    let mut stored = compact::select(connection, &ids).await?;
    let mut rows = Vec::with_capacity(deltas.len());
    for (id, delta) in ids.into_iter().zip(&deltas) {
        rows.push((id, compact::onto(layout, id, delta, stored.remove(&id))?));
    }
    compact::write(connection, layout, &rows)
        .await
        .map_err(aborted)?;
    remove(connection, environment, &old)
        .await
        .map_err(aborted)?;
    if is_last {
        let text = "update totals set unmoved = 0 where environment = ?";
        let done = sqlx::query(text).bind(environment.id.0).execute(connection);
        done.await.map_err(aborted)?;
    }
    let id = environment.id;
    transaction
        .commit(|memory, _| memory.pending.moved(id, layout, !is_last))
        .await?;
    Ok((!is_last).then_some(next))
}

/// A state in the old tables.
struct Old {
    id: i64,
    cells: Vec<Placed>,
}

async fn select(
    connection: &mut SqliteConnection,
    environment: &Environment,
    after: i64,
) -> Result<Vec<Old>, StoreError> {
    let text = concat!(
        "select states.id, states.key, ",
        old_cells!("states.id"),
        " from states not indexed where states.environment = ?1 and states.id > ?2
         order by states.id limit ?3"
    );
    let rows = sqlx::query(text)
        .bind(environment.id.0)
        .bind(after)
        .bind(STATES)
        .fetch_all(connection)
        .await
        .map_err(unreadable)?;
    rows.iter().map(|row| read(row, environment)).collect()
}

fn read(row: &SqliteRow, environment: &Environment) -> Result<Old, StoreError> {
    let id: i64 = row.try_get(0).map_err(unreadable)?;
    let text: &str = row.try_get(1).map_err(unreadable)?;
    let key = lookup::stored_key(&environment.schema, text)?;
    let number = Numbering::of(&environment.schema).of_key(&environment.schema, &key);
    let number = number.unwrap_or(id.unsigned_abs());
    let cells = match row.try_get::<Option<&str>, _>(2).map_err(unreadable)? {
        Some(text) => lookup::old(text, environment, number)?,
        None => Vec::new(),
    };
    Ok(Old { id, cells })
}

fn deltas(old: &[Old]) -> Vec<RowDelta> {
    let mut cells: Vec<Placed> = old.iter().flat_map(|state| &state.cells).copied().collect();
    cells.sort_unstable_by_key(|(place, _)| *place);
    let rows = cells.chunk_by(|(a, _), (b, _)| row_of(a.state) == row_of(b.state));
    let delta = |cells: &[Placed]| {
        let mut delta = RowDelta::of(row_of(cells[0].0.state));
        let cells = cells.iter();
        cells.for_each(|(place, tally)| delta.push(*place, *tally));
        delta
    };
    rows.map(delta).collect()
}

/// States that are numbered by their ids keep them.
async fn remove(
    connection: &mut SqliteConnection,
    environment: &Environment,
    old: &[Old],
) -> Result<(), sqlx::Error> {
    let ids = stored_forms::json_numbers(old.iter().map(|state| state.id));
    let text = "delete from cells where state in (select value from json_each(?))";
    sqlx::query(text)
        .bind(ids.clone())
        .execute(&mut *connection)
        .await?;
    if Numbering::of(&environment.schema) == Numbering::Ranked {
        let text = "delete from states where id in (select value from json_each(?))";
        sqlx::query(text).bind(ids).execute(connection).await?;
    }
    Ok(())
}

/// Returns where the rows of an environment are, and gives it a block where it has none.
pub(super) async fn layout(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<Layout, StoreError> {
    let text = "select block from environments where id = ?";
    let block = sqlx::query_scalar(text).bind(id.0);
    let block: Option<i64> = block.fetch_one(&mut *connection).await.map_err(aborted)?;
    let block = match block {
        Some(block) => block,
        None => take_block(connection, id).await?,
    };
    Ok(Layout::new(id, block))
}

/// Gives an environment a block that is nobody's and has no rows, which damage may have left.
async fn take_block(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<i64, StoreError> {
    checksums::check(connection, id).await?;
    let text = "update environments set block = (
             select min(free) from (
                 select 1 as free union select block + 1 from environments where block is not null
                 union select (max(id) >> 44) + 1 from packed
             ) where free not in (select block from environments where block is not null)
                 and not exists (select 1 from packed where id between free << 44 and (free << 44) + (1 << 44) - 1)
         ) where id = ? returning block";
    let block = sqlx::query_scalar(text).bind(id.0);
    let block = block.fetch_one(&mut *connection).await.map_err(aborted)?;
    checksums::seal(connection, id).await?;
    Ok(block)
}
