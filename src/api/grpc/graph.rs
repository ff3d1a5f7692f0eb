//! Causal graphs: as a message, and as text for Graphviz.

use super::answer::state;
use crate::api::proto;
use crate::domain::{Basis, Dependence, Edge, Graph};

impl From<Graph> for proto::GetGraphResponse {
    fn from(graph: Graph) -> Self {
        let dot = dot(&graph);
        let name = |agent: usize| graph.nodes[agent].clone();
        let edge = |edge: Edge| proto::Edge {
            from: name(edge.from),
            to: name(edge.to),
            lag: 0,
            directed: false,
            answer: Some(edge.answer.into()),
        };
        Self {
            state: Some(state(&graph.key, graph.bins.clone())),
            edges: graph.edges.into_iter().map(edge).collect(),
            nodes: graph.nodes,
            dot,
        }
    }
}

/// Returns a graph for Graphviz. Established dependence is a solid line, open ones are dashed, and there is no line where it is excluded. No line has
/// an arrowhead: within one tick dependence has no direction.
fn dot(graph: &Graph) -> String {
    let nodes = graph.nodes.iter().map(|name| format!("  {};\n", quoted(name)));
    let edges = graph.edges.iter().filter_map(|edge| line(graph, edge));
    let body: String = nodes.chain(edges).collect();
    format!("graph {} {{\n{body}}}\n", quoted(&graph.key.to_string()))
}

fn line(graph: &Graph, edge: &Edge) -> Option<String> {
    let figures = edge.answer.figures.as_ref()?;
    let dependence = figures.evidence.map_or(Dependence::Open, |evidence| evidence.dependence);
    let style = match dependence {
        Dependence::Established => "solid",
        Dependence::Open => "dashed",
        Dependence::Excluded => return None,
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
        Basis::Model(version) => format!("{label}; {} by model version {version}", edge.answer.verdict.as_str()),
        Basis::Counts(_) | Basis::Prior => label,
    };
    let [from, to] = [edge.from, edge.to].map(|agent| quoted(&graph.nodes[agent]));
    Some(format!("  {from} -- {to} [style={style}, label={}];\n", quoted(&label)))
}

/// Names of agents and keys hold neither quotes nor backslashes.
fn quoted(text: &str) -> String {
    format!("\"{text}\"")
}
