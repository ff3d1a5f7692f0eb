//! Errors of a store, by whether a caller may retry: what is wrong, and whether anything was
//! changed.

use std::fmt;

use crate::error::{ErrorKind, Problem};

/// The reason of whatever fails because there is no such environment, or none any more.
pub const ENVIRONMENT_NOT_FOUND: &str = "ENVIRONMENT_NOT_FOUND";

/// The class of a storage fault: what is wrong with a database, as far as somebody can act on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StorageFault {
    /// No space is left for what is to be written.
    DiskFull,
    /// The file, its directory or its file system cannot be written.
    ReadOnly,
    /// The machine failed to read or to write.
    InputOutput,
    /// What is stored is not what was stored.
    Damaged,
    /// Another program keeps the database locked.
    Locked,
    /// The file cannot be opened.
    Unopenable,
    /// Another file, or none, has the name of the one that was opened.
    Moved,
    /// A write has not ended for a long time.
    Stuck,
    /// Anything else.
    Other,
}

impl StorageFault {
    /// Returns it as one word for programs.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::DiskFull => "disk_full",
            Self::ReadOnly => "read_only",
            Self::InputOutput => "input_output",
            Self::Damaged => "damaged",
            Self::Locked => "locked",
            Self::Unopenable => "unopenable",
            Self::Moved => "moved",
            Self::Stuck => "stuck",
            Self::Other => "other",
        }
    }

    /// Says it as a sentence.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::DiskFull => "the disk is full",
            Self::ReadOnly => "the database is read-only",
            Self::InputOutput => "the disk failed to read or to write",
            Self::Damaged => "the database is damaged",
            Self::Locked => "another program keeps the database locked",
            Self::Unopenable => "the database cannot be opened",
            Self::Moved => "the database's file was moved away or replaced",
            Self::Stuck => "the disk does not answer",
            Self::Other => "the database refused",
        }
    }
}

/// Why a database failed: what is wrong with it, and what it said, which belongs in the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cause {
    /// What is wrong.
    pub fault: StorageFault,
    /// What was said.
    pub said: String,
}

impl Cause {
    /// Makes a cause.
    pub fn new(fault: StorageFault, said: impl Into<String>) -> Self {
        Self {
            fault,
            said: said.into(),
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.fault.in_words(), self.said)
    }
}

impl From<&str> for Cause {
    fn from(said: &str) -> Self {
        Self::new(StorageFault::Other, said)
    }
}

impl From<String> for Cause {
    fn from(said: String) -> Self {
        Self::new(StorageFault::Other, said)
    }
}

/// An error of a store. Database codes become one of these in one place, beside the database.
#[derive(Debug, Clone, thiserror::Error)]
pub enum StoreError {
    /// Nothing was changed: the transaction was rolled back.
    #[error("nothing was changed: {0}")]
    Aborted(Cause),
    /// The commit failed and may have taken effect all the same: only the watermark tells.
    #[error("the database did not say whether it committed: {0}")]
    OutcomeUnknown(Cause),
    /// What is stored is not what was stored. Nothing was changed.
    #[error("the database is damaged: {0}")]
    Damaged(String),
    /// A read failed.
    #[error("the database cannot be read: {0}")]
    Unreadable(String),
    /// Another process has the database.
    #[error(
        "{0} is in use by another nudge: stop that one, or give this one another --data directory"
    )]
    InUse(String),
    /// The file cannot be opened as one of our databases.
    #[error("cannot open {path}: {why}")]
    Unopenable {
        /// The file.
        path: String,
        /// Why, and what to do.
        why: String,
    },
    /// The environment does not exist, or exists no longer.
    #[error("unknown environment")]
    UnknownEnvironment,
    /// The environment has no model of that version, or has it no longer.
    #[error("unknown model version {0}")]
    UnknownModel(u64),
    /// Versions are never used again, and the last there can be was used.
    #[error("no version is left for another {0}: delete the environment and make it again")]
    VersionsUsedUp(&'static str),
    /// There are as many as there may be.
    #[error(
        "{limit} {what} are the most there may be here, and there are as many: delete one, or raise {flag}"
    )]
    Quota {
        /// `environments` or `models`.
        what: &'static str,
        /// The most there may be.
        limit: u64,
        /// What raises the limit.
        flag: &'static str,
    },
    /// The name is taken.
    #[error("environment `{0}` exists")]
    AlreadyExists(String),
}

impl StoreError {
    /// Says that there are as many environments as there may be.
    pub fn too_many_environments(limit: u64) -> Self {
        Self::Quota {
            what: "environments",
            limit,
            flag: "--max-environments",
        }
    }

    /// Says that an environment has as many models as it may have.
    pub fn too_many_models(limit: u64) -> Self {
        Self::Quota {
            what: "models",
            limit,
            flag: "--max-models",
        }
    }

    /// Returns what a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Aborted(_) | Self::OutcomeUnknown(_) | Self::InUse(_) => ErrorKind::Unavailable,
            Self::Unreadable(_) | Self::Damaged(_) | Self::Unopenable { .. } => ErrorKind::Internal,
            Self::UnknownEnvironment | Self::UnknownModel(_) => ErrorKind::NotFound,
            Self::VersionsUsedUp(_) => ErrorKind::Conflict,
            Self::AlreadyExists(_) => ErrorKind::AlreadyExists,
            Self::Quota { .. } => ErrorKind::Quota,
        }
    }
}

impl StoreError {
    /// Tells the error to somebody who sent a batch, without what the database said, which belongs
    /// in the log.
    pub fn of_batch(self) -> Problem {
        match &self {
            Self::Aborted(cause) => of_cause(
                &self,
                "STORE_UNAVAILABLE",
                cause,
                format!(
                    "nothing was counted: {}; send it again",
                    cause.fault.in_words()
                ),
            ),
            Self::OutcomeUnknown(cause) => of_cause(
                &self,
                "OUTCOME_UNKNOWN",
                cause,
                format!(
                    "the batch may have been counted: {}; resume and send it again, it counts once",
                    cause.fault.in_words()
                ),
            ),
            _ => self.into(),
        }
    }
}

fn of_cause(error: &StoreError, reason: &'static str, cause: &Cause, message: String) -> Problem {
    Problem::new(error.kind(), reason, message).with("cause", cause.fault.as_str())
}

impl From<StoreError> for Problem {
    /// Tells the error without what the database said, which belongs in the log.
    fn from(error: StoreError) -> Self {
        let (reason, message) = match &error {
            StoreError::Aborted(cause) => {
                let message = format!("nothing was changed: {}; send it again", cause.fault.in_words());
                return of_cause(&error, "STORE_UNAVAILABLE", cause, message);
            }
            StoreError::OutcomeUnknown(cause) => {
                let words = cause.fault.in_words();
                let message =
                    format!("the change may have been made: {words}; look whether it was, and send it again if not");
                return of_cause(&error, "OUTCOME_UNKNOWN", cause, message);
            }
            StoreError::Damaged(_) => (
                "DATABASE_DAMAGED",
                "the database is damaged where this is kept: run `nudge check`, and restore a backup".into(),
            ),
            StoreError::InUse(_) | StoreError::Unreadable(_) | StoreError::Unopenable { .. } => {
                ("INTERNAL", "the database cannot be read".into())
            }
            StoreError::UnknownEnvironment => (ENVIRONMENT_NOT_FOUND, error.to_string()),
            StoreError::UnknownModel(_) => ("MODEL_NOT_FOUND", error.to_string()),
            StoreError::VersionsUsedUp(_) => ("VERSIONS_USED_UP", error.to_string()),
            StoreError::AlreadyExists(_) => ("ENVIRONMENT_EXISTS", error.to_string()),
            StoreError::Quota { limit, .. } => {
                return Self::new(error.kind(), "QUOTA_EXCEEDED", error.to_string()).with("limit", limit);
            }
        };
        Self::new(error.kind(), reason, message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_is_told_what_is_certain_and_a_change_is_no_batch() {
        let full = || Cause::new(StorageFault::DiskFull, "code 13");
        let certain = StoreError::Aborted(full()).of_batch();
        assert_eq!(
            certain.message,
            "nothing was counted: the disk is full; send it again"
        );
        assert_eq!(
            (certain.reason, certain.details),
            ("STORE_UNAVAILABLE", vec![("cause", "disk_full".to_owned())])
        );
        let uncertain =
            StoreError::OutcomeUnknown(Cause::new(StorageFault::InputOutput, "code 1034"));
        let told = "the batch may have been counted: the disk failed to read or to write; resume and send it again, it counts once";
        assert_eq!(uncertain.clone().of_batch().message, told);
        for error in [StoreError::Aborted(full()), uncertain] {
            let problem = Problem::from(error);
            assert!(
                !problem.message.contains("batch") && !problem.message.contains("count"),
                "{problem}"
            );
            assert!(
                !problem.message.contains("code "),
                "what the database says is for the log: {problem}"
            );
            assert!(problem.kind.is_retryable());
        }
    }
}
