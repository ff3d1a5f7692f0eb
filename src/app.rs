//! The service without its socket: one handle of each room, opened and closed in one place.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use crate::environments::Environments;
use crate::influence::Influence;
use crate::ingest::Ingest;
use crate::store::Store;

/// One handle of each room. Cloning is cheap.
#[derive(Clone)]
pub struct App {
    /// What was counted.
    pub store: Arc<dyn Store>,
    /// Which worlds there are.
    pub environments: Environments,
    /// How transitions become counts.
    pub ingest: Ingest,
    /// The question itself.
    pub influence: Influence,
    /// Cancelled when the service begins to stop: not ready, streams end, nothing new begins.
    pub draining: CancellationToken,
}
