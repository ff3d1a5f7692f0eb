//! The causal graph of a state.

use axum::response::{IntoResponse, Response};
use http::{HeaderMap, header};

use super::accept::preferred;
use super::extract::{Asked, Path, Query};
use super::json_answer::json_answer;
use super::parameters::{RuleParameters, SegmentParameters, StateParameters};
use super::refusals::Refusals;
use crate::api::{fitting, json, proto};
use crate::domain::View;
use crate::serve::costs::STATE_BYTES;
use crate::serve::status::Failure;
use crate::work::aside;

/// What a graph is told in: JSON, or the language of Graphviz.
const JSON: &str = "application/json";
const DOT: &str = "text/vnd.graphviz";

/// Returns the causal graph of a state: agents as nodes, every pair with its answer and with what
/// it is beside all other agents.
///
/// A pair is `direct` where its dependence is established and no three other agents or fewer, their
/// actions held fixed, explain it; else `explained`, `open` or `absent`. With `Accept:
/// text/vnd.graphviz` it is told in DOT: direct edges are solid lines, explained ones dotted, open
/// ones dashed, and none has an arrowhead, since within one tick dependence has no direction.
/// Pictures are drawn by Graphviz: `dot -Tsvg`; who accepts neither is answered 406.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/graph",
    tag = "influence",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        StateParameters,
        ("lag" = Option<i64>, Query, description = "How many steps later the second agent of each edge is observed; 0, the default, for the same tick. At a lag edges have a direction, and agents without a later action that is declared have no edge to them", minimum = 0, maximum = 64),
        SegmentParameters,
        RuleParameters,
    ),
    responses(
        (status = 200, description = "The graph", content((json::Graph = "application/json"), (String = "text/vnd.graphviz"))),
        (status = 406, description = "`Accept` names neither JSON nor DOT", body = json::Problem, content_type = "application/problem+json"),
        Refusals
    )
)]
pub async fn get_graph(
    Asked(app): Asked,
    Path(name): Path<String>,
    headers: HeaderMap,
    Query(query): Query,
) -> Result<Response, Failure> {
    let is_dot = [JSON, DOT][preferred(&headers, &[JSON, DOT])?] == DOT;
    let draft = json::graph(query)?;
    let environment = app.environments.find(&name)?;
    let graph = app.influence.graph(&environment, &draft).await?;
    let bytes = graph.edges.len() * STATE_BYTES;
    let graph = aside(bytes, move || {
        fitting(proto::GetGraphResponse::from(graph), View::Figures)
    })
    .await??;
    if is_dot {
        return Ok((
            [(header::CONTENT_TYPE, DOT), (header::VARY, "accept")],
            graph.dot,
        )
            .into_response());
    }

    let told = json_answer(bytes, move || Ok(json::Graph::from(graph))).await?;
    Ok(([(header::VARY, "accept")], told).into_response())
}
