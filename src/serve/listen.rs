//! The accept loop and its graceful shutdown.

use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use super::connections::Host;
use super::connections::crowd::Standing;
use super::connections::limits::Limits;
use super::tls::Socket;
use crate::telemetry;

/// Serves connections until the service drains, and returns when the last one ended or had its
/// time.
pub async fn accept(
    socket: impl Into<Socket>,
    router: Router,
    draining: CancellationToken,
    limits: Limits,
) {
    let Socket { listener, tls } = socket.into();
    let (over, longest) = (CancellationToken::new(), limits.drain);
    let host = Host::new(router, limits, tls.clone(), draining.clone(), over.clone());
    let connections = TaskTracker::new();

    let renewing = async {
        if let Some(tls) = tls {
            tls.keep_up().await;
        }
    };
    let receiving = async { tokio::join!(receive(&listener, &host, &connections), renewing) };
    draining.run_until_cancelled(receiving).await;

    // Whoever connects now is refused, and finds another service or comes again.
    drop(listener);
    connections.close();
    if tokio::time::timeout(longest, connections.wait())
        .await
        .is_err()
    {
        tracing::warn!(
            waited_ms = longest.as_millis(),
            cut = connections.len(),
            "connections did not end in time"
        );
        over.cancel();
        connections.wait().await;
    }
}

async fn receive(listener: &TcpListener, host: &Arc<Host>, connections: &TaskTracker) {
    loop {
        let stream = next(listener, host).await;
        match host.crowd().admit().await {
            Some(place) => {
                connections.spawn(host.clone().serve(stream, place));
            }
            None => telemetry::connection_ended("refused"),
        }
    }
}

/// Returns the next connection. A failure to accept (too many open files) passes when others close.
async fn next(listener: &TcpListener, host: &Host) -> TcpStream {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                // Answers are small and written whole; waiting to fill a packet only delays them.
                let _ = stream.set_nodelay(true);
                return stream;
            }
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                host.crowd().evict(Standing::Resident);
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
}
