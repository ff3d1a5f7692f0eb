//! Errors of the store, as networks tell them.

use crate::error::Problem;
use crate::store::StoreError;

/// Notes an error of the store, and tells it in words about networks.
pub fn logged(error: StoreError) -> Problem {
    match error {
        StoreError::UnknownModel(_) | StoreError::UnknownEnvironment | StoreError::Quota { .. } => {
            error.into()
        }
        StoreError::Aborted(_) | StoreError::OutcomeUnknown(_) => {
            tracing::error!(%error, "the registry of networks could not be changed");
            error.into()
        }
        _ => {
            tracing::error!(%error, "the registry of networks could not be read");
            error.into()
        }
    }
}
