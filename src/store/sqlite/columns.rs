//! Reading columns that several tables have.

use sqlx::Row;
use sqlx::sqlite::SqliteRow;

use crate::store::packed::unfolded::Mark;

/// Reads a number that the tables keep from being negative.
pub(super) fn whole(row: &SqliteRow, at: usize) -> Result<u64, sqlx::Error> {
    Ok(row.try_get::<i64, _>(at)?.unsigned_abs())
}

/// Reads how far an environment is folded, from two columns.
pub(super) fn mark(row: &SqliteRow, at: usize) -> Result<Mark, sqlx::Error> {
    let next_row: Option<i64> = row.try_get(at + 1)?;
    Ok(Mark {
        upto: row.try_get(at)?,
        next_row: next_row.map(i64::unsigned_abs),
    })
}
