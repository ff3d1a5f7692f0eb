//! Which service a command speaks to.

use clap::Args;

use super::Failure;
use crate::client::Connection;

/// Where the service is.
#[derive(Debug, Clone, Args)]
pub(super) struct Server {
    /// Address of the service
    #[arg(long, value_name = "ADDRESS", env = "NUDGE_SERVER", default_value = "http://127.0.0.1:8080")]
    server: String,
}

impl Server {
    /// Connects, or says what to do.
    pub(super) async fn connect(&self) -> Result<Connection, Failure> {
        Ok(Connection::open(&self.server).await?)
    }
}
