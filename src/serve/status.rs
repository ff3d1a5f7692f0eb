//! The one place that knows status codes: kinds of error beside their HTTP and gRPC codes.

use http::StatusCode;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::error::{ErrorKind, Problem};

/// How long a caller should wait before it tries again.
pub const RETRY_AFTER: std::time::Duration = std::time::Duration::from_secs(1);

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
    if problem.kind.is_retryable() {
        details.set_retry_info(Some(RETRY_AFTER));
    }
    Status::with_error_details(code, problem.message, details)
}
