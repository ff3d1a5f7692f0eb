//! Liveness and readiness while the service starts: until the database is open the socket says that
//! it is alive, not ready, and why.

use std::convert::Infallible;
use std::sync::{Arc, OnceLock};

use axum::Router;
use axum::extract::{Request, State};
use axum::response::{IntoResponse, Response};
use http::StatusCode;
use serde_json::json;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::connections::limits::Limits;
use super::requests::{self, is_grpc};
use super::settings::{Endpoint, Settings};
use super::status::{self, Failure};
use super::tls::Socket;
use super::{listen, operations, routes};
use crate::app::App;
use crate::error::{ErrorKind, Problem};
use crate::store::Stage;
use crate::telemetry;

/// A listening service that may not be open yet. Cloning is cheap.
#[derive(Clone)]
pub struct Doors {
    stage: Stage,
    open: Arc<OnceLock<Router>>,
}

impl Doors {
    /// Makes a service that is closed, and tells by that stage how far its database is.
    pub fn closed(stage: Stage) -> Self {
        // Before the first request, so that the first of each kind is seen as a change.
        telemetry::begin();
        Self {
            stage,
            open: Arc::default(),
        }
    }

    /// Lets everybody in to an app.
    pub async fn open(
        &self,
        app: App,
        settings: &Settings,
        endpoint: &Endpoint,
    ) -> Result<(), tonic_reflection::server::Error> {
        let router = routes::router(app, settings, endpoint).await?;
        // A service is opened once.
        let _ = self.open.set(router);
        Ok(())
    }

    /// Serves connections until it drains and they have ended.
    pub async fn serve(self, socket: Socket, draining: CancellationToken, limits: Limits) {
        let router = Router::new().fallback(enter).with_state(self);
        listen::accept(socket, router, draining, limits).await;
    }

    fn refuse(&self, request: &Request) -> Response {
        requests::note_closed(request);
        let path = request.uri().path();
        let stage = self.stage.in_words();
        let problem = || {
            Problem::new(
                ErrorKind::Unavailable,
                "NOT_READY",
                format!("not ready: database: {stage}"),
            )
        };

        match path {
            "/livez" => operations::ALIVE.into_response(),
            "/v2/health/live" => axum::Json(json!({ "live": true })).into_response(),
            "/readyz" if operations::is_verbose(request.uri().query()) => {
                let checks = json!({ "database": stage });
                let body = json!({ "ready": false, "checks": checks, "background": "idle" });
                (StatusCode::SERVICE_UNAVAILABLE, axum::Json(body)).into_response()
            }
            "/readyz" => (
                StatusCode::SERVICE_UNAVAILABLE,
                format!("not ready: {stage}\n"),
            )
                .into_response(),
            _ if is_grpc(request.headers()) => {
                status::grpc(problem()).into_http::<axum::body::Body>()
            }
            _ if path.starts_with("/v2") => Failure::from(problem()).tell_text(path),
            _ => Failure::from(problem()).tell(path),
        }
    }
}

async fn enter(State(doors): State<Doors>, request: Request) -> Response {
    let Some(router) = doors.open.get() else {
        return doors.refuse(&request);
    };
    router
        .clone()
        .oneshot(request)
        .await
        .unwrap_or_else(|never: Infallible| match never {})
}
