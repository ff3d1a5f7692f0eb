//! Summaries and discoveries (multiple testing): what all states say together.

use super::extract::{Asked, Path, Query};
use super::parameters::{
    DiscoveryParameters, PairParameters, PolicyParameters, RuleParameters, SegmentParameters,
    SummaryParameters,
};
use super::refusals::Refusals;
use crate::api::{json, proto};
use crate::serve::status::Failure;

/// Returns what all states say together: how much was seen, where data suffice, and how mutual
/// information is distributed.
///
/// Where that takes longer than its caller waits, 503 tells how far it is; it goes on, so that
/// whoever asks again finds it further on.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/summary",
    tag = "summary",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        PairParameters,
        SegmentParameters,
        PolicyParameters,
        RuleParameters,
        DiscoveryParameters,
        SummaryParameters,
    ),
    responses((status = 200, description = "The summary", body = json::Summary), Refusals)
)]
pub async fn summarize(
    Asked(app): Asked,
    Path(name): Path<String>,
    Query(query): Query,
) -> Result<axum::Json<json::Summary>, Failure> {
    let draft = json::summary(query)?;
    let environment = app.environments.find(&name)?;
    let summary = app.influence.summary(&environment, &draft).await?;
    Ok(axum::Json(proto::SummarizeResponse::from(summary).into()))
}
