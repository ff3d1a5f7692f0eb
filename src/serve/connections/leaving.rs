//! Graceful shutdown of a connection, as whoever answers on it hears of it.

use tokio_util::sync::CancellationToken;

/// In the extensions of a request: cancelled when its connection is to end, so whoever answers for
/// long should come to an end and let the client reconnect.
#[derive(Debug, Clone)]
pub struct Leaving(pub CancellationToken);
