//! Size limits: whether an answer can fit into a message, asked before it is made, by what is known
//! of it beforehand, of which it has at least so many bytes. The rest is measured when it is
//! encoded.

use super::query_context::QueryContext;
use crate::api::{MOST_MESSAGE_BYTES, too_large};
use crate::domain::{
    Counts, Feature, FeatureKind, Question, RegionQuestion, Schema, Scope, StateKey, View,
};
use crate::error::Problem;
use crate::information::Alphabet;

/// Bytes of an ego action's figures beside its response.
const ACTION: u64 = 40;

/// Bytes of a probability, and of an interval of probabilities.
const PROBABILITY: u64 = 8;
const INTERVAL: u64 = 20;

/// Bytes of a cell's numbers and of what surrounds them, at least.
const CELL: u64 = 8;

/// Refuses a question whose answers a message cannot hold.
pub fn check(schema: &Schema, question: &Question) -> Result<(), Problem> {
    let states: u64 = match question.view {
        View::Verdict => question.states.iter().map(key_bytes).sum(),
        View::Figures | View::Full => question
            .states
            .iter()
            .map(|key| state_bytes(schema, key))
            .sum(),
    };

    let actions = if question.view == View::Full {
        actions_bytes(schema, &question.scope, question.states.len(), PROBABILITY)
    } else {
        0
    };

    fits(states.saturating_add(actions), question.view)
}

/// Refuses a question whose answers about regions a message cannot hold.
pub fn check_regions(schema: &Schema, question: &RegionQuestion) -> Result<(), Problem> {
    let each = match question.view {
        View::Full => 2 * PROBABILITY + INTERVAL,
        View::Figures | View::Verdict => return Ok(()),
    };
    let actions = actions_bytes(schema, &question.scope, question.regions.len(), each);
    fits(actions, question.view)
}

/// Refuses the same once it is known that there is evidence: intervals then stand beside responses,
/// and what the network expects beside both.
pub fn check_informed(context: &QueryContext, question: &Question) -> Result<(), Problem> {
    if question.view != View::Full {
        return Ok(());
    }

    let is_told = context
        .informed
        .as_ref()
        .is_some_and(|informed| informed.in_detail().is_some());
    let [evidence, network] = [
        is_told,
        context
            .network
            .as_ref()
            .is_some_and(|network| network.tells_actions()),
    ]
    .map(u64::from);
    let each = PROBABILITY + evidence * INTERVAL + network * PROBABILITY;
    fits(
        actions_bytes(
            &context.environment.schema,
            &question.scope,
            question.states.len(),
            each,
        ),
        question.view,
    )
}

/// Refuses the actions to try in so many states, where a message cannot hold them.
pub fn check_states<'a>(
    schema: &Schema,
    keys: impl Iterator<Item = &'a StateKey>,
) -> Result<(), Problem> {
    fits(
        keys.map(|key| state_bytes(schema, key)).sum(),
        View::Verdict,
    )
}

/// Refuses a graph of so many pairs, each with the bins of a state.
pub fn check_graph(schema: &Schema, key: &StateKey, pairs: usize) -> Result<(), Problem> {
    fits(
        state_bytes(schema, key).saturating_mul(pairs as u64),
        View::Figures,
    )
}

/// Refuses the counts of a state that a message cannot hold.
pub fn check_counts(schema: &Schema, counts: &Counts) -> Result<(), Problem> {
    let agents = 2 * schema.agents().len() as u64;
    fits(
        (counts.cells().len() as u64).saturating_mul(CELL + agents),
        View::Full,
    )
}

fn fits(bytes: u64, view: View) -> Result<(), Problem> {
    if bytes <= MOST_MESSAGE_BYTES as u64 {
        Ok(())
    } else {
        Err(too_large(view))
    }
}

/// Returns the bytes of the figures of all ego actions in so many states or regions, each with so
/// many for each of the other's actions.
fn actions_bytes(schema: &Schema, scope: &Scope, answers: usize, each: u64) -> u64 {
    let Alphabet { rows, columns } = scope.pair.alphabet(schema);
    let action = columns.saturating_mul(each).saturating_add(ACTION);
    action.saturating_mul(rows).saturating_mul(answers as u64)
}

/// Returns the bytes of a state in a list, at most: its bins and its figures.
pub fn most_listed(schema: &Schema, key: &StateKey) -> usize {
    const FIGURES: u64 = 512;
    (state_bytes(schema, key) + FIGURES) as usize
}

/// Returns the bytes of a key as it is written: a digit and a dot a feature, at least.
fn key_bytes(key: &StateKey) -> u64 {
    2 * key.bins().len() as u64
}

/// Returns the bytes of a state with its bins: names, labels, and what surrounds them. Labels that
/// are made of numbers are short, and not made for this.
fn state_bytes(schema: &Schema, key: &StateKey) -> u64 {
    /// The tags and lengths of a bin and of its two texts, and the shortest label.
    const AROUND: usize = 7;
    let label = |kind: &FeatureKind, bin: u32| match kind {
        FeatureKind::Categorical(labels) => labels[bin as usize].as_str().len() - 1,
        _ => 0,
    };
    let bin = |(feature, bin): (&Feature, &u32)| {
        feature.name.as_str().len() + label(&feature.kind, *bin) + AROUND
    };
    let bins: usize = schema.state().iter().zip(key.bins()).map(bin).sum();
    key_bytes(key) + bins as u64
}
