//! The table of [`crate::store::Store`], row by row.

use std::cmp::Ordering;

use sqlx::Row;
use sqlx::sqlite::SqliteConnection;

use super::ledger::{Account, Ledgers};
use super::quota;
use super::window::KEPT;
use crate::domain::{Acknowledged, Digest, Receipt, Rejection, Sequence};
use crate::store::form::Unreadable;
use crate::store::sqlite::error::{aborted, spoiled};
use crate::store::sqlite::text;
use crate::store::sqlite::writer::Transaction;
use crate::store::{Numbered, Outcome, Refusal, StoreError};

/// Decides one batch after those before it, and merges it where it is accepted.
pub(super) async fn decide<'a>(
    transaction: &mut Transaction<'_>,
    ledgers: &mut Ledgers<'a>,
    batch: &'a Numbered,
) -> Result<Outcome, StoreError> {
    if ledgers.is_read_only(batch.environment) {
        return Ok(Outcome::Refused(Refusal::ReadOnly));
    }
    let Some(ledger) = ledgers.of(batch.environment) else {
        return Ok(Outcome::Refused(Refusal::Gone));
    };
    let account = ledger
        .accounts
        .get(batch.producer.as_str())
        .expect("a ledger has every producer of its commit");
    if account.is_anothers(batch.owner.as_ref()) {
        return Ok(Outcome::Refused(Refusal::Foreign));
    }
    let expected = account.last().next();
    match batch.sequence.cmp(&expected) {
        _ if batch.sequence == Sequence::NONE => {
            Ok(Outcome::Refused(Refusal::OutOfOrder { expected }))
        }
        Ordering::Greater => Ok(Outcome::Refused(Refusal::OutOfOrder { expected })),
        Ordering::Less => seen_before(transaction.connection(), account, batch).await,
        Ordering::Equal => {
            if let Some(refusal) = quota::refusal(transaction, ledger, batch).await? {
                return Ok(Outcome::Refused(refusal));
            }
            ledger.accept(batch);
            Ok(Outcome::Acknowledged(Acknowledged::now(
                batch.receipt.clone(),
            )))
        }
    }
}

/// Compares a batch with the one that used its number: earlier in this commit, or in the database.
async fn seen_before(
    connection: &mut SqliteConnection,
    account: &Account<'_>,
    batch: &Numbered,
) -> Result<Outcome, StoreError> {
    let back = account.last().get() - batch.sequence.get();
    if back >= KEPT {
        return Ok(Outcome::Acknowledged(Acknowledged::Unverified));
    }
    let in_this_commit = account.accepted.iter().rev().nth(back as usize);
    if let Some(first) = in_this_commit {
        return Ok(compare(batch, first.digest, &first.receipt));
    }
    let Some((producer, _)) = account.stored else {
        return Ok(Outcome::Acknowledged(Acknowledged::Unverified));
    };
    let (digest, receipt) = kept(connection, producer, batch.sequence).await?;
    Ok(match receipt {
        Ok(receipt) => compare(batch, digest, &receipt),
        Err(_) if !is_same(batch, digest, &[]) => Outcome::Refused(Refusal::Reused),
        // It was counted, and that is all that is known: an error here would hold up whoever is in
        // the same commit, for ever.
        Err(why) => {
            let (environment, sequence) = (batch.environment.0, batch.sequence.get());
            tracing::warn!(environment, producer = batch.producer.as_str(), sequence, %why, "a receipt cannot be read");
            Outcome::Acknowledged(Acknowledged::Untold)
        }
    })
}

fn compare(batch: &Numbered, first: Digest, receipt: &Receipt) -> Outcome {
    match is_same(batch, first, &receipt.rejected) {
        true => Outcome::Acknowledged(Acknowledged::Duplicate(receipt.clone())),
        false => Outcome::Refused(Refusal::Reused),
    }
}

/// Returns whether a batch has the content that was digested first, by this build or by one that
/// digested what it told of rejected records too.
fn is_same(batch: &Numbered, first: Digest, told: &[Rejection]) -> bool {
    batch.digest == first
        || batch
            .worded
            .as_ref()
            .is_some_and(|worded| worded.digest(told) == first)
}

async fn kept(
    connection: &mut SqliteConnection,
    producer: i64,
    sequence: Sequence,
) -> Result<(Digest, Result<Receipt, Unreadable>), StoreError> {
    let row =
        sqlx::query("select digest, receipt from batches where producer = ? and sequence = ?")
            .bind(producer)
            .bind(sequence.get() as i64)
            .fetch_one(connection)
            .await
            .map_err(aborted)?;
    let digest = row.try_get::<&[u8], _>(0).map_err(aborted)?.try_into();
    let receipt = text::receipt(row.try_get(1).map_err(aborted)?);
    match digest {
        Ok(digest) => Ok((Digest(digest), receipt)),
        Err(_) => Err(spoiled(&format!("the digest of batch {sequence}"))),
    }
}
