//! The journal of counts: an entry a commit and environment, written with the commit and read when
//! a connection is new.

use std::collections::hash_map::Entry;
use std::sync::Arc;

use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::columns::{mark, whole};
use super::error::{spoiled, unreadable};
use super::layout::Layout;
use super::pending::{Fresh, View};
use crate::domain::EnvironmentId;
use crate::store::StoreError;
use crate::store::map::Map;
use crate::store::packed::checked;
use crate::store::packed::run::Run;
use crate::store::packed::unfolded::Unfolded;

/// Entries that go in one transaction, so that no commit waits long.
const TRIMMED: i64 = 16;

/// Writes an entry.
pub(super) async fn insert(
    connection: &mut SqliteConnection,
    id: i64,
    environment: EnvironmentId,
    run: &Run,
) -> Result<(), sqlx::Error> {
    let mut cells = checked::begin();
    cells.extend(run.bytes());
    sqlx::query("insert into journal (id, environment, cells) values (?, ?, ?)")
        .bind(id)
        .bind(environment.0)
        .bind(checked::end([environment.0, id], cells))
        .execute(connection)
        .await?;
    Ok(())
}

/// Removes some entries that are in rows, where no fold is under way, and returns how many.
pub(super) async fn trim(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
) -> Result<u64, sqlx::Error> {
    let done = sqlx::query(
        "delete from journal where id in (
             select journal.id from totals cross join journal on journal.environment = totals.environment
             where totals.environment = ?1 and totals.fold_row is null and journal.id <= totals.folded
             order by journal.id limit ?2)",
    )
    .bind(environment.0)
    .bind(TRIMMED)
    .execute(connection)
    .await?;
    Ok(done.rows_affected())
}

/// The journal as it is in the database.
pub(super) struct Loaded {
    pub(super) views: Map<EnvironmentId, View>,
    pub(super) last_entry: i64,
    /// Environments of which something cannot be read.
    pub(super) damaged: Vec<(EnvironmentId, String)>,
}

/// Reads the journal of one environment, or of all.
pub(super) async fn load(
    connection: &mut SqliteConnection,
    only: Option<EnvironmentId>,
) -> Result<Loaded, sqlx::Error> {
    let rows = sqlx::query(
        "select totals.environment, totals.transitions, totals.folded, totals.fold_row, totals.unmoved,
             environments.block, totals.cells, journal.id, journal.cells
         from totals cross join environments on environments.id = totals.environment
         left join journal on journal.environment = totals.environment
             and (journal.id > totals.folded or totals.fold_row is not null)
         where ?1 is null or totals.environment = ?1
         order by journal.id",
    )
    .bind(only.map(|id| id.0))
    .fetch_all(&mut *connection)
    .await?;
    let text = "select max(coalesce((select max(id) from journal), 0), coalesce((select max(folded) from totals), 0))";
    let mut loaded = Loaded {
        views: Map::default(),
        last_entry: sqlx::query_scalar(text).fetch_one(connection).await?,
        damaged: Vec::new(),
    };
    for row in &rows {
        let id = EnvironmentId(row.try_get(0)?);
        let view = match loaded.views.entry(id) {
            Entry::Occupied(view) => view.into_mut(),
            Entry::Vacant(place) => place.insert(view(row, id)?),
        };
        let Some(entry) = row.try_get::<Option<i64>, _>(7)? else {
            continue;
        };

        match run(row, id, entry) {
            Ok(run) => add(view, entry, run),
            Err(StoreError::Damaged(why)) => loaded.damaged.push((id, why)),
            Err(_) => unreachable!("bytes are sound or damaged"),
        }
    }
    Ok(loaded)
}

/// Reads the journal of one environment.
pub(super) async fn load_one(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<View, StoreError> {
    let mut loaded = load(connection, Some(id)).await.map_err(unreadable)?;
    if let Some((_, why)) = loaded.damaged.pop() {
        return Err(StoreError::Damaged(why));
    }
    loaded
        .views
        .remove(&id)
        .ok_or(StoreError::UnknownEnvironment)
}

fn view(row: &SqliteRow, id: EnvironmentId) -> Result<View, sqlx::Error> {
    let block: Option<i64> = row.try_get(5)?;
    Ok(View {
        unfolded: Arc::new(Unfolded::after(mark(row, 2)?)),
        revision: whole(row, 1)?,
        layout: block.map(|block| Layout::new(id, block)),
        unmoved: row.try_get::<i64, _>(4)? != 0,
        // It only says when to fold: where it is damaged, the audit tells.
        stored: row.try_get::<i64, _>(6).unwrap_or_default().max(0) as u64,
        fresh: Fresh::NONE,
    })
}

fn run(row: &SqliteRow, id: EnvironmentId, entry: i64) -> Result<Run, StoreError> {
    let bytes: &[u8] = row.try_get(8).map_err(unreadable)?;
    let run = checked::cells([id.0, entry], bytes).and_then(Run::read);
    run.map_err(|_| spoiled(&format!("entry {entry} of the journal")))
}

fn add(view: &mut View, entry: i64, run: Run) {
    view.fresh.cells += run.len() as u64;
    view.fresh.is_exact = false;
    Arc::make_mut(&mut view.unfolded).push(entry, run);
}
