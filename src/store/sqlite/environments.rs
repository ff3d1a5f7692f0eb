//! Writes to the catalogue of environments: made and changed. They are read in `load`, and removed
//! in `removal`.

use std::sync::Arc;

use sqlx::sqlite::SqliteConnection;

use super::checksums;
use super::directory::Directory;
use super::error::aborted;
use super::memory::Memory;
use super::row_id_cache::RowIdCache;
use super::stored_forms;
use super::writer::Writer;
use crate::domain::{Change, Environment, EnvironmentId, Name, Schema, Uid};
use crate::store::{Quotas, StoreError};

pub(super) async fn create(
    writer: &Writer,
    quotas: Quotas,
    name: &Name,
    schema: &Schema,
    change: &Change,
) -> Result<Arc<Environment>, StoreError> {
    let mut transaction = writer.begin().await?;

    if is_taken(transaction.connection(), name).await? {
        transaction.end().await?;
        return Err(StoreError::AlreadyExists(name.to_string()));
    }
    if count(transaction.connection()).await.map_err(aborted)? >= quotas.environments {
        transaction.end().await?;
        return Err(StoreError::too_many_environments(quotas.environments));
    }

    let uid = Uid(uuid::Uuid::new_v4().to_string());
    let mut made = Environment::new(uid, name.clone(), schema.clone()).with(change);
    made.id = insert(transaction.connection(), &made)
        .await
        .map_err(aborted)?;
    checksums::seal(transaction.connection(), made.id).await?;
    let made = Arc::new(made);

    let remember = |memory: &Memory, _: &mut RowIdCache| {
        memory.directory.put(Arc::clone(&made));
        memory.actions.begin(&made);
        memory.pending.begin(made.id);
    };
    transaction.commit(remember).await?;
    Ok(made)
}

pub(super) async fn change(
    writer: &Writer,
    directory: &Directory,
    id: EnvironmentId,
    change: &Change,
) -> Result<Arc<Environment>, StoreError> {
    let mut transaction = writer.begin().await?;
    // Looked up after `begin`, so that two changes cannot pass each other.
    let Some(present) = directory.of_id(id) else {
        transaction.end().await?;
        return Err(StoreError::UnknownEnvironment);
    };

    let changed = Arc::new(present.with(change));
    checksums::check(transaction.connection(), id).await?;
    sqlx::query("update environments set rule = ?, derived = ? where id = ?")
        .bind(stored_forms::write_rule(&changed.rule))
        .bind(stored_forms::write_derived(
            &changed.derived,
            &changed.schema,
        ))
        .bind(id.0)
        .execute(transaction.connection())
        .await
        .map_err(aborted)?;
    checksums::seal(transaction.connection(), id).await?;

    transaction
        .commit(|memory, _| memory.directory.put(Arc::clone(&changed)))
        .await?;
    Ok(changed)
}

async fn is_taken(connection: &mut SqliteConnection, name: &Name) -> Result<bool, StoreError> {
    sqlx::query_scalar("select exists (select 1 from environments where name = ?)")
        .bind(name.as_str())
        .fetch_one(connection)
        .await
        .map_err(aborted)
}

/// Returns how many there are, readable or not; those that are being removed are gone.
async fn count(connection: &mut SqliteConnection) -> Result<u64, sqlx::Error> {
    let text = "select count(*) from environments where name is not null";
    sqlx::query_scalar(text)
        .fetch_one(connection)
        .await
        .map(i64::unsigned_abs)
}

async fn insert(
    connection: &mut SqliteConnection,
    made: &Environment,
) -> Result<EnvironmentId, sqlx::Error> {
    let text = "insert into environments (uid, name, schema, schema_hash, derived, rule) values (?, ?, ?, ?, ?, ?)";
    let done = sqlx::query(text)
        .bind(&made.uid.0)
        .bind(made.name.as_str())
        .bind(stored_forms::write_schema(&made.schema))
        .bind(made.schema.hash().0.to_vec())
        .bind(stored_forms::write_derived(&made.derived, &made.schema))
        .bind(stored_forms::write_rule(&made.rule))
        .execute(&mut *connection)
        .await?;

    let id = done.last_insert_rowid();
    sqlx::query("insert into totals (environment) values (?)")
        .bind(id)
        .execute(connection)
        .await?;
    Ok(EnvironmentId(id))
}
