//! Trains again what counts have outgrown, for services that were asked to.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use super::Networks;
use crate::domain::draft::TrainingDraft;
use crate::domain::{Card, Environment, EnvironmentId, Model, Training};

/// How much must have been counted since a training, as a share of what it was made from.
const GROWTH: f64 = 0.5;

/// Transitions before which nothing is trained.
const FEWEST: u64 = 1_000;

/// A pair of agents of an environment.
type Place = (EnvironmentId, String, String);

impl Networks {
    /// Looks every so often, for ever, whether counts have grown enough for another training: of every pair that has a version, as it was trained
    /// then, and of the first two agents. A version that beats its baselines becomes active.
    pub async fn keep_up(self, every: Duration) {
        let mut tried: BTreeMap<Place, u64> = BTreeMap::new();
        loop {
            tokio::time::sleep(every).await;
            for environment in self.store.environments() {
                if let Err(problem) = self.train_what_has_grown(&environment, &mut tried).await {
                    tracing::warn!(%problem, environment = %environment.name, "a network was not trained again");
                }
            }
        }
    }

    async fn train_what_has_grown(
        &self,
        environment: &Arc<Environment>,
        tried: &mut BTreeMap<Place, u64>,
    ) -> Result<(), crate::error::Problem> {
        let counted = self.store.totals(environment.id).await.map_err(super::logged)?.transitions;
        let models = self.registry.list(environment).await?;
        for (ego, other) in pairs(environment, &models) {
            let of_pair = models.iter().rev().filter(|model| model.ego == ego && model.other == other);
            // One that cannot be read is made again as if there were none.
            let last = of_pair.filter_map(|model| model.card.as_ref().ok()).find(|card| !card.imported);
            let place = (environment.id, ego.clone(), other.clone());
            let revision = last.map_or(0, |card| card.revision).max(tried.get(&place).copied().unwrap_or(0));
            let due = (revision as f64 * (1.0 + GROWTH)).max(FEWEST as f64);
            if (counted as f64) < due || self.jobs.is_busy(environment.id, &ego, &other) {
                continue;
            }
            self.train(environment, &again(ego, other, last))?;
            tried.insert(place, counted);
        }
        Ok(())
    }
}

/// Returns the first two agents, and every pair that has a version.
fn pairs(environment: &Environment, models: &[Model]) -> Vec<(String, String)> {
    let agent = |at: usize| environment.schema.agents()[at].name.to_string();
    let mut pairs = vec![(agent(0), agent(1))];
    for model in models {
        let pair = (model.ego.clone(), model.other.clone());
        let is_known = [&pair.0, &pair.1].iter().all(|agent| environment.schema.agent(agent).is_some());
        if is_known && !pairs.contains(&pair) {
            pairs.push(pair);
        }
    }
    pairs
}

/// Asks for a training like the last one.
fn again(ego: String, other: String, last: Option<&Card>) -> TrainingDraft {
    let Training { kind, width, members, folds, epochs, weighting, seed } =
        last.map_or_else(Training::default, |card| card.training);
    TrainingDraft {
        ego: Some(ego),
        other: Some(other),
        kind: Some(kind.as_str().to_owned()),
        width: Some(width as u64),
        members: Some(members as u64),
        folds: Some(folds as u64),
        epochs: Some(epochs as u64),
        weighting: Some(weighting.as_str().to_owned()),
        seed: Some(seed),
        activate: false,
    }
}
