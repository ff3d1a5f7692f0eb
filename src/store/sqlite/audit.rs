//! Compares the totals that are kept with what rows, journal and old tables add up to, and reads
//! every row that a commit may meet. SQLite's own check passes a flipped bit in a count, and a cell
//! of an action or a segment that its environment does not have.

use std::collections::BTreeSet;

use futures::TryStreamExt;
use sqlx::sqlite::SqliteConnection;
use sqlx::{Connection, Row, SqlitePool};

use super::columns::mark;
use super::directory::Directory;
use super::error::{spoiled, unreadable};
use super::fresh;
use super::inspect::has_table;
use super::journal;
use super::layout::{Layout, Numbering};
use super::lookup;
use super::walk::{Placed, cells_of};
use crate::domain::{Environment, Schema};
use crate::store::packed::checked;
use crate::store::packed::row::row_of;
use crate::store::packed::run::Run;
use crate::store::packed::size::Size;
use crate::store::packed::unfolded::Mark;
use crate::store::{Audit, Cause, StorageFault, StoreError};

/// Audits every environment, and makes those read-only that do not add up or cannot be read.
pub(super) async fn audit(
    readers: &SqlitePool,
    directory: &Directory,
) -> Result<Vec<Audit>, StoreError> {
    // One of an earlier build that is only looked at has no rows of states yet.
    let is_packed = has_table(readers, "packed").await?;
    let mut audits = Vec::new();
    for environment in directory.all() {
        // One that was deleted meanwhile has nothing to compare.
        let Some(audit) = audit_twice(readers, &environment, is_packed).await? else {
            continue;
        };
        if let Some(why) = audit.fault() {
            directory.make_read_only(environment.id, &why);
        }
        audits.push(audit);
    }
    Ok(audits)
}

/// Audits one environment, and says what is wrong with it, if anything is.
pub(super) async fn fault_of(
    readers: &SqlitePool,
    environment: &Environment,
) -> Result<Option<String>, StoreError> {
    let audited = audit_twice(readers, environment, true).await?;
    Ok(audited.and_then(|audit| audit.fault()))
}

/// Damage is the environment's; a machine that fails to read it twice is as good as damage, and is
/// told as such the first time. Other errors are no environment's.
async fn audit_twice(
    readers: &SqlitePool,
    environment: &Environment,
    is_packed: bool,
) -> Result<Option<Audit>, StoreError> {
    let is_unread =
        |cause: &Cause| [StorageFault::Damaged, StorageFault::InputOutput].contains(&cause.fault);
    let mut audited = audit_one(readers, environment, is_packed).await;
    if audited.as_ref().is_err_and(is_unread) {
        audited = audit_one(readers, environment, is_packed).await;
    }
    match audited {
        Err(cause) if is_unread(&cause) => {
            let environment = environment.name.clone();
            Ok(Some(Audit {
                environment,
                kept: [0; 3],
                found: [0; 3],
                unreadable: Some(cause.said),
            }))
        }
        audited => audited.map_err(unreadable),
    }
}

/// What is found: wider than any number that is stored, since damaged ones may overflow.
#[derive(Default)]
struct Found {
    transitions: u128,
    size: Size,
    /// Cells of an action, a segment or a state that the environment does not have.
    strays: u64,
}

/// All statements see one moment.
async fn audit_one(
    readers: &SqlitePool,
    environment: &Environment,
    is_packed: bool,
) -> Result<Option<Audit>, Cause> {
    let mut reader = readers.acquire().await?;
    let mut moment = reader.begin().await?;
    read_producers(&mut moment, environment).await?;
    let Some(mut kept) = kept(&mut moment, environment).await? else {
        return match is_there(&mut moment, environment).await? {
            true => Err(damage(spoiled("the row of its totals"))),
            false => Ok(None),
        };
    };
    // Read in any case: the states may be those of rows.
    let old = old_cells(&mut moment, environment).await?;
    let mut found = match is_packed && !is_unmoved(&mut moment, environment).await? {
        true => Found::default(),
        false => old,
    };
    if is_packed {
        let allowed = Allowed::read(&mut moment, environment).await?;
        rows(&mut moment, environment, &allowed, &mut found).await?;
        entries(&mut moment, environment, &allowed, &mut found).await?;
        let fresh = fresh(&mut moment, environment).await.map_err(damage)?;
        kept[1] += fresh.states;
        kept[2] += fresh.cells;
        found.size += fresh;
    }

    let transitions = u64::try_from(found.transitions).unwrap_or(u64::MAX);
    let sums = [transitions, found.size.states, found.size.cells];
    let strays = format!(
        "{} of its cells are of a state, an action or a segment that it does not have",
        found.strays
    );
    Ok(Some(Audit {
        environment: environment.name.clone(),
        kept,
        found: sums,
        unreadable: (found.strays > 0 && kept == sums).then_some(strays),
    }))
}

async fn kept(
    moment: &mut SqliteConnection,
    environment: &Environment,
) -> Result<Option<[u64; 3]>, Cause> {
    let text = "select transitions, states, cells from totals where environment = ?";
    let row = sqlx::query(text)
        .bind(environment.id.0)
        .fetch_optional(moment)
        .await?;
    let Some(row) = row else { return Ok(None) };
    // Damage can make a total negative.
    let number = |at| {
        row.try_get::<i64, _>(at)
            .map(|number| number.max(0).unsigned_abs())
    };
    Ok(Some([number(0)?, number(1)?, number(2)?]))
}

/// Returns whether an environment was not deleted.
async fn is_there(moment: &mut SqliteConnection, environment: &Environment) -> Result<bool, Cause> {
    let text = "select exists (select 1 from environments where id = ? and name is not null)";
    let is_there = sqlx::query_scalar(text).bind(environment.id.0);
    Ok(is_there.fetch_one(moment).await?)
}

/// Returns whether the old tables have something of an environment, as those who read it are told.
async fn is_unmoved(
    moment: &mut SqliteConnection,
    environment: &Environment,
) -> Result<bool, Cause> {
    let text = "select unmoved from totals where environment = ?";
    let is_unmoved = sqlx::query_scalar(text).bind(environment.id.0);
    Ok(is_unmoved.fetch_one(moment).await?)
}

/// What cells there may be.
struct Allowed {
    schema: Schema,
    segments: BTreeSet<u64>,
    states: States,
}

/// Which numbers of states there may be.
enum States {
    Below(u64),
    These(BTreeSet<u64>),
}

impl Allowed {
    async fn read(moment: &mut SqliteConnection, environment: &Environment) -> Result<Self, Cause> {
        let id = environment.id.0;
        let text = "select id from segments where environment = ?";
        let segments: Vec<i64> = sqlx::query_scalar(text)
            .bind(id)
            .fetch_all(&mut *moment)
            .await?;
        let states = match (
            Numbering::of(&environment.schema),
            environment.schema.states(),
        ) {
            (Numbering::Ranked, Some(states)) => States::Below(states),
            _ => States::These(listed(moment, environment).await?),
        };
        Ok(Self {
            schema: environment.schema.clone(),
            segments: segments.into_iter().map(i64::unsigned_abs).collect(),
            states,
        })
    }

    fn has(&self, (place, tally): &Placed) -> bool {
        let has_state = match &self.states {
            States::Below(states) => place.state < *states,
            States::These(states) => states.contains(&place.state),
        };
        has_state
            && lookup::known_family(&self.schema, place, *tally).is_ok()
            && self.segments.contains(&place.segment)
    }
}

/// Returns the ids of states that are listed, where each has a key of the schema, and the same by
/// their index and in their table: a commit finds it by the one, and a question reads the other.
async fn listed(
    moment: &mut SqliteConnection,
    environment: &Environment,
) -> Result<BTreeSet<u64>, Cause> {
    let text = "select id, key, key is (select stored.key from states as stored not indexed where stored.id = states.id)
         from states indexed by sqlite_autoindex_states_1 where environment = ?";
    let mut rows = sqlx::query(text).bind(environment.id.0).fetch(moment);
    let mut ids = BTreeSet::new();
    while let Some(row) = rows.try_next().await? {
        let (id, text): (i64, &str) = (row.try_get(0)?, row.try_get(1)?);
        lookup::stored_key(&environment.schema, text).map_err(damage)?;
        if !row.try_get::<bool, _>(2)? {
            return Err(damage(spoiled(&format!("the key {text:?} of a state"))));
        }
        ids.insert(id.unsigned_abs());
        tokio::task::consume_budget().await;
    }
    Ok(ids)
}

impl Found {
    fn add_visits(&mut self, cells: &[Placed], allowed: &Allowed) {
        for cell in cells {
            if lookup::is_of_joint_actions(&cell.0) {
                self.transitions += u128::from(cell.1.n);
            }
            self.strays += u64::from(!allowed.has(cell));
        }
    }
}

/// Adds what rows have.
async fn rows(
    moment: &mut SqliteConnection,
    environment: &Environment,
    allowed: &Allowed,
    found: &mut Found,
) -> Result<(), Cause> {
    let text = "select block from environments where id = ?";
    let block: Option<i64> = sqlx::query_scalar(text)
        .bind(environment.id.0)
        .fetch_one(&mut *moment)
        .await?;
    let Some(block) = block else { return Ok(()) };
    let layout = Layout::new(environment.id, block);
    let mut rows = sqlx::query("select id, cells from packed where id between ? and ? order by id")
        .bind(layout.first())
        .bind(layout.last())
        .fetch(moment);
    while let Some(row) = rows.try_next().await? {
        let cells = cells_of(layout.name(row.try_get(0)?), row.try_get(1)?).map_err(damage)?;
        found.add_visits(&cells, allowed);
        found.size += Size::of(&cells);
        tokio::task::consume_budget().await;
    }
    Ok(())
}

/// Adds what only the journal has. States and cells are counted when they are folded.
async fn entries(
    moment: &mut SqliteConnection,
    environment: &Environment,
    allowed: &Allowed,
    found: &mut Found,
) -> Result<(), Cause> {
    let id = environment.id.0;
    let mut rows = sqlx::query(
        "select totals.folded, totals.fold_row, journal.id, journal.cells
         from totals cross join journal on journal.environment = totals.environment
         where totals.environment = ? order by journal.id",
    )
    .bind(id)
    .fetch(moment);
    while let Some(row) = rows.try_next().await? {
        let (mark, entry): (Mark, i64) = (mark(&row, 0)?, row.try_get(2)?);
        let run = checked::cells([id, entry], row.try_get(3)?).and_then(Run::read);
        let run = run.map_err(|_| damage(spoiled(&format!("entry {entry} of the journal"))))?;
        let mut cells: Vec<Placed> = run.from(0).flatten().collect();
        cells.retain(|(place, _)| !is_folded(mark, entry, row_of(place.state)));
        found.add_visits(&cells, allowed);
    }
    Ok(())
}

/// Returns what is in no row yet, and so in none of the totals that are kept.
async fn fresh(
    moment: &mut SqliteConnection,
    environment: &Environment,
) -> Result<Size, StoreError> {
    let view = journal::load_one(moment, environment.id).await?;
    let fresh = fresh::count(moment, environment, &view).await?;
    Ok(fresh.expect("one moment has one mark"))
}

fn is_folded(mark: Mark, entry: i64, row: u64) -> bool {
    entry <= mark.upto && mark.next_row.is_none_or(|next| row < next)
}

fn damage(error: StoreError) -> Cause {
    Cause::new(StorageFault::Damaged, error.to_string())
}

/// Returns what an earlier build counted and is not moved yet. Visits are summed in two halves: a
/// damaged one could overflow the sum. States are found by their index, and each is looked up in its
/// table too, which nothing else would read: one that has another key there cannot be moved.
async fn old_cells(
    moment: &mut SqliteConnection,
    environment: &Environment,
) -> Result<Found, Cause> {
    let row = sqlx::query(
        "select count(distinct mine.id), count(cells.state),
             coalesce(sum(cells.n >> 32), 0), coalesce(sum(cells.n & 0xffffffff), 0),
             coalesce(sum(not (
                 cells.joint between 0 and ?2 - 1 and coalesce(cells.entries between 0 and cells.n, 1)
                 and exists (select 1 from segments where segments.id = cells.segment and segments.environment = ?1)
                 and stored.key is mine.key
             )), 0)
         from (
             select id, key from states indexed by sqlite_autoindex_states_1 where environment = ?1 order by id
         ) as mine
         cross join states as stored not indexed on stored.id = mine.id and stored.environment = ?1
         cross join cells on cells.state = mine.id",
    )
    .bind(environment.id.0)
    .bind(environment.schema.joint_actions() as i64)
    .fetch_one(moment)
    .await?;
    let number = |at| {
        row.try_get::<i64, _>(at)
            .map(|number| number.max(0).unsigned_abs())
    };
    Ok(Found {
        transitions: (u128::from(number(2)?) << 32) + u128::from(number(3)?),
        size: Size {
            states: number(0)?,
            cells: number(1)?,
        },
        strays: number(4)?,
    })
}

/// Reads every producer and receipt to its end.
async fn read_producers(
    moment: &mut SqliteConnection,
    environment: &Environment,
) -> Result<(), Cause> {
    let text =
        "select total(length(stored.name) + stored.sequence), total(length(batches.digest) + length(batches.receipt))
         from producers cross join producers as stored not indexed on stored.id = producers.id
         left join batches on batches.producer = producers.id
         where producers.environment = ?1";
    sqlx::query(text)
        .bind(environment.id.0)
        .fetch_one(moment)
        .await?;
    Ok(())
}
