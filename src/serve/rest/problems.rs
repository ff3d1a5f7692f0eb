//! Every error is a problem: what handlers refuse, what the HTTP machinery refuses, and panics.

use std::any::Any;

use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http::{HeaderValue, StatusCode, header};

use crate::serve::status::Failure;

/// How a face tells a failure of the request of that path.
pub type Form = fn(&Failure, &str) -> Response;

/// Answers for every path that is not served.
pub async fn unknown_path() -> Failure {
    Failure::of_http(StatusCode::NOT_FOUND)
}

/// Answers for a handler that panicked, and writes the cause to the log.
pub fn of_panic(cause: Box<dyn Any + Send>) -> Response {
    log_panic(&*cause);
    Failure::of_http(StatusCode::INTERNAL_SERVER_ERROR).into_response()
}

/// Writes to the log why a handler panicked.
pub fn log_panic(cause: &(dyn Any + Send)) {
    let text = cause.downcast_ref::<String>().map(String::as_str).or(cause.downcast_ref::<&str>().copied());
    tracing::error!(cause = text.unwrap_or("unknown"), "a request handler panicked");
}

/// Gives every error answer the body that its face tells.
pub async fn tell(State(form): State<Form>, request: Request, next: Next) -> Response {
    let uri = request.uri().clone();
    let encoding = request.headers().get(header::CONTENT_ENCODING).cloned();
    let response = next.run(request).await;
    let status = response.status();
    match status.is_client_error() || status.is_server_error() {
        true => told(response, form, uri.path(), encoding.as_ref()),
        false => response,
    }
}

fn told(response: Response, form: Form, path: &str, encoding: Option<&HeaderValue>) -> Response {
    let (mut parts, _) = response.into_parts();
    let failure = parts.extensions.remove::<Failure>().unwrap_or_else(|| match (parts.status, encoding) {
        (StatusCode::UNSUPPORTED_MEDIA_TYPE, Some(found)) => {
            Failure::of_encoding(&String::from_utf8_lossy(found.as_bytes()))
        }
        (status, _) => Failure::of_http(status),
    });
    let mut told = form(&failure, path);
    // Keeps headers such as Allow, and drops those that described the old body.
    for name in [header::CONTENT_TYPE, header::CONTENT_LENGTH, header::CONTENT_ENCODING] {
        parts.headers.remove(name);
    }
    told.headers_mut().extend(parts.headers);
    told
}
