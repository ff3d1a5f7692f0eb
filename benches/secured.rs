//! What it costs to be let in: durable ingest and one question over REST on kept connections,
//! secured beside open.
//!
//! `cargo bench --bench secured`, or `cargo bench --bench secured -- rest` for one of them. Service
//! and client share the machine, so the client's half of the cost counts too.

#![allow(missing_docs)]

mod support;
#[path = "../tests/it/support/x509.rs"]
mod x509;

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use nudge::access::{Keys, generate};
use nudge::client::{ClientTls, Connection, Options, Trust};
use nudge::serve::access::Keyring;
use nudge::serve::tls::{Tls, TlsFiles};
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use support::http::get_with;
use support::{
    ACTIONS, BATCH, Service, batches, make_world_by, median, pump_by, report, runtime, state,
    wanted,
};
use tempfile::TempDir;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use x509::Authority;

const ROUNDS: usize = 7;
const BATCHES: u64 = 3_000;
const QUESTIONS: usize = 4_000;
const CONNECTIONS: usize = 4;

/// A way to a service of its own.
struct Way {
    service: Service,
    connection: Connection,
    tls: Option<TlsConnector>,
    /// Lines of the head of each question.
    lines: String,
}

impl Way {
    /// Everything is open.
    async fn open() -> Self {
        let service = Service::start().await;
        let connection = Connection::open(&service.address.to_string())
            .await
            .expect("it listens");
        Self {
            service,
            connection,
            tls: None,
            lines: String::new(),
        }
    }

    /// Everything that protects a service is on.
    async fn secured(directory: &Path) -> Self {
        let authority = Authority::new("bench");
        let certificate = authority.certify("localhost");
        let files = TlsFiles {
            certificate: directory.join("tls.crt"),
            key: directory.join("tls.key"),
            client_authorities: None,
        };
        std::fs::write(&files.certificate, certificate.certificate).expect("written");
        std::fs::write(&files.key, certificate.key).expect("written");
        let key = generate().expect("randomness");
        let keys =
            Keys::parse(&format!("bench {} read,ingest,admin", key.digest())).expect("a line");
        let tls = Tls::open(files.clone()).expect("a pair");
        let service = Service::secured(Some(tls), Some(Keyring::new(keys))).await;
        let address = format!("https://localhost:{}", service.address.port());
        let authorities = directory.join("ca.crt");
        std::fs::write(&authorities, authority.pem()).expect("written");
        let trust = ClientTls {
            trust: Trust::Authorities(authorities),
            identity: None,
        };
        let lines = format!("authorization: Bearer {}\r\n", key.reveal());
        let connection = Connection::open_with(&address, &Options::default().key(key).tls(trust))
            .await
            .expect("it listens");
        let mut roots = RootCertStore::empty();
        let der = CertificateDer::from_slice(authority.der());
        roots.add(der).expect("an authority");
        let config = ClientConfig::builder_with_provider(nudge::tls::provider())
            .with_safe_default_protocol_versions();
        let config = config
            .expect("both versions")
            .with_root_certificates(roots)
            .with_no_client_auth();
        Self {
            service,
            connection,
            tls: Some(TlsConnector::from(Arc::new(config))),
            lines,
        }
    }

    async fn transitions_per_second(&self, load: &[nudge::api::proto::Columns]) -> f64 {
        let took = pump_by(self.connection.ingest(), "world", "p", load, BATCHES).await;
        (BATCHES * BATCH as u64) as f64 / took.as_secs_f64()
    }

    async fn questions_per_second(&self, path: &str) -> f64 {
        let mut streams = Vec::new();
        for _ in 0..CONNECTIONS {
            streams.push(self.connect().await);
        }
        let started = Instant::now();
        let ask = |mut stream: Box<dyn Wire>| async move {
            for _ in 0..QUESTIONS {
                get_with(&mut stream, path, &self.lines).await;
            }
        };
        futures::future::join_all(streams.into_iter().map(ask)).await;
        (QUESTIONS * CONNECTIONS) as f64 / started.elapsed().as_secs_f64()
    }

    async fn connect(&self) -> Box<dyn Wire> {
        let stream = TcpStream::connect(self.service.address)
            .await
            .expect("listening");
        stream.set_nodelay(true).expect("a socket");
        let Some(tls) = &self.tls else {
            return Box::new(stream);
        };
        let name = ServerName::try_from("localhost").expect("a name");
        Box::new(tls.connect(name, stream).await.expect("TLS"))
    }
}

/// A kept connection of either kind.
trait Wire: AsyncRead + AsyncWrite + Unpin + Send {}

impl<S: AsyncRead + AsyncWrite + Unpin + Send> Wire for S {}

fn main() {
    runtime().block_on(async {
        let directory = TempDir::new().expect("a temporary directory");
        let ways = [Way::open().await, Way::secured(directory.path()).await];
        let load = batches(223, 64, 1);
        for way in &ways {
            make_world_by(way.connection.environments(), "world", ACTIONS).await;
            pump_by(way.connection.ingest(), "world", "p", &load, 200).await;
        }
        if wanted("ingest") {
            let mut figures = [Vec::new(), Vec::new()];
            for _ in 0..ROUNDS {
                for (way, figures) in ways.iter().zip(&mut figures) {
                    figures.push(way.transitions_per_second(&load).await);
                }
            }
            let [open, secured] = figures.map(median);
            report(
                "durable ingest with keys and TLS",
                secured,
                "without",
                open,
                "transitions/s",
                "(target >= 0.9)",
            );
        }
        if wanted("rest") {
            let key = state(1).map(|bin| bin.to_string()).join(".");
            let path = format!("/v1/environments/world/influence?key={key}&view=figures");
            let mut figures = [Vec::new(), Vec::new()];
            for _ in 0..ROUNDS {
                for (way, figures) in ways.iter().zip(&mut figures) {
                    figures.push(way.questions_per_second(&path).await);
                }
            }
            let [open, secured] = figures.map(median);
            report(
                "one known state over REST with keys and TLS",
                secured,
                "without",
                open,
                "requests/s",
                "(target >= 0.85)",
            );
        }
        for way in ways {
            way.service.stop().await;
        }
    });
}
