//! Compares the totals that every commit kept with what the cells add up to. SQLite's own check passes a flipped bit in a count.

use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqlitePool};

use super::directory::Directory;
use super::error::unreadable;
use crate::domain::Environment;
use crate::store::{Audit, StoreError};

/// Audits every environment, and makes those read-only that do not add up.
pub(super) async fn audit(readers: &SqlitePool, directory: &Directory) -> Result<Vec<Audit>, StoreError> {
    let mut audits = Vec::new();
    for environment in directory.all() {
        // One that was deleted meanwhile has nothing to compare.
        let Some(audit) = audit_one(readers, &environment).await? else { continue };
        if !audit.is_sound() && directory.make_read_only(environment.id) {
            tracing::error!(
                environment = %audit.environment,
                kept = ?audit.kept,
                found = ?audit.found,
                "the counts of an environment do not add up to its totals: it takes no more batches; restore a backup"
            );
        }
        audits.push(audit);
    }
    Ok(audits)
}

/// One statement, so that totals and cells are of the same moment. Visits are summed in two halves: a damaged one could overflow the sum.
async fn audit_one(readers: &SqlitePool, environment: &Environment) -> Result<Option<Audit>, StoreError> {
    let row = sqlx::query(
        "select totals.transitions, totals.states, totals.cells, found.high, found.low,
             (select count(*) from states where environment = ?1), found.cells
         from totals cross join (
             select count(*) as cells,
                 coalesce(sum(cells.n >> 32), 0) as high, coalesce(sum(cells.n & 0xffffffff), 0) as low
             from states cross join cells on cells.state = states.id
             where states.environment = ?1
         ) as found
         where totals.environment = ?1",
    )
    .bind(environment.id.0)
    .fetch_optional(readers)
    .await
    .map_err(unreadable)?;
    let read = |row: SqliteRow| {
        let number = |at| row.try_get::<i64, _>(at).map(i128::from);
        let transitions = (number(3)? << 32) + number(4)?;
        let kept = [number(0)?, number(1)?, number(2)?];
        let found = [transitions, number(5)?, number(6)?];
        Ok::<_, sqlx::Error>(Audit { environment: environment.name.clone(), kept: told(kept), found: told(found) })
    };
    row.map(read).transpose().map_err(unreadable)
}

/// Damage can make a sum negative or larger than any number we tell.
fn told(numbers: [i128; 3]) -> [u64; 3] {
    numbers.map(|number| u64::try_from(number.max(0)).unwrap_or(u64::MAX))
}
