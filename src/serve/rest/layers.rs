//! What is done for every request: an id, a trace, limits, compression, and errors in the form of their face.
//!
//! On the REST routes only: a timeout or a body limit would end the streams of the gRPC face.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use axum::Router;
use axum::extract::{DefaultBodyLimit, MatchedPath, Request};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use http::{HeaderName, HeaderValue, Method};
use tower::ServiceBuilder;
use tower_http::CompressionLevel;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{NotForContentType, Predicate, SizeAbove};
use tower_http::limit::RequestBodyLimitLayer;
use tower_http::request_id::{MakeRequestId, PropagateRequestIdLayer, RequestId, SetRequestIdLayer};
use tower_http::trace::{DefaultOnResponse, TraceLayer};
use tracing::{Level, Span};

use super::problems;
use crate::serve::ALLOWED;
use crate::serve::status::{Asked, Failure, too_late};
use crate::telemetry;
use crate::work::deadline::{self, Deadline};

/// The largest body, in bytes: told in words in `status.rs`.
pub const MOST_BODY_BYTES: usize = 16 << 20;
/// An answer for one state is smaller, and sooner sent than compressed.
const LEAST_COMPRESSED_BYTES: u64 = 1_024;
const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// Puts the layers around the routes and the fallback of a router, whose errors are told in that form.
pub fn around(router: Router, form: problems::Form) -> Router {
    let compressible = SizeAbove::new(LEAST_COMPRESSED_BYTES).and(NotForContentType::IMAGES);
    // The first is outermost.
    let layers = ServiceBuilder::new()
        .layer(SetRequestIdLayer::new(REQUEST_ID, Numbered::default()))
        .layer(
            TraceLayer::new_for_http()
                .make_span_with(span)
                .on_request(())
                .on_response(DefaultOnResponse::new().level(Level::DEBUG))
                .on_failure(()),
        )
        .layer(PropagateRequestIdLayer::new(REQUEST_ID))
        .layer(CompressionLayer::new().quality(CompressionLevel::Fastest).compress_when(compressible))
        .layer(middleware::from_fn_with_state(form, problems::tell))
        .layer(CatchPanicLayer::custom(problems::of_panic))
        .layer(middleware::from_fn(in_time))
        .layer(RequestBodyLimitLayer::new(MOST_BODY_BYTES))
        .layer(DefaultBodyLimit::disable());
    router.layer(layers)
}

/// Answers each request within its time, or says that there was none: what it began is dropped.
async fn in_time(request: Request, next: middleware::Next) -> Response {
    let asked = asked(request.method(), request.uri().path());
    let answer = deadline::within(Deadline::after(ALLOWED), next.run(request)).await;
    answer.unwrap_or_else(|| Failure::from(too_late(asked, ALLOWED)).into_response())
}

/// Returns what a request asks for.
fn asked(method: &Method, path: &str) -> Asked {
    let last = path.rsplit('/').next().unwrap_or_default();
    match (method, last) {
        (&Method::GET | &Method::HEAD | &Method::OPTIONS, _) => Asked::Question,
        (&Method::POST, "influence" | "infer" | "fit") => Asked::Question,
        (&Method::POST, "transitions") => Asked::Batch,
        _ => Asked::Change,
    }
}

/// Records each request under its route, which is one of few, unlike its path.
pub async fn measure(request: Request, next: middleware::Next) -> Response {
    let started = Instant::now();
    let matched = request.extensions().get::<MatchedPath>();
    let route =
        matched.map_or_else(|| "unmatched".to_owned(), |path| format!("{} {}", request.method(), path.as_str()));
    let response = next.run(request).await;
    telemetry::request("rest", route, response.status().as_u16().to_string(), started.elapsed());
    response
}

fn span<B>(request: &http::Request<B>) -> Span {
    let id = request.headers().get(REQUEST_ID).and_then(|id| id.to_str().ok());
    tracing::debug_span!("request", method = %request.method(), path = request.uri().path(), id)
}

/// Numbers requests under a random beginning, which is cheaper than a random number for each.
#[derive(Clone)]
struct Numbered {
    run: Arc<str>,
    next: Arc<AtomicU64>,
}

impl Default for Numbered {
    fn default() -> Self {
        let run = uuid::Uuid::new_v4().simple().to_string();
        Self { run: run[..16].into(), next: Arc::default() }
    }
}

impl MakeRequestId for Numbered {
    fn make_request_id<B>(&mut self, _: &http::Request<B>) -> Option<RequestId> {
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        HeaderValue::try_from(format!("{}-{number:x}", self.run)).ok().map(RequestId::new)
    }
}

#[cfg(test)]
mod tests;
