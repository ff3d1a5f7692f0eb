//! Protocol errors: what hyper answered itself, or could not answer, because it was no request.
//! Nothing that is counted elsewhere has come of it.

use std::error::Error;

use crate::telemetry;

/// Records how a connection ended.
pub fn record(ended: Result<(), Box<dyn Error + Send + Sync>>) {
    let Err(error) = ended else { return };
    tracing::debug!(%error, "a connection ended with an error");
    let Some(error) = error.downcast_ref::<hyper::Error>() else {
        return;
    };

    if let Some(fault) = Fault::of_error(error) {
        telemetry::connection_ended(fault.word());
        if let Some(status) = fault.status(error) {
            telemetry::request("rest", "other", status, None);
        }
    }
}

/// How a client broke the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    /// The head of a request is none.
    Malformed,
    /// The head of a request is larger than any may be.
    HeadTooLarge,
    /// Frames are none, or come where they may not.
    Http2,
    /// It gave no sign of life.
    Silent,
}

impl Fault {
    /// Returns what was wrong, unless the client only left.
    fn of_error(error: &hyper::Error) -> Option<Self> {
        let has_left = error.is_incomplete_message()
            || error.is_closed()
            || error.is_canceled()
            || error.is_shutdown();
        let is_lost = error
            .source()
            .is_some_and(|source| source.is::<std::io::Error>());
        match error {
            error if error.is_parse_too_large() => Some(Self::HeadTooLarge),
            error if error.is_parse() => Some(Self::Malformed),
            error if error.is_timeout() => Some(Self::Silent),
            error if has_left || is_lost || error.is_user() || error.is_body_write_aborted() => {
                None
            }
            _ => Some(Self::Http2),
        }
    }

    /// Returns the word for metrics.
    fn word(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::HeadTooLarge => "head_too_large",
            Self::Http2 => "http2",
            Self::Silent => "silent",
        }
    }

    /// Returns the status that hyper answered with, if it did.
    fn status(self, error: &hyper::Error) -> Option<&'static str> {
        match self {
            Self::Malformed if error.is_parse_version_h2() => None,
            Self::Malformed => Some("400"),
            // A URI that is too long for hyper does not fit into what it reads ahead.
            Self::HeadTooLarge => Some("431"),
            Self::Http2 | Self::Silent => None,
        }
    }
}
