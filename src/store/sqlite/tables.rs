//! Schema validation: what the database says of its own tables, which migrations it has had, and
//! how each table is defined. SQLite's own check passes a flipped bit in either, as long as the
//! text can still be read.

use std::collections::HashMap;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection, SqliteRow};
use sqlx::{ConnectOptions, Connection, Row};

use super::migrations::{MIGRATIONS, Migration};

/// Whose tables a database has.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Tables {
    /// Nobody's yet.
    None,
    /// Another program's.
    Foreign,
    /// A newer build's.
    Newer,
    /// Ours, after so many migrations.
    Ours(usize),
    /// Ours, and not as they were written.
    Damaged(String),
}

/// The list of migrations, with its index: all that there is before the first.
const LIST: [&str; 2] = ["_sqlx_migrations", "sqlite_autoindex__sqlx_migrations_1"];

/// Looks at the tables of a database.
pub(super) async fn look(connection: &mut SqliteConnection) -> Result<Tables, sqlx::Error> {
    let defined = definitions(connection).await?;
    if defined.is_empty() {
        return Ok(Tables::None);
    }

    let has_ours = ["environments", "totals", "states", "cells"]
        .iter()
        .all(|table| defined.contains_key(*table));
    if !defined.contains_key(LIST[0]) {
        let missing = "its list of migrations is missing".to_owned();
        return Ok(if has_ours {
            Tables::Damaged(missing)
        } else {
            Tables::Foreign
        });
    }

    let applied = match applied(connection).await {
        // Nothing of ours was written like that.
        Err(error @ sqlx::Error::ColumnDecode { .. }) if has_ours => {
            return Ok(Tables::Damaged(format!("its list of migrations: {error}")));
        }
        applied => applied?,
    };
    if has_ours && applied.is_empty() {
        let empty = "its list of migrations is empty".to_owned();
        return Ok(Tables::Damaged(empty));
    }
    // Other programs have lists of migrations too.
    let begins_as_ours = applied
        .first()
        .is_some_and(|first| first.is_not(&MIGRATIONS[0]).is_none());
    let is_list_alone = applied.is_empty() && defined.keys().all(|name| LIST.contains(&&**name));
    if !(has_ours || begins_as_ours || is_list_alone) {
        return Ok(Tables::Foreign);
    }

    if let Some(wrong) = MIGRATIONS
        .iter()
        .zip(&applied)
        .find_map(|(known, applied)| applied.is_not(known))
    {
        return Ok(Tables::Damaged(wrong));
    }
    if applied.len() > MIGRATIONS.len() {
        return Ok(Tables::Newer);
    }

    for (name, text) in after(applied.len()).await? {
        if defined.get(&name) != Some(&text) {
            let wrong = format!("the definition of `{name}` is not as it was written");
            return Ok(Tables::Damaged(wrong));
        }
    }
    Ok(Tables::Ours(applied.len()))
}

/// A migration as the database remembers it.
struct Applied {
    version: i64,
    description: String,
    success: bool,
    checksum: Vec<u8>,
}

impl Applied {
    /// Returns what is wrong with the record of a migration, if anything is. They were applied in
    /// order, so another version is as wrong.
    fn is_not(&self, known: &Migration) -> Option<String> {
        let is_so = self.version == known.version
            && self.description == known.description
            && self.success
            && self.checksum == known.checksum;
        (!is_so).then(|| {
            format!(
                "its record of migration {} is not as it was written",
                known.version
            )
        })
    }
}

async fn applied(connection: &mut SqliteConnection) -> Result<Vec<Applied>, sqlx::Error> {
    let text =
        "select version, description, success, checksum from _sqlx_migrations order by version";
    let rows = sqlx::query(text).fetch_all(connection).await?;
    rows.iter().map(read_applied).collect()
}

fn read_applied(row: &SqliteRow) -> Result<Applied, sqlx::Error> {
    Ok(Applied {
        version: row.try_get(0)?,
        description: row.try_get(1)?,
        success: row.try_get(2)?,
        checksum: row.try_get(3)?,
    })
}

/// Returns every table and index by name, with the text that defines it.
async fn definitions(
    connection: &mut SqliteConnection,
) -> Result<HashMap<String, Option<String>>, sqlx::Error> {
    let rows = sqlx::query("select name, sql from sqlite_schema")
        .fetch_all(connection)
        .await?;
    rows.iter()
        .map(|row| Ok((row.try_get(0)?, row.try_get(1)?)))
        .collect()
}

/// Returns the same of an empty database after so many migrations.
async fn after(migrations: usize) -> Result<HashMap<String, Option<String>>, sqlx::Error> {
    let mut scratch = SqliteConnectOptions::new()
        .in_memory(true)
        .connect()
        .await?;
    for migration in MIGRATIONS.iter().take(migrations) {
        sqlx::raw_sql(migration.sql).execute(&mut scratch).await?;
    }

    let defined = definitions(&mut scratch).await?;
    scratch.close().await?;
    Ok(defined)
}
