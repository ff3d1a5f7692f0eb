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
    let now = |agent: &usize| {
        let agent = &schema.agents()[*agent];
        variable(agent, agent.name.to_string())
    };
    let at = |outcome: usize| {
        variable(
            &schema.agents()[pair.other],
            schema.outcomes()[outcome].name.clone(),
        )
    };
    let mut given: Vec<Variable> = pair.given.iter().map(now).collect();
    // What the other did one step before, as far as it is known, is held fixed too.
    let own = pair.later.map(|later| schema.own_before(later));
    given.extend(own.map(|before| before.map_or_else(|| now(&pair.other), at)));
    Labels {
        ego: now(&pair.ego),
        other: pair.later.map_or_else(|| now(&pair.other), at),
        given,
    }
}

fn variable(agent: &Agent, name: String) -> Variable {
    let are_told = agent.actions() <= Variable::MOST_LABELS;
    let actions = if are_told {
        (0..agent.actions())
            .map(|index| agent.action_label(index))
            .collect()
    } else {
        Vec::new()
    };
    Variable { name, actions }
}
