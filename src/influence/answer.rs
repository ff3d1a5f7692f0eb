//! Answers from counts: of one state, and of thousands by several threads.

use std::sync::Arc;

use super::tables::Tables;
use crate::domain::{
    ActionFigures, Agent, Answer, Bin, Cell, Estimator, Figures, Question, Schema, SegmentId, StateKey, Tally, View,
};
use crate::error::{ErrorKind, Problem};
use crate::evidence;
use crate::information::{excess, miller_madow, plug_in};
use crate::store::StateCounts;

/// States that are answered at once; more are shared among threads, so that nobody waits behind ten thousand.
const SHARE: usize = 2_500;

/// Returns the answers for the states of a question, which have these counts.
pub async fn answers(
    schema: &Schema,
    question: &Question,
    segments: Option<&[SegmentId]>,
    counts: Vec<StateCounts>,
) -> Result<Vec<Answer>, Problem> {
    if counts.len() <= SHARE {
        let states = question.states.iter().zip(&counts);
        return Ok(states.map(|(key, state)| answer(schema, question, segments, key, state)).collect());
    }
    let shared = Arc::new((schema.clone(), question.clone(), segments.map(<[SegmentId]>::to_vec), counts));
    let share = |from: usize| {
        let shared = shared.clone();
        tokio::task::spawn_blocking(move || {
            let (schema, question, segments, counts) = &*shared;
            let states = question.states.iter().zip(counts).skip(from).take(SHARE);
            states.map(|(key, state)| answer(schema, question, segments.as_deref(), key, state)).collect::<Vec<_>>()
        })
    };
    let shares: Vec<_> = (0..question.states.len()).step_by(SHARE).map(share).collect();
    let mut answers = Vec::with_capacity(question.states.len());
    for share in shares {
        let share = share.await;
        answers.extend(share.map_err(|error| Problem::new(ErrorKind::Internal, "INTERNAL", error.to_string()))?);
    }
    Ok(answers)
}

/// Returns the answer for a state with these counts.
fn answer(
    schema: &Schema,
    question: &Question,
    segments: Option<&[SegmentId]>,
    key: &StateKey,
    state: &StateCounts,
) -> Answer {
    let cells = || state.counts.of_segments(segments);
    let tables = Tables::new(schema, &question.scope.pair, cells());
    let visits = tables.whole.total();
    let nats = tables.figure(plug_in);
    let unit = question.scope.unit;
    let figures = (question.view != View::Verdict).then(|| {
        Box::new(Figures {
            bins: bins(schema, key),
            entries: total(cells()).entries,
            revision: state.revision,
            ..figures(question, &tables, nats)
        })
    });
    let by_action = (question.view == View::Full).then(|| {
        let [ego, other] = [question.scope.pair.ego, question.scope.pair.other].map(|agent| &schema.agents()[agent]);
        by_action(ego, other, &tables, |nats| unit.from_nats(nats))
    });
    let verdict = evidence::decide(&question.scope.rule, visits, nats, None);
    Answer { key: key.clone(), visits, verdict, basis: evidence::basis(visits), figures, by_action }
}

/// Returns the sum of cells.
pub fn total<'a>(cells: impl Iterator<Item = &'a Cell>) -> Tally {
    cells.fold(Tally::EMPTY, |mut sum, cell| {
        sum.add(cell.tally);
        sum
    })
}

/// Returns the bins of a state with their labels.
pub fn bins(schema: &Schema, key: &StateKey) -> Vec<Bin> {
    let bin = |(feature, bin): (&crate::domain::Feature, &u32)| Bin {
        feature: feature.name.to_string(),
        bin: *bin,
        label: feature.kind.bin_label(*bin),
    };
    schema.state().iter().zip(key.bins()).map(bin).collect()
}

fn figures(question: &Question, tables: &Tables, nats: f64) -> Figures {
    let unit = question.scope.unit;
    let (expected, method) = tables.expected_if_independent();
    let estimate = |estimator: &Estimator| {
        let nats = match estimator {
            Estimator::Excess => tables.figure(excess),
            Estimator::MillerMadow => tables.figure(miller_madow),
        };
        (estimator.as_str(), unit.from_nats(nats))
    };
    Figures {
        bins: Vec::new(),
        entries: None,
        unit,
        threshold: question.scope.rule.in_unit(unit).threshold,
        rule: question.scope.rule.kind,
        plug_in: unit.from_nats(nats),
        expected_if_independent: unit.from_nats(expected),
        expected_method: method.as_str(),
        estimates: question.estimators.iter().map(estimate).collect(),
        revision: 0,
    }
}

/// Returns the figures of every ego action, seen or not, in index order.
fn by_action(ego: &Agent, other: &Agent, tables: &Tables, unit: impl Fn(f64) -> f64) -> Vec<ActionFigures> {
    let whole = &tables.whole;
    let figures = |index: u64| {
        let row = whole.row_labels().binary_search(&index).ok();
        ActionFigures {
            index,
            action: ego.action_label(index),
            visits: row.map_or(0, |row| whole.rows()[row]),
            plug_in_divergence: row.map(|row| unit(tables.divergence(row))),
            response: row.map(|row| response(tables, row, other.actions())),
        }
    };
    (0..ego.actions()).map(figures).collect()
}

/// Returns the relative frequency of each of the other's actions after the ego's action at a row.
fn response(tables: &Tables, row: usize, actions: u64) -> Vec<f64> {
    let whole = &tables.whole;
    let mut response = vec![0.0; actions as usize];
    for cell in whole.row(row) {
        let action = whole.column_labels()[cell.column as usize];
        response[action as usize] = cell.n as f64 / whole.rows()[row] as f64;
    }
    response
}
