//! Retraining in the background: what counts have outgrown, or what another rule has made stale,
//! for services that were asked to.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use super::Networks;
use super::store_errors::logged;
use crate::domain::draft::TrainingDraft;
use crate::domain::{Card, Environment, EnvironmentId, Model, Pair, Training, is_same_threshold};
use crate::error::Problem;

/// How much must have been counted since a training, as a share of what it was made from.
const GROWTH: f64 = 0.5;

/// Transitions before which nothing is trained.
const FEWEST: u64 = 1_000;

/// A pair of agents of an environment, and its lag.
type Place = (EnvironmentId, String, String, u32);

/// What a pair was trained on last: how much was counted, and for which threshold in nats.
#[derive(Debug, Clone, Copy)]
struct Tried {
    counted: u64,
    threshold: f64,
}

impl Networks {
    /// Looks every so often, for ever, whether counts have grown enough for another training, or
    /// the rule has another threshold than the last one was for: of every pair that has a version,
    /// as it was trained then, and of the first two agents. A version that beats its baselines
    /// becomes active.
    pub async fn keep_up(self, every: Duration) {
        let mut tried: BTreeMap<Place, Tried> = BTreeMap::new();
        loop {
            tokio::time::sleep(every).await;
            for environment in self.store.environments() {
                if let Err(problem) = self.train_what_has_grown(&environment, &mut tried).await {
                    not_trained(&environment, &problem);
                }
            }
        }
    }

    async fn train_what_has_grown(
        &self,
        environment: &Arc<Environment>,
        tried: &mut BTreeMap<Place, Tried>,
    ) -> Result<(), Problem> {
        let totals = self.store.totals(environment.id).await;
        let counted = totals.map_err(logged)?.transitions;
        let models = self.registry.list(environment).await?;
        for pair in pairs(environment, &models) {
            let threshold = environment.rule_of(&pair).threshold_nats();
            let [ego, other] =
                [pair.ego, pair.other].map(|at| environment.schema.agents()[at].name.to_string());
            let lag = pair.lag(&environment.schema);

            let of_pair = models
                .iter()
                .rev()
                .filter(|model| model.pair(&environment.schema).as_ref() == Some(&pair));
            // One that cannot be read is made again as if there were none.
            let mut readable =
                of_pair.filter_map(|model| Some((model.card.as_ref().ok()?, model.stale)));
            let last = readable.find(|(card, _)| !card.imported);

            let place = (environment.id, ego.clone(), other.clone(), lag);
            let before = tried.get(&place).copied();
            let revision = last
                .map_or(0, |(card, _)| card.revision)
                .max(before.map_or(0, |tried| tried.counted));
            let has_grown = counted as f64 >= revision as f64 * (1.0 + GROWTH);

            // Once for each threshold: a training may fail.
            let was_tried =
                before.is_some_and(|tried| is_same_threshold(tried.threshold, threshold));
            let is_stale = last.is_some_and(|(_, is_stale)| is_stale) && !was_tried;

            if counted < FEWEST
                || !(has_grown || is_stale)
                || self.jobs.is_busy(environment.id, &ego, &other, lag)
            {
                continue;
            }

            let last = last.map(|(card, _)| card);
            match self.train(environment, &again(ego, other, lag, last)).await {
                Ok(_job) => drop(tried.insert(place, Tried { counted, threshold })),
                // It keeps no other pair from its training.
                Err(problem) => not_trained(environment, &problem),
            }
        }
        Ok(())
    }
}

fn not_trained(environment: &Environment, problem: &Problem) {
    tracing::warn!(%problem, environment = %environment.name, "a network was not trained again");
}

/// Returns the first two agents, and every pair that has a version.
fn pairs(environment: &Environment, models: &[Model]) -> Vec<Pair> {
    let mut pairs = vec![Pair::new(0, 1, Vec::new())];
    for model in models {
        if let Some(pair) = model.pair(&environment.schema)
            && !pairs.contains(&pair)
        {
            pairs.push(pair);
        }
    }
    pairs
}

/// Asks for a training like the last one.
fn again(ego: String, other: String, lag: u32, last: Option<&Card>) -> TrainingDraft {
    let Training {
        kind,
        width,
        members,
        folds,
        epochs,
        weighting,
        seed,
    } = last.map_or_else(Training::default, |card| card.training);
    TrainingDraft {
        ego: Some(ego),
        other: Some(other),
        lag: lag.into(),
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
