//! States: in an order, and the counts of one.

use axum::extract::State;

use super::extract::{Path, Query};
use super::openapi::{DiscoveryParameters, ListingParameters, PairParameters, Refusals};
use crate::api::{json, proto};
use crate::app::App;
use crate::serve::status::Failure;

/// Returns states by visits or by figures, a page at a time: where is influence highest?
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/states",
    tag = "states",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        PairParameters,
        ListingParameters,
        DiscoveryParameters,
    ),
    responses((status = 200, description = "A page of states", body = json::StatePage), Refusals)
)]
pub async fn list_states(
    State(app): State<App>,
    Path(name): Path<String>,
    Query(query): Query,
) -> Result<axum::Json<json::StatePage>, Failure> {
    let listing = json::listing(query)?;
    let environment = app.environments.find(&name)?;
    let page = app.influence.states(&environment, &listing).await?;
    Ok(axum::Json(proto::ListStatesResponse::from(page).into()))
}

/// Returns the counts of one state, with labels.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/states/{key}",
    tag = "states",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        ("key" = String, Path, description = "The state's key: bin numbers joined by dots", example = "3.0.7"),
    ),
    responses((status = 200, description = "The counts", body = json::Counts), Refusals)
)]
pub async fn get_state(
    State(app): State<App>,
    Path((name, key)): Path<(String, String)>,
) -> Result<axum::Json<json::Counts>, Failure> {
    let environment = app.environments.find(&name)?;
    let view = app.influence.state(&environment, &key).await?;
    Ok(axum::Json(proto::GetStateResponse::from(view).into()))
}
