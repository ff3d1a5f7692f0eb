//! Turns the database's errors into ours: the only place that looks at its codes.

use std::fmt;
use std::path::Path;

use sqlx::migrate::MigrateError;

use crate::store::StoreError;

const READ_ONLY: i32 = 8;
const CORRUPT: i32 = 11;
const CANNOT_OPEN: i32 = 14;
const NOT_A_DATABASE: i32 = 26;

/// An error before COMMIT: the connection is dropped with it, which rolls back.
pub(super) fn aborted(error: impl fmt::Display) -> StoreError {
    StoreError::Aborted(error.to_string())
}

/// An error of COMMIT itself, after which a part of the journal may or may not be on the disk.
pub(super) fn outcome_unknown(error: impl fmt::Display) -> StoreError {
    StoreError::OutcomeUnknown(error.to_string())
}

/// An error of a read.
pub(super) fn unreadable(error: impl fmt::Display) -> StoreError {
    StoreError::Unreadable(error.to_string())
}

/// What is stored is not what we stored.
pub(super) fn spoiled(what: &str) -> StoreError {
    StoreError::Unreadable(format!("{what} is not as it was written; run `nudge check`, and restore a backup"))
}

/// A database that cannot be opened, with what to do about it.
pub(super) fn unopenable(path: &Path, why: impl fmt::Display) -> StoreError {
    StoreError::Unopenable { path: path.display().to_string(), why: why.to_string() }
}

/// An error while opening.
pub(super) fn opening(path: &Path, error: &sqlx::Error) -> StoreError {
    match primary_code(error) {
        Some(NOT_A_DATABASE) => {
            unopenable(path, "it is not a database; move it away, or choose another --data directory")
        }
        Some(CORRUPT) => unopenable(path, "it is damaged; restore a backup"),
        Some(READ_ONLY | CANNOT_OPEN) => {
            unopenable(path, "it cannot be written; give this user the right to write the file and its directory")
        }
        _ => unopenable(path, error),
    }
}

/// An error while bringing the tables up to date.
pub(super) fn migrating(path: &Path, error: &MigrateError) -> StoreError {
    match error {
        MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => opening(path, error),
        MigrateError::VersionMissing(_) => {
            unopenable(path, "it was made by a newer nudge; use that version, or choose another --data directory")
        }
        MigrateError::VersionMismatch(_) | MigrateError::Dirty(_) => {
            unopenable(path, "it was made by another build of nudge; use that one, or choose another --data directory")
        }
        other => unopenable(path, other),
    }
}

/// Returns SQLite's primary result code; the extended one carries it in its low byte.
fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let code: i32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(code & 0xff)
}
