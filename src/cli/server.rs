//! The connection options of a command: which service it speaks to.

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;

use clap::Args;

use super::Failure;
use crate::access::read_text;
use crate::client::{ClientTls, Connection, Options, Secret, Trust};

/// Where the service is.
#[derive(Debug, Clone, Args)]
pub(super) struct Server {
    /// Address of the service; https://HOST:PORT for TLS
    #[arg(
        long,
        value_name = "ADDRESS",
        env = "NUDGE_SERVER",
        default_value = "http://127.0.0.1:8080"
    )]
    server: String,
    /// The key to ask with. Prefer the variable or the file: others on this machine see the
    /// arguments of its processes
    #[arg(long, value_name = "KEY", env = "NUDGE_KEY", hide_env_values = true, value_parser = given)]
    api_key: Option<Given>,
    /// A file with the key to ask with
    #[arg(
        long,
        value_name = "FILE",
        env = "NUDGE_KEY_FILE",
        conflicts_with = "api_key"
    )]
    api_key_file: Option<PathBuf>,
    #[command(flatten)]
    tls: Tls,
}

/// A key as it was given. It is looked at later: clap would show what it refuses.
#[derive(Clone)]
struct Given(String);

impl fmt::Debug for Given {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Given(..)")
    }
}

fn given(text: &str) -> Result<Given, Infallible> {
    Ok(Given(text.to_owned()))
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
            (Some(_), None) => {
                return Err(lonely("--cert (NUDGE_CERT)", "--cert-key (NUDGE_CERT_KEY)"));
            }
            (None, Some(_)) => {
                return Err(lonely("--cert-key (NUDGE_CERT_KEY)", "--cert (NUDGE_CERT)"));
            }
        };
        let trust = self.ca.clone().map_or(Trust::System, Trust::Authorities);
        Ok(ClientTls { trust, identity })
    }
}

fn lonely(given: &str, missing: &str) -> Failure {
    Failure::usage(format!(
        "{given} is given without {missing}: a client needs a certificate and its private key"
    ))
}

impl Server {
    /// Connects, or says what to do.
    pub(super) async fn connect(&self) -> Result<Connection, Failure> {
        let options = Options {
            key: self.key()?,
            tls: self.tls.client()?,
        };
        Ok(Connection::open_with(&self.server, &options).await?)
    }

    fn key(&self) -> Result<Option<Secret>, Failure> {
        match (&self.api_key, &self.api_key_file) {
            (Some(Given(text)), _) => parse_key(text, "--api-key or NUDGE_KEY"),
            (None, Some(path)) => {
                let text = read_text(path);
                let text = text.map_err(|why| {
                    Failure::usage(format!("cannot read the key in {}: {why}", path.display()))
                })?;
                parse_key(&text, &path.display().to_string())
            }
            (None, None) => Ok(None),
        }
    }
}

fn parse_key(text: &str, from: &str) -> Result<Option<Secret>, Failure> {
    text.trim()
        .parse()
        .map(Some)
        .map_err(|why| Failure::usage(format!("{from}: {why}")))
}
