//! The queue of training jobs (first in, first out): progress while they go on, cancellation,
//! and back-pressure where too many wait.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::domain::{Environment, EnvironmentId, Job, JobState, Pair};
use crate::error::{ErrorKind, Problem};

/// Jobs that may wait at once.
const MOST_WAITING: usize = 16;

/// Jobs that are over and remembered, of all environments.
const REMEMBERED: usize = 256;

/// The jobs since the service started. Cloning is cheap.
#[derive(Clone)]
pub struct Jobs {
    /// The number of the first.
    first: u64,
    entries: Arc<Mutex<Vec<Entry>>>,
    changed: Arc<Notify>,
}

/// The share from which the time that is left is told: before it, one step more or less makes it
/// another.
const TELLING: f64 = 0.05;

struct Entry {
    environment: EnvironmentId,
    /// The environment's name.
    name: String,
    job: Job,
    /// When it had done something for the first time, and which share that was: until then it reads
    /// and fits, at another pace.
    began: Option<(Instant, f64)>,
    end: CancellationToken,
}

impl Entry {
    /// Returns the job with what is known only beside the others: those before it that are not over
    /// yet.
    fn with_place_in_queue(&self, before: &[Entry]) -> Job {
        let job = self.job.clone();
        match job.state {
            JobState::Queued => waiting(
                job,
                before.iter().filter(|entry| !entry.job.state.is_over()),
            ),
            JobState::Running => Job {
                seconds_left: self.seconds_left(),
                ..job
            },
            _ => job,
        }
    }

    /// Returns how long the rest takes if it goes as what is done went.
    fn seconds_left(&self) -> Option<f64> {
        let (at, first) = self.began?;
        let done = self.job.progress - first;
        let left = 1.0 - self.job.progress;
        (done >= TELLING).then(|| (at.elapsed().as_secs_f64() * left / done).max(0.0))
    }
}

/// Returns a job that waits, with what it waits for.
fn waiting<'e>(job: Job, mut before: impl Iterator<Item = &'e Entry>) -> Job {
    let Some(first) = before.next() else {
        return job;
    };
    let (id, name) = (first.job.id, &first.name);
    let far = match first.job.state {
        JobState::Running if first.job.progress >= 0.01 => {
            format!(", of which {:.0} % is done", 100.0 * first.job.progress)
        }
        _ => String::new(),
    };

    let more = before.count() as u64;
    let others = if more == 0 {
        String::new()
    } else {
        format!(", and for {more} more")
    };
    Job {
        ahead: 1 + more,
        message: format!("waits for job-{id} of `{name}`{far}{others}"),
        ..job
    }
}

impl Jobs {
    /// Makes an empty list of a service that starts at that time: its milliseconds since 1970
    /// number the first job. Jobs do not outlive the service, and whoever still waits for one of an
    /// earlier start must not find another's under its number.
    pub fn since(start: SystemTime) -> Self {
        let first = start
            .duration_since(UNIX_EPOCH)
            .map_or(0, |since| since.as_millis() as u64);
        Self {
            first: first.max(1),
            entries: Arc::default(),
            changed: Arc::default(),
        }
    }

    /// Adds a job that waits, or refuses where too many do; returns it with what tells that it is
    /// to end.
    pub fn add(
        &self,
        environment: &Environment,
        pair: &Pair,
        end: CancellationToken,
    ) -> Result<Job, Problem> {
        let mut entries = self.lock();
        let waiting = entries
            .iter()
            .filter(|entry| !entry.job.state.is_over())
            .count();
        if waiting >= MOST_WAITING {
            let message =
                format!("{waiting} trainings wait already; ask again when one is over, or end one");
            return Err(Problem::new(
                ErrorKind::Overloaded,
                "TOO_MANY_TRAININGS",
                message,
            ));
        }

        let id = entries.last().map_or(self.first, |entry| entry.job.id + 1);
        let [ego, other] =
            [pair.ego, pair.other].map(|agent| environment.schema.agents()[agent].name.to_string());
        let (state, message) = (JobState::Queued, "waits for its turn".to_owned());

        let job = Job {
            id,
            ego,
            other,
            lag: pair.lag(&environment.schema),
            state,
            progress: 0.0,
            message,
            version: None,
            ahead: 0,
            seconds_left: None,
        };
        let entry = Entry {
            environment: environment.id,
            name: environment.name.to_string(),
            job,
            began: None,
            end,
        };

        let told = entry.with_place_in_queue(&entries);
        entries.push(entry);

        let over: Vec<u64> = entries
            .iter()
            .filter(|entry| entry.job.state.is_over())
            .map(|entry| entry.job.id)
            .collect();
        if over.len() > REMEMBERED {
            entries.retain(|entry| entry.job.id != over[0]);
        }
        Ok(told)
    }

    /// Returns the jobs of an environment, in order of number.
    pub fn of_environment(&self, environment: EnvironmentId) -> Vec<Job> {
        let entries = self.lock();
        let own = entries
            .iter()
            .enumerate()
            .filter(|(_, entry)| entry.environment == environment);
        own.map(|(at, entry)| entry.with_place_in_queue(&entries[..at]))
            .collect()
    }

    /// Returns how many jobs there are in a state, over all environments.
    pub fn number(&self, state: JobState) -> usize {
        self.lock()
            .iter()
            .filter(|entry| entry.job.state == state)
            .count()
    }

    /// Returns one job.
    pub fn get(&self, environment: EnvironmentId, id: u64) -> Result<Job, Problem> {
        let found = self
            .of_environment(environment)
            .into_iter()
            .find(|job| job.id == id);
        found.ok_or_else(|| unknown(id, &self.lock(), environment))
    }

    /// Returns whether a pair of agents waits for a training at a lag or has one.
    pub fn is_busy(&self, environment: EnvironmentId, ego: &str, other: &str, lag: u32) -> bool {
        let is_of =
            |job: &Job| (job.ego.as_str(), job.other.as_str(), job.lag) == (ego, other, lag);
        self.of_environment(environment)
            .iter()
            .any(|job| !job.state.is_over() && is_of(job))
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
        let found = entries
            .iter()
            .find(|entry| entry.environment == environment && entry.job.id == id);
        let entry = found.ok_or_else(|| unknown(id, &entries, environment))?;
        if entry.job.state.is_over() {
            let message = format!("job-{id} is over already: {}", entry.job.state.as_str());
            return Err(Problem::new(ErrorKind::Conflict, "JOB_OVER", message));
        }
        entry.end.cancel();
        Ok(())
    }

    /// Tells every job of an environment to end.
    pub fn end_all(&self, environment: EnvironmentId) {
        self.lock()
            .iter()
            .filter(|entry| entry.environment == environment)
            .for_each(|entry| entry.end.cancel());
    }

    /// Changes what is told of a job.
    pub fn update(&self, id: u64, change: impl FnOnce(&mut Job)) {
        if let Some(entry) = self.lock().iter_mut().find(|entry| entry.job.id == id) {
            change(&mut entry.job);
            if entry.job.state == JobState::Running && entry.job.progress > 0.0 {
                entry
                    .began
                    .get_or_insert_with(|| (Instant::now(), entry.job.progress));
            }
        }
        self.changed.notify_waiters();
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Entry>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Jobs that are told where one is not known: the last ones.
const NAMED: usize = 8;

fn unknown(id: u64, jobs: &[Entry], environment: EnvironmentId) -> Problem {
    let own = jobs
        .iter()
        .rev()
        .filter(|entry| entry.environment == environment);
    let names: Vec<String> = own
        .take(NAMED)
        .map(|entry| format!("`job-{}`", entry.job.id))
        .collect();

    // None of them is "meant": their numbers are alike.
    let known = match names.is_empty() {
        true => "none was asked for since the service started".to_owned(),
        false => format!("known: {}", names.join(", ")),
    };

    Problem::new(
        ErrorKind::NotFound,
        "JOB_NOT_FOUND",
        format!("unknown job `job-{id}`; {known}"),
    )
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn entry(id: u64, state: JobState, progress: f64, began: Option<(Instant, f64)>) -> Entry {
        let (ego, other, message) = ("robot".into(), "human".into(), "learns".into());
        let job = Job {
            id,
            ego,
            other,
            lag: 0,
            state,
            progress,
            message,
            version: None,
            ahead: 0,
            seconds_left: None,
        };
        Entry {
            environment: EnvironmentId(1),
            name: "world".into(),
            job,
            began,
            end: CancellationToken::new(),
        }
    }

    #[test]
    fn who_waits_is_told_what_goes_before() {
        let over = entry(1, JobState::Failed, 0.3, None);
        let running = entry(2, JobState::Running, 0.236, Some((Instant::now(), 0.02)));
        let [third, fourth] = [3, 4].map(|id| entry(id, JobState::Queued, 0.0, None));
        let told = |before: &[&Entry], entry: &Entry| {
            let before: Vec<Entry> = before
                .iter()
                .map(|one| self::entry(one.job.id, one.job.state, one.job.progress, None))
                .collect();
            let Job { ahead, message, .. } = entry.with_place_in_queue(&before);
            (ahead, message)
        };
        assert_eq!(
            told(&[&over], &third),
            (0, "learns".into()),
            "nothing goes before, its own words stay"
        );
        let first = "waits for job-2 of `world`, of which 24 % is done";
        assert_eq!(told(&[&over, &running], &third), (1, first.to_owned()));
        assert_eq!(
            told(&[&over, &running, &third], &fourth),
            (2, format!("{first}, and for 1 more"))
        );
        assert_eq!(
            told(&[&third], &fourth),
            (1, "waits for job-3 of `world`".into())
        );
    }

    #[test]
    fn numbers_of_two_starts_differ() {
        let at = |milliseconds| Jobs::since(UNIX_EPOCH + Duration::from_millis(milliseconds)).first;
        assert_eq!(
            [at(1_796_000_000_000), at(1_796_000_000_001)],
            [1_796_000_000_000, 1_796_000_000_001]
        );
        assert_eq!(
            Jobs::since(UNIX_EPOCH - Duration::from_secs(1)).first,
            1,
            "a clock that is not set"
        );
    }

    #[test]
    fn an_unknown_job_is_told_with_those_there_are() {
        let told = |jobs: &[Entry]| unknown(7, jobs, EnvironmentId(1)).message;
        assert_eq!(
            told(&[]),
            "unknown job `job-7`; none was asked for since the service started"
        );
        let (one, other) = (
            entry(71, JobState::Done, 1.0, None),
            entry(80, JobState::Done, 1.0, None),
        );
        assert_eq!(
            told(&[one, other]),
            "unknown job `job-7`; known: `job-80`, `job-71`"
        );
        let strange = Entry {
            environment: EnvironmentId(2),
            ..entry(71, JobState::Done, 1.0, None)
        };
        assert_eq!(
            told(&[strange]),
            "unknown job `job-7`; none was asked for since the service started"
        );
    }

    #[test]
    fn the_time_left_goes_by_the_time_spent() {
        let minute_ago = Instant::now()
            .checked_sub(Duration::from_secs(60))
            .expect("the machine runs for longer");
        let left = |state, progress, began: Option<Instant>| {
            entry(1, state, progress, began.map(|at| (at, 0.02)))
                .with_place_in_queue(&[])
                .seconds_left
        };
        let seconds =
            left(JobState::Running, 0.26, Some(minute_ago)).expect("a quarter is done since");
        assert!(
            (185.0..186.0).contains(&seconds),
            "60 s * .74 / .24, and a moment: {seconds}"
        );
        assert_eq!(
            left(JobState::Running, 0.06, Some(minute_ago)),
            None,
            "too early to tell"
        );
        assert_eq!(left(JobState::Running, 0.5, None), None);
        assert_eq!(left(JobState::Done, 1.0, Some(minute_ago)), None);
        assert!(
            left(JobState::Running, 1.0, Some(minute_ago))
                .expect("known")
                .abs()
                < 1e-9
        );
    }
}
