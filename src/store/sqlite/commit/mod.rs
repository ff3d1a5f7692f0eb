//! Counting batches exactly once: decide each by the table of [`crate::store::Store`], merge what is accepted, write it, commit.
//!
//! `ledger` is what the database says before, and what is accepted on top of it; `decide` is the table; `quota` its last row; `merge` adds equal cells
//! together; `write` and `account` put it all into the database.

use self::ledger::Ledgers;
use super::directory::Directory;
use super::writer::Writer;
use crate::store::{Numbered, Outcome, Quotas, StoreError};

mod account;
mod decide;
mod ledger;
mod lookup;
mod merge;
mod quota;
mod write;

/// Commits batches in their order, in one transaction, and returns an outcome each.
pub(super) async fn commit(
    writer: &Writer,
    directory: &Directory,
    quotas: Quotas,
    batches: &[Numbered],
) -> Result<Vec<Outcome>, StoreError> {
    let mut transaction = writer.begin().await?;
    let mut ledgers = Ledgers::read(transaction.connection(), directory, quotas, batches).await?;
    let mut outcomes = Vec::with_capacity(batches.len());
    for batch in batches {
        outcomes.push(decide::decide(&mut transaction, &mut ledgers, batch).await?);
    }
    if ledgers.accepted_nothing() {
        transaction.end().await?;
        return Ok(outcomes);
    }
    let deltas = write::write(&mut transaction, ledgers).await?;
    transaction.commit(|memory, _| deltas.iter().for_each(|delta| delta.apply_to(memory))).await?;
    Ok(outcomes)
}

/// Returns a number as the database holds it.
fn signed(number: u64) -> i64 {
    i64::try_from(number).expect("a batch that would pass 2^63 - 1 was refused")
}
