//! Deadlines and patience: until when a caller waits for an answer. The faces set one around each
//! call; whoever makes something that goes on without the caller looks at it, to tell how far it is
//! while somebody still listens. It is bound to the task of the call: what is spawned has none.

use std::time::Duration;

use tokio::time::Instant;

tokio::task_local! {
    static DEADLINE: Deadline;
}

/// Of the time that a caller waits, so much is left to tell it that it is to ask again.
const MARGIN: Duration = Duration::from_secs(5);

/// When a caller goes away, and when it is told how far its answer is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Deadline {
    /// When the caller goes away.
    pub at: Instant,
    /// When a result that is not made yet is given up: five seconds before, but never before half
    /// the time is over.
    pub patience: Instant,
}

impl Deadline {
    /// Returns the deadline of a caller that waits so long from now.
    pub fn after(allowed: Duration) -> Self {
        let (now, patience) = (
            Instant::now(),
            allowed.saturating_sub(MARGIN).max(allowed / 2),
        );
        Self {
            at: now + allowed,
            patience: now + patience,
        }
    }

    /// Returns the deadline of the call that is being answered; `None` where nobody has set one.
    pub fn current() -> Option<Self> {
        DEADLINE.try_with(|deadline| *deadline).ok()
    }
}

/// Answers a call under a deadline; `None` where it passed first, so that a call which is late
/// already does not begin. What the call began is dropped with it.
pub async fn within<F: Future>(deadline: Deadline, call: F) -> Option<F::Output> {
    if deadline.at <= Instant::now() {
        return None;
    }
    tokio::time::timeout_at(deadline.at, DEADLINE.scope(deadline, call))
        .await
        .ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patience(seconds: u64) -> f64 {
        let now = Instant::now();
        (Deadline::after(Duration::from_secs(seconds)).patience - now).as_secs_f64()
    }

    #[tokio::test(start_paused = true)]
    async fn five_seconds_are_left_or_half_of_it() {
        assert_eq!([30, 10, 8, 0].map(patience), [25.0, 5.0, 4.0, 0.0]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_call_knows_its_deadline_and_ends_with_it() {
        let deadline = Deadline::after(Duration::from_secs(30));
        assert_eq!(Deadline::current(), None);
        assert_eq!(
            within(deadline, async { Deadline::current() }).await,
            Some(Some(deadline))
        );
        assert_eq!(within(deadline, std::future::pending::<()>()).await, None);
        assert_eq!(Instant::now(), deadline.at);
        assert_eq!(
            within(deadline, async { panic!("it is late already") }).await,
            None::<()>
        );
    }

    #[tokio::test]
    async fn what_is_spawned_has_none() {
        let spawned = async {
            tokio::spawn(async { Deadline::current() })
                .await
                .expect("it ends")
        };
        assert_eq!(
            within(Deadline::after(Duration::from_secs(30)), spawned).await,
            Some(None)
        );
    }
}
