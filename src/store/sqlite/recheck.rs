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

    // What these say is for those who made them, and is made again where it cannot be used.
    fits::fits(readers, id).await?;
    for model in models::models(readers, id).await? {
        models::model(readers, id, model.version).await?;
    }
    look_at_segments(readers, id).await
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

/// Reads the labels of segments in their table and in the index by which a commit finds them.
async fn look_at_segments(readers: &SqlitePool, id: EnvironmentId) -> Result<(), StoreError> {
    let text = "select total(length(stored.label)) from segments cross join segments as stored not indexed
             on stored.id = segments.id and stored.label = segments.label
         where segments.environment = ?";
    let read = sqlx::query(text).bind(id.0).fetch_one(readers).await;
    read.map(drop).map_err(unreadable)
}
