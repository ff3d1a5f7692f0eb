//! Consistency check of one environment that seemed damaged: whether everything that a commit or a
//! question may read of it can be read, and is as it was written. What passes takes batches again.
//!
//! SQLite tells of a read that failed (EIO) as it tells of a damaged page, so only reading again says
//! which it was. New connections read it: a page that came wrong once stays in the cache of the old.

use sqlx::SqlitePool;

use super::closing::Closing;
use super::directory::Directory;
use super::error::{spoiled, unreadable};
use super::lock::Identity;
use super::open::readers;
use super::{audit, fits, inspect, load, models, receipts};
use crate::domain::{Environment, EnvironmentId};
use crate::store::StoreError;

/// Fails with `Damaged` where something of an environment is not as it was written.
pub(super) async fn recheck(
    file: &Identity,
    closing: &Closing,
    directory: &Directory,
    id: EnvironmentId,
) -> Result<(), StoreError> {
    // One that was deleted meanwhile has nothing to look at.
    let Some(environment) = directory.of_id(id) else {
        return Ok(());
    };
    let anew = readers(file, closing).await.map_err(unreadable)?;
    let looked = look(&anew, &environment).await;
    anew.close().await;
    looked
}

/// Lets connections forget what they have read: a page may have come wrong once.
pub(super) async fn forget_pages(readers: &SqlitePool) -> Result<(), StoreError> {
    let mut all = Vec::new();
    for _ in 0..readers.size() {
        let mut reader = readers.acquire().await.map_err(unreadable)?;
        let forget = sqlx::query("pragma shrink_memory");
        forget.execute(&mut *reader).await.map_err(unreadable)?;
        all.push(reader);
    }
    Ok(())
}

async fn look(readers: &SqlitePool, environment: &Environment) -> Result<(), StoreError> {
    let id = environment.id;
    look_at_description(readers, environment).await?;
    if let Some(why) = audit::fault_of(readers, environment).await? {
        return Err(StoreError::Damaged(why));
    }

    let mut faults = receipts::faults(readers, id).await?;
    faults.extend(inspect::damaged_rows(readers, id).await?);
    if let Some(why) = faults.into_iter().next() {
        return Err(StoreError::Damaged(why));
    }

    // What a fit says is for those who made it, and is made again where it cannot be used.
    fits::fits(readers, id).await?;
    look_at_models(readers, id).await?;
    look_at_shared_trees(readers).await
}

/// Looks whether the trees and indices that all environments write into are whole, as whoever adds to
/// them will see: a commit, a fold or a fit that meets a damaged neighbour there meets it at times.
async fn look_at_shared_trees(readers: &SqlitePool) -> Result<(), StoreError> {
    for check in [
        "pragma integrity_check(cells)",
        "pragma integrity_check(states)",
        "pragma integrity_check(packed)",
        "pragma integrity_check(journal)",
        "pragma integrity_check(producers)",
        "pragma integrity_check(batches)",
        "pragma integrity_check(totals)",
        "pragma integrity_check(fits)",
        "pragma integrity_check(models)",
        "pragma integrity_check(segments)",
    ] {
        if let Some(why) = inspect::pages(readers, check).await?.into_iter().next() {
            return Err(StoreError::Damaged(why));
        }
    }
    Ok(())
}

/// Reads networks and their weights. One that is not as it was kept may have another's number.
async fn look_at_models(readers: &SqlitePool, id: EnvironmentId) -> Result<(), StoreError> {
    for record in models::models(readers, id).await? {
        let model = models::model(readers, id, record.version).await?;
        if !model.is_some_and(|(record, _)| record.is_sound) {
            return Err(spoiled(&format!(
                "version {} of its networks",
                record.version
            )));
        }
    }
    Ok(())
}

async fn look_at_description(
    readers: &SqlitePool,
    environment: &Environment,
) -> Result<(), StoreError> {
    let mut reader = readers.acquire().await.map_err(unreadable)?;
    let all = load::environments(&mut reader).await?;
    for loaded in all {
        match loaded {
            Err(unread) if unread.id == environment.id => {
                return Err(StoreError::Damaged(unread.why));
            }
            Ok(read) if read.id == environment.id => return Ok(()),
            _ => {}
        }
    }
    Err(spoiled("its description"))
}
