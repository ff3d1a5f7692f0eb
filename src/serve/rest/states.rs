//! Rankings of states, and the contingency table of one.

use axum::response::Response;

use super::extract::{Asked, Path, Plain, Query};
use super::json_answer::json_answer;
use super::parameters::{
    DiscoveryParameters, ListingParameters, PairParameters, PolicyParameters, RuleParameters,
    SegmentParameters,
};
use super::refusals::Refusals;
use crate::api::{fitting, json, proto};
use crate::domain::View;
use crate::serve::costs::STATE_BYTES;
use crate::serve::status::Failure;

/// About what is told of a cell, in bytes.
const CELL_BYTES: usize = 128;

/// Returns states by visits or by figures, a page at a time: where is influence highest?
///
/// Where that takes longer than its caller waits, 503 tells how far it is; it goes on, so that
/// whoever asks again finds it further on.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/states",
    tag = "states",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        PairParameters,
        SegmentParameters,
        PolicyParameters,
        RuleParameters,
        ListingParameters,
        DiscoveryParameters,
    ),
    responses((status = 200, description = "A page of states", body = json::StatePage), Refusals)
)]
pub async fn list_states(
    Asked(app): Asked,
    Path(name): Path<String>,
    Query(query): Query,
) -> Result<Response, Failure> {
    let listing = json::listing(query)?;
    let environment = app.environments.find(&name)?;
    let page = app.influence.states(&environment, &listing).await?;
    json_answer(page.states.len() * STATE_BYTES, move || {
        fitting(proto::ListStatesResponse::from(page), View::Verdict).map(json::StatePage::from)
    })
    .await
}

/// Returns the counts of one state, with labels.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/states/{key}",
    tag = "states",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        ("key" = String, Path, description = "The state's key: bin numbers joined by dots", example = "3.0.7", pattern = r"^[0-9]+(\.[0-9]+)*$"),
    ),
    responses((status = 200, description = "The counts", body = json::Counts), Refusals)
)]
pub async fn get_state(
    Plain(app): Plain,
    Path((name, key)): Path<(String, String)>,
) -> Result<Response, Failure> {
    let environment = app.environments.find(&name)?;
    let view = app.influence.state_view(&environment, &key).await?;
    json_answer(view.cells.len() * CELL_BYTES, move || {
        fitting(proto::GetStateResponse::from(view), View::Full).map(json::Counts::from)
    })
    .await
}
