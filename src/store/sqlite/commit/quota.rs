//! The last row of the table: what an environment has no room for. Exact, and free of look-ups
//! until a quota is near.

use sqlx::sqlite::SqliteConnection;

use super::ledger::{Account, Ledger};
use super::lookup;
use super::merge::stored_label;
use crate::domain::StateKey;
use crate::store::sqlite::error::aborted;
use crate::store::sqlite::known::CellKey;
use crate::store::sqlite::writer::Transaction;
use crate::store::{Numbered, Refusal, StoreError};

/// The largest number that the database holds.
const MOST: u64 = i64::MAX as u64;

/// Returns why a batch, which comes next in order, cannot be counted.
pub(super) async fn refusal(
    transaction: &mut Transaction<'_>,
    ledger: &mut Ledger<'_>,
    batch: &Numbered,
) -> Result<Option<Refusal>, StoreError> {
    if overflows(ledger, batch) {
        return Ok(Some(Refusal::Overflow));
    }
    let quotas = ledger.quotas;
    if !has_room_for_producer(transaction.connection(), ledger, batch).await? {
        return Ok(Some(Refusal::Quota {
            what: "producers",
            limit: quotas.producers,
        }));
    }
    if !has_room_for_segment(transaction.connection(), ledger, batch).await? {
        return Ok(Some(Refusal::Quota {
            what: "segments",
            limit: quotas.segments,
        }));
    }
    if !has_room_for_cells(transaction, ledger, batch).await? {
        return Ok(Some(Refusal::Quota {
            what: "cells",
            limit: quotas.cells,
        }));
    }
    Ok(None)
}

/// The sum of all visits bounds every visit and every entry, so it is the only sum to check.
fn overflows(ledger: &Ledger<'_>, batch: &Numbered) -> bool {
    let before = ledger.transitions + ledger.merged.transitions();
    let sum = before.checked_add(batch.increment.transitions);
    sum.is_none_or(|sum| sum > MOST)
        || batch
            .increment
            .cells
            .iter()
            .any(|(_, joint, _)| *joint > MOST)
}

async fn has_room_for_producer(
    connection: &mut SqliteConnection,
    ledger: &Ledger<'_>,
    batch: &Numbered,
) -> Result<bool, StoreError> {
    let account = &ledger.accounts[batch.producer.as_str()];
    if account.stored.is_some() || !account.accepted.is_empty() {
        return Ok(true);
    }
    let is_new = |account: &&Account<'_>| account.stored.is_none() && !account.accepted.is_empty();
    let new = ledger.accounts.values().filter(is_new).count() as u64;
    let text = "select count(*) from producers where environment = ?";
    let stored: i64 = sqlx::query_scalar(text)
        .bind(ledger.environment.0)
        .fetch_one(connection)
        .await
        .map_err(aborted)?;
    Ok(stored.unsigned_abs() + new < ledger.quotas.producers)
}

/// A segment begins with the first cell that is counted in it.
async fn has_room_for_segment(
    connection: &mut SqliteConnection,
    ledger: &Ledger<'_>,
    batch: &Numbered,
) -> Result<bool, StoreError> {
    let label = stored_label(batch.increment.segment.as_ref());
    let is_known = ledger.segments.contains_key(label) || ledger.merged.segments().contains(&label);
    if batch.increment.cells.is_empty() || is_known {
        return Ok(true);
    }
    let new = ledger
        .merged
        .segments()
        .iter()
        .filter(|label| !ledger.segments.contains_key(*label))
        .count() as u64;
    let text = "select count(*) from segments where environment = ?";
    let stored: i64 = sqlx::query_scalar(text)
        .bind(ledger.environment.0)
        .fetch_one(connection)
        .await
        .map_err(aborted)?;
    Ok(stored.unsigned_abs() + new < ledger.quotas.segments)
}

/// First as if every cell were new. Only where that does not fit are cells looked up, and from then
/// on this commit keeps an exact count.
async fn has_room_for_cells(
    transaction: &mut Transaction<'_>,
    ledger: &mut Ledger<'_>,
    batch: &Numbered,
) -> Result<bool, StoreError> {
    let room = ledger.quotas.cells.saturating_sub(ledger.cells);
    let most = ledger.merged.len() + batch.increment.cells.len();
    if ledger.fresh_cells.is_none() && most as u64 <= room {
        return Ok(true);
    }
    let accepted = match ledger.fresh_cells {
        Some(accepted) => accepted,
        None => count_fresh(transaction, ledger, ledger.merged.cells().collect()).await?,
    };
    let added = count_fresh(transaction, ledger, ledger.merged.absent(&batch.increment)).await?;
    let fits = accepted + added <= room || added == 0;
    ledger.fresh_cells = Some(if fits { accepted + added } else { accepted });
    Ok(fits)
}

type NamedCell<'k> = (&'k StateKey, &'k str, u64);

/// Returns how many of these cells the database does not have.
async fn count_fresh(
    transaction: &mut Transaction<'_>,
    ledger: &Ledger<'_>,
    cells: Vec<NamedCell<'_>>,
) -> Result<u64, StoreError> {
    let (connection, known) = transaction.parts();
    let keys: Vec<&StateKey> = cells.iter().map(|(key, _, _)| *key).collect();
    let states = lookup::states(connection, known, ledger.environment, &keys)
        .await
        .map_err(aborted)?;
    let stored = |((_, label, joint), state): (&NamedCell<'_>, Option<i64>)| -> Option<CellKey> {
        Some((state?, *ledger.segments.get(label)?, *joint as i64))
    };
    let candidates: Vec<CellKey> = cells.iter().zip(states).filter_map(stored).collect();
    let present = lookup::count_cells(connection, known, &candidates)
        .await
        .map_err(aborted)?;
    Ok(cells.len() as u64 - present)
}
