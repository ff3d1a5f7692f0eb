//! Lag profiles: what all states of a region say together, at one lag after the other.

use super::extract::{Asked, Json, Path, Plain, Query};
use super::parameters::ProfileParameters;
use super::refusals::Refusals;
use crate::api::{json, proto};
use crate::app::App;
use crate::domain::ProfileQuestion;
use crate::domain::draft::ProfileDraft;
use crate::serve::status::Failure;

type Told = Result<axum::Json<json::Profile>, Failure>;

/// Returns what all states of a region say together, at one lag after the other (pooled evidence):
/// where a state alone has too few visits to tell, thousands together may.
///
/// Actions are compared within strata alone: a state's, a segment's, and those of the actions held
/// fixed. Every excess stands beside where it lies under independence.
#[utoipa::path(
    post,
    path = "/v1/environments/{environment}/profile",
    tag = "influence",
    params(("environment" = String, Path, description = "The environment's name")),
    request_body = json::ProfileQuestion,
    responses((status = 200, description = "The profile", body = json::Profile), Refusals)
)]
pub async fn ask_profile(
    Plain(app): Plain,
    Path(name): Path<String>,
    Json(question): Json<json::ProfileQuestion>,
) -> Told {
    profile(&app, &name, &question.into()).await
}

/// Returns the same for a command line and for people: of all states, or of a region by a parameter
/// `region.NAME` a condition.
///
/// Where that takes longer than its caller waits, 503 tells how far it is; it goes on, so that
/// whoever asks again finds it further on.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/profile",
    tag = "influence",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        ProfileParameters,
    ),
    responses((status = 200, description = "The profile", body = json::Profile), Refusals)
)]
pub async fn get_profile(Asked(app): Asked, Path(name): Path<String>, Query(query): Query) -> Told {
    profile(&app, &name, &json::profile(query)?).await
}

async fn profile(app: &App, name: &str, draft: &ProfileDraft) -> Told {
    let environment = app.environments.find(name)?;
    let question = ProfileQuestion::new(&environment, draft)?;
    let profile = app.influence.profile(&environment, question).await?;
    Ok(axum::Json(proto::GetProfileResponse::from(profile).into()))
}
