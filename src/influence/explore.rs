//! What to try next: the states, and the ego's actions in them, where one more visit is worth most.

use rayon::prelude::*;

use super::answer::bins;
use super::survey::{Plan, Row, Survey};
use crate::domain::{Exploration, StateKey, Trial, Verdict};
use crate::priors::{self, Tables};
use crate::store::StateCounts;

/// The most states looked at.
const CONSIDERED: usize = 500;

/// Returns the undecided states of a survey that were seen at least so often, the most uncertain first.
pub fn candidates(survey: &Survey, min_visits: u64) -> Vec<StateKey> {
    let open = |row: &&Row| row.verdict == Verdict::Undecided && row.visits >= min_visits;
    let far = |row: &Row| row.evidence.map(|evidence| (evidence.probability.above_threshold - 0.5).abs());
    let mut rows: Vec<(&Row, f64)> = survey.rows.iter().filter(open).filter_map(|row| Some((row, far(row)?))).collect();
    // Rows are in order of key and the sort is stable.
    rows.sort_by(|(a, far_a), (b, far_b)| far_a.total_cmp(far_b).then(b.visits.cmp(&a.visits)));
    rows.truncate(CONSIDERED);
    rows.into_iter().map(|(row, _)| row.key.clone()).collect()
}

/// Returns the most valuable actions in these states, which have these counts.
pub fn explore(plan: &Plan, keys: &[StateKey], counts: &[StateCounts], limit: usize, as_of: u64) -> Exploration {
    let states = keys.par_iter().zip(counts);
    let mut trials: Vec<Trial> = states.flat_map_iter(|(key, state)| trials(plan, key, state)).collect();
    trials.sort_by(|a, b| {
        b.information_gain.total_cmp(&a.information_gain).then(a.key.cmp(&b.key)).then(a.index.cmp(&b.index))
    });
    trials.truncate(limit);
    Exploration { trials, considered: keys.len() as u64, as_of }
}

fn trials(plan: &Plan, key: &StateKey, state: &StateCounts) -> Vec<Trial> {
    let Some(informed) = &plan.informed else { return Vec::new() };
    let Some(prior) = informed.in_detail() else { return Vec::new() };
    let (schema, scope) = (&plan.environment.schema, &plan.scope);
    let cells = || state.counts.of_segments(plan.segments.as_deref());
    let tables = Tables::new(schema, &scope.pair, cells());
    let draws = tables.evidence(schema, &scope.pair, scope.within, cells());
    let threshold = scope.rule.threshold_nats();
    let above_threshold = prior.posterior(&informed.habits, draws.counted()).above(threshold);
    let trial = |(index, information_gain): (u64, f64)| Trial {
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
        .zip(prior.information_gain(&informed.habits, draws.counted(), priors::ego(&scope.pair), threshold))
        .map(trial)
        .collect()
}
