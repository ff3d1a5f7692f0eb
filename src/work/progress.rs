//! Progress reporting of a job: what is done, of how much, and in words.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// How far a job is. Cloning shares it.
#[derive(Debug, Clone, Default)]
pub struct Progress(Arc<Figures>);

#[derive(Debug, Default)]
struct Figures {
    step: Mutex<Step>,
    done: AtomicU64,
    total: AtomicU64,
}

#[derive(Debug, Clone)]
enum Step {
    /// Its own, in words.
    Own(&'static str),
    /// Another job, whose result is waited for.
    Of(Progress),
}

impl Default for Step {
    fn default() -> Self {
        Self::Own("")
    }
}

impl Progress {
    /// Begins a step of so many parts; `step` says in words what is done to them, "states
    /// measured".
    pub fn begin(&self, step: &'static str, total: u64) {
        *self.step() = Step::Own(step);
        self.0.done.store(0, Ordering::Relaxed);
        self.0.total.store(total, Ordering::Relaxed);
    }

    /// Tells that so many more parts are done.
    pub fn add(&self, parts: u64) {
        self.0.done.fetch_add(parts, Ordering::Relaxed);
    }

    /// Tells how far another job is, until the next step begins.
    pub(super) fn follow(&self, other: Self) {
        *self.step() = Step::Of(other);
    }

    /// Returns what is done, of how many, and in words; what grows meanwhile does not pass its
    /// total.
    pub(super) fn snapshot(&self) -> (u64, u64, &'static str) {
        let step = self.step().clone();
        match step {
            Step::Of(other) => other.snapshot(),
            Step::Own(step) => {
                let [done, total] =
                    [&self.0.done, &self.0.total].map(|figure| figure.load(Ordering::Relaxed));
                (done.min(total), total, step)
            }
        }
    }

    fn step(&self) -> MutexGuard<'_, Step> {
        self.0.step.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
