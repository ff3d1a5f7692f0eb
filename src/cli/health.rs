//! `nudge health`: a readiness probe for containers, which have no curl.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Args;

use super::Failure;
use super::addresses::{address, reachable};
use super::config::Config;
use super::duration::duration;
use super::output::print;
use super::server::Tls;
use crate::client::{ClientTls, Options, Readiness, Trust, readiness};

/// Ask a service whether it is ready
#[derive(Debug, Args)]
#[command(
    long_about = "Ask a service whether it is ready, as GET /readyz does, for health checks where there is no curl.\n\n\
    Exit code 0: ready; 1: it answers and is not ready; 2: it does not answer in time, or cannot be trusted.\n\n\
    Without --server it is the one on this machine, as NUDGE_LISTEN and NUDGE_TLS_CERT describe it: over TLS it has to show that very certificate, \
    whatever name it is for.\n\n\
    Example:\n  nudge health --server http://127.0.0.1:8080"
)]
pub(super) struct Health {
    /// Address of the service; https://HOST:PORT for TLS
    #[arg(long, value_name = "ADDRESS", env = "NUDGE_SERVER")]
    server: Option<String>,
    /// Where the service on this machine listens
    #[arg(long, env = "NUDGE_LISTEN", value_name = "ADDR", value_parser = address, default_value_t = Config::default().listen)]
    listen: SocketAddr,
    /// The certificate of the service on this machine, where it speaks TLS
    #[arg(long, env = "NUDGE_TLS_CERT", value_name = "FILE")]
    tls_cert: Option<PathBuf>,
    #[command(flatten)]
    tls: Tls,
    /// Believe whoever answers over TLS: no certificate is verified
    #[arg(long, conflicts_with = "ca")]
    no_verify: bool,
    /// How long the answer may take
    #[arg(long, value_name = "TIME", value_parser = duration, default_value = "3s")]
    timeout: Duration,
}

impl Health {
    /// Asks, and fails where it is not ready.
    pub(super) async fn run(self) -> Result<(), Failure> {
        let (address, tls) = self.service()?;
        let asked = tokio::time::timeout(
            self.timeout,
            readiness(&address, &Options::default().tls(tls)),
        )
        .await;

        let late = |_| {
            Failure::usage(format!(
                "{address} does not answer within {:?}",
                self.timeout
            ))
        };

        match asked.map_err(late)?? {
            Readiness::Ready => print("ready"),
            Readiness::NotReady(why) => Err(Failure::refused(why)),
        }
    }

    /// Returns which service is asked, and how it is known.
    fn service(&self) -> Result<(String, ClientTls), Failure> {
        let mut tls = self.tls.client()?;
        let address = match (&self.server, &self.tls_cert) {
            (Some(server), _) => server.clone(),
            (None, None) => format!("http://{}", reachable(self.listen)),
            (None, Some(certificate)) => {
                if tls.trust == Trust::System {
                    tls.trust = Trust::Exactly(certificate.clone());
                }
                format!("https://{}", reachable(self.listen))
            }
        };

        if self.no_verify {
            tls.trust = Trust::Anybody;
        }
        Ok((address, tls))
    }
}
