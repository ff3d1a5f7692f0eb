//! The causal graph of a state.

use serde::Serialize;
use utoipa::ToSchema;

use super::{Answer, State};
use crate::api::proto;

/// The causal graph of one state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Graph {
    /// The state.
    pub state: State,
    /// The agents, in the environment's order.
    pub nodes: Vec<String>,
    /// Every pair of agents, in their order.
    pub edges: Vec<Edge>,
}

/// A pair of agents in a graph. At lag 0 it has no direction.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Edge {
    /// The earlier agent in the environment's order.
    pub from: String,
    /// The later agent.
    pub to: String,
    /// Steps between the two actions: 0, the same tick.
    pub lag: u32,
    /// Whether the edge has a direction: false at lag 0.
    pub directed: bool,
    /// The answer for the pair, in the view `figures`.
    pub answer: Answer,
}

impl From<proto::GetGraphResponse> for Graph {
    fn from(graph: proto::GetGraphResponse) -> Self {
        let edge = |edge: proto::Edge| Edge {
            from: edge.from,
            to: edge.to,
            lag: edge.lag,
            directed: edge.directed,
            answer: edge.answer.map(Into::into).unwrap_or_default(),
        };
        Self {
            state: graph.state.map(Into::into).unwrap_or_default(),
            nodes: graph.nodes,
            edges: graph.edges.into_iter().map(edge).collect(),
        }
    }
}
