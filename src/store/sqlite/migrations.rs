//! Schema migrations of this build, embedded in the program: the files of `migrations/`, which are
//! applied once each, in order.
//!
//! They are listed here rather than found by a procedural macro, which would compile SQLite a
//! second time, for the compiler. A test compares the list with the folder.

use std::sync::LazyLock;

use sqlx::SqlSafeStr;
use sqlx::migrate::{Migration, MigrationType, Migrator};

/// Every migration of this build, in order.
pub(super) static MIGRATIONS: LazyLock<Migrator> =
    LazyLock::new(|| Migrator::with_migrations(FILES.map(migration).to_vec()));

/// Lists files of `migrations/` with their texts, by their names without `.sql`.
macro_rules! files {
    ($($name:literal),* $(,)?) => {
        [$((
            $name,
            include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/migrations/", $name, ".sql")),
        )),*]
    };
}

const FILES: [(&str, &str); 4] = files!["0001_counts", "0002_fits", "0003_models", "0004_owners"];

/// Makes a migration of a file. Databases keep its version, its description and the SHA-384 of its
/// text, and are refused where these differ.
fn migration((name, text): (&'static str, &'static str)) -> Migration {
    let (version, words) = name
        .split_once('_')
        .expect("a file is named by number and words");
    let version = version.parse().expect("a file's name begins with a number");

    Migration::new(
        version,
        words.replace('_', " ").into(),
        MigrationType::Simple,
        text.into_sql_str(),
        false,
    )
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// As the driver itself reads the folder, which is how every database so far was made.
    #[tokio::test]
    async fn every_file_of_the_folder_is_embedded_as_the_driver_reads_it() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("migrations");
        let read = Migrator::new(folder.as_path()).await.expect("a folder");
        assert_eq!(facts(&MIGRATIONS), facts(&read));
    }

    type Facts<'a> = (i64, &'a str, &'a [u8], &'a str, bool);

    fn facts(migrator: &Migrator) -> Vec<Facts<'_>> {
        migrator.iter().map(fact).collect()
    }

    fn fact(migration: &Migration) -> Facts<'_> {
        (
            migration.version,
            &migration.description,
            &migration.checksum,
            migration.sql.as_str(),
            migration.no_tx,
        )
    }
}
