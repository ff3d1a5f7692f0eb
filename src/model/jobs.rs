//! Trainings that were asked for: one at a time, in the order of asking, each told about while it goes on and ended when somebody says so.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::domain::{EnvironmentId, Job, JobState};
use crate::error::{ErrorKind, Problem};

/// Jobs that may wait at once.
const MOST_WAITING: usize = 16;

/// Jobs that are over and remembered, of all environments.
const REMEMBERED: usize = 256;

/// The jobs since the service started. Cloning is cheap.
#[derive(Clone, Default)]
pub struct Jobs {
    entries: Arc<Mutex<Vec<Entry>>>,
    changed: Arc<Notify>,
}

struct Entry {
    environment: EnvironmentId,
    job: Job,
    end: CancellationToken,
}

impl Jobs {
    /// Adds a job that waits, or refuses where too many do; returns it with what tells that it is to end.
    pub fn add(
        &self,
        environment: EnvironmentId,
        ego: String,
        other: String,
        end: CancellationToken,
    ) -> Result<Job, Problem> {
        let mut entries = self.lock();
        let waiting = entries.iter().filter(|entry| !entry.job.state.is_over()).count();
        if waiting >= MOST_WAITING {
            let message = format!("{waiting} trainings wait already; ask again when one is over, or end one");
            return Err(Problem::new(ErrorKind::Overloaded, "TOO_MANY_TRAININGS", message));
        }
        let id = entries.last().map_or(0, |entry| entry.job.id) + 1;
        let message = "waits for its turn".to_owned();
        let job = Job { id, ego, other, state: JobState::Queued, progress: 0.0, message, version: None };
        entries.push(Entry { environment, job: job.clone(), end });
        let over: Vec<u64> =
            entries.iter().filter(|entry| entry.job.state.is_over()).map(|entry| entry.job.id).collect();
        if over.len() > REMEMBERED {
            entries.retain(|entry| entry.job.id != over[0]);
        }
        Ok(job)
    }

    /// Returns the jobs of an environment, in order of number.
    pub fn of(&self, environment: EnvironmentId) -> Vec<Job> {
        self.lock().iter().filter(|entry| entry.environment == environment).map(|entry| entry.job.clone()).collect()
    }

    /// Returns how many jobs there are in a state, over all environments.
    pub fn number(&self, state: JobState) -> usize {
        self.lock().iter().filter(|entry| entry.job.state == state).count()
    }

    /// Returns one job.
    pub fn get(&self, environment: EnvironmentId, id: u64) -> Result<Job, Problem> {
        self.of(environment).into_iter().find(|job| job.id == id).ok_or_else(|| unknown(id))
    }

    /// Returns whether a pair of agents waits for a training or has one.
    pub fn is_busy(&self, environment: EnvironmentId, ego: &str, other: &str) -> bool {
        self.of(environment).iter().any(|job| !job.state.is_over() && job.ego == ego && job.other == other)
    }

    /// Returns a job once it is over.
    pub async fn finished(&self, environment: EnvironmentId, id: u64) -> Result<Job, Problem> {
        loop {
            let changed = self.changed.notified();
            let job = self.get(environment, id)?;
            if job.state.is_over() {
                return Ok(job);
            }
            changed.await;
        }
    }

    /// Tells a job to end, unless it is over.
    pub fn end(&self, environment: EnvironmentId, id: u64) -> Result<(), Problem> {
        let entries = self.lock();
        let found = entries.iter().find(|entry| entry.environment == environment && entry.job.id == id);
        let entry = found.ok_or_else(|| unknown(id))?;
        if entry.job.state.is_over() {
            let message = format!("job-{id} is over already: {}", entry.job.state.as_str());
            return Err(Problem::new(ErrorKind::Conflict, "JOB_OVER", message));
        }
        entry.end.cancel();
        Ok(())
    }

    /// Tells every job of an environment to end.
    pub fn end_all(&self, environment: EnvironmentId) {
        self.lock().iter().filter(|entry| entry.environment == environment).for_each(|entry| entry.end.cancel());
    }

    /// Changes what is told of a job.
    pub fn update(&self, id: u64, change: impl FnOnce(&mut Job)) {
        if let Some(entry) = self.lock().iter_mut().find(|entry| entry.job.id == id) {
            change(&mut entry.job);
        }
        self.changed.notify_waiters();
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Entry>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn unknown(id: u64) -> Problem {
    Problem::new(ErrorKind::NotFound, "JOB_NOT_FOUND", format!("unknown job `job-{id}`"))
}
