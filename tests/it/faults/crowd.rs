//! Connections that keep a service waiting: in silence, or by drops.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::task::JoinSet;

use crate::support::raw::{call, frame, header};

/// A slow client (slow-loris), by how it keeps the service waiting.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SlowClient {
    /// It never says anything.
    Silent,
    /// Headers, byte by byte.
    Headers,
    /// A REST body, byte by byte.
    Body,
    /// Half of what HTTP/2 begins with.
    HalfPreface,
    /// HTTP/2 as it begins, and then nothing: no request, and no answer to pings.
    DeafHttp2,
    /// HTTP/2 headers that never end.
    EndlessHeaders,
    /// A gRPC message, byte by byte.
    Message,
    /// Requests for large answers that it does not read.
    Unread,
}

/// Slow-loris of seven kinds; silence is an eighth.
pub const SLOW: [SlowClient; 7] = [
    SlowClient::Headers,
    SlowClient::Body,
    SlowClient::HalfPreface,
    SlowClient::DeafHttp2,
    SlowClient::EndlessHeaders,
    SlowClient::Message,
    SlowClient::Unread,
];

/// How often a drop falls: often enough that no timeout between two of them ends the connection.
const DROP: Duration = Duration::from_millis(500);

impl SlowClient {
    /// Returns what it begins with.
    fn opening(self) -> Vec<u8> {
        const MOST_MESSAGE_BYTES: u32 = 4 << 20;
        let announced = [&[0_u8], MOST_MESSAGE_BYTES.to_be_bytes().as_slice()].concat();
        match self {
            Self::Silent => Vec::new(),
            Self::Headers => b"GET /livez HTTP/1.1\r\nhost: localhost\r\nx-slow: ".to_vec(),
            Self::Body => b"POST /v1/environments/lane/transitions HTTP/1.1\r\nhost: localhost\r\ncontent-type: \
                application/json\r\ncontent-length: 16000000\r\n\r\n{\"producer\": \""
                .to_vec(),
            Self::HalfPreface => PREFACE[..16].to_vec(),
            Self::DeafHttp2 => [PREFACE.to_vec(), frame(SETTINGS, 0, 0, &[])].concat(),
            Self::EndlessHeaders => {
                let headers = frame(HEADERS, 0, 1, &header(":method", "GET"));
                [PREFACE.to_vec(), frame(SETTINGS, 0, 0, &[]), headers].concat()
            }
            Self::Message => {
                let data = frame(DATA, 0, 1, &announced);
                [PREFACE.to_vec(), frame(SETTINGS, 0, 0, &[]), call("/nudge.v1.IngestService/Write"), data].concat()
            }
            Self::Unread => b"GET /openapi.json HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(100),
        }
    }

    /// Returns what follows again and again.
    fn one_drop(self) -> Vec<u8> {
        match self {
            Self::Silent | Self::HalfPreface | Self::DeafHttp2 => Vec::new(),
            Self::Headers | Self::Body => b"a".to_vec(),
            Self::EndlessHeaders => frame(CONTINUATION, 0, 1, &header("x-slow", "a")),
            Self::Message => frame(DATA, 0, 1, b"a"),
            Self::Unread => b"GET /openapi.json HTTP/1.1\r\nhost: localhost\r\n\r\n".to_vec(),
        }
    }
}

const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
const DATA: u8 = 0;
const HEADERS: u8 = 1;
const SETTINGS: u8 = 4;
const CONTINUATION: u8 = 9;

/// Connections that wait for their end. Dropped, they go.
#[derive(Default)]
pub struct Crowd {
    open: Arc<AtomicU64>,
    connections: JoinSet<()>,
}

impl Crowd {
    /// Adds connections of one kind; where the service takes no more of them, they wait their
    /// turn.
    pub async fn join(&mut self, address: SocketAddr, client: SlowClient, connections: u64) {
        for _ in 0..connections {
            let Ok(socket) = TcpStream::connect(address).await else {
                continue;
            };
            self.open.fetch_add(1, Ordering::SeqCst);
            let open = self.open.clone();
            self.connections.spawn(async move {
                wait(socket, client).await;
                open.fetch_sub(1, Ordering::SeqCst);
            });
        }
    }

    /// Returns how many of them are open.
    pub fn open(&self) -> u64 {
        self.open.load(Ordering::SeqCst)
    }
}

/// Keeps a connection until the other side ends it.
async fn wait(mut socket: TcpStream, client: SlowClient) {
    if socket.write_all(&client.opening()).await.is_err() {
        return;
    }
    let one_drop = client.one_drop();
    let mut heard = [0; 1_024];
    loop {
        tokio::select! {
            // What is told is not answered.
            read = socket.read(&mut heard), if client != SlowClient::Unread => {
                if read.unwrap_or(0) == 0 {
                    return;
                }
            }
            () = tokio::time::sleep(DROP) => {
                if !one_drop.is_empty() && socket.write_all(&one_drop).await.is_err() {
                    return;
                }
            }
        }
    }
}
