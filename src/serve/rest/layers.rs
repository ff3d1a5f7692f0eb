//! Middleware of REST, done for every request: limits, compression, and errors in the form of their
//! face. Its id, its trace and its figures are in `serve::requests`.
//!
//! On the REST routes only: a timeout or a body limit would end the streams of the gRPC face.

use axum::Router;
use axum::extract::{DefaultBodyLimit, Request};
use axum::middleware;
use axum::response::{IntoResponse, Response};
use http::Method;
use tower::ServiceBuilder;
use tower_http::CompressionLevel;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::compression::predicate::{NotForContentType, Predicate, SizeAbove};
use tower_http::limit::RequestBodyLimitLayer;

use super::{accept, problems};
use crate::serve::costs::ALLOWED;
use crate::serve::status::{Asked, Failure, too_late};
use crate::work::deadline::{self, Deadline};

/// The largest body, in bytes: told in words in `status.rs`.
pub const MOST_BODY_BYTES: usize = 16 << 20;
/// An answer for one state is smaller, and sooner sent than compressed.
const LEAST_COMPRESSED_BYTES: u64 = 1_024;

/// Puts the layers around the routes and the fallback of a router, whose errors are told in that
/// form.
pub fn around(router: Router, form: problems::Form) -> Router {
    let compressible = SizeAbove::new(LEAST_COMPRESSED_BYTES).and(NotForContentType::IMAGES);
    // The first is outermost.
    let layers = ServiceBuilder::new()
        .map_request(accept::any_encoding)
        .layer(
            CompressionLayer::new()
                .quality(CompressionLevel::Fastest)
                .compress_when(compressible),
        )
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

#[cfg(test)]
mod tests;
