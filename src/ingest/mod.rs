//! How transitions become counts: validate, sequence, commit together, then acknowledge.

use std::sync::Arc;

use crate::domain::{Acknowledged, Batch, Environment, EnvironmentId, ProducerId, Sequence};
use crate::error::Problem;
use crate::store::Store;

/// A handle on ingestion. Cloning is cheap.
#[derive(Clone)]
pub struct Ingest {}

impl Ingest {
    /// Starts the committer.
    pub fn start(_store: Arc<dyn Store>) -> Self {
        todo!()
    }

    /// Counts one batch and returns after it is on stable storage; refuses at once, retryably, when too much waits.
    pub async fn write(
        &self,
        _environment: &Arc<Environment>,
        _producer: ProducerId,
        _batch: Batch,
    ) -> Result<Acknowledged, Problem> {
        todo!()
    }

    /// Returns the last committed sequence of a producer.
    pub async fn committed(&self, _environment: &Environment, _producer: &ProducerId) -> Result<Sequence, Problem> {
        todo!()
    }

    /// Ends the streams into an environment that was deleted.
    pub fn end_streams(&self, _environment: EnvironmentId) {
        todo!()
    }
}
