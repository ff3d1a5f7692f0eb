//! The one place that knows status codes: kinds of error beside their HTTP and gRPC codes.

use std::time::Duration;

use axum::Extension;
use axum::response::{IntoResponse, Response};
use http::{StatusCode, header};
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::api::json;
use crate::error::{ErrorKind, Problem};

/// Returns the HTTP and the gRPC code of a kind.
pub fn codes(kind: ErrorKind) -> (StatusCode, Code) {
    match kind {
        ErrorKind::Invalid => (StatusCode::BAD_REQUEST, Code::InvalidArgument),
        ErrorKind::NotFound => (StatusCode::NOT_FOUND, Code::NotFound),
        ErrorKind::Conflict => (StatusCode::CONFLICT, Code::FailedPrecondition),
        ErrorKind::AlreadyExists => (StatusCode::CONFLICT, Code::AlreadyExists),
        ErrorKind::OutOfOrder => (StatusCode::CONFLICT, Code::FailedPrecondition),
        ErrorKind::TooLarge => (StatusCode::PAYLOAD_TOO_LARGE, Code::OutOfRange),
        ErrorKind::Quota => (StatusCode::TOO_MANY_REQUESTS, Code::ResourceExhausted),
        ErrorKind::Overloaded | ErrorKind::Unavailable => (StatusCode::SERVICE_UNAVAILABLE, Code::Unavailable),
        ErrorKind::Deadline => (StatusCode::SERVICE_UNAVAILABLE, Code::DeadlineExceeded),
        ErrorKind::Internal => (StatusCode::INTERNAL_SERVER_ERROR, Code::Internal),
    }
}

/// Tells a problem as a gRPC status with `google.rpc` details: the reason always, field violations for input, when to retry where it helps.
pub fn grpc(problem: Problem) -> Status {
    let (_, code) = codes(problem.kind);
    let metadata: std::collections::HashMap<_, _> =
        problem.details.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    let mut details = ErrorDetails::with_error_info(problem.reason, "nudge", metadata);
    for fault in &problem.faults {
        details.add_bad_request_violation(&fault.pointer, &fault.detail);
    }
    if problem.retry_after.is_some() {
        details.set_retry_info(problem.retry_after);
    }
    Status::with_error_details(code, problem.message, details)
}

/// What was asked for, where it matters whether it may have been done although nobody was told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asked {
    /// To be told something: nothing is changed by it.
    Question,
    /// To count a batch, which counts once however often it is sent.
    Batch,
    /// To change something else.
    Change,
}

/// Says that there was no answer in time, and what helps.
pub fn too_late(asked: Asked, allowed: Duration) -> Problem {
    let help = match asked {
        Asked::Question => "ask for less at a time",
        Asked::Batch => "it may have been counted; send it again, it counts once",
        Asked::Change => "it may have been done; look before you send it again",
    };
    let message = format!("no answer within {} seconds: {help}", allowed.as_secs_f64());
    let problem = Problem::new(ErrorKind::Deadline, "TIMEOUT", message);
    if asked == Asked::Batch { problem.retry_after(RETRY_BATCH) } else { problem }
}

/// After how long a batch that was not answered is sent again.
const RETRY_BATCH: Duration = Duration::from_secs(1);

const TOO_LARGE: &str = "BODY_TOO_LARGE";

/// Makes the problem of a body that has more than so many bytes.
pub fn body_too_large(most: usize) -> Problem {
    let message = format!("the body is larger than {} MiB; send less at a time", most >> 20);
    Problem::new(ErrorKind::TooLarge, TOO_LARGE, message).with("limit_bytes", most)
}

/// A problem under its HTTP status. As a response it is only a note, which [`Failure::tell`] turns into a body once the request's path is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    status: StatusCode,
    problem: Problem,
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        Self { status: codes(problem.kind).0, problem }
    }
}

impl Failure {
    /// Makes the failure of a request that no room of ours refused, but the HTTP machinery did.
    pub fn of_http(status: StatusCode) -> Self {
        let (kind, reason, message) = match status {
            StatusCode::NOT_FOUND => (ErrorKind::NotFound, "PATH_NOT_FOUND", "nothing is served under this path"),
            StatusCode::METHOD_NOT_ALLOWED => {
                (ErrorKind::Invalid, "METHOD_NOT_ALLOWED", "this path does not take this method")
            }
            StatusCode::PAYLOAD_TOO_LARGE => {
                (ErrorKind::TooLarge, TOO_LARGE, "the body is larger than 16 MiB; send less at a time")
            }
            StatusCode::UNSUPPORTED_MEDIA_TYPE => (
                ErrorKind::Invalid,
                "UNSUPPORTED_MEDIA_TYPE",
                "the body is of a type or an encoding that this path does not take",
            ),
            StatusCode::SERVICE_UNAVAILABLE => (ErrorKind::Unavailable, "UNAVAILABLE", "the service cannot answer now"),
            status if status.is_server_error() => {
                (ErrorKind::Internal, "INTERNAL", "the service failed; the cause is in its log")
            }
            _ => (ErrorKind::Invalid, "BAD_REQUEST", "the request could not be read"),
        };
        Self { status, problem: Problem::new(kind, reason, message) }
    }

    /// Makes the failure of a body that has more than so many bytes, as it was sent or unpacked.
    pub fn of_size(most: usize) -> Self {
        body_too_large(most).into()
    }

    /// Makes the failure of a body in an encoding that is not read.
    pub fn of_encoding(found: &str) -> Self {
        let mut failure = Self::of_http(StatusCode::UNSUPPORTED_MEDIA_TYPE);
        failure.problem.message = format!("got content encoding {found:?}, expected gzip, deflate or identity");
        failure
    }

    /// Makes the failure of a body whose type is not one of `expected`.
    pub fn of_media_type(found: &str, expected: &str) -> Self {
        let mut failure = Self::of_http(StatusCode::UNSUPPORTED_MEDIA_TYPE);
        failure.problem.message = format!("got content type {found:?}, expected {expected}");
        failure
    }

    /// Makes the failure of a request for an answer of none of the types that there are.
    pub fn of_accept(found: &str, expected: &str) -> Self {
        let message = format!("got accept {found:?}, expected {expected}");
        let problem = Problem::new(ErrorKind::Invalid, "NOT_ACCEPTABLE", message);
        Self { status: StatusCode::NOT_ACCEPTABLE, problem }
    }

    /// Tells the failure of the request of that path as `application/problem+json`, and when to retry where it helps.
    pub fn tell(&self, instance: &str) -> Response {
        let body = json::Problem::new(&self.problem, self.status.as_u16(), instance);
        self.response("application/problem+json", axum::Json(body))
    }

    /// Tells the failure as `{"error": text}`, as the Open Inference Protocol wants it.
    pub fn tell_text(&self, _: &str) -> Response {
        self.response("application/json", axum::Json(serde_json::json!({ "error": self.problem.message })))
    }

    fn response(&self, content_type: &'static str, body: impl IntoResponse) -> Response {
        let mut response = (self.status, [(header::CONTENT_TYPE, content_type)], body).into_response();
        if let Some(wait) = self.problem.retry_after {
            response.headers_mut().insert(header::RETRY_AFTER, wait.as_secs().into());
        }
        response
    }
}

impl IntoResponse for Failure {
    fn into_response(self) -> Response {
        (self.status, Extension(self)).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_retry_is_advised_where_it_helps() {
        let overloaded = Failure::from(Problem::new(ErrorKind::Overloaded, "OVERLOADED", "too much waits"));
        let response = overloaded.tell("/v1/x");
        assert_eq!(response.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(response.headers()[header::RETRY_AFTER], "1");
        assert_eq!(response.headers()[header::CONTENT_TYPE], "application/problem+json");
        let invalid = Failure::from(Problem::invalid("question", Vec::new())).tell("/v1/x");
        assert!(!invalid.headers().contains_key(header::RETRY_AFTER));
    }

    #[test]
    fn every_refusal_keeps_its_status() {
        for code in [400, 404, 405, 408, 413, 414, 415, 431, 500, 502, 503] {
            let status = StatusCode::from_u16(code).expect("a status");
            assert_eq!(Failure::of_http(status).tell("/").status(), status);
        }
    }
}
