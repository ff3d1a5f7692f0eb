//! The causal graph of a state.

use serde::Serialize;
use utoipa::ToSchema;

use super::{Answer, State, words};
use crate::proto;

/// The causal graph of one state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Graph {
    /// The state.
    pub state: State,
    /// How many steps later the second agent of each edge is observed; 0 for the same tick.
    pub lag: u32,
    /// The agents, in the environment's order.
    pub nodes: Vec<String>,
    /// Every pair of agents, in their order; at a lag in both directions.
    pub edges: Vec<Edge>,
}

/// A pair of agents in a graph. At lag 0 it has no direction.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Edge {
    /// The earlier agent in the environment's order; at a lag the ego.
    pub from: String,
    /// The later agent; at a lag the other.
    pub to: String,
    /// Steps between the two actions; 0 for the same tick.
    pub lag: u32,
    /// Whether the edge has a direction, from the first to the second: false at lag 0, true at every
    /// other.
    pub directed: bool,
    /// What the pair is, beside all other agents: `direct` (dependent, and no three others or fewer
    /// explain it), `explained` (dependent by itself, but not with some others' actions held
    /// fixed), `open` (not decided, or dependent only with others' actions held fixed) or `absent`.
    #[schema(value_type = words::EdgeKind)]
    pub kind: String,
    /// The agents that explain it, where it is `explained`: with their actions held fixed no
    /// dependence is left.
    pub explained_by: Vec<String>,
    /// The agents that open it, where there are such; then it is `open`: with their actions held
    /// fixed there is dependence that is not seen without.
    pub opened_by: Vec<String>,
    /// What that means, in a sentence.
    pub note: String,
    /// The answer for the pair by itself, in the view `figures`.
    pub answer: Answer,
}

impl From<proto::GetGraphResponse> for Graph {
    fn from(graph: proto::GetGraphResponse) -> Self {
        Self {
            state: graph.state.map(Into::into).unwrap_or_default(),
            lag: graph.lag,
            nodes: graph.nodes,
            edges: graph.edges.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::Edge> for Edge {
    fn from(edge: proto::Edge) -> Self {
        Self {
            from: edge.from,
            to: edge.to,
            lag: edge.lag,
            directed: edge.directed,
            kind: edge_kind(edge.kind).into(),
            explained_by: edge.explained_by,
            opened_by: edge.opened_by,
            note: edge.note,
            answer: edge.answer.map(Into::into).unwrap_or_default(),
        }
    }
}

/// Returns the word for a kind of edge; nothing for one that is never sent.
pub fn edge_kind(number: i32) -> &'static str {
    match proto::EdgeKind::try_from(number) {
        Ok(proto::EdgeKind::Direct) => "direct",
        Ok(proto::EdgeKind::Explained) => "explained",
        Ok(proto::EdgeKind::Open) => "open",
        Ok(proto::EdgeKind::Absent) => "absent",
        Ok(proto::EdgeKind::Unspecified) | Err(_) => "",
    }
}
