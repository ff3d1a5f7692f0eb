//! Structured logs: where they go, how they look, and rate limiting, by which a flood of the same
//! line becomes a few.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tracing_subscriber::EnvFilter;

/// Rate limiting of a log line: lets the first of many lines that say the same into the log, and
/// then one in a while.
pub struct Seldom {
    every: Duration,
    /// When one was last let in, and how many were left out since.
    state: Mutex<(Option<Instant>, u64)>,
}

impl Seldom {
    /// Lets one in at most that often.
    pub const fn every(every: Duration) -> Self {
        Self {
            every,
            state: Mutex::new((None, 0)),
        }
    }

    /// Returns how many were left out before this line, or `None` where it is to be left out
    /// itself.
    pub fn admits(&self, now: Instant) -> Option<u64> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (last, left_out) = &mut *state;
        if last.is_some_and(|last| now.duration_since(last) < self.every) {
            *left_out += 1;
            return None;
        }
        *last = Some(now);
        Some(std::mem::take(left_out))
    }
}

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogFormat {
    /// For people on a terminal.
    Human,
    /// One JSON object a line.
    Json,
}

/// Sends logs to standard error; `RUST_LOG` says which, by default what an operator should know.
pub fn log(format: LogFormat) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new("info"));
    let lines = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        // It would tell so on standard error, and panic where that is what cannot be written: a log
        // that is full or that nobody reads must end nothing.
        .log_internal_errors(false)
        .with_target(false);
    // A second call finds the first one's subscriber, which stays.
    let _ = match format {
        LogFormat::Human => lines
            .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()))
            .try_init(),
        LogFormat::Json => lines.json().flatten_event(true).try_init(),
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_is_let_in_and_then_one_in_a_while() {
        let (seldom, start) = (Seldom::every(Duration::from_secs(5)), Instant::now());
        let at = |millis| seldom.admits(start + Duration::from_millis(millis));
        assert_eq!(
            [0, 1, 4_999, 5_000, 5_001, 60_000].map(at),
            [Some(0), None, None, Some(2), None, Some(1)]
        );
    }
}
