//! Look-ups of states and cells that exist, through the row id cache.

use std::sync::LazyLock;

use sqlx::Row;
use sqlx::sqlite::SqliteConnection;

use crate::domain::{EnvironmentId, StateKey};
use crate::store::sqlite::row_id_cache::{CellKey, RowIdCache};
use crate::store::sqlite::rows::ManyRows;
use crate::store::sqlite::stored_forms;

/// States a statement; their keys are one text.
const KEYS: usize = 1_000;

/// Returns the id of each state that exists. Hot states come from memory.
pub(super) async fn states(
    connection: &mut SqliteConnection,
    row_ids: &mut RowIdCache,
    environment: EnvironmentId,
    keys: &[&StateKey],
) -> Result<Vec<Option<i64>>, sqlx::Error> {
    let mut found: Vec<Option<i64>> = keys
        .iter()
        .map(|key| row_ids.state_id(environment, key))
        .collect();

    let missing: Vec<usize> = (0..keys.len()).filter(|at| found[*at].is_none()).collect();
    for chunk in missing.chunks(KEYS) {
        for (at, id) in
            select_states(connection, environment, chunk.iter().map(|at| keys[*at])).await?
        {
            let at = chunk[at];
            found[at] = Some(id);
            row_ids.add_state(environment, keys[at], id);
        }
    }
    Ok(found)
}

async fn select_states(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    keys: impl Iterator<Item = &StateKey>,
) -> Result<Vec<(usize, i64)>, sqlx::Error> {
    let rows = sqlx::query(
        "select wanted.key, states.id from json_each(?2) as wanted
         cross join states on states.environment = ?1 and states.key = wanted.value",
    )
    .bind(environment.0)
    .bind(stored_forms::json_texts(keys))
    .fetch_all(connection)
    .await?;
    rows.iter()
        .map(|row| Ok((row.try_get::<i64, _>(0)? as usize, row.try_get(1)?)))
        .collect()
}

/// Returns how many of these cells exist; each is given once. Hot cells come from memory.
pub(super) async fn count_cells(
    connection: &mut SqliteConnection,
    row_ids: &mut RowIdCache,
    cells: &[CellKey],
) -> Result<u64, sqlx::Error> {
    let mut unknown: Vec<CellKey> = cells
        .iter()
        .filter(|cell| !row_ids.has_cell(cell))
        .copied()
        .collect();
    // In the order of the table, so that neighbours are on one page.
    unknown.sort_unstable();

    let remembered = (cells.len() - unknown.len()) as u64;
    Ok(remembered + select_count(connection, &unknown).await?)
}

async fn select_count(
    connection: &mut SqliteConnection,
    cells: &[CellKey],
) -> Result<u64, sqlx::Error> {
    static COUNT: LazyLock<ManyRows> = LazyLock::new(|| {
        ManyRows::new(
            "select count(*) from (values",
            "(?, ?, ?)",
            ") as wanted cross join cells
             on cells.state = wanted.column1 and cells.segment = wanted.column2 and cells.joint = wanted.column3",
        )
    });

    let mut present = 0;
    for (text, chunk) in COUNT.chunks(cells) {
        let mut query = sqlx::query_scalar(text);
        for (state, segment, joint) in chunk {
            query = query.bind(*state).bind(*segment).bind(*joint);
        }
        let count: i64 = query.fetch_one(&mut *connection).await?;
        present += count.unsigned_abs();
    }
    Ok(present)
}
