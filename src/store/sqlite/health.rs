//! Readiness probe: whether a commit would succeed, by what became of the last writes. A failed one
//! says no at once, and only one that reached the disk says yes again.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::store::{Cause, StorageFault, StoreError};
use crate::telemetry::Seldom;

/// How long after a failure it is tried again, while nobody else does.
const RETRY: Duration = Duration::from_secs(1);

/// How long a proof may take before the disk is said not to answer.
const PATIENCE: Duration = Duration::from_secs(10);

/// From one line of the log to the next while writes fail.
const TOLD_EVERY: Duration = Duration::from_secs(5);

/// What became of the last writes.
pub(super) struct Health {
    state: Mutex<State>,
    told: Seldom,
}

struct State {
    /// Why the last write failed, if it did, and since when they do.
    failing: Option<(Cause, Instant)>,
    /// When a write last ended, whichever way.
    last: Option<Instant>,
    /// Since when a proof is waited for.
    waiting: Option<Instant>,
}

impl Health {
    /// Begins without any proof.
    pub(super) fn new() -> Self {
        let state = State {
            failing: None,
            last: None,
            waiting: None,
        };
        Self {
            state: Mutex::new(state),
            told: Seldom::every(TOLD_EVERY),
        }
    }

    /// Notes that a write reached the disk.
    pub(super) fn succeeded(&self, now: Instant) {
        let mut state = self.lock_state();
        state.last = Some(now);
        state.waiting = None;
        if let Some((cause, since)) = state.failing.take() {
            let failed_seconds = now.duration_since(since).as_secs_f64();
            tracing::info!(failed_seconds, why = %cause, "ready again: a write reached the disk");
        }
    }

    /// Notes that a write failed.
    pub(super) fn failed(&self, cause: &Cause, now: Instant) {
        let mut state = self.lock_state();
        state.last = Some(now);
        state.waiting = None;
        let since = state.failing.as_ref().map_or(now, |(_, since)| *since);
        state.failing = Some((cause.clone(), since));

        // The log may be slow.
        drop(state);
        if let Some(left_out) = self.told.admits(now) {
            tracing::error!(why = %cause, left_out, "not ready: a write failed");
        }
    }

    /// Notes what an error says of the next write.
    pub(super) fn heed(&self, error: &StoreError) {
        match error {
            StoreError::Aborted(cause) | StoreError::OutcomeUnknown(cause) => {
                self.failed(cause, Instant::now())
            }
            StoreError::Damaged(said) => self.failed(
                &Cause::new(StorageFault::Damaged, said.as_str()),
                Instant::now(),
            ),
            _ => {}
        }
    }

    /// Says more exactly what was wrong with the last write, where that was found out.
    pub(super) fn diagnosed(&self, fault: StorageFault) {
        if let Some((cause, _)) = &mut self.lock_state().failing {
            cause.fault = fault;
        }
    }

    /// Returns whether a proof is due where one so old is enough, and begins to wait for it if so.
    pub(super) fn wants_proof(&self, oldest: Duration, now: Instant) -> bool {
        let mut state = self.lock_state();
        let enough = if state.failing.is_some() {
            oldest.min(RETRY)
        } else {
            oldest
        };

        let is_due = state
            .last
            .is_none_or(|last| now.duration_since(last) >= enough);
        if is_due {
            state.waiting.get_or_insert(now);
        }
        is_due
    }

    /// Returns what is wrong with the writes, if they fail.
    pub(super) fn fault(&self) -> Option<StorageFault> {
        self.lock_state()
            .failing
            .as_ref()
            .map(|(cause, _)| cause.fault)
    }

    /// Returns whether a commit would succeed, or why not.
    pub(super) fn ready(&self, now: Instant) -> Result<(), Cause> {
        let state = self.lock_state();
        if let Some((cause, _)) = &state.failing {
            return Err(cause.clone());
        }

        match state.waiting.map(|since| now.duration_since(since)) {
            Some(waited) if waited > PATIENCE => Err(Cause::new(
                StorageFault::Stuck,
                format!("no write has ended for {} s", waited.as_secs()),
            )),
            _ => Ok(()),
        }
    }

    fn lock_state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PROOF: Duration = Duration::from_secs(3);

    fn full() -> Cause {
        Cause::new(StorageFault::DiskFull, "code 13")
    }

    #[test]
    fn the_last_write_decides() {
        let (health, now) = (Health::new(), Instant::now());
        assert_eq!(health.ready(now), Ok(()));
        health.failed(&full(), now);
        assert_eq!(health.ready(now), Err(full()));
        health.succeeded(now);
        assert_eq!(health.ready(now), Ok(()));
    }

    #[test]
    fn a_proof_is_wanted_when_idle_and_sooner_while_it_fails() {
        let (health, start) = (Health::new(), Instant::now());
        let after = |seconds| start + Duration::from_secs(seconds);
        assert!(health.wants_proof(PROOF, start), "nothing was proven yet");
        health.succeeded(start);
        assert!(
            !health.wants_proof(PROOF, after(2)),
            "somebody committed meanwhile"
        );
        assert!(health.wants_proof(PROOF, after(3)));
        health.failed(&full(), after(3));
        assert!(!health.wants_proof(PROOF, after(3)));
        assert!(health.wants_proof(PROOF, after(4)));
        let soon = Duration::from_millis(500);
        health.failed(&full(), after(5));
        assert!(
            !health.wants_proof(soon, after(5)) && health.wants_proof(soon, after(5) + soon),
            "who asks wants it sooner"
        );
    }

    #[test]
    fn a_disk_that_does_not_answer_is_not_ready() {
        let (health, start) = (Health::new(), Instant::now());
        let after = |seconds| start + Duration::from_secs(seconds);
        health.succeeded(start);
        assert!(health.wants_proof(PROOF, after(3)));
        assert!(health.wants_proof(PROOF, after(4)), "nothing has ended yet");
        assert_eq!(health.ready(after(13)), Ok(()));
        assert_eq!(
            health.ready(after(14)).map_err(|cause| cause.fault),
            Err(StorageFault::Stuck)
        );
        health.succeeded(after(15));
        assert_eq!(health.ready(after(15)), Ok(()));
    }
}
