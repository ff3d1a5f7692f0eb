//! Fitted priors (empirical Bayes) and exploration: what the service learns from all states, and
//! what it would like to see next.

use axum::response::Response;

use super::extract::{Asked, Path, Query};
use super::json_answer::json_answer;
use super::parameters::{
    ExplorationParameters, PairParameters, PolicyParameters, RuleParameters, SegmentParameters,
};
use super::refusals::Refusals;
use crate::api::{fitting, json, proto};
use crate::domain::View;
use crate::error::{Fault, Problem};
use crate::serve::costs::STATE_BYTES;
use crate::serve::status::Failure;

/// Returns where one more visit is worth most: states, and the ego's actions in them. What to try
/// next to learn one's influence.
///
/// Send such visits under a segment of their own that the rule's `exploration` names, so that what was
/// tried weighs nothing in mutual information.
///
/// Where that takes longer than its caller waits, 503 tells how far it is; it goes on, so that
/// whoever asks again finds it further on.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/explore",
    tag = "states",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        PairParameters,
        SegmentParameters,
        PolicyParameters,
        RuleParameters,
        ExplorationParameters,
    ),
    responses((status = 200, description = "What to try, the most valuable first", body = json::Exploration), Refusals)
)]
pub async fn explore(
    Asked(app): Asked,
    Path(name): Path<String>,
    Query(query): Query,
) -> Result<Response, Failure> {
    let draft = json::exploration(query)?;
    let environment = app.environments.find(&name)?;
    let exploration = app.influence.explore(&environment, &draft).await?;
    json_answer(exploration.trials.len() * STATE_BYTES, move || {
        fitting(proto::ExploreResponse::from(exploration), View::Verdict)
            .map(json::Exploration::from)
    })
    .await
}

/// Fits the prior of the evidence to all states, now, and answers when it is done. It is done by
/// itself as counts grow.
///
/// Where that takes longer than its caller waits, 503 tells how far it is; it goes on, so that
/// whoever asks again finds it further on.
#[utoipa::path(
    post,
    path = "/v1/environments/{environment}/fit",
    tag = "summary",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        ("ego" = Option<String>, Query, description = "One agent of the pair; without `ego`, `other`, `given` and `lag` every pair is fitted at lag 0"),
        ("other" = Option<String>, Query, description = "The other agent of the pair, or an outcome with values"),
        ("lag" = Option<i64>, Query, description = "How many steps later the other's action is observed; 0, the default, for the same tick. Each lag has a fit of its own, and so has each direction", minimum = 0, maximum = 64),
        ("given" = Option<Vec<String>>, Query, description = "Agents whose actions are held fixed"),
    ),
    responses((status = 200, description = "What was fitted", body = json::Fits), Refusals)
)]
pub async fn fit_prior(
    Asked(app): Asked,
    Path(name): Path<String>,
    Query(query): Query,
    body: bytes::Bytes,
) -> Result<axum::Json<json::Fits>, Failure> {
    if !body.is_empty() && &body[..] != b"{}" {
        let detail = "got a body, expected none: the pair is named in the query string";
        return Err(Problem::invalid("body", vec![Fault::new("", detail)]).into());
    }
    let pair = json::fit(query)?;
    let environment = app.environments.find(&name)?;
    let fits = app.influence.fit(&environment, pair.as_ref()).await?;
    Ok(axum::Json(proto::FitPriorResponse::from(fits).into()))
}
