//! Schema migrations of this build, embedded in the program: the files of `migrations/`, each applied
//! once, in order, in a transaction of its own.
//!
//! What a database keeps of each is what the driver's own migrator kept, which earlier builds used:
//! version, description, and the SHA-384 of the text. It is not used any more, because it brings the
//! drivers of other databases into the lock file, and its macro compiled SQLite a second time.
//! [`super::tables`] compares the records before anything is applied.

use std::sync::LazyLock;
use std::time::Instant;

use sha2::{Digest, Sha384};
use sqlx::Connection;
use sqlx::sqlite::SqliteConnection;

/// Every migration of this build, in order.
pub(super) static MIGRATIONS: LazyLock<[Migration; FILES.len()]> =
    LazyLock::new(|| FILES.map(Migration::of_file));

/// One step of the schema.
pub(super) struct Migration {
    /// Its number: 1, 2, 3, ...
    pub(super) version: i64,
    /// Its file's name in words.
    pub(super) description: String,
    /// What it does.
    pub(super) sql: &'static str,
    /// The SHA-384 of that.
    pub(super) checksum: [u8; 48],
}

/// Lists files of `migrations/` with their texts, by their names without `.sql`.
macro_rules! files {
    ($($name:literal),* $(,)?) => {
        [$((
            $name,
            include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/migrations/", $name, ".sql")),
        )),*]
    };
}

const FILES: [(&str, &str); 6] = files![
    "0001_counts",
    "0002_fits",
    "0003_models",
    "0004_owners",
    "0005_packed",
    "0006_derived",
];

impl Migration {
    fn of_file((name, sql): (&str, &'static str)) -> Self {
        let (version, words) = name
            .split_once('_')
            .expect("a file is named by number and words");
        Self {
            version: version.parse().expect("a file's name begins with a number"),
            description: words.replace('_', " "),
            sql,
            checksum: Sha384::digest(sql).into(),
        }
    }

    /// Applies it and records that, both or neither.
    pub(super) async fn apply(&self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        let started = Instant::now();
        let mut transaction = connection.begin().await?;
        sqlx::raw_sql(self.sql).execute(&mut *transaction).await?;
        sqlx::query(
            "insert into _sqlx_migrations (version, description, success, checksum, execution_time)
             values (?, ?, true, ?, -1)",
        )
        .bind(self.version)
        .bind(&self.description)
        .bind(&self.checksum[..])
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await?;

        // How long it took is known only now, and only told: it may be lost.
        sqlx::query("update _sqlx_migrations set execution_time = ? where version = ?")
            .bind(started.elapsed().as_nanos() as i64)
            .bind(self.version)
            .execute(connection)
            .await?;
        Ok(())
    }
}

/// Makes the table of records where there is none. Its text is kept by the database, and is the
/// driver's to the byte.
pub(super) async fn make_records(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    let text = "
CREATE TABLE IF NOT EXISTS _sqlx_migrations (
    version BIGINT PRIMARY KEY,
    description TEXT NOT NULL,
    installed_on TIMESTAMP NOT NULL DEFAULT CURRENT_TIMESTAMP,
    success BOOLEAN NOT NULL,
    checksum BLOB NOT NULL,
    execution_time BIGINT NOT NULL
);
                ";
    sqlx::raw_sql(text).execute(connection).await.map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_listed_in_order() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/migrations");
        let entries = std::fs::read_dir(folder).expect("a folder");
        let mut found: Vec<String> = entries
            .map(|entry| entry.expect("an entry").file_name())
            .filter_map(|name| Some(name.to_str()?.strip_suffix(".sql")?.to_owned()))
            .collect();
        found.sort();
        assert_eq!(FILES.map(|(name, _)| name).to_vec(), found);

        let versions = MIGRATIONS.each_ref().map(|migration| migration.version);
        assert!((1..=FILES.len() as i64).eq(versions), "{versions:?}");
    }
}
