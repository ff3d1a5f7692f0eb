//! Connections: the accept loop, its timeouts, and its graceful end.

use std::time::Duration;

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio_util::sync::CancellationToken;

/// How long the headers of a request may take: a client that sends them drop by drop loses its connection.
const HEADERS: Duration = Duration::from_secs(10);

/// How often an idle HTTP/2 connection is asked for a sign of life, and how long it may take to give it.
const KEEP_ALIVE: (Duration, Duration) = (Duration::from_secs(20), Duration::from_secs(10));

/// How long requests and streams may take to end once the service drains.
const DRAIN: Duration = Duration::from_secs(9);

/// Serves connections until the service drains, and returns when the last one ended or had its time.
pub async fn accept(listener: TcpListener, router: Router, draining: CancellationToken) {
    let service = TowerToHyperService::new(router);
    let connections = GracefulShutdown::new();
    let builder = builder();
    while let Some(stream) = draining.run_until_cancelled(next(&listener)).await {
        let connection = builder.serve_connection(TokioIo::new(stream), service.clone()).into_owned();
        let watched = connections.watch(connection);
        tokio::spawn(async move {
            if let Err(error) = watched.await {
                tracing::debug!(%error, "a connection ended with an error");
            }
        });
    }
    drop(listener);
    if tokio::time::timeout(DRAIN, connections.shutdown()).await.is_err() {
        tracing::warn!(waited_seconds = DRAIN.as_secs(), "connections were cut: they did not end in time");
    }
}

fn builder() -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(HEADERS);
    let (interval, timeout) = KEEP_ALIVE;
    builder.http2().timer(TokioTimer::new()).keep_alive_interval(interval).keep_alive_timeout(timeout);
    builder
}

/// Returns the next connection. A failure to accept (too many open files) passes when others close, so it is waited out.
async fn next(listener: &TcpListener) -> TcpStream {
    loop {
        match listener.accept().await {
            Ok((stream, _)) => {
                // Answers are small and written whole; waiting to fill a packet only delays them.
                let _ = stream.set_nodelay(true);
                return stream;
            }
            Err(error) => {
                tracing::warn!(%error, "a connection could not be accepted");
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        }
    }
}
