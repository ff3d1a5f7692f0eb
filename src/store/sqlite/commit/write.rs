//! Writing what was accepted: segments and states that are new, an entry of the journal, and totals.
//! The numbers that were used are in `account`.

use std::sync::LazyLock;

use sqlx::sqlite::SqliteConnection;

use super::account::write_account;
use super::failed::Failed;
use super::signed::signed;
use crate::domain::{Cell, Environment, EnvironmentId, Family, Schema, SegmentId, StateKey};
use crate::store::StoreError;
use crate::store::ledger::Ledger;
use crate::store::map::Map;
use crate::store::packed::cells::Place;
use crate::store::packed::run::Run;
use crate::store::sqlite::error::aborted;
use crate::store::sqlite::layout::{Layout, Numbering};
use crate::store::sqlite::lookup;
use crate::store::sqlite::memory::Memory;
use crate::store::sqlite::pending::Entry;
use crate::store::sqlite::row_id_cache::RowIdCache;
use crate::store::sqlite::rows::ManyRows;
use crate::store::sqlite::walk::Placed;
use crate::store::sqlite::writer::Transaction;
use crate::store::sqlite::{journal, moving};

/// What a commit adds to one environment, for memory.
pub(super) struct Delta<'a> {
    environment: EnvironmentId,
    entry: Entry,
    states: Keys<'a>,
}

/// The keys of the states of a commit, by the numbers that they are stored under.
enum Keys<'a> {
    /// Told by their ranks.
    Ranked(Schema),
    Listed(Map<u64, &'a StateKey>),
}

impl Delta<'_> {
    /// Brings memory up to date.
    pub(super) fn apply_to(&self, memory: &Memory) {
        let (id, revision) = (self.environment, self.entry.revision);
        memory.pending.push(id, &self.entry);

        let cells = || self.entry.run.from(0).flatten();
        let stated = cells().map(|placed| (placed.0.state, cell(placed)));
        let key = |number| self.states.of(number);
        memory.cache.apply(id, revision, stated, key);

        let cells = cells().map(cell);
        let cells = cells.map(|(family, cell)| (family, cell.joint, cell.tally));
        memory.actions.apply(id, revision, cells);
    }
}

impl Keys<'_> {
    fn of(&self, number: u64) -> StateKey {
        match self {
            Self::Ranked(schema) => schema.state_of_rank(number),
            Self::Listed(keys) => keys[&number].clone(),
        }
    }
}

fn cell((place, tally): Placed) -> (Family, Cell) {
    let cell = Cell {
        joint: place.joint,
        segment: SegmentId(place.segment as i64),
        tally,
    };
    (Family::from_number(place.family as u32), cell)
}

/// Writes everything, and returns what memory has to be told after COMMIT.
pub(super) async fn write<'a>(
    transaction: &mut Transaction<'_>,
    accepted: Vec<Ledger<'a>>,
) -> Result<Vec<Delta<'a>>, Failed> {
    let mut deltas = Vec::new();
    let next_entry = transaction.memory().pending.next_entry();
    for (entry, ledger) in (next_entry..).zip(accepted) {
        let environment = ledger.environment;
        let written = write_ledger(transaction, entry, ledger).await;
        deltas.extend(written.map_err(|error| Failed::in_environment(environment, error))?);
    }
    Ok(deltas)
}

async fn write_ledger<'a>(
    transaction: &mut Transaction<'_>,
    entry: i64,
    mut ledger: Ledger<'a>,
) -> Result<Option<Delta<'a>>, StoreError> {
    let connection = transaction.connection();
    for (name, account) in ledger.advanced() {
        write_account(connection, ledger.environment, name, account).await?;
    }
    if ledger.merged.is_empty() {
        return Ok(None);
    }
    let environment = transaction.memory().directory.of_id(ledger.environment);
    let environment = environment.ok_or(StoreError::UnknownEnvironment)?;
    let known = transaction.memory().pending.view(environment.id);
    let layout = match known.and_then(|view| view.layout) {
        Some(layout) => layout,
        None => moving::layout(transaction.connection(), environment.id).await?,
    };
    write_counts(transaction, &environment, layout, entry, &mut ledger)
        .await
        .map(Some)
        .map_err(aborted)
}

async fn write_counts<'a>(
    transaction: &mut Transaction<'_>,
    environment: &Environment,
    layout: Layout,
    entry: i64,
    ledger: &mut Ledger<'a>,
) -> Result<Delta<'a>, sqlx::Error> {
    let (connection, row_ids) = transaction.parts();
    let segments = segments(connection, ledger).await?;
    let (states, run) = match Numbering::of(&environment.schema) {
        Numbering::Ranked => {
            let cells = cells(ledger, &segments, |rank| rank);
            // In order of rank: so they are where segments were made in the order of the commit.
            let run = match segments.is_sorted() {
                true => Run::of(cells),
                false => sorted_run(cells),
            };
            (Keys::Ranked(environment.schema.clone()), run)
        }
        Numbering::Listed => {
            let keys = ledger.merged.listed();
            let ids = ids(connection, row_ids, environment.id, keys).await?;
            let keys = ids.iter().copied().zip(keys.iter().copied()).collect();
            let cells = cells(ledger, &segments, |at| ids[at as usize]);
            (Keys::Listed(keys), sorted_run(cells))
        }
    };
    let fresh = ledger.fresh_cells();
    journal::insert(connection, entry, environment.id, &run).await?;
    add_transitions(connection, environment.id, ledger.merged.transitions()).await?;
    let entry = Entry {
        id: entry,
        run,
        fresh,
        layout,
        revision: ledger.revision(),
    };
    Ok(Delta {
        environment: environment.id,
        entry,
        states,
    })
}

/// Returns the ids of the segments of the commit, which are made where they are new.
async fn segments(
    connection: &mut SqliteConnection,
    ledger: &Ledger<'_>,
) -> Result<Vec<i64>, sqlx::Error> {
    let mut ids = Vec::new();
    for label in ledger.merged.segments() {
        ids.push(match ledger.segment(label) {
            Some(id) => id.0,
            None => insert_segment(connection, ledger.environment, label).await?,
        });
    }
    Ok(ids)
}

async fn insert_segment(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    label: &str,
) -> Result<i64, sqlx::Error> {
    let text = "insert into segments (environment, label) values (?, ?)";
    let done = sqlx::query(text)
        .bind(environment.0)
        .bind(label.to_owned())
        .execute(connection)
        .await?;
    Ok(done.last_insert_rowid())
}

/// Returns the ids of states, which are made where they are new. The only writer gives out ids
/// itself, so it needs no answer from the database.
async fn ids(
    connection: &mut SqliteConnection,
    row_ids: &mut RowIdCache,
    environment: EnvironmentId,
    keys: &[&StateKey],
) -> Result<Vec<u64>, sqlx::Error> {
    let found = lookup::ids(connection, row_ids, environment, keys).await?;
    let mut new: Vec<usize> = (0..keys.len()).filter(|at| found[*at].is_none()).collect();
    new.sort_unstable_by_key(|at| keys[*at]);
    let mut ids: Vec<i64> = found.into_iter().map(|id| id.unwrap_or_default()).collect();
    let text = "select coalesce(max(id), 0) + 1 from states";
    let first_new: i64 = sqlx::query_scalar(text).fetch_one(&mut *connection).await?;
    for (id, at) in (first_new..).zip(&new) {
        ids[*at] = id;
        row_ids.add_state(environment, keys[*at], id);
    }
    let rows: Vec<(i64, &StateKey)> = new.iter().map(|at| (ids[*at], keys[*at])).collect();
    insert_states(connection, environment, &rows).await?;
    Ok(ids.into_iter().map(i64::unsigned_abs).collect())
}

async fn insert_states(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    rows: &[(i64, &StateKey)],
) -> Result<(), sqlx::Error> {
    static INSERT: LazyLock<ManyRows> = LazyLock::new(|| {
        ManyRows::new(
            "insert into states (id, environment, key) values",
            "(?, ?, ?)",
            "",
        )
    });
    for (text, chunk) in INSERT.chunks(rows) {
        let mut query = sqlx::query(text);
        for (id, key) in chunk {
            query = query.bind(*id).bind(environment.0).bind(key.to_string());
        }
        query.execute(&mut *connection).await?;
    }
    Ok(())
}

/// Returns the cells of a commit in the order of its numbers; `stored` tells under which number a
/// state is stored.
fn cells(
    ledger: &mut Ledger<'_>,
    segments: &[i64],
    stored: impl Fn(u64) -> u64,
) -> impl Iterator<Item = Placed> {
    ledger
        .merged
        .tallies()
        .map(move |((state, segment, family, joint), tally)| {
            let place = Place {
                state: stored(state),
                segment: segments[segment as usize].unsigned_abs(),
                family: u64::from(family),
                joint,
            };
            (place, tally)
        })
}

/// Packs cells that come in any order.
fn sorted_run(cells: impl Iterator<Item = Placed>) -> Run {
    let mut cells: Vec<Placed> = cells.collect();
    cells.sort_unstable_by_key(|(place, _)| *place);
    Run::of(cells)
}

async fn add_transitions(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    added: u64,
) -> Result<(), sqlx::Error> {
    sqlx::query("update totals set transitions = transitions + ? where environment = ?")
        .bind(signed(added))
        .bind(environment.0)
        .execute(connection)
        .await?;
    Ok(())
}
