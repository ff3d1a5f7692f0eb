//! Marginal counts: how often each action was taken and each value observed, summed over every cell of
//! an environment where memory does not know it.

use std::ops::ControlFlow;
use std::sync::Arc;

use sqlx::SqlitePool;
use sqlx::sqlite::SqliteConnection;

use super::error::{spoiled, unreadable};
use super::lookup;
use super::memory::Memory;
use super::pending::View;
use super::read;
use super::walk::{self, Placed, Wanted};
use crate::domain::{ActionTotals, Environment, Family};
use crate::store::StoreError;
use crate::store::packed::unfolded::Outdated;

/// Returns the totals of an environment at its newest revision. Where nothing is kept until it is
/// settled what was committed, `settling` is awaited first.
pub(super) async fn actions(
    readers: &SqlitePool,
    memory: &Memory,
    environment: &Environment,
    settling: impl Future<Output = Result<(), StoreError>>,
) -> Result<Arc<ActionTotals>, StoreError> {
    let kept = &memory.actions;
    if let Some(kept) = kept.get(environment.id) {
        return Ok(kept);
    }
    let turn = kept.turn().await;
    if let Some(kept) = kept.get(environment.id) {
        return Ok(kept);
    }

    // Nothing is kept until a transaction has settled what was committed, and each question would
    // read every cell. Whether one can begin is not the reader's concern.
    if kept.is_suspended() {
        settling.await.ok();
    }

    let mut reader = readers.acquire().await.map_err(unreadable)?;
    let load = kept.announce(turn, environment.id);
    loop {
        let view = read::view(&mut reader, memory, environment.id).await?;
        if let Ok(totals) = sum(&mut reader, environment, &view).await? {
            load.snapshot_taken(&environment.schema, view.revision);
            return Ok(load.finish(totals));
        }
    }
}

/// Adds every cell.
async fn sum(
    reader: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
) -> Result<Result<ActionTotals, Outdated>, StoreError> {
    let mut totals = ActionTotals::new(&environment.schema);
    let mut visits = 0;
    let show = |_, cells: &[Placed]| {
        add(&mut totals, &mut visits, environment, cells)?;
        Ok(ControlFlow::Continue(()))
    };
    let walked = walk::states(reader, environment.id, view, Wanted::All, show).await?;
    totals.revision = view.revision;
    Ok(walked.map(|()| totals))
}

/// Adds cells, and their visits. Damaged ones could overflow a sum, which no sound ones do.
fn add(
    totals: &mut ActionTotals,
    visits: &mut u64,
    environment: &Environment,
    cells: &[Placed],
) -> Result<(), StoreError> {
    for (place, tally) in cells {
        let sum = visits
            .checked_add(tally.n)
            .filter(|sum| *sum <= i64::MAX as u64);
        *visits = sum.ok_or_else(|| spoiled("the sum of an environment's visits"))?;

        match lookup::known_family(&environment.schema, place, *tally)? {
            Family::JOINT => totals.add(place.joint, *tally),
            family => totals.add_value(family, place.joint, *tally),
        }
    }
    Ok(())
}
