//! Offloading to blocking threads of work that takes milliseconds: too long for a thread that
//! serves connections, and too short to wait for a place in a queue.

use crate::error::{ErrorKind, Problem};

/// Bytes up to which something is sooner decoded, checked or encoded than handed to another thread:
/// well below a millisecond.
const LIGHT: usize = 64 << 10;

/// Does work of so many bytes on a thread of its own, unless they are few.
pub async fn aside<T: Send + 'static>(
    bytes: usize,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    if bytes <= LIGHT {
        Ok(work())
    } else {
        beside(work).await
    }
}

/// Does work on a thread of its own.
pub async fn beside<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    tokio::task::spawn_blocking(work).await.map_err(|error| {
        tracing::error!(%error, "work ended unexpectedly");
        Problem::new(
            ErrorKind::Internal,
            "INTERNAL",
            "the service failed; the cause is in its log",
        )
    })
}
