//! Causal graphs for people: a line for every pair of agents, and what those mean that are no plain
//! edge.

use super::output::{Table, count, figure_or_dash, steps_later};
use crate::api::json::{dependence, edge_kind};
use crate::api::proto;

/// Returns a graph as text.
pub(super) fn render(environment: &str, graph: &proto::GetGraphResponse) -> String {
    let state = graph.state.clone().unwrap_or_default();
    let lag = graph.edges.first().map_or(0, |edge| edge.lag);
    let mut text = format!(
        "{environment}: who depends on whom, {}\n\nstate {}\n",
        steps_later(lag),
        state.key
    );

    for bin in &state.bins {
        text += &format!("  {} = {}\n", bin.feature, bin.label);
    }

    let visits = graph
        .edges
        .iter()
        .find_map(|edge| edge.answer.as_ref())
        .map_or(0, |answer| answer.visits);

    text + &format!(
        "\n{} visits\n{}{}",
        count(visits),
        edges(graph),
        notes(graph)
    )
}

fn edges(graph: &proto::GetGraphResponse) -> String {
    let unit = graph
        .edges
        .first()
        .and_then(|edge| edge.answer.as_ref())
        .map_or("", |answer| &answer.unit);
    let mean = format!("posterior mean ({unit})");
    let mut table = Table::new(&["pair", "edge", "by", "by themselves", "P(dependent)", &mean]);
    for edge in &graph.edges {
        let answer = edge.answer.clone().unwrap_or_default();
        let others = [edge.explained_by.as_slice(), edge.opened_by.as_slice()].concat();
        table.row([
            pair(edge),
            kind(edge).into(),
            if others.is_empty() {
                "-".into()
            } else {
                others.join(", ")
            },
            dependence(answer.dependence).unwrap_or("unknown").into(),
            figure_or_dash(
                answer
                    .probability
                    .as_ref()
                    .map(|probability| probability.dependent),
            ),
            figure_or_dash(
                answer
                    .mutual_information
                    .and_then(|information| information.posterior_mean),
            ),
        ]);
    }

    table.render("  ")
}

/// Returns the word for an edge: one that somebody opens is told from one that is merely undecided.
fn kind(edge: &proto::Edge) -> &'static str {
    if edge.opened_by.is_empty() {
        edge_kind(edge.kind)
    } else {
        "opened"
    }
}

/// Says what those pairs mean of which others are a part.
fn notes(graph: &proto::GetGraphResponse) -> String {
    let of_others = graph
        .edges
        .iter()
        .filter(|edge| !edge.explained_by.is_empty() || !edge.opened_by.is_empty());
    let notes: String = of_others
        .map(|edge| format!("{}: {}\n", pair(edge), edge.note))
        .collect();
    if notes.is_empty() {
        notes
    } else {
        format!("\n{notes}")
    }
}

fn pair(edge: &proto::Edge) -> String {
    let joined = if edge.directed { "->" } else { "-" };
    format!("{} {joined} {}", edge.from, edge.to)
}
