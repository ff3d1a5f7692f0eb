//! Causal graphs: as a message, with a sentence for each pair of agents, and as text for Graphviz.

use nudge_core::domain::{Basis, Edge, EdgeKind, Graph};

use super::answer::state_of_key;
use crate::proto;

impl From<Graph> for proto::GetGraphResponse {
    fn from(graph: Graph) -> Self {
        let dot = dot(&graph);
        let notes: Vec<String> = graph
            .edges
            .iter()
            .map(|edge| edge_note(&graph, edge))
            .collect();
        let name = |agent: usize| graph.nodes[agent].clone();
        let edge = |(edge, note): (Edge, String)| proto::Edge {
            from: name(edge.from),
            to: name(edge.to),
            lag: graph.lag,
            directed: graph.lag > 0,
            kind: proto::EdgeKind::from(edge.kind).into(),
            explained_by: names(&graph.nodes, &edge.explained_by),
            opened_by: names(&graph.nodes, &edge.opened_by),
            note,
            answer: Some(edge.answer.into()),
        };

        Self {
            state: Some(state_of_key(&graph.key, graph.bins.clone())),
            edges: graph.edges.into_iter().zip(notes).map(edge).collect(),
            nodes: graph.nodes,
            lag: graph.lag,
            dot,
        }
    }
}

impl From<EdgeKind> for proto::EdgeKind {
    fn from(kind: EdgeKind) -> Self {
        match kind {
            EdgeKind::Direct => Self::Direct,
            EdgeKind::Explained => Self::Explained,
            EdgeKind::Open => Self::Open,
            EdgeKind::Absent => Self::Absent,
        }
    }
}

fn names(nodes: &[String], agents: &[usize]) -> Vec<String> {
    agents.iter().map(|agent| nodes[*agent].clone()).collect()
}

/// Says in a sentence what a pair of agents is.
fn edge_note(graph: &Graph, edge: &Edge) -> String {
    let [explaining, opening] = [&edge.explained_by, &edge.opened_by]
        .map(|agents| names(&graph.nodes, agents).join(" and "));
    match edge.kind {
        EdgeKind::Direct => {
            "dependent by themselves, and no three other agents or fewer explain it".into()
        }
        EdgeKind::Explained => {
            format!("dependent by themselves, but not while {explaining} is held fixed")
        }
        EdgeKind::Open if edge.opened_by.is_empty() => {
            "what was seen does not decide whether they are dependent".into()
        }
        EdgeKind::Open => {
            let why = match is_common_effect(graph, edge) {
                true => {
                    "holding a common effect of two agents fixed makes them dependent, so this need be no edge"
                }
                false if graph.lag > 0 => "who act only together look like this",
                false => {
                    "who act only together look like this, and so do two whose common effect is held fixed"
                }
            };
            format!(
                "not known to be dependent by themselves, but dependent while {opening} is held fixed: {why}"
            )
        }
        EdgeKind::Absent => "not dependent, whoever is held fixed".into(),
    }
}

/// Returns whether one of those that open an edge is next to both of its ends. Nobody's action now
/// is an effect of what is observed later.
fn is_common_effect(graph: &Graph, edge: &Edge) -> bool {
    if graph.lag > 0 {
        return false;
    }
    let is_next_to = |a: usize, b: usize| {
        let ends = (a.min(b), a.max(b));
        graph
            .edges
            .iter()
            .any(|one| (one.from, one.to) == ends && one.kind == EdgeKind::Direct)
    };
    edge.opened_by
        .iter()
        .any(|agent| is_next_to(*agent, edge.from) && is_next_to(*agent, edge.to))
}

/// Returns a graph for Graphviz. Direct edges are solid lines, explained ones dotted and open ones
/// dashed, and there is no line where it is absent. Lines have arrowheads at a lag only: within one
/// tick dependence has no direction.
fn dot(graph: &Graph) -> String {
    let word = if graph.lag > 0 { "digraph" } else { "graph" };
    let nodes = graph
        .nodes
        .iter()
        .map(|name| format!("  {};\n", quoted(name)));
    let edges = graph.edges.iter().filter_map(|edge| line(graph, edge));
    let body: String = nodes.chain(edges).collect();
    format!("{word} {} {{\n{body}}}\n", quoted(&graph.key.to_string()))
}

fn line(graph: &Graph, edge: &Edge) -> Option<String> {
    let figures = edge.answer.figures.as_ref()?;
    let style = match edge.kind {
        EdgeKind::Direct => "solid",
        EdgeKind::Explained => "dotted",
        EdgeKind::Open => "dashed",
        EdgeKind::Absent => return None,
    };

    let label = match figures.evidence {
        Some(evidence) => format!(
            "{:.3} {}, P(dependent) {:.2}",
            evidence.posterior_mean,
            figures.unit.as_str(),
            evidence.probability.dependent
        ),
        None => "not known".into(),
    };

    let label = match edge.answer.basis {
        Basis::Model(version) => format!(
            "{label}; {} by model version {version}",
            edge.answer.verdict.as_str()
        ),
        Basis::Counts(_) | Basis::Prior => label,
    };

    let others = [
        ("explained", &edge.explained_by),
        ("opened", &edge.opened_by),
    ];
    let others = others.into_iter().filter(|(_, agents)| !agents.is_empty());
    let others = others
        .map(|(word, agents)| format!("; {word} by {}", names(&graph.nodes, agents).join(", ")));
    let label = label + &others.collect::<String>();
    let [from, to] = [edge.from, edge.to].map(|agent| quoted(&graph.nodes[agent]));

    let joined = if graph.lag > 0 { "->" } else { "--" };
    Some(format!(
        "  {from} {joined} {to} [style={style}, label={}];\n",
        quoted(&label)
    ))
}

/// Names of agents and keys hold neither quotes nor backslashes.
fn quoted(text: &str) -> String {
    format!("\"{text}\"")
}
