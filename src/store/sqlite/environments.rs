//! The worlds in the database: made, changed, and read at the start.

use std::sync::Arc;

use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::directory::Directory;
use super::error::{aborted, spoiled, unreadable};
use super::text;
use super::writer::Writer;
use crate::domain::{Environment, EnvironmentId, Name, Schema, Uid, WrittenRule};
use crate::store::StoreError;

/// Reads every environment.
pub(super) async fn load(connection: &mut SqliteConnection) -> Result<Vec<Environment>, StoreError> {
    let rows = sqlx::query("select id, uid, name, schema, schema_hash, rule from environments where name is not null")
        .fetch_all(connection)
        .await
        .map_err(unreadable)?;
    rows.iter().map(read).collect()
}

pub(super) async fn create(
    writer: &Writer,
    name: &Name,
    schema: &Schema,
    rule: WrittenRule,
) -> Result<Arc<Environment>, StoreError> {
    let uid = Uid(uuid::Uuid::new_v4().to_string());
    let mut transaction = writer.begin().await?;
    if is_taken(transaction.connection(), name).await? {
        transaction.end().await?;
        return Err(StoreError::AlreadyExists(name.to_string()));
    }
    let id = insert(transaction.connection(), &uid, name, schema, rule).await.map_err(aborted)?;
    let made = Arc::new(Environment { id, uid, name: name.clone(), schema: schema.clone(), rule });
    transaction.commit(|memory, _| memory.directory.put(Arc::clone(&made))).await?;
    Ok(made)
}

pub(super) async fn set_rule(
    writer: &Writer,
    directory: &Directory,
    id: EnvironmentId,
    rule: WrittenRule,
) -> Result<Arc<Environment>, StoreError> {
    let mut transaction = writer.begin().await?;
    // Looked up after `begin`, so that two changes cannot pass each other.
    let Some(present) = directory.of_id(id) else {
        transaction.end().await?;
        return Err(StoreError::UnknownEnvironment);
    };
    sqlx::query("update environments set rule = ? where id = ?")
        .bind(text::of_rule(&rule))
        .bind(id.0)
        .execute(transaction.connection())
        .await
        .map_err(aborted)?;
    let changed = Arc::new(Environment { rule, ..Environment::clone(&present) });
    transaction.commit(|memory, _| memory.directory.put(Arc::clone(&changed))).await?;
    Ok(changed)
}

async fn is_taken(connection: &mut SqliteConnection, name: &Name) -> Result<bool, StoreError> {
    sqlx::query_scalar("select exists (select 1 from environments where name = ?)")
        .bind(name.as_str())
        .fetch_one(connection)
        .await
        .map_err(aborted)
}

async fn insert(
    connection: &mut SqliteConnection,
    uid: &Uid,
    name: &Name,
    schema: &Schema,
    rule: WrittenRule,
) -> Result<EnvironmentId, sqlx::Error> {
    let text = "insert into environments (uid, name, schema, schema_hash, rule) values (?, ?, ?, ?, ?)";
    let done = sqlx::query(text)
        .bind(&uid.0)
        .bind(name.as_str())
        .bind(text::of_schema(schema))
        .bind(schema.hash().0.to_vec())
        .bind(text::of_rule(&rule))
        .execute(&mut *connection)
        .await?;
    let id = done.last_insert_rowid();
    sqlx::query("insert into totals (environment) values (?)").bind(id).execute(connection).await?;
    Ok(EnvironmentId(id))
}

fn read(row: &SqliteRow) -> Result<Environment, StoreError> {
    let name: String = row.try_get("name").map_err(unreadable)?;
    let environment = |row: &SqliteRow| {
        let schema = text::schema(row.try_get("schema").ok()?)?;
        let hash: Vec<u8> = row.try_get("schema_hash").ok()?;
        (schema.hash().0[..] == hash).then_some(Environment {
            id: EnvironmentId(row.try_get("id").ok()?),
            uid: Uid(row.try_get("uid").ok()?),
            name: name.parse().ok()?,
            schema,
            rule: text::rule(row.try_get("rule").ok()?)?,
        })
    };
    environment(row).ok_or_else(|| spoiled(&format!("environment `{name}`")))
}
