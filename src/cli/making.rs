//! Environments that play is sent into: made where they are missing, and left as they are.

use super::Failure;
use crate::client::{ClientError, Connection};
use crate::domain::draft::DescriptionDraft;
use crate::error::ErrorKind;

/// Makes an environment where it is missing, or confirms that it is there with this schema. One
/// that is there keeps its derived features: somebody may have changed them.
pub(super) async fn make(
    connection: &Connection,
    name: &str,
    mut description: DescriptionDraft,
) -> Result<(), Failure> {
    if is_there(connection, name).await? {
        description.derived = None;
    }
    Ok(connection.apply(name, description).await?)
}

async fn is_there(connection: &Connection, name: &str) -> Result<bool, ClientError> {
    match connection.environment(name).await {
        Ok(_) => Ok(true),
        Err(ClientError::Refused(refusal)) if refusal.kind == ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}
