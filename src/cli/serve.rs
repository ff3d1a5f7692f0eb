//! `nudge serve`: the service on a socket, until a signal.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;

use super::config::{Config, database};
use super::key::KeysFile;
use super::signals::Signals;
use super::{Failure, output};
use crate::access::redacted;
use crate::serve::access::Keyring;
use crate::serve::{Running, Settings, Starting};
use crate::store::{SqliteStore, Stage};
use crate::telemetry;

/// Serve REST, gRPC, gRPC-Web and metrics on one port
#[derive(Debug, Args)]
#[command(long_about = "Serve REST, gRPC, gRPC-Web and metrics on one port.\n\n\
    Counts are kept in DIR/nudge.db, one service to a directory. SIGTERM or Ctrl-C stops it gracefully: streams end after their last receipt, \
    within 10 seconds, and nothing that was acknowledged is lost. A second signal stops it at once, and loses nothing either.\n\n\
    Example:\n  nudge serve --listen 127.0.0.1:8080 --data ./nudge-data")]
pub struct Serve {
    #[command(flatten)]
    config: Config,
    /// Print the configuration that flags and environment make, and end.
    #[arg(long)]
    print_config: bool,
}

impl Serve {
    /// Serves until a signal.
    pub async fn run(self) -> Result<(), Failure> {
        let config = self.config;
        if self.print_config {
            return output::print(&redacted(&config.to_toml()));
        }

        telemetry::log(config.log.format());
        let signals = Signals::install()?;
        let keys = KeysFile::read_and_watch(config.keys.as_deref())?;
        let Some(service) = Service::start(&config, keys.ring.clone(), &signals).await? else {
            return Ok(());
        };
        let scheme = if config.tls_cert.is_some() {
            "https"
        } else {
            "http"
        };
        output::print(&format!("listening on {scheme}://{}", service.address))?;

        tokio::select! {
            () = signals.next() => {}
            never = keys.follow() => match never {},
        }
        service.stop_unless(&signals).await
    }
}

/// A service that runs in this process until a signal: what commands add to [`Running`].
pub(super) struct Service {
    /// Its rooms.
    pub(super) running: Running,
    /// Where it listens.
    pub(super) address: SocketAddr,
}

impl Service {
    /// Takes the port, where it says at once that it is alive, opens the database and begins to
    /// serve those who have one of `keys`, or everybody where there are none. `None` where a signal
    /// came first.
    pub(super) async fn start(
        config: &Config,
        keys: Option<Keyring>,
        signals: &Signals,
    ) -> Result<Option<Self>, Failure> {
        refuse_to_be_open(config)?;
        let tls = config.tls()?;

        // The port first: whoever finds it taken should not have touched the data.
        let mut starting = Starting::new(Settings {
            keys,
            hosts: config.hosts.clone(),
            cors_origins: config.cors_origins.clone(),
            limits: config.limits(),
        });
        let address = starting
            .listen(config.listen, tls)
            .await
            .map_err(|error| cannot_listen(config.listen, &error))?;

        let path = database(&config.data);
        let store = tokio::select! {
            store = SqliteStore::open_telling(&path, config.store(), starting.stage()) => store,
            () = signals.next() => {
                // Whatever it was at is done or undone by the next opening, as after kill -9.
                tracing::info!("stopped before the database was open");
                return Ok(None);
            }
            never = tell_waiting(address, starting.stage()) => match never {},
        };
        let store = Arc::new(store.map_err(Failure::usage)?);

        let running = starting
            .open(store, config.upkeep())
            .await
            .map_err(Failure::usage)?;
        tracing::info!(%address, database = %path.display(), "serving");
        Ok(Some(Self { running, address }))
    }

    /// Shuts down gracefully, or at once when another signal comes.
    pub(super) async fn stop_unless(self, signals: &Signals) -> Result<(), Failure> {
        tracing::info!("stopping: streams end after their last receipt");
        tokio::select! {
            stopped = self.running.shutdown() => stopped.map_err(Failure::usage),
            () = signals.next() => Err(Failure::refused("stopped at once by a second signal; nothing acknowledged is lost")),
        }
    }
}

/// Says in the log what takes so long, less and less often.
async fn tell_waiting(address: SocketAddr, stage: &Stage) -> Infallible {
    const LONGEST: Duration = Duration::from_secs(60);
    let mut wait = Duration::from_secs(1);
    loop {
        tokio::time::sleep(wait).await;
        tracing::info!(%address, doing = stage.in_words(), "listening, and not ready yet");
        wait = (wait * 2).min(LONGEST);
    }
}

/// Refuses to let in everybody who reaches this machine, unless that is wanted.
fn refuse_to_be_open(config: &Config) -> Result<(), Failure> {
    let ip = config.listen.ip().to_canonical();
    if ip.is_loopback() || config.keys.is_some() {
        return Ok(());
    }

    if config.insecure {
        let address = config.listen;
        tracing::warn!(%address, "without keys everybody who reaches this address is let in (--insecure)");
        return Ok(());
    }

    let others = if ip.is_unspecified() {
        "every address of this machine"
    } else {
        "an address that others reach"
    };

    Err(Failure::usage(format!(
        "{} is {others}, and without keys everybody there could read, change and delete everything: give --keys FILE (`nudge key new` makes \
         one), or listen on 127.0.0.1, or give --insecure where something else keeps others away",
        config.listen
    )))
}

fn cannot_listen(address: SocketAddr, error: &std::io::Error) -> Failure {
    let advice = match error.kind() {
        std::io::ErrorKind::AddrInUse => {
            ": stop what listens there, or choose another address with --listen"
        }
        std::io::ErrorKind::PermissionDenied => ": choose a port above 1023 with --listen",
        _ => ": choose another address with --listen",
    };
    Failure::usage(format!("cannot listen on {address}: {error}{advice}"))
}
