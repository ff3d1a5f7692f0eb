//! Counting batches exactly once: decide each by the table of [`crate::store::Store`], merge what is accepted, write it, commit.
//!
//! `ledger` is what the database says before, and what is accepted on top of it; `decide` is the table; `quota` its last row; `merge` adds equal cells
//! together; `write` and `account` put it all into the database.

use self::ledger::Ledgers;
use super::directory::Directory;
use super::writer::Writer;
use crate::domain::EnvironmentId;
use crate::store::{Numbered, Outcome, Quotas, StoreError};

mod account;
mod decide;
mod ledger;
mod lookup;
mod merge;
mod quota;
mod write;

/// How many of each producer's batches are kept, with digest and receipt.
pub(super) const KEPT: u64 = 1_024;

/// Commits batches in their order, in one transaction, and returns an outcome each. An environment that turns out to be damaged holds up no other: it
/// takes no more batches, and the rest is begun anew.
pub(super) async fn commit(
    writer: &Writer,
    directory: &Directory,
    quotas: Quotas,
    batches: &[Numbered],
) -> Result<Vec<Outcome>, StoreError> {
    loop {
        match attempt(writer, directory, quotas, batches).await {
            Err(Failed { error: StoreError::Damaged(why), environment: Some(id) })
                if directory.make_read_only(id, &why) => {}
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
    transaction.commit(|memory, _| deltas.iter().for_each(|delta| delta.apply_to(memory))).await?;
    Ok(outcomes)
}

/// Why a commit failed, and in whose rows.
struct Failed {
    error: StoreError,
    /// None where it is no environment's.
    environment: Option<EnvironmentId>,
}

impl Failed {
    fn in_environment(id: EnvironmentId, error: StoreError) -> Self {
        Self { error, environment: Some(id) }
    }
}

impl From<StoreError> for Failed {
    fn from(error: StoreError) -> Self {
        Self { error, environment: None }
    }
}

/// Returns a number as the database holds it.
fn signed(number: u64) -> i64 {
    i64::try_from(number).expect("a batch that would pass 2^63 - 1 was refused")
}
