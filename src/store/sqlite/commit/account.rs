//! Writing idempotency keys: each producer's watermark, and the receipts that answer duplicates.

use std::sync::LazyLock;

use sqlx::sqlite::SqliteConnection;

use super::signed::signed;
use crate::domain::{EnvironmentId, Sequence};
use crate::store::ledger::{Account, last_dropped};
use crate::store::sqlite::checksums;
use crate::store::sqlite::error::aborted;
use crate::store::sqlite::rows::ManyRows;
use crate::store::sqlite::stored_forms;
use crate::store::{Numbered, StoreError};

/// Advances a producer over its batches, and keeps their digests and receipts. The sequence is
/// compared once more, in SQL.
pub(super) async fn write_account(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    producer: &str,
    account: &Account<'_>,
) -> Result<(), StoreError> {
    let id = match account.id() {
        Some(id) => id.0,
        None => insert_producer(connection, environment, producer)
            .await
            .map_err(aborted)?,
    };

    let (before, last) = (signed(account.before().get()), signed(account.last().get()));
    let owner = account.owner();
    let text =
        "update producers set sequence = ?, owner = ?, checksum = ? where id = ? and sequence = ?";
    let done = sqlx::query(text)
        .bind(last)
        .bind(owner.map(str::to_owned))
        .bind(checksums::producer(id, environment.0, producer, owner))
        .bind(id)
        .bind(before)
        .execute(&mut *connection)
        .await;
    let done = done.map_err(aborted)?;
    if done.rows_affected() != 1 {
        return Err(aborted(format!(
            "the sequence of producer `{producer}` is no longer {before}"
        )));
    }

    insert_batches(connection, id, account.accepted())
        .await
        .map_err(aborted)?;
    prune_batches(connection, id, account.last())
        .await
        .map_err(aborted)
}

async fn insert_producer(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    producer: &str,
) -> Result<i64, sqlx::Error> {
    let text = "insert into producers (environment, name, sequence) values (?, ?, 0)";
    let done = sqlx::query(text)
        .bind(environment.0)
        .bind(producer.to_owned())
        .execute(connection)
        .await?;
    Ok(done.last_insert_rowid())
}

async fn insert_batches(
    connection: &mut SqliteConnection,
    producer: i64,
    batches: &[&Numbered],
) -> Result<(), sqlx::Error> {
    static INSERT: LazyLock<ManyRows> = LazyLock::new(|| {
        ManyRows::new(
            "insert into batches (producer, sequence, digest, receipt, checksum) values",
            "(?, ?, ?, ?, ?)",
            "",
        )
    });

    for (sql, chunk) in INSERT.chunks(batches) {
        let mut query = sqlx::query(sql);
        for batch in chunk {
            let sequence = signed(batch.sequence.get());
            let receipt = stored_forms::write_receipt(&batch.receipt);
            let checksum = checksums::batch(producer, sequence, &batch.digest.0, &receipt);
            query = query.bind(producer).bind(sequence);
            query = query.bind(batch.digest.0.to_vec()).bind(receipt);
            query = query.bind(checksum);
        }
        query.execute(&mut *connection).await?;
    }
    Ok(())
}

async fn prune_batches(
    connection: &mut SqliteConnection,
    producer: i64,
    watermark: Sequence,
) -> Result<(), sqlx::Error> {
    let dropped = last_dropped(watermark);
    if dropped != Sequence::NONE {
        let text = "delete from batches where producer = ? and sequence <= ?";
        sqlx::query(text)
            .bind(producer)
            .bind(signed(dropped.get()))
            .execute(connection)
            .await?;
    }
    Ok(())
}
