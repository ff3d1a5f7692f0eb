//! Batch upserts of what was accepted: segments and states that are new, cells and totals. The
//! numbers that were used are in `account`.

use std::sync::LazyLock;

use sqlx::sqlite::SqliteConnection;

use super::account::write_account;
use super::failed::Failed;
use super::lookup;
use super::signed::signed;
use crate::domain::{Cell, EnvironmentId, SegmentId, StateKey, Tally};
use crate::store::StoreError;
use crate::store::ledger::Ledger;
use crate::store::sqlite::error::aborted;
use crate::store::sqlite::memory::Memory;
use crate::store::sqlite::row_id_cache::{CellKey, RowIdCache};
use crate::store::sqlite::rows::ManyRows;
use crate::store::sqlite::writer::Transaction;

/// What a commit adds to one environment, for memory.
pub(super) struct Delta<'a> {
    environment: EnvironmentId,
    revision: u64,
    states: Vec<&'a StateKey>,
    /// In order of state.
    rows: Vec<CellRow>,
}

/// A cell as it is written.
struct CellRow {
    key: CellKey,
    tally: Tally,
    /// Its state's number in the commit.
    state: u32,
}

impl Delta<'_> {
    /// Brings memory up to date.
    pub(super) fn apply_to(&self, memory: &Memory) {
        let states = self.rows.chunk_by(|a, b| a.state == b.state);
        let delta = states.map(|rows| {
            (
                self.states[rows[0].state as usize],
                rows.iter().map(CellRow::cell),
            )
        });
        memory.cache.apply(self.environment, self.revision, delta);

        let actions = self.rows.iter().map(|row| (row.key.2 as u64, row.tally));
        memory
            .actions
            .apply(self.environment, self.revision, actions);
    }
}

impl CellRow {
    fn cell(&self) -> Cell {
        Cell {
            joint: self.key.2 as u64,
            segment: SegmentId(self.key.1),
            tally: self.tally,
        }
    }
}

/// Writes everything, and returns what memory has to be told after COMMIT.
pub(super) async fn write<'a>(
    transaction: &mut Transaction<'_>,
    accepted: Vec<Ledger<'a>>,
) -> Result<Vec<Delta<'a>>, Failed> {
    let (connection, row_ids) = transaction.parts();
    let mut deltas = Vec::new();
    for ledger in accepted {
        let environment = ledger.environment;
        let written = write_ledger(connection, row_ids, ledger).await;
        deltas.extend(written.map_err(|error| Failed::in_environment(environment, error))?);
    }
    Ok(deltas)
}

async fn write_ledger<'a>(
    connection: &mut SqliteConnection,
    row_ids: &mut RowIdCache,
    mut ledger: Ledger<'a>,
) -> Result<Option<Delta<'a>>, StoreError> {
    for (name, account) in ledger.advanced() {
        write_account(connection, ledger.environment, name, account).await?;
    }

    if ledger.merged.len() == 0 {
        return Ok(None);
    }
    write_counts(connection, row_ids, &mut ledger)
        .await
        .map(Some)
        .map_err(aborted)
}

async fn write_counts<'a>(
    connection: &mut SqliteConnection,
    row_ids: &mut RowIdCache,
    ledger: &mut Ledger<'a>,
) -> Result<Delta<'a>, sqlx::Error> {
    let environment = ledger.environment;
    let segments = segments(connection, ledger).await?;
    let states = states(connection, row_ids, environment, ledger.merged.states()).await?;
    let rows = cell_rows(ledger, &segments, &states.ids);

    // Counted before they are written, for afterwards all of them exist.
    let fresh = count_fresh(connection, row_ids, &rows, states.first_new).await?;
    upsert_cells(connection, &rows).await?;
    rows.iter().for_each(|row| row_ids.add_cell(row.key));

    add_totals(
        connection,
        environment,
        [ledger.merged.transitions(), states.new, fresh],
    )
    .await?;
    Ok(Delta {
        environment,
        revision: ledger.revision(),
        states: ledger.merged.states().to_vec(),
        rows,
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

/// The states of a commit: every id from `first_new` on was given now.
struct States {
    ids: Vec<i64>,
    first_new: i64,
    new: u64,
}

/// Returns the ids of states, which are made where they are new. The only writer gives out ids
/// itself, so it needs no answer from the database.
async fn states(
    connection: &mut SqliteConnection,
    row_ids: &mut RowIdCache,
    environment: EnvironmentId,
    keys: &[&StateKey],
) -> Result<States, sqlx::Error> {
    let found = lookup::states(connection, row_ids, environment, keys).await?;
    let text = "select coalesce(max(id), 0) + 1 from states";
    let first_new: i64 = sqlx::query_scalar(text).fetch_one(&mut *connection).await?;

    let mut new: Vec<usize> = (0..keys.len()).filter(|at| found[*at].is_none()).collect();
    new.sort_unstable_by_key(|at| keys[*at]);

    let mut ids: Vec<i64> = found.into_iter().map(|id| id.unwrap_or_default()).collect();
    for (id, at) in (first_new..).zip(&new) {
        ids[*at] = id;
        row_ids.add_state(environment, keys[*at], id);
    }

    let rows: Vec<(i64, &StateKey)> = new.iter().map(|at| (ids[*at], keys[*at])).collect();
    insert_states(connection, environment, &rows).await?;
    Ok(States {
        ids,
        first_new,
        new: new.len() as u64,
    })
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

/// Returns the cells of a commit in the order of the table, so that neighbours are written
/// together.
fn cell_rows(ledger: &mut Ledger<'_>, segments: &[i64], states: &[i64]) -> Vec<CellRow> {
    let row = |((state, segment, joint), tally)| CellRow {
        key: (
            states[state as usize],
            segments[segment as usize],
            signed(joint),
        ),
        tally,
        state,
    };

    let mut rows: Vec<CellRow> = ledger.merged.take_cells().map(row).collect();
    rows.sort_unstable_by_key(|row| row.key);
    rows
}

/// Returns how many cells will be new: all of a new state, and those of older states that are not
/// found.
async fn count_fresh(
    connection: &mut SqliteConnection,
    row_ids: &mut RowIdCache,
    rows: &[CellRow],
    first_new_state: i64,
) -> Result<u64, sqlx::Error> {
    let of_older = rows.partition_point(|row| row.key.0 < first_new_state);
    let candidates: Vec<CellKey> = rows[..of_older].iter().map(|row| row.key).collect();
    Ok(rows.len() as u64 - lookup::count_cells(connection, row_ids, &candidates).await?)
}

async fn upsert_cells(
    connection: &mut SqliteConnection,
    rows: &[CellRow],
) -> Result<(), sqlx::Error> {
    static UPSERT: LazyLock<ManyRows> = LazyLock::new(|| {
        ManyRows::new(
            "insert into cells (state, segment, joint, n, entries) values",
            "(?, ?, ?, ?, ?)",
            "on conflict do update set n = n + excluded.n, entries = entries + excluded.entries",
        )
    });

    for (text, chunk) in UPSERT.chunks(rows) {
        let mut query = sqlx::query(text);
        for CellRow {
            key: (state, segment, joint),
            tally,
            ..
        } in chunk
        {
            query = query.bind(*state).bind(*segment).bind(*joint);
            query = query.bind(signed(tally.n)).bind(tally.entries.map(signed));
        }
        query.execute(&mut *connection).await?;
    }
    Ok(())
}

async fn add_totals(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    added: [u64; 3],
) -> Result<(), sqlx::Error> {
    let [transitions, states, cells] = added.map(signed);
    sqlx::query(
        "update totals set transitions = transitions + ?, states = states + ?, cells = cells + ? where environment = ?",
    )
    .bind(transitions)
    .bind(states)
    .bind(cells)
    .bind(environment.0)
    .execute(connection)
    .await?;
    Ok(())
}
