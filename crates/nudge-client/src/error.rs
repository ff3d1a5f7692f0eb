//! Errors of the client, and which of them are transient.

use nudge_core::error::{ErrorKind, Fault};
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::tls::TlsError;

/// An error of the client. Cloning is cheap enough to tell it to every caller that waits.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ClientError {
    /// The address cannot be used.
    #[error("cannot use the address {address:?}: {why}")]
    Address {
        /// What was given.
        address: String,
        /// What is wrong with it.
        why: String,
    },
    /// Nobody answers.
    #[error("nobody listens at {address} ({why})")]
    Unreachable {
        /// Where.
        address: String,
        /// What the network said.
        why: String,
    },
    /// Somebody answers with whom the client does not agree on TLS.
    #[error("no TLS with {address}: {why}")]
    Untrusted {
        /// Where.
        address: String,
        /// What is wrong.
        why: String,
    },
    /// A file of TLS cannot be used.
    #[error("{0}")]
    Tls(#[from] TlsError),
    /// Somebody answers who does not speak `nudge.v1`.
    #[error("what listens at {address} is no Nudge ({why})")]
    NotNudge {
        /// Where.
        address: String,
        /// What it answered.
        why: String,
    },
    /// The service said no; the same again would be refused again.
    #[error("{0}")]
    Refused(Refusal),
    /// The service could not be reached again in time. What was not acknowledged may have been
    /// counted: resuming says.
    #[error("gave up after {seconds} s without the service, which last said: {last}")]
    GaveUp {
        /// How long it was tried.
        seconds: u64,
        /// The last error.
        last: String,
    },
    /// What was given to the client is wrong; nothing was sent.
    #[error("{0}")]
    Invalid(String),
    /// The service and this producer disagree about what was sent.
    #[error("{0}")]
    Disagreement(String),
    /// The producer's task ended, because the program is ending.
    #[error("the producer was stopped")]
    Stopped,
}

/// A refusal in the service's words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Refusal {
    /// What a caller can do about it.
    pub kind: ErrorKind,
    /// One UPPER_SNAKE word; empty if the service gave none.
    pub reason: String,
    /// One plain sentence.
    pub message: String,
    /// Every fault of the input.
    pub faults: Vec<Fault>,
}

impl ClientError {
    /// Returns what a caller can do about it.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Address { .. } | Self::Invalid(_) | Self::Tls(_) => ErrorKind::Invalid,
            Self::Unreachable { .. }
            | Self::Untrusted { .. }
            | Self::GaveUp { .. }
            | Self::Stopped => ErrorKind::Unavailable,
            Self::NotNudge { .. } => ErrorKind::NotFound,
            Self::Refused(refusal) => refusal.kind,
            Self::Disagreement(_) => ErrorKind::Conflict,
        }
    }
}

impl From<Status> for ClientError {
    fn from(status: Status) -> Self {
        Self::Refused(Refusal::from(&status))
    }
}

impl From<&Status> for Refusal {
    fn from(status: &Status) -> Self {
        let details = status.get_error_details();
        let reason = details
            .error_info()
            .map(|info| info.reason.clone())
            .unwrap_or_default();
        let violations = details
            .bad_request()
            .map_or(&[][..], |bad| bad.field_violations.as_slice());
        let faults = violations
            .iter()
            .map(|violation| Fault::new(&violation.field, &violation.description))
            .collect();

        Self {
            kind: kind_of_code(status.code(), &reason),
            reason,
            message: words_of(status),
            faults,
        }
    }
}

/// Codes become kinds here, as kinds become codes in the service. Two kinds share a code, and the
/// reason tells them apart.
fn kind_of_code(code: Code, reason: &str) -> ErrorKind {
    match code {
        Code::InvalidArgument => ErrorKind::Invalid,
        Code::Unauthenticated => ErrorKind::Unauthenticated,
        Code::PermissionDenied => ErrorKind::Forbidden,
        Code::NotFound => ErrorKind::NotFound,
        Code::FailedPrecondition if reason == "OUT_OF_ORDER" => ErrorKind::OutOfOrder,
        Code::FailedPrecondition => ErrorKind::Conflict,
        Code::AlreadyExists => ErrorKind::AlreadyExists,
        Code::OutOfRange => ErrorKind::TooLarge,
        Code::ResourceExhausted => ErrorKind::Quota,
        Code::Unavailable => ErrorKind::Unavailable,
        _ => ErrorKind::Internal,
    }
}

/// Returns whether the same may succeed on a new stream: the service is away for a moment, or the
/// network broke.
///
/// The service signs its errors with a reason, so an unsigned one with a vague code was made up by
/// the transport.
pub(crate) fn is_transient(status: &Status) -> bool {
    let details = status.get_error_details();
    match status.code() {
        Code::Unavailable => true,
        Code::Unknown
        | Code::Internal
        | Code::Cancelled
        | Code::Aborted
        | Code::DeadlineExceeded => details.error_info().is_none(),
        _ => details.retry_info().is_some(),
    }
}

/// Returns the status's message, or its code where it has none.
pub(crate) fn words_of(status: &Status) -> String {
    if status.message().is_empty() {
        status.code().to_string()
    } else {
        status.message().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use tonic_types::ErrorDetails;

    use super::*;

    fn signed(code: Code, reason: &str) -> Status {
        Status::with_error_details(
            code,
            "no",
            ErrorDetails::with_error_info(reason, "nudge", []),
        )
    }

    #[test]
    fn broken_networks_are_tried_again_and_refusals_are_not() {
        for code in [
            Code::Unavailable,
            Code::Unknown,
            Code::Internal,
            Code::Cancelled,
        ] {
            assert!(
                is_transient(&Status::new(code, "h2 protocol error")),
                "{code:?}"
            );
        }
        assert!(is_transient(&signed(Code::Unavailable, "DRAINING")));
        assert!(!is_transient(&signed(Code::Internal, "INTERNAL")));
        for code in [
            Code::InvalidArgument,
            Code::NotFound,
            Code::FailedPrecondition,
            Code::ResourceExhausted,
        ] {
            assert!(!is_transient(&Status::new(code, "no")), "{code:?}");
        }
    }

    #[test]
    fn a_quota_that_frees_itself_is_tried_again() {
        let details = ErrorDetails::with_retry_info(Some(std::time::Duration::from_secs(1)));
        assert!(is_transient(&Status::with_error_details(
            Code::ResourceExhausted,
            "wait",
            details
        )));
    }

    #[test]
    fn a_refusal_keeps_the_words_of_the_service() {
        let mut details = ErrorDetails::with_error_info("INVALID_INPUT", "nudge", []);
        details.add_bad_request_violation("/states/0", "got 9");
        let refusal = Refusal::from(&Status::with_error_details(
            Code::InvalidArgument,
            "invalid question",
            details,
        ));
        assert_eq!(
            (refusal.kind, refusal.reason.as_str()),
            (ErrorKind::Invalid, "INVALID_INPUT")
        );
        assert_eq!(refusal.faults, [Fault::new("/states/0", "got 9")]);
        assert_eq!(
            Refusal::from(&signed(Code::FailedPrecondition, "OUT_OF_ORDER")).kind,
            ErrorKind::OutOfOrder
        );
        assert_eq!(
            Refusal::from(&signed(Code::FailedPrecondition, "FENCED")).kind,
            ErrorKind::Conflict
        );
    }
}
