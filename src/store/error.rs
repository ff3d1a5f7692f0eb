//! What can go wrong with a store.

use crate::error::{ErrorKind, Problem};

/// An error of a store. Database codes become one of these in one place, beside the database.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Nothing was changed: the transaction was rolled back.
    #[error("the database refused, nothing was counted: {0}")]
    Aborted(String),
    /// The commit failed and may have taken effect all the same: only the watermark tells.
    #[error("the database did not say whether it committed: {0}")]
    OutcomeUnknown(String),
    /// A read failed.
    #[error("the database cannot be read: {0}")]
    Unreadable(String),
    /// Another process has the database.
    #[error("{0} is in use by another nudge: stop that one, or give this one another --data directory")]
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
    #[error("{limit} {what} are the most there may be here, and there are as many: delete one, or raise {flag}")]
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
        Self::Quota { what: "environments", limit, flag: "--max-environments" }
    }

    /// Says that an environment has as many models as it may have.
    pub fn too_many_models(limit: u64) -> Self {
        Self::Quota { what: "models", limit, flag: "--max-models" }
    }

    /// Returns what a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Aborted(_) | Self::OutcomeUnknown(_) | Self::InUse(_) => ErrorKind::Unavailable,
            Self::Unreadable(_) | Self::Unopenable { .. } => ErrorKind::Internal,
            Self::UnknownEnvironment | Self::UnknownModel(_) => ErrorKind::NotFound,
            Self::VersionsUsedUp(_) => ErrorKind::Conflict,
            Self::AlreadyExists(_) => ErrorKind::AlreadyExists,
            Self::Quota { .. } => ErrorKind::Quota,
        }
    }
}

impl From<StoreError> for Problem {
    /// Tells the error without its cause, which belongs in the log.
    fn from(error: StoreError) -> Self {
        let (reason, message) = match &error {
            StoreError::Aborted(_) => {
                ("STORE_UNAVAILABLE", "the database refused, nothing was counted; send it again".into())
            }
            StoreError::OutcomeUnknown(_) => {
                ("OUTCOME_UNKNOWN", "the batch may have been counted; resume and send it again, it counts once".into())
            }
            StoreError::InUse(_) | StoreError::Unreadable(_) | StoreError::Unopenable { .. } => {
                ("INTERNAL", "the database cannot be read".into())
            }
            StoreError::UnknownEnvironment => ("ENVIRONMENT_NOT_FOUND", error.to_string()),
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
