//! The TLS handshake of one connection, and why it failed.

use std::net::IpAddr;
use std::time::{Duration, Instant};

use rustls::Error;
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::sync::CancellationToken;

use super::{Tls, plain};
use crate::telemetry::{self, Seldom};

/// The first byte of TLS: a record of the handshake (RFC 8446, section 5.1).
const HANDSHAKE: u8 = 0x16;

/// Strangers can fail as often as they like, and the log is not theirs.
static FAILURES: Seldom = Seldom::every(Duration::from_secs(5));

impl Tls {
    /// Agrees with a client on a secret; none where that failed, which is told. Whoever drops this
    /// half-way calls [`too_late`]. The token is cancelled when the authorities change by which the
    /// client was let in.
    pub async fn secure(
        &self,
        stream: TcpStream,
    ) -> Option<(TlsStream<TcpStream>, CancellationToken)> {
        let peer = stream.peer_addr().ok().map(|address| address.ip());
        let mut first = [0];
        match stream.peek(&mut first).await {
            Ok(1..) if first[0] == HANDSHAKE => {}
            Ok(1..) => {
                failed("plain_text", "it does not speak TLS", peer);
                plain::refuse(stream).await;
                return None;
            }
            Ok(0) => return unheard("the connection was closed", peer),
            Err(error) => return unheard(&error.to_string(), peer),
        }
        let current = self.current.load_full();
        let acceptor = TlsAcceptor::from(current.config.clone());

        match acceptor.accept(stream).into_fallible().await {
            Ok(secured) => Some((secured, current.outdated.clone())),
            Err((error, stream)) => {
                failed(reason(&error), &error.to_string(), peer);
                plain::linger(stream).await;
                None
            }
        }
    }
}

/// Tells of a handshake that took too long, or of a client that said nothing.
pub fn too_late(peer: Option<IpAddr>) {
    failed("timeout", "it did not end in time", peer);
}

fn unheard<T>(error: &str, peer: Option<IpAddr>) -> Option<T> {
    failed("closed", error, peer);
    None
}

fn failed(reason: &'static str, error: &str, peer: Option<IpAddr>) {
    telemetry::handshake_failed(reason);
    // Probes of a port connect and close; that is no news.
    if reason == "closed" {
        return;
    }
    if let Some(left_out) = FAILURES.admits(Instant::now()) {
        tracing::warn!(
            reason,
            error,
            peer = peer.map(tracing::field::display),
            left_out,
            "a TLS handshake failed"
        );
    }
}

/// Returns the word for metrics.
fn reason(error: &std::io::Error) -> &'static str {
    match error
        .get_ref()
        .and_then(|inner| inner.downcast_ref::<Error>())
    {
        Some(Error::NoCertificatesPresented) => "no_client_certificate",
        Some(Error::InvalidCertificate(_)) => "bad_client_certificate",
        Some(Error::AlertReceived(_)) => "refused_by_client",
        Some(_) => "protocol",
        None => "closed",
    }
}
