//! Background refits: a prior that was asked for lately is fitted again when enough more was
//! counted. Answers go on with the last fit until the next is there, and name it.

use std::time::{Duration, Instant};

use super::registry::PriorRegistry;
use crate::domain::{Environment, EnvironmentId, Pair};
use crate::error::{ErrorKind, Problem};
use crate::work::Progress;

/// How much must have been counted since the last fit, as a share of what it was made from.
const GROWTH: f64 = 0.1;

/// The rest after a fit, as a multiple of the time it took: fitting takes a twentieth of one core
/// at most.
const REST: u32 = 20;

impl PriorRegistry {
    /// Returns the oldest fit of an environment that was asked for within the hour before `now`:
    /// the revision that it stands on, and when it was made if that was since the start. `None`
    /// where nothing was fitted yet.
    pub fn oldest(
        &self,
        environment: EnvironmentId,
        now: Instant,
    ) -> Option<(u64, Option<Instant>)> {
        let pairs = self.asked.lately(environment, now);
        let kept = self.lock();
        let fitted = pairs
            .into_iter()
            .filter_map(|pair| kept.peek(&(environment, pair)));
        let oldest = fitted
            .filter(|fitted| fitted.id.version > 0)
            .min_by_key(|fitted| fitted.id.revision)?;
        Some((oldest.id.revision, oldest.made))
    }

    /// Fits what has grown enough, for ever: what was asked for within the last hour.
    pub async fn keep_up(self, every: Duration) {
        loop {
            tokio::time::sleep(every).await;
            self.keep_up_once(Instant::now()).await;
        }
    }

    /// Fits what has grown enough and was asked for within the hour before `now`.
    pub async fn keep_up_once(&self, now: Instant) {
        for environment in self.store.environments() {
            for pair in self.asked.lately(environment.id, now) {
                let started = Instant::now();
                match self.fit_if_due(&environment, &pair).await {
                    Ok(true) => tokio::time::sleep(started.elapsed() * REST).await,
                    Ok(false) => {}
                    // Somebody may have removed it meanwhile.
                    Err(problem) if problem.kind == ErrorKind::NotFound => {}
                    Err(problem) => {
                        tracing::warn!(%problem, environment = %environment.name, "a prior was not fitted")
                    }
                }
            }
        }
    }

    /// Fits a pair if that is due, and returns whether it was.
    async fn fit_if_due(&self, environment: &Environment, pair: &Pair) -> Result<bool, Problem> {
        // The turn comes first: what was due before it may have been made on request meanwhile.
        let turn = self.making.lock().await;
        let Some(fitted) = self.get(environment, pair).await? else {
            return Ok(false);
        };

        let counted = self.store.totals(environment.id).await?.transitions;
        let due = fitted.id.revision as f64 * (1.0 + GROWTH);
        if counted == fitted.id.revision || (counted as f64) < due {
            return Ok(false);
        }

        Ok(self
            .make(&turn, &Progress::default(), environment, pair)
            .await?
            .is_some())
    }
}
