//! Finding the counts of states by their keys, and the numbers of states that have one in a table.

use std::collections::BTreeMap;

use futures::TryStreamExt;
use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::columns::mark;
use super::error::{spoiled, unreadable};
use super::layout::Numbering;
use super::old_cells::{self, old_cells};
use super::pending::View;
use super::row_id_cache::RowIdCache;
use super::stored_forms;
use super::walk::{Placed, add_equal, cells_of};
use crate::domain::{
    Cell, Counts, Environment, EnvironmentId, Family, Schema, SegmentId, StateKey, Tally,
};
use crate::store::StoreError;
use crate::store::packed::cells::{MOST, Place};
use crate::store::packed::row::row_of;
use crate::store::packed::unfolded::{Mark, Outdated};

/// Which of the counts are wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Of {
    /// Those of rows, of the journal and of old tables together.
    All,
    /// Those that are not in the journal alone.
    Stored,
}

/// Returns the cells of states, in the order of their keys. `Outdated` where a fold was begun since
/// the view was taken.
pub(super) async fn states(
    connection: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
    keys: &[&StateKey],
    of: Of,
) -> Result<Result<Vec<Vec<Placed>>, Outdated>, StoreError> {
    match Numbering::of(&environment.schema) {
        Numbering::Ranked if !view.unmoved => {
            let ranks: Vec<u64> = keys
                .iter()
                .map(|key| environment.schema.rank(key))
                .collect();
            ranked(connection, environment.id, view, &ranks, of).await
        }
        numbering => by_key(connection, environment, numbering, view, keys, of).await,
    }
}

/// Returns the counts that placed cells are, which are of one state and in order.
pub(super) fn counts(environment: &Environment, cells: &[Placed]) -> Result<Counts, StoreError> {
    let Some((first, _)) = cells.first() else {
        return Ok(Counts::default());
    };
    // Mostly one family in one segment, or none but that of joint actions.
    let mut families: Vec<(Family, Vec<Cell>)> = Vec::new();
    for (place, tally) in cells {
        debug_assert_eq!(place.state, first.state, "cells of one state");
        let family = known_family(&environment.schema, place, *tally)?;
        let cell = Cell {
            joint: place.joint,
            segment: SegmentId(place.segment as i64),
            tally: *tally,
        };
        match families.iter_mut().rev().find(|(of, _)| *of == family) {
            Some((_, cells)) => cells.push(cell),
            None => families.push((family, vec![cell])),
        }
    }

    families.sort_unstable_by_key(|(family, _)| *family);
    let mut families = families.into_iter().peekable();
    let joint = families.next_if(|(family, _)| *family == Family::JOINT);
    let mut counts = Counts::new(joint.map_or_else(Vec::new, |(_, cells)| cells));
    families.for_each(|(family, cells)| counts.push(family, cells));
    Ok(counts)
}

/// Returns the family of a cell that the schema has.
pub(super) fn known_family(
    schema: &Schema,
    place: &Place,
    tally: Tally,
) -> Result<Family, StoreError> {
    let family = family_of(place);
    let cells = family.and_then(|family| schema.cells_of_family(family));
    let is_known = cells.is_some_and(|cells| place.joint < cells) && tally.n <= MOST;
    family
        .filter(|_| is_known)
        .ok_or_else(|| spoiled("a state's counts"))
}

/// Returns whether the visits of a cell count: each is in the family of joint actions once, and in
/// others again.
pub(super) fn is_of_joint_actions(place: &Place) -> bool {
    family_of(place) == Some(Family::JOINT)
}

/// Returns the family that a place is in, where it has the number of one.
fn family_of(place: &Place) -> Option<Family> {
    u32::try_from(place.family).ok().map(Family::from_number)
}

/// Where the cells of each state go: by its number, the positions in the order asked.
type Places = BTreeMap<u64, Vec<usize>>;

async fn ranked(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    view: &View,
    ranks: &[u64],
    of: Of,
) -> Result<Result<Vec<Vec<Placed>>, Outdated>, StoreError> {
    let mut places = Places::new();
    for (at, rank) in ranks.iter().enumerate() {
        places.entry(*rank).or_default().push(at);
    }

    let mut found = vec![Vec::new(); ranks.len()];
    let mark = add_stored(connection, id, view, &places, &mut found).await?;
    let added = match of {
        Of::Stored => is_of(view, mark),
        Of::All => add_unfolded(view, mark, &places, &mut found)?,
    };
    Ok(added.map(|()| found))
}

/// Adds what the rows of states have, and returns how far these are folded.
async fn add_stored(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    view: &View,
    places: &Places,
    found: &mut [Vec<Placed>],
) -> Result<Mark, StoreError> {
    let text = "select totals.folded, totals.fold_row, packed.id, packed.cells
         from totals left join packed on packed.id in (select value from json_each(?2))
         where totals.environment = ?1";
    let query = sqlx::query(text)
        .bind(id.0)
        .bind(row_ids(view, places.keys().copied()));
    let mut rows = query.fetch(connection);
    let mut marked = None;
    while let Some(row) = rows.try_next().await.map_err(unreadable)? {
        marked = Some(mark(&row, 0).map_err(unreadable)?);
        let row_id: Option<i64> = row.try_get(2).map_err(unreadable)?;
        let Some((row_id, layout)) = row_id.zip(view.layout) else {
            continue;
        };

        let cells = cells_of(layout.name(row_id), row.try_get(3).map_err(unreadable)?)?;
        for state in cells.chunk_by(|(a, _), (b, _)| a.state == b.state) {
            for at in places.get(&state[0].0.state).into_iter().flatten() {
                found[*at].extend_from_slice(state);
            }
        }
    }
    marked.ok_or(StoreError::UnknownEnvironment)
}

/// Returns the ids of the rows that states are in, in order and each once, as a list in JSON.
pub(super) fn row_ids(view: &View, states: impl Iterator<Item = u64>) -> String {
    let Some(layout) = view.layout else {
        return stored_forms::json_numbers([]);
    };
    let mut ids: Vec<i64> = states.map(|state| layout.id_of_state(state)).collect();
    ids.sort_unstable();
    ids.dedup();
    stored_forms::json_numbers(ids)
}

/// Adds what the journal has of states.
fn add_unfolded(
    view: &View,
    mark: Mark,
    places: &Places,
    found: &mut [Vec<Placed>],
) -> Result<Result<(), Outdated>, StoreError> {
    for (rank, positions) in places {
        let Ok(unfolded) = unfolded(view, *rank, mark)? else {
            return Ok(Err(Outdated));
        };
        positions
            .iter()
            .for_each(|at| add(&mut found[*at], &unfolded));
    }
    Ok(Ok(()))
}

/// Fails where rows and view are of different folds.
fn is_of(view: &View, mark: Mark) -> Result<(), Outdated> {
    view.unfolded.from(u64::MAX, mark).map(|_nothing| ())
}

/// Returns what the journal has of a state.
fn unfolded(
    view: &View,
    state: u64,
    mark: Mark,
) -> Result<Result<Vec<Placed>, Outdated>, StoreError> {
    let Ok(cells) = view.unfolded.from(state, mark) else {
        return Ok(Err(Outdated));
    };
    let of_state = cells.take_while(|cell| {
        cell.as_ref()
            .map_or(true, |(place, _)| place.state == state)
    });
    let cells: Result<Vec<Placed>, _> = of_state.collect();
    cells.map(Ok).map_err(|_| spoiled("the journal of counts"))
}

fn add(cells: &mut Vec<Placed>, more: &[Placed]) {
    let stored = cells.len();
    cells.extend_from_slice(more);
    if stored > 0 && !more.is_empty() {
        add_equal(cells);
    }
}

/// Returns the same by the table of states: where that has their numbers, or cells that are not
/// moved yet.
async fn by_key(
    connection: &mut SqliteConnection,
    environment: &Environment,
    numbering: Numbering,
    view: &View,
    keys: &[&StateKey],
    of: Of,
) -> Result<Result<Vec<Vec<Placed>>, Outdated>, StoreError> {
    let schema = &environment.schema;
    let numbers: Vec<Option<u64>> = keys
        .iter()
        .map(|key| numbering.of_key(schema, key))
        .collect();
    let first = view.layout.map(|layout| layout.first());
    let rows = numbers
        .iter()
        .map(|number| Some(view.layout?.id_of_state((*number)?)));
    let text = concat!(
        "select wanted.key, totals.folded, totals.fold_row, states.id, packed.id, packed.cells, ",
        old_cells!("states.id"),
        " from totals cross join json_each(?2) as wanted
         left join states on states.environment = ?1 and states.key = wanted.value ->> 0
         left join packed on packed.id = coalesce(wanted.value ->> 1, ?3 + (states.id >> 4))
         where totals.environment = ?1"
    );
    let query = sqlx::query(text)
        .bind(environment.id.0)
        .bind(stored_forms::json_pairs(keys.iter().zip(rows)))
        .bind(first);
    let mut stored = query.fetch(connection);
    let mut found = vec![Vec::new(); keys.len()];
    let mut rows = 0;
    while let Some(row) = stored.try_next().await.map_err(unreadable)? {
        rows += 1;
        let at = row.try_get::<i64, _>(0).map_err(unreadable)? as usize;
        let id: Option<i64> = row.try_get(3).map_err(unreadable)?;
        let Some(state) = numbers[at].or(id.map(i64::unsigned_abs)) else {
            continue;
        };
        let mark = mark(&row, 1).map_err(unreadable)?;
        found[at] = stored_cells(&row, environment, view, state)?;
        if let (Of::Stored, Err(outdated)) = (of, is_of(view, mark)) {
            return Ok(Err(outdated));
        }
        if of == Of::All {
            let Ok(unfolded) = unfolded(view, state, mark)? else {
                return Ok(Err(Outdated));
            };
            add(&mut found[at], &unfolded);
        }
    }
    if rows == 0 && !keys.is_empty() {
        return Err(StoreError::UnknownEnvironment);
    }
    Ok(Ok(found))
}

/// Reads the cells of a state from its row and from the old tables.
fn stored_cells(
    row: &SqliteRow,
    environment: &Environment,
    view: &View,
    state: u64,
) -> Result<Vec<Placed>, StoreError> {
    let id: Option<i64> = row.try_get(4).map_err(unreadable)?;
    let mut cells = match id.zip(view.layout) {
        Some((id, layout)) => cells_of(layout.name(id), row.try_get(5).map_err(unreadable)?)?,
        None => Vec::new(),
    };
    cells.retain(|(place, _)| place.state == state);
    if let Some(text) = row.try_get::<Option<&str>, _>(6).map_err(unreadable)? {
        add(&mut cells, &old(text, environment, state)?);
    }
    debug_assert!(
        cells
            .iter()
            .all(|(place, _)| row_of(place.state) == row_of(state))
    );
    Ok(cells)
}

/// Reads cells of the old table, in order of place.
pub(super) fn old(
    text: &str,
    environment: &Environment,
    state: u64,
) -> Result<Vec<Placed>, StoreError> {
    let cells = old_cells::cells(text, environment.schema.joint_actions());
    let placed = |cell: Cell| {
        let place = Place {
            state,
            segment: cell.segment.0.unsigned_abs(),
            family: 0,
            joint: cell.joint,
        };
        (place, cell.tally)
    };
    let cells = cells.ok_or_else(|| spoiled("a state's counts"))?;
    let mut placed: Vec<Placed> = cells.into_iter().map(placed).collect();
    placed.sort_unstable_by_key(|(place, _)| *place);
    Ok(placed)
}

/// States a statement; their keys are one text.
const KEYS: usize = 1_000;

/// Returns the id of each state that is in the table. Hot states come from memory.
pub(super) async fn ids(
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
        let wanted = chunk.iter().map(|at| keys[*at]);
        for (at, id) in select_ids(connection, environment, wanted).await? {
            let at = chunk[at];
            found[at] = Some(id);
            row_ids.add_state(environment, keys[at], id);
        }
    }
    Ok(found)
}

async fn select_ids(
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

/// Returns the keys of states by their numbers, in the order asked.
pub(super) async fn keys(
    connection: &mut SqliteConnection,
    environment: &Environment,
    numbers: &[u64],
) -> Result<Vec<StateKey>, StoreError> {
    match Numbering::of(&environment.schema) {
        Numbering::Ranked => numbers
            .iter()
            .map(|rank| key_of_rank(environment, *rank))
            .collect(),
        Numbering::Listed => listed_keys(connection, environment.id, numbers).await,
    }
}

/// Reads the key of a state as it is kept, which must be one of the schema's.
pub(super) fn stored_key(schema: &Schema, text: &str) -> Result<StateKey, StoreError> {
    let key = StateKey::from_stored(text).filter(|key| schema.has(key));
    key.ok_or_else(|| spoiled(&format!("the key {text:?} of a state")))
}

fn key_of_rank(environment: &Environment, rank: u64) -> Result<StateKey, StoreError> {
    let exists = environment
        .schema
        .states()
        .is_some_and(|states| rank < states);
    exists
        .then(|| environment.schema.state_of_rank(rank))
        .ok_or_else(|| spoiled(&format!("the number {rank} of a state")))
}

async fn listed_keys(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    numbers: &[u64],
) -> Result<Vec<StateKey>, StoreError> {
    let mut keys = Vec::with_capacity(numbers.len());
    for chunk in numbers.chunks(KEYS) {
        let rows = sqlx::query(
            "select wanted.key, states.key from json_each(?2) as wanted
             left join states on states.id = wanted.value and states.environment = ?1 order by wanted.key",
        )
        .bind(id.0)
        .bind(stored_forms::json_numbers(chunk.iter().map(|number| *number as i64)))
        .fetch_all(&mut *connection)
        .await
        .map_err(unreadable)?;
        for row in rows {
            let text: Option<&str> = row.try_get(1).map_err(unreadable)?;
            let key = text.and_then(StateKey::from_stored);
            keys.push(key.ok_or_else(|| spoiled(&format!("the key {text:?} of a state")))?);
        }
    }
    Ok(keys)
}
