//! TLS and mutual TLS of the listening socket, by rustls: HTTP/1.1 and HTTP/2 by ALPN, with
//! certificates that are read again when their files change.
//!
//! ```text
//! files --load--> Certified --swap--> the next handshake      (connections that are open keep what they began with, unless the authorities of clients
//!                                                              changed: then they are asked to leave)
//!   ^ watch, every second and at SIGHUP
//! ```
//!
//! A handshake runs in the task of its connection, and within the time that the headers of a first
//! request have.

mod files;
mod handshake;
mod plain;
mod watch;

use std::sync::Arc;

use arc_swap::ArcSwap;
use rustls::ServerConfig;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub use files::TlsFiles;
pub use handshake::too_late;

use self::files::{Certified, Contents};
use crate::telemetry;
use crate::tls::TlsError;

/// The certificate of a service, and whom it lets in. Cloning shares it.
#[derive(Clone)]
pub struct Tls {
    files: Arc<TlsFiles>,
    current: Arc<ArcSwap<Current>>,
    /// The digest of what the files held when they were last looked at, which is not what is used
    /// where that was bad.
    first: blake3::Hash,
}

impl Tls {
    /// Reads the files, or says which of them cannot be used.
    pub fn open(files: TlsFiles) -> Result<Self, TlsError> {
        let contents = Contents::read_files(&files)?;
        let certified = contents.certified()?;
        certified.tell();
        telemetry::begin_tls();
        let current = Arc::new(ArcSwap::from_pointee(Current::of_certified(certified)));

        Ok(Self {
            files: Arc::new(files),
            current,
            first: contents.digest(),
        })
    }
}

/// The configuration that the next handshake uses.
pub(super) struct Current {
    config: Arc<ServerConfig>,
    /// The digest of the authorities of clients.
    authorities: blake3::Hash,
    /// Cancelled when clients are let in by other authorities.
    outdated: CancellationToken,
}

impl Current {
    fn of_certified(certified: Certified) -> Self {
        Self {
            config: certified.config,
            authorities: certified.authorities,
            outdated: CancellationToken::new(),
        }
    }
}

/// Where connections come from, and whether they speak TLS.
pub struct Socket {
    /// The listening socket.
    pub listener: TcpListener,
    /// The certificate; without it everything is plain text.
    pub tls: Option<Tls>,
}

impl From<TcpListener> for Socket {
    fn from(listener: TcpListener) -> Self {
        Self {
            listener,
            tls: None,
        }
    }
}
