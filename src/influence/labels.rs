//! Names for numbers: the labels of variables, actions, bins and cells, as answers carry them.

use crate::domain::{
    Agent, Bin, Cell, Feature, Label, LabelledCell, Labels, Pair, Schema, SegmentId, StateKey,
    Variable,
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
    let variable = |agent: &usize| variable(&schema.agents()[*agent]);
    Labels {
        ego: variable(&pair.ego),
        other: variable(&pair.other),
        given: pair.given.iter().map(variable).collect(),
    }
}

fn variable(agent: &Agent) -> Variable {
    let are_told = agent.actions() <= Variable::MOST_LABELS;
    let actions = if are_told {
        (0..agent.actions())
            .map(|index| agent.action_label(index))
            .collect()
    } else {
        Vec::new()
    };
    Variable {
        name: agent.name.to_string(),
        actions,
    }
}
