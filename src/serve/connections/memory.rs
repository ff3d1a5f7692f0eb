//! Back-pressure on memory: one budget of bytes for all messages that are not finished or not
//! answered yet, from which each takes as it grows.
//!
//! Nothing waits for bytes. Messages that wait for each other's memory would all wait for ever; one
//! that is refused gives back what it holds at once.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::error::{ErrorKind, Problem};
use crate::telemetry;

/// A message up to this size may take the last quarter of the budget: large ones do not shut small
/// ones out.
const SMALL: usize = 64 << 10;

/// The memory budget of all unfinished messages together.
#[derive(Debug)]
pub struct Budget {
    most: usize,
    held: AtomicUsize,
}

impl Budget {
    /// Makes a budget of so many bytes.
    pub fn new(most: usize) -> Arc<Self> {
        Arc::new(Self {
            most,
            held: AtomicUsize::new(0),
        })
    }

    /// Returns how many bytes are held.
    pub fn held(&self) -> usize {
        self.held.load(Ordering::Relaxed)
    }

    fn take(&self, bytes: usize, most: usize) -> bool {
        let more = |held: usize| held.checked_add(bytes).filter(|held| *held <= most);
        self.held
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, more)
            .is_ok()
    }
}

/// The share of the budget that one message holds, until it is let go or dropped.
#[derive(Debug)]
pub struct Charge {
    budget: Arc<Budget>,
    held: Mutex<usize>,
}

impl Charge {
    /// Makes the charge of a message that holds nothing yet.
    pub fn new(budget: Arc<Budget>) -> Self {
        Self {
            budget,
            held: Mutex::new(0),
        }
    }

    /// Takes so many bytes more, or refuses, retryably.
    pub fn grow(&self, bytes: usize) -> Result<(), Problem> {
        self.set(&mut self.lock(), |held| held + bytes)
    }

    /// Holds so many bytes from now on, or refuses, retryably.
    pub fn hold(&self, bytes: usize) -> Result<(), Problem> {
        self.set(&mut self.lock(), |_| bytes)
    }

    /// Gives back everything.
    pub fn release(&self) {
        let held = std::mem::take(&mut *self.lock());
        self.budget.held.fetch_sub(held, Ordering::Relaxed);
    }

    fn set(&self, held: &mut usize, change: impl FnOnce(usize) -> usize) -> Result<(), Problem> {
        let wanted = change(*held);
        if wanted > *held && !self.budget.take(wanted - *held, self.most(wanted)) {
            telemetry::shed("TOO_MANY_UNFINISHED_BYTES");
            return Err(full());
        }

        if wanted < *held {
            self.budget
                .held
                .fetch_sub(*held - wanted, Ordering::Relaxed);
        }
        *held = wanted;
        Ok(())
    }

    fn most(&self, wanted: usize) -> usize {
        if wanted <= SMALL {
            self.budget.most
        } else {
            self.budget.most / 4 * 3
        }
    }

    fn lock(&self) -> MutexGuard<'_, usize> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Charge {
    fn drop(&mut self) {
        self.release();
    }
}

fn full() -> Problem {
    let message =
        "messages that are not finished hold all the memory that there is for them; send it again";
    Problem::new(ErrorKind::Overloaded, "TOO_MANY_UNFINISHED_BYTES", message)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_taken_comes_back() {
        let budget = Budget::new(400 << 10);
        let (first, second) = (Charge::new(budget.clone()), Charge::new(budget.clone()));
        assert!(first.grow(200 << 10).is_ok() && second.hold(100 << 10).is_ok());
        assert_eq!(
            second.grow(1).expect_err("three quarters are taken").kind,
            ErrorKind::Overloaded
        );
        assert_eq!(budget.held(), 300 << 10, "a refusal takes nothing");
        assert!(second.hold(50 << 10).is_ok());
        assert_eq!(budget.held(), 250 << 10);
        first.release();
        drop(second);
        assert_eq!(budget.held(), 0);
        drop(first);
        assert_eq!(budget.held(), 0, "nothing is given back twice");
    }

    #[test]
    fn large_messages_leave_room_for_small_ones() {
        let budget = Budget::new(400 << 10);
        let (large, small) = (Charge::new(budget.clone()), Charge::new(budget));
        assert!(large.grow(300 << 10).is_ok() && large.grow(1).is_err());
        assert!(small.grow(SMALL).is_ok() && small.grow(1).is_err());
    }
}
