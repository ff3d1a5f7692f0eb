//! Integrity audit (a checksum by sums): compares the totals that every commit kept with what the
//! cells add up to, and reads every row that a commit may meet. SQLite's own check passes a flipped
//! bit in a count, and a cell of an action or a segment that its environment does not have.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqlitePool};

use super::directory::Directory;
use super::error::unreadable;
use crate::domain::Environment;
use crate::store::{Audit, Cause, StorageFault, StoreError};

/// Audits every environment, and makes those read-only that do not add up or cannot be read.
pub(super) async fn audit(
    readers: &SqlitePool,
    directory: &Directory,
) -> Result<Vec<Audit>, StoreError> {
    let mut audits = Vec::new();
    for environment in directory.all() {
        // One that was deleted meanwhile has nothing to compare.
        let Some(audit) = audit_patiently(readers, &environment).await? else {
            continue;
        };
        if let Some(why) = audit.fault() {
            directory.make_read_only(environment.id, &why);
        }
        audits.push(audit);
    }
    Ok(audits)
}

/// Damage is the environment's; a machine that fails to read it twice is as good as damage. Other
/// errors are no environment's.
async fn audit_patiently(
    readers: &SqlitePool,
    environment: &Environment,
) -> Result<Option<Audit>, StoreError> {
    let mut audited = audit_one(readers, environment, Bound::None).await;
    if audited
        .as_ref()
        .is_err_and(|cause| cause.fault == StorageFault::InputOutput)
    {
        audited = audit_one(readers, environment, Bound::None).await;
    }

    // What was damaged may be where the next environment begins.
    if audited
        .as_ref()
        .is_err_and(|cause| cause.fault == StorageFault::Damaged)
    {
        audited = audit_one(readers, environment, Bound::Kept).await;
    }

    match audited {
        Err(cause) if [StorageFault::Damaged, StorageFault::InputOutput].contains(&cause.fault) => {
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

/// How far rows are read.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Bound {
    /// To where they end, which is seen only by looking at what comes next.
    None,
    /// As many as the totals say there are. Were there more, the sums would have to be right
    /// without them.
    Kept,
}

/// One statement, so that totals and cells are of the same moment. Visits are summed in two halves:
/// a damaged one could overflow the sum. States are found by their index, and each is looked up in
/// its table too, which nothing else would read. Their cells are read in the order in which they
/// lie.
async fn audit_one(
    readers: &SqlitePool,
    environment: &Environment,
    bound: Bound,
) -> Result<Option<Audit>, Cause> {
    read_producers(readers, environment).await?;
    let row = sqlx::query(
        "select totals.transitions, totals.states, totals.cells, found.high, found.low,
             (select count(*) from (
                 select id, key from states indexed by sqlite_autoindex_states_1 where environment = ?1
                 limit case when ?3 then (select states from totals where environment = ?1) else -1 end
              ) as mine cross join states as stored not indexed on stored.id = mine.id
                 where stored.environment = ?1 and stored.key = mine.key),
             found.cells, found.strays
         from totals cross join (
             select count(*) as cells,
                 coalesce(sum(cells.n >> 32), 0) as high, coalesce(sum(cells.n & 0xffffffff), 0) as low,
                 coalesce(sum(not (
                     cells.joint between 0 and ?2 - 1 and coalesce(cells.entries between 0 and cells.n, 1)
                     and exists (select 1 from segments where segments.id = cells.segment and segments.environment = ?1)
                 )), 0) as strays
             from (
                 select cells.* from (
                     select id from (
                         select id from states indexed by sqlite_autoindex_states_1 where environment = ?1
                         limit case when ?3 then (select states from totals where environment = ?1) else -1 end
                     ) order by id
                 ) as mine cross join cells on cells.state = mine.id
                 limit case when ?3 then (select cells from totals where environment = ?1) else -1 end
             ) as cells
         ) as found
         where totals.environment = ?1",
    )
    .bind(environment.id.0)
    .bind(environment.schema.joint_actions() as i64)
    .bind(bound == Bound::Kept)
    .fetch_optional(readers)
    .await?;
    let audit = row.map(|row| read_audit(&row, environment));
    Ok(audit.transpose()?)
}

fn read_audit(row: &SqliteRow, environment: &Environment) -> Result<Audit, sqlx::Error> {
    let number = |at| row.try_get::<i64, _>(at).map(i128::from);
    let kept = [number(0)?, number(1)?, number(2)?];
    let transitions = (number(3)? << 32) + number(4)?;
    let found = [transitions, number(5)?, number(6)?];

    // Sums that differ say more than cells that cannot be.
    let strays = number(7)?;
    let unreadable = (strays > 0 && kept == found).then(|| {
        format!("{strays} of its cells are of an action or a segment that it does not have")
    });
    Ok(Audit {
        environment: environment.name.clone(),
        kept: as_unsigned(kept),
        found: as_unsigned(found),
        unreadable,
    })
}

/// Reads every producer and receipt to its end.
async fn read_producers(readers: &SqlitePool, environment: &Environment) -> Result<(), Cause> {
    let text =
        "select total(length(stored.name) + stored.sequence), total(length(batches.digest) + length(batches.receipt))
         from producers cross join producers as stored not indexed on stored.id = producers.id
         left join batches on batches.producer = producers.id
         where producers.environment = ?1";
    sqlx::query(text)
        .bind(environment.id.0)
        .fetch_one(readers)
        .await?;
    Ok(())
}

/// Damage can make a sum negative or larger than any number we tell.
fn as_unsigned(numbers: [i128; 3]) -> [u64; 3] {
    numbers.map(|number| u64::try_from(number.max(0)).unwrap_or(u64::MAX))
}
