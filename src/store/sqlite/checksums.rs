//! Checksums (CRC-32) of rows whose content follows from nothing else that is kept, so that a
//! flipped bit in one of them is not believed. Each is written with its row, and is over which row
//! it is, too.
//!
//! What an index has as well, or what adds up, needs none: SQLite's own check and the audit compare
//! that. A row of an earlier build has none until it is written again.

use crc32fast::Hasher;
use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::error::{aborted, spoiled};
use crate::domain::EnvironmentId;
use crate::store::StoreError;

/// A checksum in the making. Each part says where it ends, so that no two rows are taken for one.
struct Parts(Hasher);

impl Parts {
    fn new() -> Self {
        Self(Hasher::new())
    }

    fn number(mut self, number: i64) -> Self {
        self.0.update(&number.to_le_bytes());
        self
    }

    fn bytes(self, bytes: &[u8]) -> Self {
        let mut parts = self.number(bytes.len() as i64);
        parts.0.update(bytes);
        parts
    }

    fn text(self, text: &str) -> Self {
        self.bytes(text.as_bytes())
    }

    /// Adds what may be absent.
    fn option<T>(self, part: Option<T>, add: impl FnOnce(Self, T) -> Self) -> Self {
        match part {
            Some(part) => add(self.number(1), part),
            None => self.number(0),
        }
    }

    fn end(self) -> i64 {
        i64::from(self.0.finalize())
    }
}

/// Returns the checksum of a producer, but for its sequence, which its batches lead up to.
pub(super) fn producer(id: i64, environment: i64, name: &str, owner: Option<&str>) -> i64 {
    let parts = Parts::new().number(id).number(environment).text(name);
    parts.option(owner, Parts::text).end()
}

/// Returns the checksum of a batch.
pub(super) fn batch(producer: i64, sequence: i64, digest: &[u8], receipt: &str) -> i64 {
    let parts = Parts::new().number(producer).number(sequence);
    parts.bytes(digest).text(receipt).end()
}

/// Returns the checksum of a fit, of which the numbers are its version and revision.
pub(super) fn fit(environment: i64, pair: &str, numbers: [i64; 2], body: &str) -> i64 {
    let [version, revision] = numbers;
    let parts = Parts::new().number(environment).text(pair);
    parts.number(version).number(revision).text(body).end()
}

/// Returns the checksum of a network, but for when it was activated, which an index has too.
pub(super) fn model(key: [i64; 2], agents: [i64; 2], kind: &str, card: &str) -> i64 {
    let ([environment, version], [ego, other]) = (key, agents);
    let parts = Parts::new().number(environment).number(version);
    let parts = parts.number(ego).number(other);
    parts.text(kind).text(card).end()
}

/// Returns the checksum of the weights of a network.
pub(super) fn weights([environment, version]: [i64; 2], weights: &[u8]) -> i64 {
    let parts = Parts::new().number(environment).number(version);
    parts.bytes(weights).end()
}

/// Returns the checksum of the last version of networks that was given.
pub(super) fn last_version(environment: i64, last: i64) -> i64 {
    Parts::new().number(environment).number(last).end()
}

/// Returns the checksum of an environment.
fn environment(row: &SqliteRow) -> Result<i64, sqlx::Error> {
    let parts = Parts::new().number(row.try_get("id")?);
    let parts = parts.text(row.try_get("uid")?).text(row.try_get("name")?);
    let parts = parts.text(row.try_get("schema")?);
    let parts = parts.bytes(row.try_get("schema_hash")?);
    let parts = parts.text(row.try_get("rule")?);
    let parts = parts.option(row.try_get("block")?, Parts::number);
    // One without is as it was before there were any.
    Ok(match derived(row)? {
        Some(derived) => parts.text(derived).end(),
        None => parts.end(),
    })
}

/// Returns the stored text of the derived features of an environment, if it has any.
pub(super) fn derived(row: &SqliteRow) -> Result<Option<&str>, sqlx::Error> {
    match row.try_get("derived") {
        // Databases of earlier builds, which are only looked at, have no such column.
        Err(sqlx::Error::ColumnNotFound(_)) => Ok(None),
        found => found,
    }
}

/// Returns whether a row, read with all its columns, is as it was written. One without a checksum
/// is believed.
pub(super) fn is_sound(
    row: &SqliteRow,
    checksum: impl FnOnce(&SqliteRow) -> Result<i64, sqlx::Error>,
) -> Result<bool, sqlx::Error> {
    let kept: Option<i64> = match row.try_get("checksum") {
        // Databases of earlier builds, which are only looked at, have no such column.
        Err(sqlx::Error::ColumnNotFound(_)) => None,
        kept => kept?,
    };
    match kept {
        Some(kept) => Ok(checksum(row)? == kept),
        None => Ok(true),
    }
}

/// Returns whether the row of an environment is as it was written.
pub(super) fn is_sound_environment(row: &SqliteRow) -> Result<bool, sqlx::Error> {
    is_sound(row, environment)
}

/// Returns whether the row of a producer is as it was written.
pub(super) fn is_sound_producer(row: &SqliteRow) -> Result<bool, sqlx::Error> {
    is_sound(row, |row| {
        let (id, environment) = (row.try_get("id")?, row.try_get("environment")?);
        let (name, owner) = (row.try_get("name")?, row.try_get("owner")?);
        Ok(producer(id, environment, name, owner))
    })
}

/// Returns whether the last version of networks that was given is as it was written.
pub(super) fn is_sound_last_version(row: &SqliteRow) -> Result<bool, sqlx::Error> {
    is_sound(row, |row| {
        Ok(last_version(
            row.try_get("environment")?,
            row.try_get("last")?,
        ))
    })
}

async fn select_environment(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<SqliteRow, StoreError> {
    let text = "select * from environments where id = ?";
    let row = sqlx::query(text).bind(id.0).fetch_one(connection).await;
    row.map_err(aborted)
}

/// Fails where the row of an environment, which is to be changed, is not as it was written: else
/// [`seal`] would make it good.
pub(super) async fn check(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<(), StoreError> {
    let row = select_environment(connection, id).await?;
    match is_sound_environment(&row).map_err(aborted)? {
        true => Ok(()),
        false => Err(spoiled("its description")),
    }
}

/// Writes the checksum of an environment that was made or changed.
pub(super) async fn seal(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<(), StoreError> {
    let row = select_environment(connection, id).await?;
    let checksum = environment(&row).map_err(aborted)?;
    let text = "update environments set checksum = ? where id = ?";
    let done = sqlx::query(text)
        .bind(checksum)
        .bind(id.0)
        .execute(connection);
    done.await.map(drop).map_err(aborted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_rows_have_the_parts_of_one() {
        assert_ne!(
            producer(1, 2, "ab", Some("c")),
            producer(1, 2, "a", Some("bc"))
        );
        assert_ne!(producer(1, 2, "a", Some("")), producer(1, 2, "a", None));
        assert_ne!(fit(1, "0,1", [2, 3], "x"), fit(1, "0,1", [3, 2], "x"));
        assert_ne!(weights([1, 2], b"x"), weights([2, 1], b"x"));
    }
}
