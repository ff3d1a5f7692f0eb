//! Errors of the store, as questions tell them.

use crate::error::{ErrorKind, Problem};
use crate::store::StoreError;

/// Notes an error of the store, and tells it as a problem.
pub fn logged(error: StoreError) -> Problem {
    // That an environment was deleted meanwhile is no fault.
    if error.kind() != ErrorKind::NotFound {
        tracing::error!(%error, "a question could not be answered");
    }
    error.into()
}
