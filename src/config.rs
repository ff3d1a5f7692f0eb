//! The one configuration of a service: what `nudge serve` takes, with its defaults.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// How a service runs. Every field has a flag and an environment variable of the same name,
/// `--data` and `NUDGE_DATA`.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// The one address of REST, gRPC, metrics and the page. Port 0 takes a free one.
    pub listen: SocketAddr,
    /// The directory of the database, made if it is missing.
    pub data: PathBuf,
    /// The most cells of an environment.
    pub max_cells: u64,
    /// The most segments of an environment.
    pub max_segments: u64,
    /// The most producers of an environment.
    pub max_producers: u64,
    /// The most models of an environment.
    pub max_models: u64,
    /// The most environments.
    pub max_environments: u64,
    /// Cells of the states that are kept in memory.
    pub cache_cells: usize,
    /// How often it is looked whether priors are to be fitted again; never if it is zero.
    pub fit_every: Duration,
    /// How often it is looked whether networks are to be trained again; never if it is zero.
    pub train_every: Duration,
    /// The most connections; fewer where the limit on open files leaves room for fewer.
    pub max_connections: usize,
    /// The age at which connections are asked to leave; never if it is zero.
    pub max_connection_age: Duration,
    /// The file of the keys that are let in; without one, everybody is.
    pub keys: Option<PathBuf>,
    /// Whether everybody may be let in who reaches an address that is not this machine's own.
    pub insecure: bool,
    /// Names by which the service may be asked for, beside loopback names and the address that it
    /// listens on.
    pub hosts: Vec<String>,
    /// The certificate of the service in PEM, with those between it and its authority; plain text
    /// without it.
    pub tls_cert: Option<PathBuf>,
    /// The private key of the certificate, in PEM.
    pub tls_key: Option<PathBuf>,
    /// The authorities one of which every client has a certificate of, in PEM; clients need none
    /// without it.
    pub tls_client_ca: Option<PathBuf>,
    /// Origins whose pages may call REST and gRPC-Web; none by default.
    pub cors_origins: Vec<String>,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            data: PathBuf::from("nudge-data"),
            max_cells: 5_000_000,
            max_segments: 4_096,
            max_producers: 10_000,
            max_models: 256,
            max_environments: 1_000,
            cache_cells: 400_000,
            fit_every: Duration::from_secs(5),
            train_every: Duration::ZERO,
            max_connections: 4_096,
            max_connection_age: Duration::from_secs(3_600),
            keys: None,
            insecure: false,
            hosts: Vec::new(),
            tls_cert: None,
            tls_key: None,
            tls_client_ca: None,
            cors_origins: Vec::new(),
        }
    }
}

impl Config {
    /// Returns the path of the database.
    pub fn database(&self) -> PathBuf {
        self.data.join("nudge.db")
    }
}
