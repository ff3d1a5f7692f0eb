//! `nudge serve`: the service on a socket, until a signal.

use std::convert::Infallible;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;

use clap::{Args, ValueEnum};

use super::duration::duration;
use super::key::KeysFile;
use super::{Failure, output};
use crate::access::redacted;
use crate::app::Upkeep;
use crate::config::Config;
use crate::serve::connections::files;
use crate::serve::connections::limits::Limits;
use crate::serve::tls::{Tls, TlsFiles};
use crate::serve::{Running, Settings, Starting};
use crate::store::{Options, Quotas, SqliteStore, Stage};
use crate::telemetry::{self, LogFormat};

/// Serve REST, gRPC, gRPC-Web and metrics on one port
#[derive(Debug, Args)]
#[command(long_about = "Serve REST, gRPC, gRPC-Web and metrics on one port.\n\n\
    Counts are kept in DIR/nudge.db, one service to a directory. SIGTERM or Ctrl-C stops it gracefully: streams end after their last receipt, \
    within 10 seconds, and nothing that was acknowledged is lost. A second signal stops it at once, and loses nothing either.\n\n\
    Example:\n  nudge serve --listen 127.0.0.1:8080 --data ./nudge-data")]
pub struct Serve {
    #[command(flatten)]
    settings: ServeSettings,
    /// Print the configuration that flags and environment make, and end.
    #[arg(long)]
    print_config: bool,
}

/// The flags of a service; each has an environment variable.
#[derive(Debug, Args)]
pub struct ServeSettings {
    /// The address of every face. Port 0 takes a free one.
    #[arg(long, env = "NUDGE_LISTEN", value_name = "ADDR", value_parser = address, default_value_t = Config::default().listen)]
    pub listen: SocketAddr,
    /// The directory of the database, made if it is missing.
    #[arg(long, env = "NUDGE_DATA", value_name = "DIR", default_value_os_t = Config::default().data)]
    pub data: PathBuf,
    /// The most cells (state, segment, joint action) of an environment.
    #[arg(long, env = "NUDGE_MAX_CELLS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Config::default().max_cells)]
    pub max_cells: u64,
    /// The most segments of an environment.
    #[arg(long, env = "NUDGE_MAX_SEGMENTS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Config::default().max_segments)]
    pub max_segments: u64,
    /// The most producers of an environment.
    #[arg(long, env = "NUDGE_MAX_PRODUCERS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Config::default().max_producers)]
    pub max_producers: u64,
    /// The most models (versions of networks) of an environment.
    #[arg(long, env = "NUDGE_MAX_MODELS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Config::default().max_models)]
    pub max_models: u64,
    /// The most environments. Those that exist stay, also where there are more.
    #[arg(long, env = "NUDGE_MAX_ENVIRONMENTS", value_name = "N", value_parser = at_least_one::<u64>, default_value_t = Config::default().max_environments)]
    pub max_environments: u64,
    /// Cells kept in memory.
    #[arg(long, env = "NUDGE_CACHE_CELLS", value_name = "N", default_value_t = Config::default().cache_cells)]
    pub cache_cells: usize,
    /// How often it is looked whether priors are to be fitted to the counts again, which is when a
    /// tenth more was counted, for pairs of agents that were asked about within the last hour; 0s
    /// for never.
    #[arg(long, env = "NUDGE_FIT_EVERY", value_name = "TIME", value_parser = duration, default_value = "5s")]
    pub fit_every: Duration,
    /// How often it is looked whether networks are to be trained again, which is when half as much
    /// again was counted; 0s for never.
    #[arg(long, env = "NUDGE_TRAIN_EVERY", value_name = "TIME", value_parser = duration, default_value = "0s")]
    pub train_every: Duration,
    /// The most connections, as far as the limit on open files (ulimit -n) leaves room; the idlest
    /// one makes room for a new one.
    #[arg(long, env = "NUDGE_MAX_CONNECTIONS", value_name = "N", value_parser = at_least_one::<usize>, default_value_t = Config::default().max_connections)]
    pub max_connections: usize,
    /// The age, give or take a tenth, at which a connection is asked to leave, so that clients
    /// spread over services anew; 0s for never.
    #[arg(long, env = "NUDGE_MAX_CONNECTION_AGE", value_name = "TIME", value_parser = duration, default_value = "1h")]
    pub max_connection_age: Duration,
    /// The file of the keys that are let in (see `nudge key new`), read again on SIGHUP. Without
    /// one, everybody who reaches the service is let in.
    #[arg(long, env = "NUDGE_KEYS", value_name = "FILE")]
    pub keys: Option<PathBuf>,
    /// Let in everybody who reaches an address that is not this machine's own: only where something
    /// else keeps others away.
    #[arg(long, env = "NUDGE_INSECURE", value_parser = clap::builder::BoolishValueParser::new())]
    pub insecure: bool,
    /// A name by which the service may be asked for without a key, beside loopback names and the
    /// address that it listens on, such as nudge.example.org or *.example.org; repeat it, or
    /// separate several by commas.
    #[arg(long, env = "NUDGE_HOSTS", value_name = "NAME", value_delimiter = ',', value_parser = host)]
    pub hosts: Vec<String>,
    /// The certificate of the service in PEM, with those between it and its authority: every face
    /// speaks TLS (HTTP/1.1 and HTTP/2). It is read again when it changes.
    #[arg(long, env = "NUDGE_TLS_CERT", value_name = "FILE")]
    pub tls_cert: Option<PathBuf>,
    /// The private key of the certificate, in PEM and not encrypted.
    #[arg(long, env = "NUDGE_TLS_KEY", value_name = "FILE")]
    pub tls_key: Option<PathBuf>,
    /// The certificates of authorities, in PEM: every client needs a certificate of one of them
    /// (mutual TLS).
    #[arg(long, env = "NUDGE_TLS_CLIENT_CA", value_name = "FILE")]
    pub tls_client_ca: Option<PathBuf>,
    /// An origin whose pages may call, such as https://example.org; repeat it, or separate several
    /// by commas.
    #[arg(long, env = "NUDGE_CORS_ORIGINS", value_name = "ORIGIN", value_delimiter = ',', value_parser = origin)]
    pub cors_origins: Vec<String>,
    /// How log lines look.
    #[arg(long, env = "NUDGE_LOG", value_enum, default_value_t = Log::Human)]
    pub log: Log,
}

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Log {
    /// For people.
    Human,
    /// One JSON object a line.
    Json,
}

impl Log {
    /// Returns the format of log lines.
    pub fn format(self) -> LogFormat {
        match self {
            Self::Human => LogFormat::Human,
            Self::Json => LogFormat::Json,
        }
    }
}

impl ServeSettings {
    /// Returns the configuration.
    pub fn config(&self) -> Config {
        Config {
            listen: self.listen,
            data: self.data.clone(),
            max_cells: self.max_cells,
            max_segments: self.max_segments,
            max_producers: self.max_producers,
            max_models: self.max_models,
            max_environments: self.max_environments,
            cache_cells: self.cache_cells,
            fit_every: self.fit_every,
            train_every: self.train_every,
            max_connections: self.max_connections,
            max_connection_age: self.max_connection_age,
            keys: self.keys.clone(),
            insecure: self.insecure,
            hosts: self.hosts.clone(),
            tls_cert: self.tls_cert.clone(),
            tls_key: self.tls_key.clone(),
            tls_client_ca: self.tls_client_ca.clone(),
            cors_origins: self.cors_origins.clone(),
        }
    }
}

impl Serve {
    /// Serves until a signal.
    pub async fn run(self) -> Result<(), Failure> {
        let config = self.settings.config();
        if self.print_config {
            return print(&config, self.settings.log);
        }
        telemetry::log(self.settings.log.format());
        let signals = Signals::install()?;
        let Some(service) = Service::start(&config, &signals).await? else {
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
            never = service.reload() => match never {},
        }
        service.stop_unless(&signals).await
    }
}

/// A service that runs in this process.
pub struct Service {
    /// Its rooms and its end.
    pub running: Running,
    /// Where it listens.
    pub address: SocketAddr,
    keys: KeysFile,
}

impl Service {
    /// Takes the port, where it says at once that it is alive, opens the database and begins to
    /// serve. `None` where a signal came first.
    pub async fn start(config: &Config, signals: &Signals) -> Result<Option<Self>, Failure> {
        let quotas = Quotas {
            cells: config.max_cells,
            segments: config.max_segments,
            producers: config.max_producers,
            models: config.max_models,
            environments: config.max_environments,
        };
        let options = Options {
            quotas,
            cache_cells: config.cache_cells,
        };
        refuse_to_be_open(config)?;
        let keys = KeysFile::read(config.keys.as_deref())?;
        let tls = tls(config)?;
        // The port first: whoever finds it taken should not have touched the data.
        let mut starting = Starting::new(Settings {
            keys: keys.ring.clone(),
            hosts: config.hosts.clone(),
            cors_origins: config.cors_origins.clone(),
            limits: Limits {
                connections: files::leave_room_for(config.max_connections),
                age: config.max_connection_age,
                ..Limits::default()
            },
        });
        let address = starting
            .listen(config.listen, tls)
            .await
            .map_err(|error| cannot_listen(config.listen, &error))?;

        let database = config.database();
        let store = tokio::select! {
            store = SqliteStore::open_telling(&database, options, starting.stage()) => store,
            () = signals.next() => {
                // Whatever it was at is done or undone by the next opening, as after kill -9.
                tracing::info!("stopped before the database was open");
                return Ok(None);
            }
            never = tell_waiting(address, starting.stage()) => match never {},
        };
        let store = Arc::new(store.map_err(|error| Failure::usage(error.to_string()))?);

        let upkeep = Upkeep {
            fit_every: config.fit_every,
            train_every: config.train_every,
        };
        let running = starting
            .open(store, upkeep)
            .await
            .map_err(|error| Failure::usage(error.to_string()))?;
        tracing::info!(%address, database = %database.display(), "serving");
        Ok(Some(Self {
            running,
            address,
            keys,
        }))
    }

    /// Reads the keys again whenever SIGHUP comes, for ever.
    pub async fn reload(&self) -> Infallible {
        self.keys.follow().await
    }

    /// Stops gracefully, or at once when another signal comes.
    pub async fn stop_unless(self, signals: &Signals) -> Result<(), Failure> {
        tracing::info!("stopping: streams end after their last receipt");
        tokio::select! {
            stopped = self.stop() => stopped,
            () = signals.next() => Err(Failure::refused("stopped at once by a second signal; nothing acknowledged is lost")),
        }
    }

    /// Ends streams after their last receipt, commits what is queued, and closes the database.
    pub async fn stop(self) -> Result<(), Failure> {
        self.running
            .shutdown()
            .await
            .map_err(|error| Failure::usage(error.to_string()))
    }
}

/// Reads the files of TLS, where it is wanted.
fn tls(config: &Config) -> Result<Option<Tls>, Failure> {
    let files = match (&config.tls_cert, &config.tls_key, &config.tls_client_ca) {
        (Some(certificate), Some(key), authorities) => TlsFiles {
            certificate: certificate.clone(),
            key: key.clone(),
            client_authorities: authorities.clone(),
        },
        (None, None, None) => return Ok(None),
        (Some(_), None, _) => {
            return Err(lonely(
                "--tls-cert (NUDGE_TLS_CERT)",
                "--tls-key (NUDGE_TLS_KEY)",
            ));
        }
        (None, Some(_), _) => {
            return Err(lonely(
                "--tls-key (NUDGE_TLS_KEY)",
                "--tls-cert (NUDGE_TLS_CERT)",
            ));
        }
        (None, None, Some(_)) => {
            return Err(lonely(
                "--tls-client-ca (NUDGE_TLS_CLIENT_CA)",
                "--tls-cert and --tls-key",
            ));
        }
    };
    Tls::open(files)
        .map(Some)
        .map_err(|error| Failure::usage(error.to_string()))
}

fn lonely(given: &str, missing: &str) -> Failure {
    Failure::usage(format!(
        "{given} is given without {missing}: TLS needs a certificate and its private key"
    ))
}

/// Says in the log what takes so long, less and less often.
async fn tell_waiting(address: SocketAddr, stage: &Stage) -> Infallible {
    const LONGEST: Duration = Duration::from_secs(60);
    let mut wait = Duration::from_secs(1);
    loop {
        tokio::time::sleep(wait).await;
        tracing::info!(%address, doing = stage.told(), "listening, and not ready yet");
        wait = (wait * 2).min(LONGEST);
    }
}

/// SIGINT and SIGTERM.
pub struct Signals(tokio::sync::Mutex<(tokio::signal::unix::Signal, tokio::signal::unix::Signal)>);

impl Signals {
    /// Takes the signals over from the operating system's default.
    pub fn install() -> Result<Self, Failure> {
        use tokio::signal::unix::{SignalKind, signal};
        let of = |kind| signal(kind).map_err(|error| Failure::usage(error.to_string()));
        Ok(Self(tokio::sync::Mutex::new((
            of(SignalKind::interrupt())?,
            of(SignalKind::terminate())?,
        ))))
    }

    /// Waits for the next of them.
    pub async fn next(&self) {
        let mut signals = self.0.lock().await;
        let (interrupt, terminate) = &mut *signals;
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    }
}

/// Reads an address to listen on.
pub(super) fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| {
        format!("got {text:?}, expected an IP address and a port such as 127.0.0.1:8080")
    })
}

/// Reads a name of a host: without scheme, port or path.
fn host(text: &str) -> Result<String, String> {
    let is_known = |byte: u8| byte.is_ascii_alphanumeric() || b"-._:[]*".contains(&byte);
    let has_port = text
        .rsplit_once(':')
        .is_some_and(|(name, port)| !name.contains(':') && port.parse::<u16>().is_ok());
    let is_host = !text.is_empty() && text.bytes().all(is_known) && !has_port;
    let expected =
        "expected a name without scheme and port such as nudge.example.org or *.example.org";
    is_host
        .then(|| text.to_owned())
        .ok_or_else(|| format!("got {text:?}, {expected}"))
}

/// Reads an origin: scheme, host and perhaps a port, or `*` for any.
fn origin(text: &str) -> Result<String, String> {
    let plain = text.strip_suffix('/').unwrap_or(text);
    let is_scheme = |scheme: &str| {
        scheme.starts_with(|first: char| first.is_ascii_alphabetic())
            && scheme
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || b"+-.".contains(&byte))
    };
    let is_host = |host: &str| {
        !host.is_empty()
            && host
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || b"-._:[]".contains(&byte))
    };
    let is_origin = plain
        .split_once("://")
        .is_some_and(|(scheme, host)| is_scheme(scheme) && is_host(host));
    let expected = "expected a scheme, a host and perhaps a port such as https://example.org, or *";
    (is_origin || text == "*")
        .then(|| plain.to_owned())
        .ok_or_else(|| format!("got {text:?}, {expected}"))
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

/// Returns an address that a client on this machine can reach.
pub(super) fn reachable(address: SocketAddr) -> SocketAddr {
    match address.ip() {
        ip if ip.is_unspecified() => {
            SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), address.port())
        }
        _ => address,
    }
}

fn at_least_one<N: FromStr + Default + PartialOrd>(text: &str) -> Result<N, String> {
    let number = text.parse().ok().filter(|number| *number > N::default());
    number.ok_or_else(|| format!("got {text:?}, expected a whole number of at least 1"))
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

/// Tells the files of TLS by their paths; what is in them is nobody's business.
fn paths(config: &Config) -> String {
    let paths = [
        ("tls_cert", &config.tls_cert),
        ("tls_key", &config.tls_key),
        ("tls_client_ca", &config.tls_client_ca),
    ];
    paths
        .into_iter()
        .filter_map(|(name, path)| Some(format!("{name} = {:?}\n", path.as_ref()?)))
        .collect()
}

fn print(config: &Config, log: Log) -> Result<(), Failure> {
    let log = if log == Log::Json { "json" } else { "human" };
    let quoted = |origins: &[String]| {
        origins
            .iter()
            .map(|origin| format!("{origin:?}"))
            .collect::<Vec<_>>()
            .join(", ")
    };
    output::print(&redacted(&format!(
        "listen = \"{}\"\ndata = {:?}\nmax_cells = {}\nmax_segments = {}\nmax_producers = {}\nmax_models = {}\nmax_environments = {}\ncache_cells = {}\nfit_every = \"{}s\"\ntrain_every = \"{}s\"\n\
         max_connections = {}\nmax_connection_age = \"{}s\"\n{}insecure = {}\nhosts = [{}]\n{}cors_origins = [{}]\nlog = \"{log}\"",
        config.listen,
        config.data,
        config.max_cells,
        config.max_segments,
        config.max_producers,
        config.max_models,
        config.max_environments,
        config.cache_cells,
        config.fit_every.as_secs(),
        config.train_every.as_secs(),
        config.max_connections,
        config.max_connection_age.as_secs(),
        config
            .keys
            .as_ref()
            .map(|path| format!("keys = {path:?}\n"))
            .unwrap_or_default(),
        config.insecure,
        quoted(&config.hosts),
        paths(config),
        quoted(&config.cors_origins),
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_origin_has_a_scheme_and_no_path() {
        for (text, kept) in [
            ("https://example.org", "https://example.org"),
            ("http://localhost:3000", "http://localhost:3000"),
            ("https://[::1]:8443/", "https://[::1]:8443"),
            ("tauri://localhost", "tauri://localhost"),
            ("*", "*"),
        ] {
            assert_eq!(origin(text).as_deref(), Ok(kept), "{text}");
        }
        for wrong in [
            "",
            "example.org",
            "https://",
            "://x",
            "https://example.org/path",
            "https://*.example.org",
            "null",
            " ",
        ] {
            let told = origin(wrong).expect_err(wrong);
            assert!(
                told.starts_with(&format!("got {wrong:?}, expected a scheme, a host")),
                "{told}"
            );
        }
    }
}
