//! Which service a command speaks to.

use std::convert::Infallible;
use std::fmt;
use std::path::PathBuf;

use clap::Args;

use super::Failure;
use crate::client::{Connection, Options, Secret};

/// Where the service is.
#[derive(Debug, Clone, Args)]
pub(super) struct Server {
    /// Address of the service
    #[arg(long, value_name = "ADDRESS", env = "NUDGE_SERVER", default_value = "http://127.0.0.1:8080")]
    server: String,
    /// The key to ask with. Prefer the variable or the file: others on this machine see the arguments of its processes
    #[arg(long, value_name = "KEY", env = "NUDGE_KEY", hide_env_values = true, value_parser = given)]
    api_key: Option<Given>,
    /// A file with the key to ask with
    #[arg(long, value_name = "FILE", env = "NUDGE_KEY_FILE", conflicts_with = "api_key")]
    api_key_file: Option<PathBuf>,
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

impl Server {
    /// Connects, or says what to do.
    pub(super) async fn connect(&self) -> Result<Connection, Failure> {
        let options = self.key()?.map_or_else(Options::default, |key| Options::default().key(key));
        Ok(Connection::open_with(&self.server, &options).await?)
    }

    fn key(&self) -> Result<Option<Secret>, Failure> {
        let key = |text: &str, from: &str| {
            text.trim().parse().map(Some).map_err(|why| Failure::usage(format!("{from}: {why}")))
        };
        match (&self.api_key, &self.api_key_file) {
            (Some(Given(text)), _) => key(text, "--api-key or NUDGE_KEY"),
            (None, Some(path)) => {
                let text = std::fs::read_to_string(path);
                let text = text
                    .map_err(|error| Failure::usage(format!("cannot read the key in {}: {error}", path.display())))?;
                key(&text, &path.display().to_string())
            }
            (None, None) => Ok(None),
        }
    }
}
