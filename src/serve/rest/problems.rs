//! Problem details (RFC 9457) for every error: what handlers refuse, what the HTTP machinery
//! refuses, and panics.

use std::any::Any;
use std::sync::Arc;

use axum::body::Body;
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodRouter, any};
use http::{StatusCode, header};

use super::nearest;
use crate::serve::requests;
use crate::serve::status::{self, Failure};

/// How a face tells a failure of the request of that path.
pub type Form = fn(&Failure, &str) -> Response;

/// Returns what answers for every path that is not served, callers of gRPC as they expect it. Of
/// those that are served, as templates, it tells which may have been meant.
pub fn unknown_path(served: impl IntoIterator<Item = String>) -> MethodRouter {
    let served: Arc<[String]> = served.into_iter().collect();
    any(move |request: Request| unknown(request, served))
}

async fn unknown(request: Request, served: Arc<[String]>) -> Response {
    let media = request.headers().get(header::CONTENT_TYPE);
    match media.filter(|_| requests::is_grpc(request.headers())) {
        Some(media) => {
            let refused = status::unknown_call();
            requests::note(&request, refused.code());
            (
                [(header::CONTENT_TYPE, media.clone())],
                refused.into_http::<Body>(),
            )
                .into_response()
        }
        None => Failure::of_path(&nearest::hint(request.uri().path(), &served)).into_response(),
    }
}

/// Answers for a handler that panicked, and writes the cause to the log.
pub fn of_panic(cause: Box<dyn Any + Send>) -> Response {
    log_panic(&*cause);
    Failure::of_http(StatusCode::INTERNAL_SERVER_ERROR).into_response()
}

/// Writes to the log why a handler panicked.
pub fn log_panic(cause: &(dyn Any + Send)) {
    let text = cause
        .downcast_ref::<String>()
        .map(String::as_str)
        .or(cause.downcast_ref::<&str>().copied());
    tracing::error!(
        cause = text.unwrap_or("unknown"),
        "a request handler panicked"
    );
}

/// Gives every error answer the body that its face tells.
pub async fn tell(State(form): State<Form>, request: Request, next: Next) -> Response {
    let uri = request.uri().clone();
    let response = next.run(request).await;
    let status = response.status();
    match status.is_client_error() || status.is_server_error() {
        true => in_form(response, form, uri.path()),
        false => response,
    }
}

/// Returns an error answer with the body of its face.
fn in_form(response: Response, form: Form, path: &str) -> Response {
    let (mut parts, _) = response.into_parts();
    let failure = parts
        .extensions
        .remove::<Failure>()
        .unwrap_or_else(|| Failure::of_http(parts.status));
    let mut told = form(&failure, path);
    // Keeps headers such as Allow, and drops those that described the old body.
    for name in [
        header::CONTENT_TYPE,
        header::CONTENT_LENGTH,
        header::CONTENT_ENCODING,
    ] {
        parts.headers.remove(name);
    }

    told.headers_mut().extend(parts.headers);
    told
}
