//! Experimental design, what to try next: the states, and the ego's actions in them, where one more
//! visit has the largest expected information gain.

use std::sync::Arc;

use rayon::prelude::*;

use super::labels::{bins, names};
use super::pass_cache::PassResult;
use super::query_context::QueryContext;
use super::state_ranking::StateRanking;
use super::store_errors::logged;
use crate::domain::{Exploration, StateKey, Suggestion, Verdict};
use crate::error::Problem;
use crate::priors::{self, Tables};
use crate::store::{StateCounts, Store};
use crate::work::{Gate, Progress, Stop, Stopped};

/// The most states looked at.
const CONSIDERED: usize = 500;

/// Returns the undecided states of a ranking that were seen at least so often, the most uncertain
/// first.
fn candidates(ranking: &StateRanking, min_visits: u64) -> Vec<StateKey> {
    let rows = &ranking.rows;
    let open = rows.verdicts().zip(rows.visits()).zip(rows.evidence());
    let mut open: Vec<(usize, u64, f64)> = (0..)
        .zip(open)
        .filter(|(_, ((verdict, visits), _))| {
            *verdict == Verdict::Undecided && *visits >= min_visits
        })
        .filter_map(|(at, ((_, visits), evidence))| {
            let far = (evidence?.probability.above_threshold - 0.5).abs();
            Some((at, visits, far))
        })
        .collect();

    // Rows are in order of key and the sort is stable.
    open.sort_by(|(_, n, far), (_, m, other)| far.total_cmp(other).then(m.cmp(n)));
    open.truncate(CONSIDERED);
    open.into_iter().map(|(at, ..)| rows.key(at)).collect()
}

/// The most that are ever told.
const MOST_TOLD: usize = 1_000;

/// States looked at in one piece of work.
const TOGETHER: usize = 16;

/// What was found.
pub struct Explored {
    /// What it was looked for in.
    pub ranking: Arc<PassResult<StateRanking>>,
    /// The most valuable actions first.
    trials: Vec<Suggestion>,
    considered: u64,
}

impl Explored {
    /// Returns at most so many of the trials, for the query that they were found for.
    pub fn first(&self, context: &QueryContext, limit: usize) -> Exploration {
        let (schema, pair) = (&context.environment.schema, &context.scope.pair);
        let trials = self.trials(limit).to_vec();
        Exploration {
            labels: names(schema, pair),
            lag: pair.lag(schema),
            trials,
            considered: self.considered,
            as_of: self.ranking.as_of,
            fit: self.ranking.fit,
        }
    }

    /// Returns the same trials as they are kept.
    pub fn trials(&self, limit: usize) -> &[Suggestion] {
        &self.trials[..limit.min(self.trials.len())]
    }
}

/// Ranks actions by expected information gain, in the undecided states of a ranking that were seen
/// at least so often.
pub async fn explore(
    store: &dyn Store,
    gate: &Gate,
    context: &QueryContext,
    ranking: Arc<PassResult<StateRanking>>,
    min_visits: u64,
    progress: &Progress,
) -> Result<Explored, Problem> {
    let keys = candidates(&ranking, min_visits);
    progress.begin("states explored", keys.len() as u64);

    let mut trials = Vec::new();
    for keys in keys.chunks(TOGETHER) {
        let counts = store
            .counts(context.environment.id, keys)
            .await
            .map_err(logged)?;
        let (context, states, size) = (context.clone(), keys.to_vec(), keys.len() as u64);
        trials.extend(
            gate.run(move |stop| explored(&context, &states, &counts, stop))
                .await?,
        );
        progress.add(size);
    }

    trials.sort_by(|a: &Suggestion, b| {
        b.information_gain
            .total_cmp(&a.information_gain)
            .then(a.key.cmp(&b.key))
            .then(a.index.cmp(&b.index))
    });
    trials.truncate(MOST_TOLD);
    Ok(Explored {
        trials,
        considered: keys.len() as u64,
        ranking,
    })
}

fn explored(
    context: &QueryContext,
    keys: &[StateKey],
    counts: &[StateCounts],
    stop: &Stop,
) -> Result<Vec<Suggestion>, Stopped> {
    let state = |(key, state)| stop.check().map(|()| suggestions(context, key, state));
    let trials: Result<Vec<Vec<Suggestion>>, Stopped> =
        keys.par_iter().zip(counts).map(state).collect();
    Ok(trials?.into_iter().flatten().collect())
}

fn suggestions(context: &QueryContext, key: &StateKey, state: &StateCounts) -> Vec<Suggestion> {
    let Some(informed) = &context.informed else {
        return Vec::new();
    };
    let Some(prior) = informed.in_detail() else {
        return Vec::new();
    };

    let (schema, scope) = (&context.environment.schema, &context.scope);
    let cells = || {
        state
            .counts
            .of_pair(schema, &scope.pair, context.segments.as_deref())
    };
    let tables = Tables::new(schema, &scope.pair, cells());
    let observations = tables.observations(schema, &scope.pair, scope.within, cells());

    let threshold = scope.rule.threshold_nats();
    let above_threshold = prior
        .posterior(&informed.habits, observations.counted())
        .above(threshold);

    let trial = |(index, information_gain): (u64, f64)| Suggestion {
        key: key.clone(),
        bins: bins(schema, key),
        visits: tables.whole.total(),
        index,
        action: schema.agents()[scope.pair.ego].action_label(index),
        action_visits: tables.whole.row_sum(index),
        information_gain,
        above_threshold,
    };
    (0..)
        .zip(prior.information_gain(
            &informed.habits,
            observations.counted(),
            priors::ego(&scope.pair),
            threshold,
        ))
        .map(trial)
        .collect()
}
