//! What can be wrong with a recording.

use nudge_core::error::ErrorKind;

/// An error of a recording, with its place.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecordingError {
    /// The bytes are not what they should be as a whole.
    #[error("cannot be read as a recording: {0}")]
    Unreadable(String),
    /// The first line lacks a column.
    #[error("line 1: column `{0}` is missing")]
    MissingColumn(&'static str),
    /// One row is wrong.
    #[error("line {line}: {why}")]
    Row {
        /// The line, from 1; the header is the first.
        line: u64,
        /// What is wrong with it.
        why: String,
    },
    /// One field of a row is wrong.
    #[error("line {line}, column `{column}`: {why}")]
    Field {
        /// The line, from 1; the header is the first.
        line: u64,
        /// The column.
        column: &'static str,
        /// The value that was found and what was expected.
        why: String,
    },
}

impl RecordingError {
    /// Returns what a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Invalid
    }
}
