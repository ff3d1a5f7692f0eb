//! Figures of each of the ego's actions: how often it was taken, how far it moves the other
//! (Kullback-Leibler divergence), and how the other responds, with credible intervals.

use super::assessor::Assessor;
use crate::domain::{ActionFigures, Interval, Schema, Scope};
use crate::evidence::ActionPosterior;
use crate::information::Table;
use crate::information::pooled::{Response, Responses};
use crate::priors::{self, Observations, Tables};

/// Returns the figures of every ego action, seen or not, in index order; `observations` is what the
/// evidence rests on.
pub fn by_action(
    assessor: Assessor<'_>,
    tables: &Tables,
    observations: &Observations<'_>,
) -> Vec<ActionFigures> {
    let pair = &assessor.scope.pair;
    let believed = assessor.informed.and_then(|informed| {
        Some(informed.in_detail()?.by_action(
            &informed.habits,
            observations.counted(),
            priors::ego(pair),
        ))
    });

    let mut believed = believed.unwrap_or_default().into_iter();
    let figures = |index: u64| figures(assessor, tables, index, believed.next());
    (0..assessor.schema.agents()[pair.ego].actions())
        .map(figures)
        .collect()
}

fn figures(
    assessor: Assessor<'_>,
    tables: &Tables,
    index: u64,
    believed: Option<ActionPosterior>,
) -> ActionFigures {
    let pair = &assessor.scope.pair;
    let ego = &assessor.schema.agents()[pair.ego];
    let responses = pair.alphabet(assessor.schema).columns;
    let unit = |nats: f64| assessor.scope.unit.from_nats(nats);

    let row = tables.whole.row_labels().binary_search(&index).ok();
    let seen = ActionFigures {
        index,
        action: ego.action_label(index),
        visits: tables.whole.row_sum(index),
        plug_in_divergence: row.map(|row| unit(tables.divergence(row))),
        response: row.map(|row| frequencies(&tables.whole, row, responses)),
        ..ActionFigures::default()
    };

    match believed {
        None => seen,
        Some(believed) => ActionFigures {
            divergence: Some((
                unit(believed.divergence_mean),
                believed.divergence_interval.map(unit) as Interval,
            )),
            response: Some(believed.response),
            response_intervals: believed.response_intervals,
            ..seen
        },
    }
}

/// Returns the figures of every ego action over the strata of a region, in index order, in nats.
pub fn on_the_whole(schema: &Schema, scope: &Scope, responses: &Responses) -> Vec<ActionFigures> {
    let ego = &schema.agents()[scope.pair.ego];
    let figures = |(index, response): (u64, Response)| {
        let is_seen = response.visits > 0;
        ActionFigures {
            index,
            action: ego.action_label(index),
            visits: response.visits,
            plug_in_divergence: is_seen.then_some(response.divergence),
            expected_divergence: is_seen.then_some(response.divergence_if_independent),
            response: is_seen.then_some(response.frequencies),
            response_intervals: response.intervals,
            response_if_independent: response.if_independent,
            ..ActionFigures::default()
        }
    };
    (0..).zip(responses.by_row()).map(figures).collect()
}

/// Returns the relative frequency of each of the other's actions after the ego's action at a row.
fn frequencies(table: &Table, row: usize, actions: u64) -> Vec<f64> {
    let mut frequencies = vec![0.0; actions as usize];
    for cell in table.row(row) {
        let action = table.column_labels()[cell.column as usize];
        frequencies[action as usize] = cell.n as f64 / table.rows()[row] as f64;
    }
    frequencies
}
