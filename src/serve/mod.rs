//! Everything on a listening socket: REST, gRPC, gRPC-Web, the inference protocol and operations on one port.
//!
//! Handlers decode, ask a room of [`App`], and encode. An `if` about the problem rather than the protocol belongs further in.

use std::net::IpAddr;
use std::time::Duration;

use axum::{Router, middleware};
use tower_http::catch_panic::CatchPanicLayer;

use self::access::{Guard, Keyring};
use self::connections::limits::Limits;
use self::tls::Socket;
use crate::app::App;
use crate::store::Stage;

pub mod access;
pub mod connections;
pub mod listen;
pub mod tls;

mod cors;
mod doors;
mod figures;
mod grpc;
mod inference;
mod operations;
mod requests;
mod rest;
mod status;

pub use doors::Doors;

/// How long a call may take, unless its caller says otherwise (gRPC's `grpc-timeout`). Streams take as long as they want.
const ALLOWED: Duration = Duration::from_secs(30);

/// About what is told of a state, in bytes.
const STATE_BYTES: usize = 1_024;

/// What may be set about the faces.
#[derive(Debug, Clone, Default)]
pub struct Settings {
    /// The origins whose pages may call from a browser, `https://example.org`; `*` for any. None by default.
    pub cors_origins: Vec<String>,
    /// Who is let in; everybody where it is absent.
    pub keys: Option<Keyring>,
    /// The address that is listened on.
    pub listen: Option<IpAddr>,
    /// Names, beside loopback names and the address that is listened on, by which the service may be asked for: `nudge.example.org`, `*.example.org`.
    pub hosts: Vec<String>,
    /// What connections may take.
    pub limits: Limits,
}

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

/// Returns every route of every face.
async fn router(app: App, settings: &Settings) -> Result<Router, tonic_reflection::server::Error> {
    // Without this an unknown REST path would answer 200 with a gRPC status.
    let grpc = grpc::routes(app.clone()).await?.into_axum_router().reset_fallback();
    let grpc = grpc.layer(CatchPanicLayer::custom(grpc::of_panic)).layer(middleware::from_fn(grpc::in_time));
    let grpc = grpc.layer(middleware::from_fn(grpc::give_reasons)).layer(middleware::from_fn(requests::note_code));
    let grpc = grpc.layer(tonic_web::GrpcWebLayer::new());
    let router =
        rest::router(app.clone()).merge(inference::router(app.clone())).merge(operations::router(app)).merge(grpc);
    requests::expect(rest::documented());
    let guard = Guard::new(settings);
    let router = router.layer(middleware::from_fn_with_state(guard, access::admit));
    Ok(cors::allow(router, &settings.cors_origins).layer(middleware::from_fn(requests::note_route)))
}
