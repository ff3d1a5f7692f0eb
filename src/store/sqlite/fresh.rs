//! How many states and cells of the journal are in no row yet: what the totals of an environment
//! lack, which are written when rows are.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use sqlx::sqlite::SqliteConnection;

use super::lookup::{self, Of};
use super::pending::View;
use super::walk::{self, RowCells, Wanted};
use crate::domain::{Environment, StateKey};
use crate::store::StoreError;
use crate::store::packed::size::Size;
use crate::store::packed::unfolded::Outdated;

/// States that are looked up together.
const STATES: usize = 1_000;

/// Counts what the journal of a view has and nothing else has.
pub(super) async fn count(
    connection: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
) -> Result<Result<Size, Outdated>, StoreError> {
    if view.unfolded.is_empty() {
        return Ok(Ok(Size::default()));
    }
    if view.unmoved {
        return beside_old(connection, environment, view).await;
    }

    let mut fresh = Size::default();
    let rows = lookup::row_ids(view, view.unfolded.states());
    let count = |row: RowCells| {
        let stored = Size::of(&row.stored);
        fresh += Size::of(&row.into_sum()).less(stored);
        Ok(ControlFlow::Continue(()))
    };
    let counted = walk::rows(
        connection,
        environment.id,
        view,
        Wanted::These(&rows),
        count,
    )
    .await?;
    Ok(counted.map(|()| fresh))
}

/// Counts the same, state by state, while there are cells in the old table.
async fn beside_old(
    connection: &mut SqliteConnection,
    environment: &Environment,
    view: &View,
) -> Result<Result<Size, Outdated>, StoreError> {
    let states: BTreeSet<u64> = view.unfolded.states().collect();
    let states: Vec<u64> = states.into_iter().collect();
    let mut fresh = Size::default();
    for chunk in states.chunks(STATES) {
        let keys = lookup::keys(connection, environment, chunk).await?;
        let keys: Vec<&StateKey> = keys.iter().collect();
        let Ok(all) = lookup::states(connection, environment, view, &keys, Of::All).await? else {
            return Ok(Err(Outdated));
        };
        // Asked later, so that more of it may be in rows, but nothing that is not among all.
        let stored = lookup::states(connection, environment, view, &keys, Of::Stored).await?;
        let Ok(stored) = stored else {
            return Ok(Err(Outdated));
        };
        for (all, stored) in all.iter().zip(&stored) {
            fresh += Size::of(all).less(Size::of(stored));
        }
    }
    Ok(Ok(fresh))
}
