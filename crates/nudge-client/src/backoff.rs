//! Exponential back-off with jitter: how long the service has been away, and when to try again.

use std::hash::{BuildHasher, RandomState};
use std::time::Duration;

use tokio::time::Instant;

const FIRST_DELAY: Duration = Duration::from_millis(100);
const LONGEST_DELAY: Duration = Duration::from_secs(5);

/// The exponential back-off of one time without progress.
pub(crate) struct Backoff {
    since: Instant,
    attempts: u32,
    last: String,
}

impl Backoff {
    /// Begins at the first delay.
    pub(crate) fn since(now: Instant) -> Self {
        Self {
            since: now,
            attempts: 0,
            last: String::new(),
        }
    }

    /// Restarts the clock, and goes on with the delays: before `now` nothing waited, so nobody was kept waiting.
    pub(crate) fn restart_clock(&mut self, now: Instant) {
        self.since = now;
    }

    /// Returns how long there has been no progress.
    pub(crate) fn elapsed(&self, now: Instant) -> Duration {
        now.duration_since(self.since)
    }

    /// Returns the error of the last attempt.
    pub(crate) fn last_error(&self) -> &str {
        &self.last
    }

    /// Notes a failure and returns how long to wait before the next attempt.
    pub(crate) fn next_delay(&mut self, why: String) -> Duration {
        self.last = why;
        let delay = delay(self.attempts, jitter());
        self.attempts += 1;
        delay
    }
}

/// Returns twice the delay of the attempt before, up to a limit, less up to half of it, so that a
/// thousand producers do not come back at once.
fn delay(attempts: u32, jitter: f64) -> Duration {
    let doubled = FIRST_DELAY.saturating_mul(2_u32.saturating_pow(attempts));
    doubled.min(LONGEST_DELAY).mul_f64(1.0 - jitter / 2.0)
}

/// Returns a number from 0 to 1 that differs from producer to producer; the standard library's
/// hasher is seeded by the system.
fn jitter() -> f64 {
    RandomState::new().hash_one(0) as f64 / u64::MAX as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_double_up_to_a_limit() {
        let delays: Vec<u128> = [0, 1, 2, 5, 6, 40]
            .map(|attempts| delay(attempts, 0.0).as_millis())
            .to_vec();
        assert_eq!(delays, [100, 200, 400, 3_200, 5_000, 5_000]);
        assert_eq!(delay(0, 1.0).as_millis(), 50);
    }
}
