//! Snapshot reads. Each is one statement, so it sees one moment, and ends before it returns, so it
//! does not hold up checkpoints of the write-ahead log.

use std::path::Path;
use std::sync::Arc;

use futures::TryStreamExt;
use sqlx::sqlite::{SqliteConnection, SqliteRow};
use sqlx::{Row, SqlitePool};

use super::cache::{CountsCache, Epoch};
use super::error::{spoiled, unreadable};
use super::packed::{self, packed_cells};
use super::stored_forms;
use super::walk::{Walk, all_states, own_states};
use crate::domain::{
    Cell, Counts, Environment, EnvironmentId, Label, ProducerId, SegmentId, Sequence, StateKey,
};
use crate::store::{ByVisits, Cursor, Held, Scanned, StateCounts, StoreError, Totals};
use crate::telemetry;

/// Returns the counts of states: what is cached from memory, the rest by one statement.
pub(super) async fn counts(
    readers: &SqlitePool,
    cache: &CountsCache,
    environment: &Environment,
    keys: &[StateKey],
) -> Result<Vec<StateCounts>, StoreError> {
    let id = environment.id;
    let (mut found, epoch) = cache.get(id, keys);
    let missing: Vec<usize> = (0..keys.len()).filter(|at| found[*at].is_none()).collect();
    telemetry::cached(keys.len() - missing.len(), missing.len());

    if !missing.is_empty() {
        let wanted: Vec<&StateKey> = missing.iter().map(|at| &keys[*at]).collect();
        let loaded = load(readers, environment, &wanted).await?;
        remember(cache, id, epoch, &wanted, &loaded);
        missing
            .into_iter()
            .zip(loaded)
            .for_each(|(at, counts)| found[at] = Some(counts));
    }
    Ok(found.into_iter().flatten().collect())
}

fn remember(
    cache: &CountsCache,
    id: EnvironmentId,
    epoch: Epoch,
    keys: &[&StateKey],
    loaded: &[StateCounts],
) {
    let Some(first) = loaded.first() else { return };
    let states = keys
        .iter()
        .zip(loaded)
        .map(|(key, state)| (StateKey::clone(key), Arc::clone(&state.counts)));
    cache.insert(id, epoch, first.revision, states);
}

/// Loads states with the environment's revision, from one snapshot.
async fn load(
    readers: &SqlitePool,
    environment: &Environment,
    keys: &[&StateKey],
) -> Result<Vec<StateCounts>, StoreError> {
    let text = concat!(
        "select wanted.key, totals.transitions, ",
        packed_cells!("states.id"),
        " from totals cross join json_each(?2) as wanted
         left join states on states.environment = ?1 and states.key = wanted.value
         where totals.environment = ?1"
    );
    let query = sqlx::query(text)
        .bind(environment.id.0)
        .bind(stored_forms::json_texts(keys));

    let mut loaded: Vec<Option<StateCounts>> = vec![None; keys.len()];
    // As they come: the rows of thousands of states together would be larger than their counts.
    let mut rows = query.fetch(readers);
    while let Some(row) = rows.try_next().await.map_err(unreadable)? {
        let at = whole(&row, 0).map_err(unreadable)? as usize;
        let revision = whole(&row, 1).map_err(unreadable)?;
        loaded[at] = Some(StateCounts {
            counts: Arc::new(counts_of(&row, 2, environment)?),
            revision,
        });
    }

    loaded
        .into_iter()
        .collect::<Option<_>>()
        .ok_or(StoreError::UnknownEnvironment)
}

/// Returns the next states after a cursor, in order of their ids.
pub(super) async fn scan(
    readers: &SqlitePool,
    environment: &Environment,
    after: Cursor,
    states: u32,
    walk: Walk,
) -> Result<Vec<Scanned>, StoreError> {
    macro_rules! text {
        ($states:ident) => {
            concat!(
                "select id, key, ",
                packed_cells!("states.id"),
                " from ",
                $states!(),
                " where environment = ?1 and id > ?2 order by id limit ?3"
            )
        };
    }
    let text = match walk {
        Walk::All => text!(all_states),
        Walk::Own => text!(own_states),
    };
    let mut rows = sqlx::query(text)
        .bind(environment.id.0)
        .bind(after.0)
        .bind(states)
        .fetch(readers);

    let mut page = Vec::new();
    while let Some(row) = rows.try_next().await.map_err(unreadable)? {
        page.push(scanned(&row, environment)?);
    }
    Ok(page)
}

/// The SQL of the first states by their visits. Where states are walked by id, so are their cells,
/// which lie in that order: a pass that seeks nothing and sorts no more than the page. A rank is
/// the number of visits, with a sign for the order.
macro_rules! by_visits_text {
    ($states:ident) => {
        concat!(
            "select chosen.id, chosen.key, ",
            packed_cells!("chosen.id"),
            ", totals.transitions
         from totals left join (
             select states.id as id, states.key as key, sum(cells.n) * ?2 as rank
             from ",
            $states!(),
            " cross join cells on cells.state = states.id
             where states.environment = ?1 and (?3 is null or cells.segment in (select value from json_each(?3)))
             group by states.id
             having sum(cells.n) >= ?4 and (?5 is null or sum(cells.n) * ?2 > ?5
                 or (sum(cells.n) * ?2 = ?5 and states.key > ?6 collate bins))
             order by rank, states.key collate bins limit ?7
         ) as chosen
         where totals.environment = ?1
         order by chosen.rank, chosen.key collate bins"
        )
    };
}

/// Returns the first states in an order of their visits, and the revision they are of.
pub(super) async fn by_visits(
    readers: &SqlitePool,
    environment: &Environment,
    wanted: &ByVisits,
    walk: Walk,
) -> Result<(Vec<Scanned>, u64), StoreError> {
    let text = match walk {
        Walk::All => by_visits_text!(all_states),
        Walk::Own => by_visits_text!(own_states),
    };
    let ByVisits {
        segments,
        min_visits,
        descending,
        after,
        states,
    } = wanted;

    let sign = if *descending { -1 } else { 1 };
    // No state has more visits than fit.
    let (least, states) =
        i64::try_from(*min_visits).map_or((i64::MAX, 0), |least| (least, *states));
    let rank = after
        .as_ref()
        .map(|(visits, _)| sign * i64::try_from(*visits).unwrap_or(i64::MAX));

    let query = sqlx::query(text)
        .bind(environment.id.0)
        .bind(sign)
        .bind(
            segments
                .as_ref()
                .map(|ids| stored_forms::json_numbers(ids.iter().map(|id| id.0))),
        )
        .bind(least)
        .bind(rank)
        .bind(after.as_ref().map(|(_, key)| key.to_string()))
        .bind(states);

    let (mut rows, mut page, mut revision) = (query.fetch(readers), Vec::new(), None);
    while let Some(row) = rows.try_next().await.map_err(unreadable)? {
        revision = Some(whole(&row, 3).map_err(unreadable)?);
        // An environment without such states is one row without a state.
        if row
            .try_get::<Option<i64>, _>(0)
            .map_err(unreadable)?
            .is_some()
        {
            page.push(scanned(&row, environment)?);
        }
    }

    Ok((page, revision.ok_or(StoreError::UnknownEnvironment)?))
}

fn scanned(row: &SqliteRow, environment: &Environment) -> Result<Scanned, StoreError> {
    let key: &str = row.try_get(1).map_err(unreadable)?;
    Ok(Scanned {
        cursor: Cursor(row.try_get(0).map_err(unreadable)?),
        key: StateKey::from_stored(key).ok_or_else(|| spoiled(&format!("state {key:?}")))?,
        counts: counts_of(row, 2, environment)?,
    })
}

/// Reads packed cells; a state without any has none.
fn counts_of(row: &SqliteRow, at: usize, environment: &Environment) -> Result<Counts, StoreError> {
    cells_of(row, at, environment).map(Counts::new)
}

/// Reads packed cells as they come, those of several states too.
pub(super) fn cells_of(
    row: &SqliteRow,
    at: usize,
    environment: &Environment,
) -> Result<Vec<Cell>, StoreError> {
    match row.try_get::<Option<&str>, _>(at).map_err(unreadable)? {
        None => Ok(Vec::new()),
        Some(text) => packed::cells(text, environment.schema.joint_actions())
            .ok_or_else(|| spoiled("a state's counts")),
    }
}

/// Returns the segments in order of label.
pub(super) async fn segments(
    readers: &SqlitePool,
    id: EnvironmentId,
) -> Result<Vec<(SegmentId, Option<Label>)>, StoreError> {
    let rows = sqlx::query("select id, label from segments where environment = ? order by label")
        .bind(id.0)
        .fetch_all(readers)
        .await
        .map_err(unreadable)?;
    rows.iter().map(segment).collect()
}

fn segment(row: &SqliteRow) -> Result<(SegmentId, Option<Label>), StoreError> {
    let text: &str = row.try_get(1).map_err(unreadable)?;
    let label = match text {
        "" => None,
        text => Some(
            text.parse()
                .map_err(|_| spoiled(&format!("segment {text:?}")))?,
        ),
    };
    Ok((SegmentId(row.try_get(0).map_err(unreadable)?), label))
}

/// Returns the totals of an environment.
pub(super) async fn totals(readers: &SqlitePool, id: EnvironmentId) -> Result<Totals, StoreError> {
    let row = sqlx::query(
        "select transitions, states, cells,
             (select count(*) from segments where segments.environment = totals.environment),
             (select count(*) from producers where producers.environment = totals.environment)
         from totals where environment = ?",
    )
    .bind(id.0)
    .fetch_optional(readers)
    .await
    .map_err(unreadable)?
    .ok_or(StoreError::UnknownEnvironment)?;

    let number = |at| whole(&row, at).map_err(unreadable);
    Ok(Totals {
        transitions: number(0)?,
        states: number(1)?,
        cells: number(2)?,
        segments: number(3)?,
        producers: number(4)?,
    })
}

/// Returns the last sequence of a producer; `None` where there is no such environment.
pub(super) async fn watermark(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    producer: &ProducerId,
) -> Result<Option<Sequence>, StoreError> {
    let sequence: Option<i64> = sqlx::query_scalar(
        "select coalesce(producers.sequence, 0)
         from totals left join producers on producers.environment = totals.environment and producers.name = ?2
         where totals.environment = ?1",
    )
    .bind(id.0)
    .bind(producer.as_str())
    .fetch_optional(connection)
    .await
    .map_err(unreadable)?;
    Ok(sequence.map(Sequence::from_stored))
}

/// Returns the name of the key that a producer belongs to, where it belongs to one.
pub(super) async fn owner(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    producer: &ProducerId,
) -> Result<Option<String>, StoreError> {
    let text = "select owner from producers where environment = ? and name = ?";
    let owner = sqlx::query_scalar(text)
        .bind(id.0)
        .bind(producer.as_str())
        .fetch_optional(connection)
        .await;
    Ok(owner.map_err(unreadable)?.flatten())
}

/// Returns the bytes of the database and its journal.
pub(super) async fn bytes(path: &Path) -> Result<u64, StoreError> {
    let database = tokio::fs::metadata(path).await.map_err(unreadable)?.len();
    let mut journal = path.as_os_str().to_owned();
    journal.push("-wal");
    // A database that was just closed has none.
    let journal = tokio::fs::metadata(journal)
        .await
        .map_or(0, |metadata| metadata.len());
    Ok(database + journal)
}

/// Returns the free bytes of the disk, as far as this process may use them, and all.
pub(super) async fn disk(path: &Path) -> Result<[u64; 2], StoreError> {
    let path = path.to_owned();
    // A disk that does not answer must not hold up a thread that serves connections.
    let asked = tokio::task::spawn_blocking(move || rustix::fs::statvfs(&path))
        .await
        .map_err(std::io::Error::from);

    let disk = asked
        .map_err(unreadable)?
        .map_err(std::io::Error::from)
        .map_err(unreadable)?;
    Ok([disk.f_bavail, disk.f_blocks].map(|blocks| blocks * disk.f_frsize))
}

/// Returns what each environment holds.
pub(super) async fn held(readers: &SqlitePool) -> Result<Vec<(EnvironmentId, Held)>, StoreError> {
    let rows = sqlx::query(
        "select environment, transitions, states, cells,
             (select count(*) from segments where segments.environment = totals.environment),
             (select count(*) from producers where producers.environment = totals.environment),
             (select count(*) from models where models.environment = totals.environment),
             (select count(distinct ego || '~' || other) from models
                 where models.environment = totals.environment and activated is not null)
         from totals order by environment",
    )
    .fetch_all(readers)
    .await
    .map_err(unreadable)?;
    rows.iter()
        .map(read_held)
        .collect::<Result<_, _>>()
        .map_err(unreadable)
}

fn read_held(row: &SqliteRow) -> Result<(EnvironmentId, Held), sqlx::Error> {
    let totals = Totals {
        transitions: whole(row, 1)?,
        states: whole(row, 2)?,
        cells: whole(row, 3)?,
        segments: whole(row, 4)?,
        producers: whole(row, 5)?,
    };
    let held = Held {
        totals,
        models: whole(row, 6)?,
        active: whole(row, 7)?,
    };
    Ok((EnvironmentId(row.try_get(0)?), held))
}

/// Reads a number that the tables keep from being negative.
pub(super) fn whole(row: &SqliteRow, at: usize) -> Result<u64, sqlx::Error> {
    Ok(row.try_get::<i64, _>(at)?.unsigned_abs())
}
