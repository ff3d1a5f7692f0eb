//! Group commit: all batches that wait are counted in one transaction, exactly once.
//!
//! What counts is for [`crate::store::ledger`] to say. `books` answers its questions; `write` and
//! `account` put into the database what it accepts. `failed` says whose rows were at fault.

use self::books::SqliteBooks;
use self::failed::Failed;
use super::directory::Directory;
use super::writer::Writer;
use crate::store::ledger::{Ledger, Ledgers};
use crate::store::{Numbered, Outcome, Quotas, StoreError};

mod account;
mod books;
mod failed;
mod signed;
mod write;

/// Commits batches in their order, in one transaction, and returns an outcome each. An environment
/// that turns out to be damaged holds up no other: it takes no more batches, and the rest is begun
/// anew. Damage is believed once a new connection meets it too, for SQLite tells of a read that
/// failed (EIO) in the same words.
pub(super) async fn commit(
    writer: &Writer,
    directory: &Directory,
    quotas: Quotas,
    batches: &[Numbered],
) -> Result<Vec<Outcome>, StoreError> {
    let mut suspected = Vec::new();
    loop {
        let failed = match attempt(writer, directory, quotas, batches).await {
            Ok(outcomes) => return Ok(outcomes),
            Err(failed) => failed,
        };

        let Failed { error, environment } = &failed;
        let goes_on = match (error, environment) {
            (StoreError::Damaged(why), suspect) if !suspected.contains(suspect) => {
                tracing::warn!(why, "a commit met damage: it is begun anew");
                suspected.push(*suspect);
                true
            }
            (StoreError::Damaged(why), Some(id)) => directory.make_read_only(*id, why),
            _ => false,
        };
        if !goes_on {
            return Err(failed.error);
        }
    }
}

fn cells(batch: &Numbered) -> u64 {
    batch.increment.most_cells() as u64
}

async fn attempt(
    writer: &Writer,
    directory: &Directory,
    quotas: Quotas,
    batches: &[Numbered],
) -> Result<Vec<Outcome>, Failed> {
    let mut transaction = writer.begin().await?;
    let mut books = SqliteBooks {
        transaction: &mut transaction,
        directory,
        quota: quotas.cells,
        most_cells: batches.iter().map(cells).sum(),
    };
    let mut ledgers = Ledgers::open(&mut books, quotas, batches).await?;

    let mut outcomes = Vec::with_capacity(batches.len());
    for batch in batches {
        outcomes.push(ledgers.decide(&mut books, batch).await?);
    }

    let accepted: Vec<Ledger<'_>> = ledgers.into_accepted().collect();
    if accepted.is_empty() {
        transaction.end().await?;
        return Ok(outcomes);
    }

    let deltas = write::write(&mut transaction, accepted).await?;
    transaction
        .commit(|memory, _| deltas.iter().for_each(|delta| delta.apply_to(memory)))
        .await?;
    Ok(outcomes)
}
