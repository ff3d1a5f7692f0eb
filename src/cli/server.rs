//! Which service a command speaks to.

use std::path::PathBuf;

use clap::Args;

use super::Failure;
use crate::client::{ClientTls, Connection, Trust};

/// Where the service is.
#[derive(Debug, Clone, Args)]
pub(super) struct Server {
    /// Address of the service; https://HOST:PORT for TLS
    #[arg(long, value_name = "ADDRESS", env = "NUDGE_SERVER", default_value = "http://127.0.0.1:8080")]
    server: String,
    #[command(flatten)]
    tls: Tls,
}

/// TLS towards the service. The private key is `--cert-key`, for `--key` names a state.
#[derive(Debug, Clone, Args)]
pub(super) struct Tls {
    /// Certificates of the authorities that are trusted instead of this machine's, in PEM
    #[arg(long, value_name = "FILE", env = "NUDGE_CA")]
    ca: Option<PathBuf>,
    /// Certificate of this client in PEM, for services that want one
    #[arg(long, value_name = "FILE", env = "NUDGE_CERT")]
    cert: Option<PathBuf>,
    /// Private key of --cert, in PEM and not encrypted
    #[arg(long, value_name = "FILE", env = "NUDGE_CERT_KEY")]
    cert_key: Option<PathBuf>,
}

impl Tls {
    /// Returns what the client does about TLS.
    pub(super) fn client(&self) -> Result<ClientTls, Failure> {
        let identity = match (&self.cert, &self.cert_key) {
            (Some(certificate), Some(key)) => Some((certificate.clone(), key.clone())),
            (None, None) => None,
            (Some(_), None) => return Err(lonely("--cert (NUDGE_CERT)", "--cert-key (NUDGE_CERT_KEY)")),
            (None, Some(_)) => return Err(lonely("--cert-key (NUDGE_CERT_KEY)", "--cert (NUDGE_CERT)")),
        };
        let trust = self.ca.clone().map_or(Trust::System, Trust::Authorities);
        Ok(ClientTls { trust, identity })
    }
}

fn lonely(given: &str, missing: &str) -> Failure {
    Failure::usage(format!("{given} is given without {missing}: a client needs a certificate and its private key"))
}

impl Server {
    /// Connects, or says what to do.
    pub(super) async fn connect(&self) -> Result<Connection, Failure> {
        Ok(Connection::open_with(&self.server, &self.tls.client()?).await?)
    }
}
