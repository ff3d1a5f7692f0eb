//! Counting batches exactly once: decide each by the table of [`crate::store::Store`], merge what
//! is accepted, write it, commit.
//!
//! `ledger` is what the database says before, and what is accepted on top of it; `decide` is the
//! table; `quota` its last row; `merge` adds equal cells together; `write` and `account` put it all
//! into the database. Whoever asks again within the `window` hears what was said first.

use self::failed::Failed;
use self::ledger::Ledgers;
use super::directory::Directory;
use super::writer::Writer;
use crate::store::{Numbered, Outcome, Quotas, StoreError};

mod account;
mod decide;
mod failed;
mod ledger;
mod lookup;
mod merge;
mod quota;
mod signed;
mod window;
mod write;

pub(super) use self::window::KEPT;

/// Commits batches in their order, in one transaction, and returns an outcome each. An environment
/// that turns out to be damaged holds up no other: it takes no more batches, and the rest is begun
/// anew.
pub(super) async fn commit(
    writer: &Writer,
    directory: &Directory,
    quotas: Quotas,
    batches: &[Numbered],
) -> Result<Vec<Outcome>, StoreError> {
    loop {
        match attempt(writer, directory, quotas, batches).await {
            Err(Failed {
                error: StoreError::Damaged(why),
                environment: Some(id),
            }) if directory.make_read_only(id, &why) => {}
            outcome => return outcome.map_err(|failed| failed.error),
        }
    }
}

async fn attempt(
    writer: &Writer,
    directory: &Directory,
    quotas: Quotas,
    batches: &[Numbered],
) -> Result<Vec<Outcome>, Failed> {
    let mut transaction = writer.begin().await?;
    let mut ledgers = Ledgers::read(transaction.connection(), directory, quotas, batches).await?;
    let mut outcomes = Vec::with_capacity(batches.len());
    for batch in batches {
        let decided = decide::decide(&mut transaction, &mut ledgers, batch).await;
        outcomes.push(decided.map_err(|error| Failed::in_environment(batch.environment, error))?);
    }
    if ledgers.accepted_nothing() {
        transaction.end().await?;
        return Ok(outcomes);
    }
    let deltas = write::write(&mut transaction, ledgers).await?;
    transaction
        .commit(|memory, _| deltas.iter().for_each(|delta| delta.apply_to(memory)))
        .await?;
    Ok(outcomes)
}
