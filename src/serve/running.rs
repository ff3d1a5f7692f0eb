//! The lifecycle of the service: it listens before it is ready, is ready once its store is open,
//! and shuts down gracefully. Commands, the demo, experiments, tests and benchmarks all run it by
//! this.
//!
//! ```text
//! Starting::new --listen--> alive, not ready --open(store)--> Running: ready --shutdown--> drained, committed, closed
//! ```

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;

use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::{CancellationToken, DropGuard};

use super::doors::Doors;
use super::settings::{Endpoint, Settings};
use super::tls::{Socket, Tls};
use crate::app::{App, Upkeep};
use crate::store::{Stage, Store};

/// A service whose store is not open yet: alive where it listens, and not ready. Dropping it stops
/// it.
pub struct Starting {
    settings: Settings,
    endpoint: Endpoint,
    stage: Stage,
    doors: Doors,
    serving: Serving,
}

/// A service that runs in this process. Dropping it begins its shutdown and waits for nothing.
pub struct Running {
    /// Its rooms.
    pub app: App,
    serving: Serving,
}

/// What goes on for a service: the accept loop, where it listens.
struct Serving {
    draining: CancellationToken,
    stop: DropGuard,
    accepting: Option<JoinHandle<()>>,
}

impl Starting {
    /// Makes a service that neither listens nor counts yet.
    pub fn new(settings: Settings) -> Self {
        let (stage, draining) = (Stage::default(), CancellationToken::new());
        Self {
            settings,
            endpoint: Endpoint::default(),
            doors: Doors::closed(stage.clone()),
            stage,
            serving: Serving {
                stop: draining.clone().drop_guard(),
                draining,
                accepting: None,
            },
        }
    }

    /// Returns what readiness tells until the store is open, for whoever opens it.
    pub fn stage(&self) -> &Stage {
        &self.stage
    }

    /// Takes a port and begins to accept connections, over TLS where there is a certificate; returns
    /// the address, which is what port 0 became. Experiments, which nobody calls, do without.
    pub async fn listen(
        &mut self,
        address: SocketAddr,
        tls: Option<Tls>,
    ) -> io::Result<SocketAddr> {
        let listener = TcpListener::bind(address).await?;
        let taken = listener.local_addr()?;
        self.endpoint = Endpoint {
            ip: Some(address.ip()),
            speaks_tls: tls.is_some(),
        };

        let accepting = self.doors.clone().serve(
            Socket { listener, tls },
            self.serving.draining.clone(),
            self.settings.limits.clone(),
        );
        self.serving.accepting = Some(tokio::spawn(accepting));
        Ok(taken)
    }

    /// Opens the rooms on a store, and is ready.
    pub async fn open(
        self,
        store: Arc<dyn Store>,
        upkeep: Upkeep,
    ) -> Result<Running, tonic_reflection::server::Error> {
        let app = App::open(self.serving.draining.clone(), store, upkeep);
        self.doors
            .open(app.clone(), &self.settings, &self.endpoint)
            .await?;
        Ok(Running {
            app,
            serving: self.serving,
        })
    }

    /// Stops accepting connections, and waits until those that there are have ended.
    pub async fn shutdown(self) -> io::Result<()> {
        self.serving.shutdown().await
    }
}

impl Running {
    /// Shuts down gracefully, in bounded time: not ready, streams end after their last receipt, what
    /// is queued is committed, and the store is closed. Fails where the accept loop has panicked.
    pub async fn shutdown(self) -> io::Result<()> {
        let served = self.serving.shutdown().await;
        self.app.close().await;
        served
    }
}

impl Serving {
    async fn shutdown(self) -> io::Result<()> {
        drop(self.stop);
        match self.accepting {
            Some(accepting) => Ok(accepting.await?),
            None => Ok(()),
        }
    }
}
