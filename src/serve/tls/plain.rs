//! The answer to clients that speak plain text where TLS is wanted, in their own protocol, so that
//! their users read what is wrong.

use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use crate::api::json;
use crate::error::{ErrorKind, Problem};

/// How HTTP/2 begins, as far as no method of HTTP/1 does.
const PREFACE: &[u8] = b"PRI";

/// Empty settings of HTTP/2 and a GOAWAY with the error INADEQUATE_SECURITY, whose last 20 bytes
/// are words for whoever debugs it (RFC 9113, section 6.8).
const GOAWAY: &[u8] = b"\0\0\0\x04\0\0\0\0\0\
    \0\0\x1c\x07\0\0\0\0\0\0\0\0\0\0\0\0\x0cthis port speaks TLS";

/// What is read of a request at most, and how long, so that its sender comes to read the answer.
const UNWANTED: (u64, Duration) = (64 << 10, Duration::from_millis(500));

/// Answers, and closes the connection.
pub(super) async fn refuse(mut stream: TcpStream) {
    let mut first = [0; PREFACE.len()];
    let is_http2 = matches!(stream.peek(&mut first).await, Ok(read) if &first[..read] == PREFACE);
    let answer = if is_http2 {
        GOAWAY.to_vec()
    } else {
        bad_request().into_bytes()
    };

    // Whoever has gone does not read it.
    if stream.write_all(&answer).await.is_ok() {
        linger(stream).await;
    }
}

/// Ends a connection so that the last word arrives: where bytes are left unread, the other side
/// loses it.
pub(super) async fn linger(mut stream: TcpStream) {
    if stream.shutdown().await.is_err() {
        return;
    }
    let (most, longest) = UNWANTED;
    let _ = timeout(
        longest,
        tokio::io::copy(&mut stream.take(most), &mut tokio::io::sink()),
    )
    .await;
}

/// Returns the answer of HTTP/1.
fn bad_request() -> String {
    let message = "this port speaks TLS: say https:// instead of http://";
    let problem = Problem::new(ErrorKind::Invalid, "TLS_REQUIRED", message);
    let body = serde_json::to_string(&json::Problem::new(&problem, 400, "/")).unwrap_or_default();
    let length = body.len();
    format!(
        "HTTP/1.1 400 Bad Request\r\ncontent-type: application/problem+json\r\ncontent-length: {length}\r\nconnection: close\r\n\r\n{body}"
    )
}
