//! Subgroup discovery: in which regions a pair depends.

use super::extract::{Asked, Json, Path, Plain, Query};
use super::parameters::RegionSearchParameters;
use super::refusals::Refusals;
use crate::api::{json, proto};
use crate::app::App;
use crate::domain::RegionSearchQuestion;
use crate::domain::draft::RegionSearchDraft;
use crate::serve::status::Failure;

type Told = Result<axum::Json<json::RegionSearch>, Failure>;

/// Returns the regions in which a pair depends (subgroup discovery): rules of one to three conditions
/// on features of the state and derived ones, found in one half of the segments and tested on the
/// other.
///
/// Every figure is of the half that tests, but for those that say otherwise. Where nothing passes,
/// `regions` is empty: too little was counted to tell, or there is nothing.
#[utoipa::path(
    post,
    path = "/v1/environments/{environment}/regions",
    tag = "influence",
    params(("environment" = String, Path, description = "The environment's name")),
    request_body = json::RegionSearchQuestion,
    responses((status = 200, description = "The regions", body = json::RegionSearch), Refusals)
)]
pub async fn ask_regions(
    Plain(app): Plain,
    Path(name): Path<String>,
    Json(question): Json<json::RegionSearchQuestion>,
) -> Told {
    regions(&app, &name, &question.into()).await
}

/// Returns the same for a command line and for people: of all states, or within a region by a
/// parameter `region.NAME` a condition.
///
/// Where that takes longer than its caller waits, 503 tells how far it is; it goes on, so that
/// whoever asks again finds it further on.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/regions",
    tag = "influence",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        RegionSearchParameters,
    ),
    responses((status = 200, description = "The regions", body = json::RegionSearch), Refusals)
)]
pub async fn get_regions(Asked(app): Asked, Path(name): Path<String>, Query(query): Query) -> Told {
    regions(&app, &name, &json::region_search(query)?).await
}

async fn regions(app: &App, name: &str, draft: &RegionSearchDraft) -> Told {
    let environment = app.environments.find(name)?;
    let question = RegionSearchQuestion::new(&environment, draft)?;
    let found = app.influence.regions(&environment, question).await?;
    Ok(axum::Json(proto::FindRegionsResponse::from(found).into()))
}
