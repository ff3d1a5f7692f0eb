//! Admission control and back-pressure: room in the queue, in transitions, or as much as these take
//! where outcomes are observed, with fair shares for streams and for single calls.
//!
//! Streams wait in line for as long as it takes, so a share that both could take would never be
//! free when a single call looks. Single calls have a share of their own beside it. The sum of both
//! bounds what waits in memory.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::committer::MOST_COMMIT_TRANSITIONS;
use crate::error::{ErrorKind, Problem};

/// The share of streams: one commit at work, and what is decoded and validated meanwhile.
const STREAMS: usize = 4 * MOST_COMMIT_TRANSITIONS;

/// The share of single calls: half a commit, which is six of the largest batches or very many small
/// ones.
const CALLS: usize = MOST_COMMIT_TRANSITIONS / 2;

/// The most that one batch may take: it must fit into the share of single calls.
pub const MOST: usize = CALLS;

/// How long a single call waits for room: some commits, and shorter than anybody's patience.
const PATIENCE: Duration = Duration::from_secs(2);

/// The capacity of the queue that is free, as two semaphores. Cloning is cheap.
#[derive(Clone)]
pub struct Room {
    streams: Arc<Semaphore>,
    calls: Arc<Semaphore>,
}

impl Default for Room {
    fn default() -> Self {
        Self {
            streams: Arc::new(Semaphore::new(STREAMS)),
            calls: Arc::new(Semaphore::new(CALLS)),
        }
    }
}

impl Room {
    /// Takes room for a batch of a stream, first come, first served.
    pub async fn for_stream(&self, transitions: u32) -> Result<OwnedSemaphorePermit, Problem> {
        self.streams
            .clone()
            .acquire_many_owned(transitions)
            .await
            .map_err(|_| overloaded())
    }

    /// Takes room for a single call: what streams leave, else its share, first come, first served.
    /// Refuses after a moment, retryably.
    pub async fn for_call(&self, transitions: u32) -> Result<OwnedSemaphorePermit, Problem> {
        if let Ok(room) = self.streams.clone().try_acquire_many_owned(transitions) {
            return Ok(room);
        }
        let room = self.calls.clone().acquire_many_owned(transitions);
        tokio::time::timeout(PATIENCE, room)
            .await
            .ok()
            .and_then(Result::ok)
            .ok_or_else(overloaded)
    }

    /// Returns how many transitions wait for their commit.
    pub fn taken(&self) -> usize {
        (STREAMS - self.streams.available_permits()) + (CALLS - self.calls.available_permits())
    }
}

fn overloaded() -> Problem {
    Problem::new(
        ErrorKind::Overloaded,
        "OVERLOADED",
        format!("{CALLS} transitions of single calls wait already; send it again"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn streams_leave_single_calls_their_share() {
        let room = Room::default();
        let _all = room.for_stream(STREAMS as u32).await.expect("free");
        let mut next = Box::pin(room.for_stream(1));
        assert!(futures::poll!(&mut next).is_pending(), "streams wait");
        assert!(room.for_call(CALLS as u32).await.is_ok());
    }

    #[tokio::test(start_paused = true)]
    async fn a_single_call_waits_its_turn_for_a_moment() {
        let room = Room::default();
        let _streams = room
            .for_call(STREAMS as u32)
            .await
            .expect("left by streams");
        let all = room.for_call(CALLS as u32).await.expect("free");
        assert_eq!(room.taken(), STREAMS + CALLS);
        assert_eq!(
            room.for_call(1).await.expect_err("full").kind,
            ErrorKind::Overloaded
        );
        let mut large = Box::pin(room.for_call(10_000));
        let mut small = Box::pin(room.for_call(1));
        assert!(futures::poll!(&mut large).is_pending() && futures::poll!(&mut small).is_pending());
        drop(all);
        assert!(large.await.is_ok() && small.await.is_ok());
        assert_eq!(room.taken(), STREAMS);
    }
}
