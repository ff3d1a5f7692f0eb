//! How a commit fails.

use crate::domain::EnvironmentId;
use crate::store::StoreError;

/// Why a commit failed, and in whose rows.
pub(super) struct Failed {
    pub(super) error: StoreError,
    /// None where it is no environment's.
    pub(super) environment: Option<EnvironmentId>,
}

impl Failed {
    /// Makes the failure of what is of one environment.
    pub(super) fn in_environment(id: EnvironmentId, error: StoreError) -> Self {
        Self {
            error,
            environment: Some(id),
        }
    }
}

impl From<StoreError> for Failed {
    fn from(error: StoreError) -> Self {
        Self {
            error,
            environment: None,
        }
    }
}
