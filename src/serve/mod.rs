//! Everything on a listening socket: REST, gRPC, gRPC-Web, the inference protocol and operations on
//! one port.
//!
//! Handlers decode, ask a room of [`App`], and encode. An `if` about the problem rather than the
//! protocol belongs further in.

use self::tls::Socket;
use crate::app::App;
use crate::store::Stage;

pub mod access;
pub mod connections;
pub mod listen;
pub mod tls;

mod cors;
mod costs;
mod doors;
mod figures;
mod grpc;
mod inference;
mod operations;
mod requests;
mod rest;
mod routes;
mod settings;
mod status;

pub use doors::Doors;
pub use settings::Settings;

/// Serves an app on a socket until it drains and its connections have ended.
pub async fn serve(
    app: App,
    socket: impl Into<Socket>,
    settings: Settings,
) -> Result<(), tonic_reflection::server::Error> {
    let doors = Doors::closed(Stage::default());
    doors.open(app.clone(), &settings).await?;
    doors.serve(socket, app.draining, settings.limits).await;
    Ok(())
}
