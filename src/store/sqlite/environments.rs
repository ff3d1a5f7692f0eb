//! The worlds in the database: made, changed, and read at the start.

use std::sync::Arc;

use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::directory::{Directory, Loaded};
use super::error::{aborted, unreadable};
use super::known::Known;
use super::text;
use super::writer::{Memory, Writer};
use crate::domain::{Environment, EnvironmentId, Name, Schema, Uid, UnreadableEnvironment, WrittenRule};
use crate::store::{Quotas, StoreError};

/// Reads every environment. One that cannot be read does not keep the others away.
pub(super) async fn load(connection: &mut SqliteConnection) -> Result<Vec<Loaded>, StoreError> {
    match all(connection).await.map_err(unreadable) {
        Err(StoreError::Damaged(_)) => one_by_one(connection).await,
        all => all,
    }
}

async fn all(connection: &mut SqliteConnection) -> Result<Vec<Loaded>, sqlx::Error> {
    let rows = sqlx::query("select id, uid, name, schema, schema_hash, rule from environments where name is not null")
        .fetch_all(connection)
        .await?;
    rows.iter().map(|row| read(row, row.try_get("id")?, row.try_get("name")?)).collect()
}

/// Reads what a damaged table still has. Names and ids come from the index of names alone.
async fn one_by_one(connection: &mut SqliteConnection) -> Result<Vec<Loaded>, StoreError> {
    let rows = sqlx::query("select id, name from environments where name is not null order by name");
    let mut loaded = Vec::new();
    for row in rows.fetch_all(&mut *connection).await.map_err(unreadable)? {
        let id: i64 = row.try_get("id").map_err(unreadable)?;
        let name: String = row.try_get("name").unwrap_or_else(|_| format!("damaged-{id}"));
        let text = "select uid, schema, schema_hash, rule from environments where id = ?";
        let found = sqlx::query(text).bind(id).fetch_one(&mut *connection).await;
        loaded.push(match found.and_then(|row| read(&row, id, &name)) {
            Ok(environment) => environment,
            Err(error) => {
                let why = format!("the database is damaged: {error}");
                Err(UnreadableEnvironment { id: EnvironmentId(id), uid: Uid(String::new()), name, why })
            }
        });
    }
    Ok(loaded)
}

pub(super) async fn create(
    writer: &Writer,
    quotas: Quotas,
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
    if count(transaction.connection()).await.map_err(aborted)? >= quotas.environments {
        transaction.end().await?;
        return Err(StoreError::too_many_environments(quotas.environments));
    }
    let id = insert(transaction.connection(), &uid, name, schema, rule).await.map_err(aborted)?;
    let made = Arc::new(Environment { id, uid, name: name.clone(), schema: schema.clone(), rule });
    let remember = |memory: &Memory, _: &mut Known| {
        memory.directory.put(Arc::clone(&made));
        memory.actions.begin(&made);
    };
    transaction.commit(remember).await?;
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

/// Returns how many there are, readable or not; those that are being removed are gone.
async fn count(connection: &mut SqliteConnection) -> Result<u64, sqlx::Error> {
    let text = "select count(*) from environments where name is not null";
    sqlx::query_scalar(text).fetch_one(connection).await.map(i64::unsigned_abs)
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

fn read(row: &SqliteRow, id: i64, name: &str) -> Result<Loaded, sqlx::Error> {
    let (id, uid) = (EnvironmentId(id), Uid(row.try_get("uid")?));
    Ok(match parse(row, name) {
        Ok((name, schema, rule)) => Ok(Environment { id, uid, name, schema, rule }),
        Err(why) => Err(UnreadableEnvironment { id, uid, name: name.to_owned(), why }),
    })
}

/// Reads the parts that have a form, or says what is wrong with the first that cannot be read.
fn parse(row: &SqliteRow, name: &str) -> Result<(Name, Schema, WrittenRule), String> {
    let text = |column| row.try_get::<&str, _>(column).map_err(|error| format!("its {column}: {error}"));
    let hash: &[u8] = row.try_get("schema_hash").map_err(|error| format!("its schema_hash: {error}"))?;

    let schema = text::schema(text("schema")?).map_err(|why| format!("its schema: {why}"))?;
    if schema.hash().0[..] != *hash {
        return Err(format!("its schema: it hashes to {}, not to what is kept beside it", schema.hash()));
    }
    let rule = text::rule(text("rule")?).map_err(|why| format!("its rule: {why}"))?;
    let name = name.parse().map_err(|why: String| format!("its name: {why}"))?;
    Ok((name, schema, rule))
}
