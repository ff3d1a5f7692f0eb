//! What can go wrong, in words that belong to no face: a kind, a reason and the faults of an input.
//!
//! Every module keeps its own small error enum and describes it as a [`Problem`]. HTTP and gRPC
//! codes are not here: the serving layer maps a kind to both of them, once.

use std::fmt;
use std::time::Duration;

/// What a caller can do about an error. HTTP and gRPC codes follow from it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// The input is wrong: correct it. Its faults are listed.
    Invalid,
    /// Nobody knows who asks: there is no key, or none that is let in.
    Unauthenticated,
    /// Whoever asks may not have it.
    Forbidden,
    /// The thing named does not exist.
    NotFound,
    /// The request contradicts what is stored; sent again it will fail again.
    Conflict,
    /// The thing exists already, as something else.
    AlreadyExists,
    /// A sequence number is ahead of its producer's next one.
    OutOfOrder,
    /// The request or its answer is larger than a stated limit.
    TooLarge,
    /// A stated quota is used up.
    Quota,
    /// Too much waits already: send it again after a moment.
    Overloaded,
    /// The service cannot do this now, or cannot say whether it did: reconnect, resume, resend.
    Unavailable,
    /// The caller's deadline passed before there was an answer.
    Deadline,
    /// A defect or a broken machine; the cause is in the log.
    Internal,
}

impl ErrorKind {
    /// Returns whether the same request may succeed later without being changed.
    pub fn is_retryable(self) -> bool {
        matches!(self, Self::Overloaded | Self::Unavailable)
    }
}

/// One fault of an input: where it is, and what was expected there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// A JSON pointer into the input, `/state/0/continuous/edges/2`.
    pub pointer: String,
    /// The value that was found and what was expected.
    pub detail: String,
}

impl Fault {
    /// Makes a fault at `pointer`.
    pub fn new(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self {
            pointer: pointer.into(),
            detail: detail.into(),
        }
    }

    /// Returns this fault seen from a value that holds the faulty one under `prefix`.
    pub fn under(self, prefix: &str) -> Self {
        Self {
            pointer: format!("{prefix}{}", self.pointer),
            detail: self.detail,
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.pointer.is_empty() {
            f.write_str(&self.detail)
        } else {
            write!(f, "{}: {}", self.pointer, self.detail)
        }
    }
}

/// Returns a JSON pointer to a member, which escapes `~` and `/` (RFC 6901).
pub fn pointer(name: &str) -> String {
    format!("/{}", name.replace('~', "~0").replace('/', "~1"))
}

/// An error as every face tells it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// What a caller can do about it.
    pub kind: ErrorKind,
    /// One UPPER_SNAKE word, the same on every face.
    pub reason: &'static str,
    /// One plain sentence: lower case, no full stop, names the thing.
    pub message: String,
    /// Every fault of the input that was found, not only the first.
    pub faults: Vec<Fault>,
    /// Numbers and names that a program can act on, such as `expected_sequence`.
    pub details: Vec<(&'static str, String)>,
    /// After how long the same may be sent again, where that helps.
    pub retry_after: Option<Duration>,
}

/// How long a caller should wait before it tries again, where nothing better is known.
const RETRY_AFTER: Duration = Duration::from_secs(1);

impl Problem {
    /// Makes a problem without faults or details.
    pub fn new(kind: ErrorKind, reason: &'static str, message: impl Into<String>) -> Self {
        let retry_after = kind.is_retryable().then_some(RETRY_AFTER);
        Self {
            kind,
            reason,
            message: message.into(),
            faults: Vec::new(),
            details: Vec::new(),
            retry_after,
        }
    }

    /// Makes the problem of an input with these faults; the message tells the first ones.
    pub fn invalid(what: &str, faults: Vec<Fault>) -> Self {
        const TOLD: usize = 3;
        let told: Vec<String> = faults.iter().take(TOLD).map(Fault::to_string).collect();

        let rest = faults.len().saturating_sub(TOLD);
        let more = if rest > 0 {
            format!("; and {rest} more")
        } else {
            String::new()
        };

        let message = format!("invalid {what}: {}{more}", told.join("; "));
        Self {
            faults,
            ..Self::new(ErrorKind::Invalid, "INVALID_INPUT", message)
        }
    }

    /// Returns this problem with one more detail.
    pub fn with(mut self, name: &'static str, value: impl fmt::Display) -> Self {
        self.details.push((name, value.to_string()));
        self
    }

    /// Returns this problem of a request that may be sent again after so long.
    pub fn retry_after(self, wait: Duration) -> Self {
        Self {
            retry_after: Some(wait),
            ..self
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for Problem {}
