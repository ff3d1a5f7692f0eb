//! Status codes, which nothing else knows: kinds of error beside their HTTP and gRPC codes.

use std::collections::HashMap;
use std::time::Duration;

use axum::Extension;
use axum::response::{IntoResponse, Response};
use http::{HeaderValue, StatusCode, header};
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::api::json;
use crate::error::{ErrorKind, Fault, Problem};

/// Who says the reasons of errors.
const DOMAIN: &str = "nudge";

const PATH_NOT_FOUND: &str = "PATH_NOT_FOUND";
const UNSUPPORTED: &str = "UNSUPPORTED_MEDIA_TYPE";

/// Returns the HTTP and the gRPC code of a kind.
pub fn codes(kind: ErrorKind) -> (StatusCode, Code) {
    match kind {
        ErrorKind::Invalid => (StatusCode::BAD_REQUEST, Code::InvalidArgument),
        ErrorKind::Unauthenticated => (StatusCode::UNAUTHORIZED, Code::Unauthenticated),
        ErrorKind::Forbidden => (StatusCode::FORBIDDEN, Code::PermissionDenied),
        ErrorKind::NotFound => (StatusCode::NOT_FOUND, Code::NotFound),
        ErrorKind::Conflict => (StatusCode::CONFLICT, Code::FailedPrecondition),
        ErrorKind::AlreadyExists => (StatusCode::CONFLICT, Code::AlreadyExists),
        ErrorKind::OutOfOrder => (StatusCode::CONFLICT, Code::FailedPrecondition),
        ErrorKind::TooLarge => (StatusCode::PAYLOAD_TOO_LARGE, Code::OutOfRange),
        ErrorKind::Quota => (StatusCode::TOO_MANY_REQUESTS, Code::ResourceExhausted),
        ErrorKind::Overloaded | ErrorKind::Unavailable => {
            (StatusCode::SERVICE_UNAVAILABLE, Code::Unavailable)
        }
        ErrorKind::Deadline => (StatusCode::SERVICE_UNAVAILABLE, Code::DeadlineExceeded),
        ErrorKind::Internal => (StatusCode::INTERNAL_SERVER_ERROR, Code::Internal),
    }
}

/// The most faults that gRPC tells one by one. They travel in headers, of which clients take 8 KiB;
/// REST tells all of them.
const MOST_TOLD: usize = 10;

/// The most bytes of a message in a gRPC status, which is told twice: percent-encoded, where a byte
/// may become three, and in the details.
const MOST_MESSAGE: usize = 800;

/// The most bytes of a text in the details, and of all faults together; in base64 they are a third
/// more.
const MOST_TEXT: usize = 250;
const MOST_FAULTS: usize = 2_000;

/// Tells a problem as a gRPC status with `google.rpc` details: the reason always, field violations
/// for input, when to retry where it helps.
///
/// Of many faults the first are told, and `more_faults` beside the reason says how many there are
/// besides.
pub fn grpc(problem: Problem) -> Status {
    let (_, code) = codes(problem.kind);
    let told = field_violations(&problem.faults);
    let more = problem.faults.len() - told.len();
    let more = (more > 0).then(|| ("more_faults".to_owned(), more.to_string()));
    let given = problem
        .details
        .iter()
        .map(|(name, value)| ((*name).to_owned(), cut(value, MOST_TEXT)));

    let mut details = ErrorDetails::with_error_info(
        problem.reason,
        DOMAIN,
        given.chain(more).collect::<HashMap<_, _>>(),
    );
    for (pointer, detail) in told {
        details.add_bad_request_violation(pointer, detail);
    }
    if problem.retry_after.is_some() {
        details.set_retry_info(problem.retry_after);
    }
    Status::with_error_details(code, cut(&problem.message, MOST_MESSAGE), details)
}

/// Returns the pointers and details of the first faults, as many as fit into headers.
fn field_violations(faults: &[Fault]) -> Vec<(String, String)> {
    let mut left = MOST_FAULTS;
    let first = faults.iter().take(MOST_TOLD).map(|fault| {
        (
            cut(&fault.pointer, MOST_TEXT),
            cut(&fault.detail, MOST_TEXT),
        )
    });

    let fits = |(pointer, detail): &(String, String)| {
        let rest = left.checked_sub(pointer.len() + detail.len());
        left = rest.unwrap_or_default();
        rest.is_some()
    };

    first.take_while(fits).collect()
}

/// Returns the beginning of a text that is longer than so many bytes, and says that there is more.
fn cut(text: &str, most: usize) -> String {
    const MORE: &str = "...";
    if text.len() <= most {
        return text.to_owned();
    }
    format!(
        "{}{MORE}",
        &text[..text.floor_char_boundary(most - MORE.len())]
    )
}

/// Gives a status that the gRPC machinery made by itself what ours have: a reason, and a code that
/// says whose fault it is.
pub fn of_grpc(status: &Status) -> Status {
    let message = status.message();
    let (code, reason, message) = match status.code() {
        Code::Unimplemented if message.is_empty() => return unknown_call(),
        Code::Unimplemented => (Code::Unimplemented, UNSUPPORTED, message),
        Code::OutOfRange
            if message.contains("encoded message length") && !message.contains("decoded") =>
        {
            (Code::OutOfRange, "ANSWER_TOO_LARGE", message)
        }
        Code::OutOfRange | Code::ResourceExhausted => {
            (Code::OutOfRange, "MESSAGE_TOO_LARGE", message)
        }
        Code::Internal if !message.starts_with("Error encoding") => {
            (Code::InvalidArgument, "UNDECODABLE", message)
        }
        Code::Internal => (Code::Internal, "INTERNAL", message),
        Code::NotFound => (Code::NotFound, "NOT_FOUND", message),
        Code::Cancelled => (Code::Cancelled, "CANCELLED", message),
        Code::InvalidArgument => (Code::InvalidArgument, "INVALID_INPUT", message),
        code => (code, "UNKNOWN", message),
    };
    signed(code, reason, message)
}

/// Says that there is no such service or method.
pub fn unknown_call() -> Status {
    let message =
        "nothing is served under this path: see which services and methods there are by reflection";
    signed(Code::Unimplemented, PATH_NOT_FOUND, message)
}

fn signed(code: Code, reason: &str, message: &str) -> Status {
    let details = ErrorDetails::with_error_info(reason, DOMAIN, HashMap::new());
    Status::with_error_details(code, cut(message, MOST_MESSAGE), details)
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

    if asked == Asked::Batch {
        problem.retry_after(RETRY_BATCH)
    } else {
        problem
    }
}

/// After how long a batch that was not answered is sent again.
const RETRY_BATCH: Duration = Duration::from_secs(1);

/// What is told beside 401: how to show a key.
const CHALLENGE: HeaderValue = HeaderValue::from_static("Bearer realm=\"nudge\"");

const TOO_LARGE: &str = "BODY_TOO_LARGE";

/// Makes the problem of a body that has more than so many bytes.
pub fn body_too_large(most: usize) -> Problem {
    let message = format!(
        "the body is larger than {} MiB; send less at a time",
        most >> 20
    );
    Problem::new(ErrorKind::TooLarge, TOO_LARGE, message).with("limit_bytes", most)
}

/// A problem under its HTTP status. As a response it is only a note, which [`Failure::tell`] turns
/// into a body once the request's path is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    status: StatusCode,
    problem: Problem,
}

impl From<Problem> for Failure {
    fn from(problem: Problem) -> Self {
        Self {
            status: codes(problem.kind).0,
            problem,
        }
    }
}

impl Failure {
    /// Makes the failure of a request that no room of ours refused, but the HTTP machinery did.
    pub fn of_http(status: StatusCode) -> Self {
        let (kind, reason, message) = match status {
            StatusCode::NOT_FOUND => (
                ErrorKind::NotFound,
                PATH_NOT_FOUND,
                "nothing is served under this path",
            ),
            StatusCode::METHOD_NOT_ALLOWED => (
                ErrorKind::Invalid,
                "METHOD_NOT_ALLOWED",
                "this path does not take this method",
            ),
            StatusCode::PAYLOAD_TOO_LARGE => (
                ErrorKind::TooLarge,
                TOO_LARGE,
                "the body is larger than 16 MiB; send less at a time",
            ),
            StatusCode::UNSUPPORTED_MEDIA_TYPE => (
                ErrorKind::Invalid,
                UNSUPPORTED,
                "the body is of a type or an encoding that this path does not take",
            ),
            StatusCode::SERVICE_UNAVAILABLE => (
                ErrorKind::Unavailable,
                "UNAVAILABLE",
                "the service cannot answer now",
            ),
            status if status.is_server_error() => (
                ErrorKind::Internal,
                "INTERNAL",
                "the service failed; the cause is in its log",
            ),
            _ => (
                ErrorKind::Invalid,
                "BAD_REQUEST",
                "the request could not be read",
            ),
        };
        Self {
            status,
            problem: Problem::new(kind, reason, message),
        }
    }

    /// Makes the failure of a path that is not served, with what may have been meant.
    pub fn of_path(hint: &str) -> Self {
        let mut failure = Self::of_http(StatusCode::NOT_FOUND);
        failure.problem.message += hint;
        failure
    }

    /// Makes the failure of a body that has more than so many bytes, as it was sent or unpacked.
    pub fn of_size(most: usize) -> Self {
        body_too_large(most).into()
    }

    /// Makes the failure of a body in an encoding that is not read.
    pub fn of_encoding(found: &str) -> Self {
        let mut failure = Self::of_http(StatusCode::UNSUPPORTED_MEDIA_TYPE);
        failure.problem.message =
            format!("got content encoding {found:?}, expected gzip, deflate or identity");
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
        Self {
            status: StatusCode::NOT_ACCEPTABLE,
            problem,
        }
    }

    /// Tells the failure of the request of that path as `application/problem+json`, and when to
    /// retry where it helps.
    pub fn tell(&self, instance: &str) -> Response {
        let body = json::Problem::new(&self.problem, self.status.as_u16(), instance);
        self.response("application/problem+json", axum::Json(body))
    }

    /// Tells the failure as `{"error": text}`, as the Open Inference Protocol wants it.
    pub fn tell_text(&self, _: &str) -> Response {
        self.response(
            "application/json",
            axum::Json(serde_json::json!({ "error": self.problem.message })),
        )
    }

    fn response(&self, content_type: &'static str, body: impl IntoResponse) -> Response {
        let mut response =
            (self.status, [(header::CONTENT_TYPE, content_type)], body).into_response();
        if self.status == StatusCode::UNAUTHORIZED {
            response
                .headers_mut()
                .insert(header::WWW_AUTHENTICATE, CHALLENGE);
        }
        if let Some(wait) = self.problem.retry_after {
            response
                .headers_mut()
                .insert(header::RETRY_AFTER, wait.as_secs().into());
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
        let overloaded = Failure::from(Problem::new(
            ErrorKind::Overloaded,
            "OVERLOADED",
            "too much waits",
        ));
        let response = overloaded.tell("/v1/x");
        assert_eq!(response.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(response.headers()[header::RETRY_AFTER], "1");
        assert_eq!(
            response.headers()[header::CONTENT_TYPE],
            "application/problem+json"
        );
        let invalid = Failure::from(Problem::invalid("question", Vec::new())).tell("/v1/x");
        assert!(!invalid.headers().contains_key(header::RETRY_AFTER));
    }

    /// Bytes of the headers of a status, as HTTP/2 counts them.
    fn header_bytes(status: Status) -> usize {
        let headers = status.into_http::<()>().into_parts().0.headers;
        headers
            .iter()
            .map(|(name, value)| name.as_str().len() + value.len() + 32)
            .sum()
    }

    #[test]
    fn the_first_faults_and_the_number_of_the_rest_fit_into_headers() {
        let most = 8 << 10;
        for (text, number) in [
            ("x", 3),
            ("x", 10),
            ("x", 11),
            ("x", 100_000),
            ("\u{1f980}", 100),
            ("", 1),
        ] {
            for times in [1, 40, 100_000] {
                let fault = |i: usize| {
                    Fault::new(
                        format!("/states/{i}/{}", text.repeat(times)),
                        text.repeat(times),
                    )
                };
                let faults: Vec<Fault> = (0..number).map(fault).collect();
                let problem = Problem::invalid("question", faults)
                    .with("schema_hash", "f".repeat(10 * times));
                let status = grpc(problem);
                let told = status
                    .get_details_bad_request()
                    .expect("violations")
                    .field_violations
                    .len();
                let metadata = status.get_details_error_info().expect("a reason").metadata;
                let more = metadata
                    .get("more_faults")
                    .map_or(0, |more| more.parse().expect("a number"));
                assert!((1..=10).contains(&told), "{told} of {number} x {times}");
                assert_eq!(told + more, number, "{number} x {times}");
                assert!(
                    times > 1 || told == number.min(10),
                    "short ones are all told: {told} of {number}"
                );
                let bytes = header_bytes(status);
                assert!(
                    bytes < most,
                    "{bytes} bytes for {number} x {times} {text:?}"
                );
            }
        }
    }

    #[test]
    fn the_machinery_of_grpc_gets_a_reason_for_everything_that_it_says() {
        let cases = [
            (
                Status::unimplemented(""),
                Code::Unimplemented,
                "PATH_NOT_FOUND",
            ),
            (
                Status::unimplemented("Content is compressed with `zstd`"),
                Code::Unimplemented,
                "UNSUPPORTED_MEDIA_TYPE",
            ),
            (
                Status::internal("failed to decode Protobuf message"),
                Code::InvalidArgument,
                "UNDECODABLE",
            ),
            (
                Status::out_of_range("decoded message length too large"),
                Code::OutOfRange,
                "MESSAGE_TOO_LARGE",
            ),
            (
                Status::resource_exhausted("Error decompressing: size limit"),
                Code::OutOfRange,
                "MESSAGE_TOO_LARGE",
            ),
            (
                Status::out_of_range("Error, encoded message length too large"),
                Code::OutOfRange,
                "ANSWER_TOO_LARGE",
            ),
            (
                Status::internal("Error encoding: x"),
                Code::Internal,
                "INTERNAL",
            ),
            (
                Status::not_found("service not registered"),
                Code::NotFound,
                "NOT_FOUND",
            ),
            (Status::aborted("x"), Code::Aborted, "UNKNOWN"),
        ];
        for (made, code, reason) in cases {
            let status = of_grpc(&made);
            let info = status.get_details_error_info().expect("a reason");
            assert_eq!(
                (status.code(), info.reason.as_str(), info.domain.as_str()),
                (code, reason, "nudge"),
                "{made:?}"
            );
            assert!(!status.message().is_empty());
        }
    }

    #[test]
    fn every_refusal_keeps_its_status() {
        for code in [400, 404, 405, 408, 413, 414, 415, 431, 500, 502, 503] {
            let status = StatusCode::from_u16(code).expect("a status");
            assert_eq!(Failure::of_http(status).tell("/").status(), status);
        }
    }
}
