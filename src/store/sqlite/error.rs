//! Error mapping: turns the database's errors into ours, the only place that looks at its codes.

use std::fmt;
use std::io::ErrorKind;
use std::path::Path;

use crate::store::{Cause, StorageFault, StoreError};

// Primary result codes: https://www.sqlite.org/rescode.html
const BUSY: i32 = 5;
const LOCKED: i32 = 6;
const READ_ONLY: i32 = 8;
const INPUT_OUTPUT: i32 = 10;
const CORRUPT: i32 = 11;
const FULL: i32 = 13;
const CANNOT_OPEN: i32 = 14;
const CONSTRAINT: i32 = 19;
const NOT_A_DATABASE: i32 = 26;

/// Says what is wrong with a database that is so damaged that it cannot be opened.
pub(super) fn damaged(what: &str) -> String {
    format!("it is damaged: {what}; `nudge check` tells the same and more, and a backup mends it")
}

/// Says of a database that a later build made it.
pub(super) fn made_by_newer(path: &Path) -> StoreError {
    unopenable(
        path,
        "it was made by a newer nudge; use that version, or choose another --data directory",
    )
}

/// An error before COMMIT: the connection is dropped with it, which rolls back.
pub(super) fn aborted(error: impl Into<Cause>) -> StoreError {
    match error.into() {
        Cause {
            fault: StorageFault::Damaged,
            said,
        } => StoreError::Damaged(said),
        cause => StoreError::Aborted(cause),
    }
}

/// What could not be read for a commit, or to resume a producer, keeps it from being made: nothing is
/// counted, and who sent it may send it again.
pub(super) fn of_commit(error: StoreError) -> StoreError {
    match error {
        StoreError::Unreadable(why) => {
            StoreError::Aborted(Cause::new(StorageFault::InputOutput, why))
        }
        error => error,
    }
}

/// An error of COMMIT itself, after which a part of the journal may or may not be on the disk.
///
/// A full disk is certain: the last page of a transaction makes it whole, and SQLite reports
/// `SQLITE_FULL` only where a page could not be written. What comes after that page (fsync, the
/// index of the journal) has other codes.
pub(super) fn uncommitted(error: sqlx::Error) -> StoreError {
    match error.into() {
        cause @ Cause {
            fault: StorageFault::DiskFull,
            ..
        } => StoreError::Aborted(cause),
        cause => StoreError::OutcomeUnknown(cause),
    }
}

/// An error of a read.
pub(super) fn unreadable(error: impl Into<Cause>) -> StoreError {
    match error.into() {
        Cause {
            fault: StorageFault::Damaged,
            said,
        } => StoreError::Damaged(said),
        Cause {
            fault: StorageFault::Other,
            said,
        } => StoreError::Unreadable(said),
        cause => StoreError::Unreadable(cause.to_string()),
    }
}

/// What is stored is not what we stored.
pub(super) fn spoiled(what: &str) -> StoreError {
    StoreError::Damaged(format!(
        "{what} is not as it was written; run `nudge check`, and restore a backup"
    ))
}

impl From<sqlx::Error> for Cause {
    fn from(error: sqlx::Error) -> Self {
        Self::new(fault_of(&error), error.to_string())
    }
}

impl From<std::io::Error> for Cause {
    fn from(error: std::io::Error) -> Self {
        Self::new(fault_of_io(error.kind()), error.to_string())
    }
}

fn fault_of(error: &sqlx::Error) -> StorageFault {
    match (error, primary_code(error)) {
        // Nobody but us writes, by rules that no input can break, and a value of another type was
        // not written by us.
        (_, Some(CORRUPT | NOT_A_DATABASE | CONSTRAINT))
        | (
            sqlx::Error::ColumnDecode { .. } | sqlx::Error::Decode(_) | sqlx::Error::RowNotFound,
            _,
        ) => StorageFault::Damaged,
        (_, Some(FULL)) => StorageFault::DiskFull,
        (_, Some(READ_ONLY)) => StorageFault::ReadOnly,
        (_, Some(INPUT_OUTPUT)) => StorageFault::InputOutput,
        (_, Some(BUSY | LOCKED)) => StorageFault::Locked,
        (_, Some(CANNOT_OPEN)) => StorageFault::Unopenable,
        _ => StorageFault::Other,
    }
}

/// Returns what keeps a file from being written.
pub(super) fn fault_of_io(kind: ErrorKind) -> StorageFault {
    match kind {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
            StorageFault::DiskFull
        }
        ErrorKind::ReadOnlyFilesystem | ErrorKind::PermissionDenied => StorageFault::ReadOnly,
        ErrorKind::NotFound => StorageFault::Moved,
        _ => StorageFault::InputOutput,
    }
}

/// A database that cannot be opened, with what to do about it.
pub(super) fn unopenable(path: &Path, why: impl fmt::Display) -> StoreError {
    StoreError::Unopenable {
        path: path.display().to_string(),
        why: why.to_string(),
    }
}

/// Returns whether an error says that pages of a database of ours are damaged.
pub(super) fn is_damage(error: &sqlx::Error) -> bool {
    primary_code(error) != Some(NOT_A_DATABASE) && fault_of(error) == StorageFault::Damaged
}

/// An error while opening, or while bringing the tables up to date.
pub(super) fn opening(path: &Path, error: &sqlx::Error) -> StoreError {
    match primary_code(error) {
        Some(NOT_A_DATABASE) => unopenable(
            path,
            "it is not a database; move it away, or choose another --data directory; if it was one, its first page is damaged: restore a backup",
        ),
        Some(CORRUPT) => unopenable(path, damaged(&error.to_string())),
        Some(READ_ONLY | CANNOT_OPEN) => unopenable(
            path,
            "it cannot be written; give this user the right to write the file and its directory",
        ),
        Some(FULL) => unopenable(
            path,
            format!(
                "{error}; make room on the disk and start again, or choose another --data directory"
            ),
        ),
        Some(INPUT_OUTPUT) => unopenable(
            path,
            format!(
                "{error}; the disk does not do as it is asked: is it full, or broken? The system's log says more"
            ),
        ),
        _ => unopenable(path, error),
    }
}

/// Returns SQLite's primary result code; the extended one carries it in its low byte.
fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let code: i32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(code & 0xff)
}
