//! Cross-origin resource sharing (CORS): REST and gRPC-Web from the origins that are allowed, and
//! from no other.

use axum::Router;
use http::{HeaderName, HeaderValue, Method, header};
use tower_http::cors::{AllowOrigin, CorsLayer};

/// What the two faces send beside what every request may have, and what a page may read of the
/// answers.
const SENT: [HeaderName; 8] = [
    header::AUTHORIZATION,
    header::CONTENT_TYPE,
    HeaderName::from_static("x-request-id"),
    HeaderName::from_static("x-grpc-web"),
    HeaderName::from_static("x-user-agent"),
    HeaderName::from_static("grpc-timeout"),
    HeaderName::from_static("connect-protocol-version"),
    HeaderName::from_static("inference-header-content-length"),
];
const READ: [HeaderName; 7] = [
    header::WWW_AUTHENTICATE,
    header::RETRY_AFTER,
    HeaderName::from_static("x-request-id"),
    HeaderName::from_static("grpc-status"),
    HeaderName::from_static("grpc-message"),
    HeaderName::from_static("grpc-status-details-bin"),
    HeaderName::from_static("inference-header-content-length"),
];

/// Lets pages of these origins call every route; `*` stands for any origin, an empty list for none.
pub fn allow(router: Router, origins: &[String]) -> Router {
    if origins.is_empty() {
        return router;
    }

    let allowed = match origins.iter().any(|origin| origin == "*") {
        true => AllowOrigin::any(),
        false => AllowOrigin::list(origins.iter().filter_map(|origin| value(origin))),
    };
    let methods = [
        Method::GET,
        Method::PUT,
        Method::POST,
        Method::PATCH,
        Method::DELETE,
    ];

    let cors = CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods(methods);
    router.layer(cors.allow_headers(SENT).expose_headers(READ))
}

fn value(origin: &str) -> Option<HeaderValue> {
    let value = HeaderValue::from_str(origin);
    value
        .inspect_err(|_| tracing::warn!(origin, "an origin that cannot be a header is not allowed"))
        .ok()
}
