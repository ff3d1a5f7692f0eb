//! Recovery of the catalogue: reading every environment when a connection is new, each as far as it
//! can be read.

use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::checksums;
use super::directory::Loaded;
use super::error::unreadable;
use super::stored_forms;
use crate::domain::{
    DerivedFeatures, Environment, EnvironmentId, Name, Schema, Uid, UnreadableEnvironment,
    WrittenRule,
};
use crate::store::StoreError;

/// Reads every environment. One that cannot be read does not keep the others away.
pub(super) async fn environments(
    connection: &mut SqliteConnection,
) -> Result<Vec<Loaded>, StoreError> {
    match read_all(connection).await.map_err(unreadable) {
        Err(StoreError::Damaged(_)) => read_one_by_one(connection).await,
        all => all,
    }
}

async fn read_all(connection: &mut SqliteConnection) -> Result<Vec<Loaded>, sqlx::Error> {
    let rows = sqlx::query("select * from environments where name is not null")
        .fetch_all(connection)
        .await?;
    rows.iter()
        .map(|row| read_environment(row, row.try_get("id")?, row.try_get("name")?))
        .collect()
}

/// Reads what a damaged table still has. Names and ids come from the index of names alone.
async fn read_one_by_one(connection: &mut SqliteConnection) -> Result<Vec<Loaded>, StoreError> {
    let rows =
        sqlx::query("select id, name from environments where name is not null order by name");
    let mut loaded = Vec::new();
    for row in rows.fetch_all(&mut *connection).await.map_err(unreadable)? {
        let id: i64 = row.try_get("id").map_err(unreadable)?;
        let name: String = row
            .try_get("name")
            .unwrap_or_else(|_| format!("damaged-{id}"));
        let text = "select * from environments where id = ?";
        let found = sqlx::query(text).bind(id).fetch_one(&mut *connection).await;

        loaded.push(
            match found.and_then(|row| read_environment(&row, id, &name)) {
                Ok(environment) => environment,
                Err(error) => {
                    let why = format!("the database is damaged: {error}");
                    Err(UnreadableEnvironment {
                        id: EnvironmentId(id),
                        uid: Uid(String::new()),
                        name,
                        why,
                    })
                }
            },
        );
    }
    Ok(loaded)
}

fn read_environment(row: &SqliteRow, id: i64, name: &str) -> Result<Loaded, sqlx::Error> {
    let (id, uid) = (EnvironmentId(id), Uid(row.try_get("uid")?));
    Ok(match parse(row, name) {
        Ok(Parsed {
            name,
            schema,
            derived,
            rule,
        }) => Ok(Environment {
            id,
            uid,
            name,
            schema,
            derived,
            rule,
        }),
        Err(why) => Err(UnreadableEnvironment {
            id,
            uid,
            name: name.to_owned(),
            why,
        }),
    })
}

/// The parts that have a form.
struct Parsed {
    name: Name,
    schema: Schema,
    derived: DerivedFeatures,
    rule: WrittenRule,
}

/// Reads them, or says what is wrong with the first that cannot be read.
fn parse(row: &SqliteRow, name: &str) -> Result<Parsed, String> {
    let text = |column| {
        row.try_get::<&str, _>(column)
            .map_err(|error| format!("its {column}: {error}"))
    };
    let hash: &[u8] = row
        .try_get("schema_hash")
        .map_err(|error| format!("its schema_hash: {error}"))?;

    let schema =
        stored_forms::read_schema(text("schema")?).map_err(|why| format!("its schema: {why}"))?;
    if schema.hash().0[..] != *hash {
        return Err(format!(
            "its schema: it hashes to {}, not to what is kept beside it",
            schema.hash()
        ));
    }
    let rule = stored_forms::read_rule(text("rule")?).map_err(|why| format!("its rule: {why}"))?;
    let derived = derived(row, &schema).map_err(|why| format!("its derived features: {why}"))?;
    let name = name
        .parse()
        .map_err(|why: String| format!("its name: {why}"))?;
    // Last, since all others say more.
    match checksums::is_sound_environment(row) {
        Ok(true) => Ok(Parsed {
            name,
            schema,
            derived,
            rule,
        }),
        Ok(false) => Err("its name, rule or place: it is not as it was written".to_owned()),
        Err(error) => Err(format!("its checksum: {error}")),
    }
}

fn derived(row: &SqliteRow, schema: &Schema) -> Result<DerivedFeatures, String> {
    let text = checksums::derived(row).map_err(|error| error.to_string())?;
    let read = text.map(|text| stored_forms::read_derived(text, schema));
    let read = read.transpose().map_err(|why| why.to_string())?;
    Ok(read.unwrap_or_default())
}
