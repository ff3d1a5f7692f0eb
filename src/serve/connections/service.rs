//! What stands between a connection and the routes: it notes when requests begin and end, and watches their bodies.

use std::convert::Infallible;
use std::net::IpAddr;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use futures::FutureExt;
use futures::future::BoxFuture;
use http::request::Parts;
use http::{Request, Response, header};
use hyper::body::Incoming;
use tower::ServiceExt;
use tracing::Instrument;

use super::Leaving;
use super::crowd::Standing;
use super::framing::Framing;
use super::memory::{Budget, Charge};
use super::received::{Form, Manner, Received};
use super::sent::Sent;
use super::vitals::Vitals;
use crate::error::{ErrorKind, Problem};
use crate::serve::operations;
use crate::serve::requests::{Call, is_grpc};
use crate::serve::status::{self, Failure};
use crate::telemetry;

/// Calls whose sender goes on for as long as it likes.
const STREAMS: [&str; 3] = [
    "/nudge.v1.IngestService/Ingest",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
];

/// The routes, for one connection.
pub struct Watched {
    /// What is served.
    pub router: Router,
    /// The connection.
    pub vitals: Arc<Vitals>,
    /// What it may do.
    pub standing: Standing,
    /// Where the bytes of its messages come from.
    pub budget: Arc<Budget>,
    /// From where it comes.
    pub peer: Option<IpAddr>,
}

impl hyper::service::Service<Request<Incoming>> for Watched {
    type Response = Response<Sent>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Response<Sent>, Infallible>>;

    fn call(&self, request: Request<Incoming>) -> Self::Future {
        let progress = Arc::new(self.vitals.begin(request.version()));
        let charge = Arc::new(Charge::new(self.budget.clone()));
        let (mut parts, body) = request.into_parts();
        let mut call = Call::begin(&mut parts, self.peer);
        let body = Received::new(body, manner(&parts), charge.clone(), progress.clone());
        if self.standing == Standing::Guest {
            self.vitals.leaving.cancel();
            if !operations::is_asked(parts.uri.path()) {
                let refusal = call.answered(too_many(&parts)).map(|body| Sent::new(body, progress, call));
                return async { Ok(refusal) }.boxed();
            }
        }
        parts.extensions.insert(charge.clone());
        parts.extensions.insert(Leaving(self.vitals.leaving.clone()));
        let answer = self.router.clone().oneshot(Request::from_parts(parts, body));
        let span = call.span();
        let answer = async move {
            let Ok(response) = answer.await;
            // What was asked is in other hands now, or done with.
            charge.release();
            Ok(call.answered(response).map(|body| Sent::new(body, progress, call)))
        };
        answer.instrument(span).boxed()
    }
}

fn manner(parts: &Parts) -> Manner {
    let media = parts.headers.get(header::CONTENT_TYPE).map_or(&[][..], |media| media.as_bytes());
    let is_web = media.starts_with(b"application/grpc-web");
    let path = parts.uri.path();
    let form = match path {
        _ if path.starts_with("/v1/") || path.starts_with("/v2/") => Form::Document,
        _ if STREAMS.contains(&path) && !is_web => Form::Messages(Framing::default()),
        _ => Form::Message,
    };
    Manner { form, is_grpc: is_grpc(&parts.headers), is_announced: parts.headers.contains_key(header::EXPECT) }
}

/// Answers a guest who asks what only residents may ask.
fn too_many(parts: &Parts) -> Response<Body> {
    telemetry::shed("TOO_MANY_CONNECTIONS");
    let message = "there are as many connections as the service takes, and all are busy; try again";
    let problem = Problem::new(ErrorKind::Overloaded, "TOO_MANY_CONNECTIONS", message);
    match is_grpc(&parts.headers) {
        true => status::grpc(problem).into_http(),
        false => Failure::from(problem).tell(parts.uri.path()),
    }
}
