//! Environments: made, shown, changed and removed.

use std::sync::Arc;

use axum::response::{IntoResponse, Response};
use http::StatusCode;

use super::extract::{Asked, Json, Path, Plain, Query};
use super::json_answer::json_answer;
use super::refusals::Refusals;
use crate::api::{json, proto};
use crate::domain::Environment;
use crate::serve::status::Failure;

/// Creates an environment, or confirms that it exists with this very description.
///
/// A rule and derived features that are present set those of an environment that exists; absent,
/// they are kept. Another schema under the name is refused with 409. What `GET` answers comes back
/// in as it is.
#[utoipa::path(
    put,
    path = "/v1/environments/{environment}",
    tag = "environments",
    params(("environment" = String, Path, description = "The environment's name: `[a-z0-9][a-z0-9._-]{0,62}`")),
    request_body = json::Description,
    responses(
        (status = 201, description = "Created", body = json::Environment),
        (status = 200, description = "Existed already", body = json::Environment),
        Refusals,
    )
)]
pub async fn apply_environment(
    Plain(app): Plain,
    Path(name): Path<String>,
    Json(description): Json<json::Description>,
) -> Result<Response, Failure> {
    let (environment, created) = app
        .environments
        .apply(&name, description.of_name(&name)?)
        .await?;
    let status = if created {
        StatusCode::CREATED
    } else {
        StatusCode::OK
    };
    Ok((status, shown(environment).await?).into_response())
}

/// Returns one environment.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}",
    tag = "environments",
    params(("environment" = String, Path, description = "The environment's name")),
    responses((status = 200, description = "The environment", body = json::Environment), Refusals)
)]
pub async fn get_environment(
    Plain(app): Plain,
    Path(name): Path<String>,
) -> Result<Response, Failure> {
    shown(app.environments.find(&name)?).await
}

/// Returns environments in order of name, a page at a time.
#[utoipa::path(
    get,
    path = "/v1/environments",
    tag = "environments",
    params(
        ("page_size" = Option<u32>, Query, minimum = 0, maximum = 1_000, description = "The most to return, 1 to 1,000; 100 by default, which 0 means too"),
        ("page_token" = Option<String>, Query, description = "The `next_page_token` of the page before"),
    ),
    responses((status = 200, description = "A page of environments", body = json::EnvironmentPage), Refusals)
)]
pub async fn list_environments(
    Asked(app): Asked,
    Query(query): Query,
) -> Result<Response, Failure> {
    let (page_size, page_token) = json::page(query)?;
    let page = app.environments.list(page_size, page_token.as_deref())?;
    // A description may be large, and nobody has measured it.
    json_answer(usize::MAX, move || {
        Ok(json::EnvironmentPage::from(
            proto::ListEnvironmentsResponse::from(page),
        ))
    })
    .await
}

/// Changes the parts of the rule and the derived features that are given, all or nothing, and keeps
/// the rest.
#[utoipa::path(
    patch,
    path = "/v1/environments/{environment}",
    tag = "environments",
    params(("environment" = String, Path, description = "The environment's name")),
    request_body = json::EnvironmentChange,
    responses((status = 200, description = "The environment as it now is", body = json::Environment), Refusals)
)]
pub async fn update_environment(
    Plain(app): Plain,
    Path(name): Path<String>,
    Json(change): Json<json::EnvironmentChange>,
) -> Result<Response, Failure> {
    shown(app.environments.update(&name, &change.into()).await?).await
}

/// Removes an environment with its counts and watermarks, for ever, and ends its streams.
///
/// Accepted at once: its name is free, and what it leaves in the database goes in the background,
/// of which `/readyz?verbose` tells.
#[utoipa::path(
    delete,
    path = "/v1/environments/{environment}",
    tag = "environments",
    params(("environment" = String, Path, description = "The environment's name")),
    responses((status = 204, description = "The environment is gone"), Refusals)
)]
pub async fn delete_environment(
    Plain(app): Plain,
    Path(name): Path<String>,
) -> Result<StatusCode, Failure> {
    app.environments.delete(&name).await?;
    Ok(StatusCode::NO_CONTENT)
}

async fn shown(environment: Arc<Environment>) -> Result<Response, Failure> {
    json_answer(usize::MAX, move || {
        Ok(json::Environment::from(proto::Environment::from(
            &*environment,
        )))
    })
    .await
}
