//! Connections spoken by hand, which do what no client would.

use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

/// Longer than anything takes on a busy machine; what never comes is found out by it.
pub const LONG: Duration = Duration::from_secs(60);

/// The beginning of an HTTP/2 connection: the preface and empty settings.
pub const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// A connection without a client.
pub struct Raw<S = TcpStream>(pub S);

impl Raw {
    /// Connects and sends some bytes.
    pub async fn open(address: SocketAddr, first: &[u8]) -> Self {
        Self::over(
            TcpStream::connect(address).await.expect("it listens"),
            first,
        )
        .await
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> Raw<S> {
    /// Sends some bytes over a stream.
    pub async fn over(mut stream: S, first: &[u8]) -> Self {
        stream.write_all(first).await.expect("sent");
        stream.flush().await.expect("sent");
        Self(stream)
    }

    /// Reads until that text has come, and returns everything up to it.
    pub async fn until(&mut self, text: &str) -> String {
        let mut read = Vec::new();
        let mut buffer = [0; 4_096];
        while !String::from_utf8_lossy(&read).contains(text) {
            let some = timeout(LONG, self.0.read(&mut buffer))
                .await
                .expect("in time")
                .expect("open");
            assert!(some > 0, "ended after {}", String::from_utf8_lossy(&read));
            read.extend_from_slice(&buffer[..some]);
        }
        String::from_utf8_lossy(&read).into_owned()
    }

    /// Reads to the end of the connection, answering pings, and returns everything.
    pub async fn end(&mut self) -> Vec<u8> {
        let mut read = Vec::new();
        let mut buffer = [0; 4_096];
        // A connection that is cut while bytes are on their way ends with an error.
        while let Ok(some @ 1..) = timeout(LONG, self.0.read(&mut buffer))
            .await
            .expect("it is ended")
        {
            read.extend_from_slice(&buffer[..some]);
            if let Some(ping) = buffer[..some]
                .windows(17)
                .find(|frame| frame.starts_with(b"\0\0\x08\x06\0"))
            {
                let pong = frame(6, 1, 0, &ping[9..]);
                let _ = self.0.write_all(&pong).await;
            }
        }
        read
    }

    /// Sends a byte now and then until the connection is ended.
    pub async fn drip(&mut self, byte: u8) {
        let dripping = async {
            while self.0.write_all(&[byte]).await.is_ok() && self.0.flush().await.is_ok() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        timeout(LONG, dripping).await.expect("it is ended");
    }
}

/// Returns a frame of HTTP/2 (RFC 9113, section 4.1).
pub fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u32).to_be_bytes();
    [&length[1..], &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

/// Returns a header as it stands: literal, without indexing (RFC 7541, section 6.2.2).
pub fn header(name: &str, value: &str) -> Vec<u8> {
    [
        &[0, name.len() as u8],
        name.as_bytes(),
        &[value.len() as u8],
        value.as_bytes(),
    ]
    .concat()
}

/// Returns the headers of a call, as a frame that leaves its body open.
pub fn call(path: &str) -> Vec<u8> {
    let headers = [
        header(":method", "POST"),
        header(":scheme", "http"),
        header(":path", path),
        header(":authority", "nudge"),
        header("content-type", "application/grpc"),
        header("te", "trailers"),
    ];
    frame(1, 4, 1, &headers.concat())
}
