//! Names for numbers: the labels of variables, actions, bins and cells, as answers carry them.

use crate::domain::{
    Bin, Cell, Feature, Label, LabelledCell, Labels, Pair, Schema, SegmentId, StateKey, Variable,
};

/// Returns the bins of a state with their labels.
pub fn bins(schema: &Schema, key: &StateKey) -> Vec<Bin> {
    let bin = |(feature, bin): (&Feature, &u32)| Bin {
        feature: feature.name.to_string(),
        bin: *bin,
        label: feature.kind.bin_label(*bin),
    };
    schema.state().iter().zip(key.bins()).map(bin).collect()
}

/// Returns a cell with the labels of its segment and of its actions.
pub fn labelled(
    schema: &Schema,
    segments: &[(SegmentId, Option<Label>)],
    cell: &Cell,
) -> LabelledCell {
    let actions = schema.actions_of(cell.joint);
    let labels = schema
        .agents()
        .iter()
        .zip(&actions)
        .map(|(agent, index)| agent.action_label(*index))
        .collect();

    let segment = segments
        .iter()
        .find(|(id, _)| *id == cell.segment)
        .and_then(|(_, label)| label.clone());

    LabelledCell {
        segment,
        actions,
        labels,
        tally: cell.tally,
    }
}

/// Returns the names and the actions of the variables of a pair.
pub fn labels(schema: &Schema, pair: &Pair) -> Labels {
    labels_up_to(Variable::MOST_LABELS, schema, pair)
}

/// Returns the names of the variables of a pair, beside what has no indices.
pub fn names(schema: &Schema, pair: &Pair) -> Labels {
    labels_up_to(0, schema, pair)
}

/// Returns the names of the variables of a pair, and the actions of those that have so many at most.
fn labels_up_to(most: u64, schema: &Schema, pair: &Pair) -> Labels {
    let now = |agent: &usize| {
        let agent = &schema.agents()[*agent];
        let label = |index| agent.action_label(index);
        variable(most, agent.name.as_str(), agent.actions(), label)
    };
    let at = |outcome: usize| {
        let outcome = &schema.outcomes()[outcome];
        let label = |index| outcome.value_label(index);
        variable(most, &outcome.name, outcome.values(), label)
    };

    let mut given: Vec<Variable> = pair.given.iter().map(now).collect();
    // What an agent did one step before, as far as it is known, is held fixed too.
    let own = pair.later.zip(pair.other_agent(schema));
    given.extend(own.map(|(later, other)| {
        let before = schema.own_before(later);
        before.map_or_else(|| now(&other), at)
    }));

    Labels {
        ego: now(&pair.ego),
        other: pair.later.map_or_else(|| now(&pair.other), at),
        given,
    }
}

fn variable(most: u64, name: &str, letters: u64, label: impl Fn(u64) -> String) -> Variable {
    let told = if letters <= most { letters } else { 0 };
    Variable {
        name: name.to_owned(),
        actions: (0..told).map(label).collect(),
    }
}
