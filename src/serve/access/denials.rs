//! Denials: who is not let in is told why, and the metrics count it.

use crate::error::{ErrorKind, Problem};

/// Makes the problem of who shows no key that is let in.
pub(super) fn unauthenticated(message: impl Into<String>) -> Problem {
    Problem::new(ErrorKind::Unauthenticated, "UNAUTHENTICATED", message)
}

/// Returns the word of a reason in the metrics.
pub(super) fn word(reason: &str) -> &'static str {
    match reason {
        "UNAUTHENTICATED" => "unauthenticated",
        "ENVIRONMENT_FORBIDDEN" => "environment",
        "HOST_NOT_ALLOWED" => "host",
        "ORIGIN_NOT_ALLOWED" => "origin",
        "RATE_EXCEEDED" => "rate",
        _ => "scope",
    }
}

/// Returns a text from a request for an error, of which a caller may have made a novel.
pub(super) fn shortened(text: &[u8]) -> String {
    const MOST: usize = 100;
    let text = String::from_utf8_lossy(text);
    let told: String = text.chars().take(MOST).collect();
    if told.len() < text.len() {
        format!("{told}...")
    } else {
        told
    }
}
