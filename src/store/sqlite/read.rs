//! Reads. Each is one statement or one transaction, so it sees one moment, and ends before it
//! returns, so it does not hold up the write-ahead log. What the journal has beside the rows comes
//! from memory, which is looked at first: where a fold was begun in between, it is looked at again.
//! One that is begun later changes nothing of that moment, however long the read takes.

use std::collections::BinaryHeap;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use sqlx::sqlite::{SqliteConnection, SqliteRow};
use sqlx::{Connection, Row, SqlitePool};

use super::checksums;
use super::columns::whole;
use super::error::{spoiled, unreadable};
use super::fresh;
use super::layout::Numbering;
use super::lookup::{self, Of};
use super::memory::Memory;
use super::pending::View;
use super::walk::{self, Placed, Wanted};
use super::{cache::Epoch, journal};
use crate::domain::{
    Counts, Environment, EnvironmentId, Label, ProducerId, SegmentId, Sequence, StateKey,
};
use crate::store::packed::size::Size;
use crate::store::packed::unfolded::Outdated;
use crate::store::{ByVisits, Cursor, Held, Scanned, StateCounts, StoreError, Totals};
use crate::telemetry;

/// Returns the counts of states: what is cached from memory, the rest by one statement.
pub(super) async fn counts(
    readers: &SqlitePool,
    memory: &Memory,
    environment: &Environment,
    keys: &[StateKey],
) -> Result<Vec<StateCounts>, StoreError> {
    let id = environment.id;
    let (mut found, epoch) = memory.cache.get(id, keys);
    let missing: Vec<usize> = (0..keys.len()).filter(|at| found[*at].is_none()).collect();
    telemetry::cached(keys.len() - missing.len(), missing.len());
    if !missing.is_empty() {
        let wanted: Vec<&StateKey> = missing.iter().map(|at| &keys[*at]).collect();
        let loaded = load(readers, memory, environment, &wanted).await?;
        remember(memory, id, epoch, &wanted, &loaded);
        missing
            .into_iter()
            .zip(loaded)
            .for_each(|(at, counts)| found[at] = Some(counts));
    }
    Ok(found.into_iter().flatten().collect())
}

fn remember(
    memory: &Memory,
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
    memory.cache.insert(id, epoch, first.revision, states);
}

/// Returns what is known of the journal of an environment: from memory, or from the database where
/// memory knows nothing.
pub(super) async fn view(
    connection: &mut SqliteConnection,
    memory: &Memory,
    id: EnvironmentId,
) -> Result<View, StoreError> {
    match memory.pending.view(id) {
        Some(view) => Ok(view),
        None => journal::load_one(connection, id).await,
    }
}

async fn load(
    readers: &SqlitePool,
    memory: &Memory,
    environment: &Environment,
    keys: &[&StateKey],
) -> Result<Vec<StateCounts>, StoreError> {
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    loop {
        let view = view(&mut reader, memory, environment.id).await?;
        let found = lookup::states(&mut reader, environment, &view, keys, Of::All).await?;
        let Ok(found) = found else { continue };
        let counts = found
            .iter()
            .map(|cells| state_counts(environment, &view, cells));
        return counts.collect();
    }
}

fn state_counts(
    environment: &Environment,
    view: &View,
    cells: &[Placed],
) -> Result<StateCounts, StoreError> {
    Ok(StateCounts {
        counts: Arc::new(lookup::counts(environment, cells)?),
        revision: view.revision,
    })
}

/// Returns the next states from a cursor on, in order of their numbers.
pub(super) async fn scan(
    readers: &SqlitePool,
    memory: &Memory,
    environment: &Environment,
    from: Cursor,
    states: u32,
) -> Result<Vec<Scanned>, StoreError> {
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    loop {
        let view = view(&mut reader, memory, environment.id).await?;
        let page = page(&mut reader, environment, &view, from, states).await?;
        let Ok(page) = page else { continue };
        let numbers: Vec<u64> = page.iter().map(|(number, _)| *number).collect();
        let keys = lookup::keys(&mut reader, environment, &numbers).await?;
        let scanned = |((number, counts), key): ((u64, Counts), StateKey)| Scanned {
            cursor: Cursor(number as i64 + 1),
            key,
            counts,
        };
        return Ok(page.into_iter().zip(keys).map(scanned).collect());
    }
}

type Page = Vec<(u64, Counts)>;

async fn page(
    connection: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
    from: Cursor,
    states: u32,
) -> Result<Result<Page, Outdated>, StoreError> {
    let mut page = Page::new();
    // Every row has a state, but that of the first may come before.
    let wanted = Wanted::From(from.0.unsigned_abs(), states.saturating_add(1));
    let show = |number, cells: &[Placed]| {
        page.push((number, lookup::counts(environment, cells)?));
        Ok(match page.len() < states as usize {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        })
    };
    let walked = walk::states(connection, environment.id, view, wanted, show).await?;
    Ok(walked.map(|()| page))
}

/// Returns the first states in an order of their visits, and the revision they are of.
pub(super) async fn by_visits(
    readers: &SqlitePool,
    memory: &Memory,
    environment: &Environment,
    wanted: &ByVisits,
) -> Result<(Vec<Scanned>, u64), StoreError> {
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    loop {
        let view = view(&mut reader, memory, environment.id).await?;
        let mut moment = reader.begin().await.map_err(unreadable)?;
        let first = match Numbering::of(&environment.schema) {
            Numbering::Ranked => first_ranked(&mut moment, environment, &view, wanted).await?,
            Numbering::Listed => first_listed(&mut moment, environment, &view, wanted).await?,
        };
        let Ok(first) = first else { continue };
        let keys: Vec<&StateKey> = first.iter().map(|(_, key)| key).collect();
        let found = lookup::states(&mut moment, environment, &view, &keys, Of::All).await?;
        let Ok(found) = found else { continue };

        let mut page = Vec::with_capacity(first.len());
        for ((number, key), cells) in first.iter().zip(&found) {
            page.push(Scanned {
                cursor: Cursor(*number as i64 + 1),
                key: key.clone(),
                counts: lookup::counts(environment, cells)?,
            });
        }
        return Ok((page, view.revision));
    }
}

/// States by number and key, in order.
type First = Vec<(u64, StateKey)>;

/// Returns the first states where numbers are in the order of keys.
async fn first_ranked(
    connection: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
    wanted: &ByVisits,
) -> Result<Result<First, Outdated>, StoreError> {
    let after = wanted.after.as_ref();
    let after = after.map(|(visits, key)| (order(*visits, wanted), environment.schema.rank(key)));
    let states = wanted.states as usize;
    let mut first = BinaryHeap::with_capacity(states + 1);
    let candidate = |visits, number| {
        let place = (order(visits, wanted), number);
        if after.is_none_or(|after| place > after) {
            first.push(place);
            if first.len() > states {
                first.pop();
            }
        }
    };
    if let Err(outdated) = candidates(connection, environment, view, wanted, candidate).await? {
        return Ok(Err(outdated));
    }
    let numbers: Vec<u64> = first
        .into_sorted_vec()
        .into_iter()
        .map(|(_, number)| number)
        .collect();
    let keys = lookup::keys(connection, environment, &numbers).await?;
    Ok(Ok(numbers.into_iter().zip(keys).collect()))
}

/// Returns the first states where only the table of states knows keys: those of equally many visits
/// as the last one are looked up before it is known which come first.
async fn first_listed(
    connection: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
    wanted: &ByVisits,
) -> Result<Result<First, Outdated>, StoreError> {
    let after = wanted.after.as_ref();
    let after = after.map(|(visits, key)| (order(*visits, wanted), key));
    let mut all = Vec::new();
    let candidate = |visits, number| {
        let order = order(visits, wanted);
        if after.is_none_or(|(least, _)| order >= least) {
            all.push((order, number));
        }
    };
    if let Err(outdated) = candidates(connection, environment, view, wanted, candidate).await? {
        return Ok(Err(outdated));
    }

    all.sort_unstable();
    let mut first = Vec::new();
    for tied in all.chunk_by(|(a, _), (b, _)| a == b) {
        let order = tied[0].0;
        let numbers: Vec<u64> = tied.iter().map(|(_, number)| *number).collect();
        let keys = lookup::keys(connection, environment, &numbers).await?;
        let mut tied: Vec<(u64, StateKey)> = numbers.into_iter().zip(keys).collect();
        tied.retain(|(_, key)| after.is_none_or(|after| (order, key) > after));
        tied.sort_unstable_by(|(_, a), (_, b)| a.cmp(b));
        first.extend(tied);
        if first.len() >= wanted.states as usize {
            break;
        }
    }
    first.truncate(wanted.states as usize);
    Ok(Ok(first))
}

/// Shows the visits and the number of every state that has enough.
async fn candidates(
    connection: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
    wanted: &ByVisits,
    mut candidate: impl FnMut(u64, u64),
) -> Result<Result<(), Outdated>, StoreError> {
    let counts = |place: &SegmentId| {
        wanted
            .segments
            .as_ref()
            .is_none_or(|named| named.contains(place))
    };
    let show = |number, cells: &[Placed]| {
        let mut visits = 0;
        for (place, tally) in cells {
            if lookup::is_of_joint_actions(place) && counts(&SegmentId(place.segment as i64)) {
                visits += tally.n;
            }
        }
        if visits >= wanted.min_visits.max(1) {
            candidate(visits, number);
        }
        Ok(ControlFlow::Continue(()))
    };
    walk::states(connection, environment.id, view, Wanted::All, show).await
}

/// Returns a number that is less for what comes first.
fn order(visits: u64, wanted: &ByVisits) -> u64 {
    match wanted.descending {
        true => u64::MAX - visits,
        false => visits,
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

/// Returns the totals of an environment: those that are kept, and what only the journal has, which
/// is counted once for each entry.
pub(super) async fn totals(
    readers: &SqlitePool,
    memory: &Memory,
    environment: &Environment,
) -> Result<Totals, StoreError> {
    let id = environment.id;
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    loop {
        let view = view(&mut reader, memory, id).await?;
        if let Some(size) = memory.pending.size(id, &view) {
            let kept = kept_totals(&mut reader, id).await?;
            return Ok(with_size(kept, size, &view));
        }

        let mut moment = reader.begin().await.map_err(unreadable)?;
        let kept = kept_totals(&mut moment, id).await?;
        let fresh = fresh::count(&mut moment, environment, &view).await?;
        let Ok(fresh) = fresh else { continue };
        let mut size = kept_size(&kept);
        size += fresh;
        memory.pending.measured(id, &view, size);
        return Ok(with_size(kept, size, &view));
    }
}

fn kept_size(totals: &Totals) -> Size {
    Size {
        states: totals.states,
        cells: totals.cells,
    }
}

fn with_size(kept: Totals, size: Size, view: &View) -> Totals {
    Totals {
        transitions: view.revision,
        states: size.states,
        cells: size.cells,
        ..kept
    }
}

/// Reads the totals that are kept.
async fn kept_totals(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<Totals, StoreError> {
    let row = sqlx::query(
        "select transitions, states, cells,
             (select count(*) from segments where segments.environment = totals.environment),
             (select count(*) from producers where producers.environment = totals.environment)
         from totals where environment = ?",
    )
    .bind(id.0)
    .fetch_optional(connection)
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
    let text = "select * from producers where environment = ? and name = ?";
    let row = sqlx::query(text)
        .bind(id.0)
        .bind(producer.as_str())
        .fetch_optional(connection)
        .await
        .map_err(unreadable)?;
    let Some(row) = row else { return Ok(None) };
    match checksums::is_sound_producer(&row).map_err(unreadable)? {
        true => row.try_get("owner").map_err(unreadable),
        false => Err(spoiled(&format!("producer `{producer}`"))),
    }
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

/// Returns what each environment holds, by the totals that are kept.
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
    let held: Result<_, sqlx::Error> = rows.iter().map(held_of).collect();
    held.map_err(unreadable)
}

fn held_of(row: &SqliteRow) -> Result<(EnvironmentId, Held), sqlx::Error> {
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

/// Cells of the journal that may be looked up for what is held.
const LOOKED_UP: usize = 10_000;

/// Adds what only the journal has to what environments hold. Where that is much, states and cells
/// are those that were found last, or that are in rows: a little behind, and never falling.
pub(super) async fn hold_unfolded(
    readers: &SqlitePool,
    memory: &Memory,
    all: &mut [(EnvironmentId, Held)],
) -> Result<(), StoreError> {
    let mut room = LOOKED_UP;
    for (id, held) in all {
        let Some(environment) = memory.directory.of_id(*id) else {
            continue;
        };
        let least = memory.pending.least_size(*id);
        let cost = cost_of_totals(memory, *id);
        if cost <= room || least.is_none() {
            room = room.saturating_sub(cost);
            match totals(readers, memory, &environment).await {
                Ok(totals) => held.totals = totals,
                // It was deleted meanwhile, or what is wrong with it is told where it is asked
                // about.
                Err(StoreError::UnknownEnvironment | StoreError::Damaged(_)) => {}
                Err(error) => return Err(error),
            }
        }
        let size = kept_size(&held.totals).max(least.unwrap_or_default());
        (held.totals.states, held.totals.cells) = (size.states, size.cells);
    }
    Ok(())
}

/// Returns how many cells are to be looked up for the totals of an environment.
fn cost_of_totals(memory: &Memory, id: EnvironmentId) -> usize {
    let Some(view) = memory.pending.view(id) else {
        return usize::MAX;
    };
    match memory.pending.size(id, &view) {
        Some(_) => 0,
        None => view.unfolded.len(),
    }
}
