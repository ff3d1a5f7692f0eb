//! The model registry: which versions of trained networks there are, which of them is active, and
//! their weights.
//!
//! Not for what they say: cards and weights are kept as they come.

use sqlx::sqlite::{SqliteConnection, SqliteRow};
use sqlx::{Row, SqlitePool};

use super::checksums;
use super::directory::Directory;
use super::error::{aborted, spoiled, unreadable};
use super::writer::{Transaction, Writer};
use crate::domain::EnvironmentId;
use crate::store::{ModelRecord, NewModel, Quotas, StoreError};

/// The SQL of models, with whether each is the active one of its pair.
macro_rules! select {
    ($which:literal) => {
        concat!(
            "select *, ifnull(activated = (select max(activated) from models as rivals
                 where rivals.environment = models.environment
                     and rivals.ego = models.ego and rivals.other = models.other), 0) as active
             from models where environment = ? ",
            $which
        )
    };
}

/// Returns the models of an environment, in order of version.
pub(super) async fn models(
    readers: &SqlitePool,
    id: EnvironmentId,
) -> Result<Vec<ModelRecord>, StoreError> {
    let rows = sqlx::query(select!("order by version"))
        .bind(id.0)
        .fetch_all(readers)
        .await
        .map_err(unreadable)?;
    rows.iter()
        .map(|row| read_record(row).map_err(unreadable))
        .collect()
}

/// Returns a model with its weights, empty where they are missing.
pub(super) async fn model(
    readers: &SqlitePool,
    id: EnvironmentId,
    version: u64,
) -> Result<Option<(ModelRecord, Vec<u8>)>, StoreError> {
    // Both statements see one moment.
    let mut moment = readers.begin().await.map_err(unreadable)?;
    let row = sqlx::query(select!("and version = ?"))
        .bind(id.0)
        .bind(version.cast_signed())
        .fetch_optional(&mut *moment)
        .await
        .map_err(unreadable)?;
    let Some(row) = row else { return Ok(None) };
    let mut record = read_record(&row).map_err(unreadable)?;

    let text = "select * from model_weights where environment = ? and version = ?";
    let row = sqlx::query(text)
        .bind(id.0)
        .bind(version.cast_signed())
        .fetch_optional(&mut *moment)
        .await
        .map_err(unreadable)?;
    let Some(row) = row else {
        return Ok(Some((record, Vec::new())));
    };
    let (weights, is_sound) = read_weights(&row).map_err(unreadable)?;
    record.is_sound &= is_sound;
    Ok(Some((record, weights)))
}

fn read_record(row: &SqliteRow) -> Result<ModelRecord, sqlx::Error> {
    let whole = |name| row.try_get::<i64, _>(name).map(i64::unsigned_abs);
    Ok(ModelRecord {
        version: whole("version")?,
        ego: whole("ego")? as usize,
        other: whole("other")? as usize,
        kind: row.try_get("kind")?,
        activated: row
            .try_get::<Option<i64>, _>("activated")?
            .map(i64::unsigned_abs),
        active: row.try_get("active")?,
        card: row.try_get("card")?,
        is_sound: checksums::is_sound(row, |row| {
            let agents = [row.try_get("ego")?, row.try_get("other")?];
            let (kind, card) = (row.try_get("kind")?, row.try_get("card")?);
            Ok(checksums::model(key(row)?, agents, kind, card))
        })?,
    })
}

/// Reads weights, and whether they are as they were written.
fn read_weights(row: &SqliteRow) -> Result<(Vec<u8>, bool), sqlx::Error> {
    let weights: Vec<u8> = row.try_get("weights")?;
    let is_sound = checksums::is_sound(row, |row| Ok(checksums::weights(key(row)?, &weights)))?;
    Ok((weights, is_sound))
}

fn key(row: &SqliteRow) -> Result<[i64; 2], sqlx::Error> {
    Ok([row.try_get("environment")?, row.try_get("version")?])
}

/// Keeps a model under the next version of its environment.
pub(super) async fn keep(
    writer: &Writer,
    directory: &Directory,
    quotas: Quotas,
    id: EnvironmentId,
    model: &NewModel,
) -> Result<u64, StoreError> {
    let mut transaction = begin(writer, directory, id).await?;
    if count(transaction.connection(), id).await.map_err(aborted)? >= quotas.models {
        transaction.end().await?;
        return Err(StoreError::too_many_models(quotas.models));
    }

    let Some(version) = next_version(transaction.connection(), id).await? else {
        transaction.end().await?;
        return Err(StoreError::VersionsUsedUp("network"));
    };

    insert(transaction.connection(), id, version, model)
        .await
        .map_err(aborted)?;
    transaction.commit(|_, _| ()).await?;
    Ok(version.unsigned_abs())
}

async fn count(connection: &mut SqliteConnection, id: EnvironmentId) -> Result<u64, sqlx::Error> {
    let text = "select count(*) from models where environment = ?";
    sqlx::query_scalar(text)
        .bind(id.0)
        .fetch_one(connection)
        .await
        .map(i64::unsigned_abs)
}

/// Takes the next version; `None` where the last there can be was used.
async fn next_version(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<Option<i64>, StoreError> {
    let Some(version) = last_version(connection, id).await?.checked_add(1) else {
        return Ok(None);
    };
    let text =
        "insert or replace into model_versions (environment, last, checksum) values (?, ?, ?)";
    let done = sqlx::query(text)
        .bind(id.0)
        .bind(version)
        .bind(checksums::last_version(id.0, version))
        .execute(connection);
    done.await.map_err(aborted)?;
    Ok(Some(version))
}

async fn last_version(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<i64, StoreError> {
    let text = "select * from model_versions where environment = ?";
    let row = sqlx::query(text).bind(id.0).fetch_optional(connection);
    let Some(row) = row.await.map_err(aborted)? else {
        return Ok(0);
    };
    match checksums::is_sound_last_version(&row).map_err(aborted)? {
        true => row.try_get("last").map_err(aborted),
        false => Err(spoiled("the last version of its networks")),
    }
}

async fn insert(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    version: i64,
    model: &NewModel,
) -> Result<(), sqlx::Error> {
    let agents = [model.ego, model.other].map(|agent| agent as i64);
    let text = "insert into models (environment, version, ego, other, kind, card, checksum) values (?, ?, ?, ?, ?, ?, ?)";
    let query = sqlx::query(text)
        .bind(id.0)
        .bind(version)
        .bind(agents[0])
        .bind(agents[1]);
    query
        .bind(&model.kind)
        .bind(&model.card)
        .bind(checksums::model(
            [id.0, version],
            agents,
            &model.kind,
            &model.card,
        ))
        .execute(&mut *connection)
        .await?;

    let text =
        "insert into model_weights (environment, version, weights, checksum) values (?, ?, ?, ?)";
    sqlx::query(text)
        .bind(id.0)
        .bind(version)
        .bind(&model.weights)
        .bind(checksums::weights([id.0, version], &model.weights))
        .execute(connection)
        .await?;
    Ok(())
}

/// Makes a version the active one of its pair.
pub(super) async fn activate(
    writer: &Writer,
    directory: &Directory,
    id: EnvironmentId,
    version: u64,
) -> Result<(), StoreError> {
    let text = "update models set activated =
                    (select ifnull(max(activated), 0) + 1 from models where environment = ?1)
                where environment = ?1 and version = ?2";
    change(writer, directory, id, version, text).await
}

/// Rolls a version back.
pub(super) async fn deactivate(
    writer: &Writer,
    directory: &Directory,
    id: EnvironmentId,
    version: u64,
) -> Result<(), StoreError> {
    let text = "update models set activated = null where environment = ? and version = ?";
    change(writer, directory, id, version, text).await
}

/// Deletes a version.
pub(super) async fn delete(
    writer: &Writer,
    directory: &Directory,
    id: EnvironmentId,
    version: u64,
) -> Result<(), StoreError> {
    change(
        writer,
        directory,
        id,
        version,
        "delete from models where environment = ? and version = ?",
    )
    .await
}

/// Runs a statement that changes one version.
async fn change(
    writer: &Writer,
    directory: &Directory,
    id: EnvironmentId,
    version: u64,
    text: &'static str,
) -> Result<(), StoreError> {
    let mut transaction = begin(writer, directory, id).await?;
    let query = sqlx::query(text).bind(id.0).bind(version.cast_signed());
    let done = query
        .execute(transaction.connection())
        .await
        .map_err(aborted)?;

    if done.rows_affected() == 0 {
        transaction.end().await?;
        return Err(StoreError::UnknownModel(version));
    }
    transaction.commit(|_, _| ()).await
}

async fn begin<'a>(
    writer: &'a Writer,
    directory: &Directory,
    id: EnvironmentId,
) -> Result<Transaction<'a>, StoreError> {
    let transaction = writer.begin().await?;
    // Looked up after `begin`: an environment that is gone must not get rows again.
    if directory.of_id(id).is_none() {
        transaction.end().await?;
        return Err(StoreError::UnknownEnvironment);
    }
    Ok(transaction)
}
