//! Networks: trained, listed, switched, taken along and removed.

use std::sync::Arc;

use axum::response::{IntoResponse, Response};
use http::{StatusCode, header};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

use super::extract::{Asked, File, OCTETS, OptionalJson, Path, Plain, Query};
use super::refusals::Refusals;
use crate::api::json::ModelOrJob;
use crate::api::{json, proto};
use crate::app::App;
use crate::domain::{Environment, Job, Model, ModelId};
use crate::error::Problem;
use crate::serve::status::Failure;

/// A safetensors file: weights in PyTorch's layout, with the card of their network.
#[derive(ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code)]
pub struct Safetensors(Vec<u8>);

/// Names a version.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub struct VersionPath {
    /// The environment's name.
    environment: String,
    /// The number of a version.
    #[param(pattern = "^(0|[1-9][0-9]{0,17})$")]
    model: String,
}

impl VersionPath {
    fn find(&self, app: &App) -> Result<(Arc<Environment>, u64), Problem> {
        let version = json::model_version(&self.model)?;
        Ok((app.environments.find(&self.environment)?, version))
    }
}

/// Names a version or a job.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Path)]
pub struct IdPath {
    /// The environment's name.
    environment: String,
    /// The number of a version, or `job-` and the number of a job.
    #[param(pattern = "^(job-)?(0|[1-9][0-9]{0,17})$")]
    model: String,
}

impl IdPath {
    fn find(&self, app: &App) -> Result<(Arc<Environment>, ModelId), Problem> {
        let id = json::model_id(&self.model)?;
        Ok((app.environments.find(&self.environment)?, id))
    }
}

/// Trains a network for a pair of agents, after those that were asked for before; answers at once
/// with its job.
///
/// `Location` is where the job tells how far it is. A version comes out, which is made active by
/// itself where it beats every baseline.
#[utoipa::path(
    post,
    path = "/v1/environments/{environment}/models",
    tag = "models",
    params(("environment" = String, Path, description = "The environment's name")),
    request_body(content = Option<json::TrainingRequest>, description = "What differs from the defaults; may be empty"),
    responses(
        (
            status = 202,
            description = "The training was asked for",
            body = json::Job,
            headers(("Location" = String, description = "Where the job tells how far it is")),
        ),
        Refusals
    )
)]
pub async fn train_model(
    Plain(app): Plain,
    Path(name): Path<String>,
    OptionalJson(request): OptionalJson<json::TrainingRequest>,
) -> Result<Response, Failure> {
    let environment = app.environments.find(&name)?;
    let job = app.networks.train(&environment, &request.into()).await?;
    let location = format!("/v1/environments/{name}/models/{}", ModelId::Job(job.id));
    Ok((
        StatusCode::ACCEPTED,
        [(header::LOCATION, location)],
        axum::Json(job_shown(job)),
    )
        .into_response())
}

/// Returns the versions, a page at a time, and the jobs that were asked for since the service
/// started.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/models",
    tag = "models",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        ("page_size" = Option<u32>, Query, minimum = 0, maximum = 1_000, description = "The most versions to return, 1 to 1,000; 1,000 by default, which 0 means too"),
        ("page_token" = Option<String>, Query, description = "The `next_page_token` of the page before"),
    ),
    responses((status = 200, description = "Versions and jobs", body = json::Models), Refusals)
)]
pub async fn list_models(
    Asked(app): Asked,
    Path(name): Path<String>,
    Query(query): Query,
) -> Result<axum::Json<json::Models>, Failure> {
    let (page_size, page_token) = json::page(query)?;
    let environment = app.environments.find(&name)?;
    let page = app
        .networks
        .page(&environment, page_size, page_token.as_deref())
        .await?;
    Ok(axum::Json(proto::ListModelsResponse::from(page).into()))
}

/// Returns a version, or how far a job is.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/models/{model}",
    tag = "models",
    params(IdPath),
    responses((status = 200, description = "The version or the job", body = json::ModelOrJob), Refusals)
)]
pub async fn get_model(
    Plain(app): Plain,
    Path(path): Path<IdPath>,
) -> Result<axum::Json<ModelOrJob>, Failure> {
    let (environment, id) = path.find(&app)?;
    Ok(axum::Json(match id {
        ModelId::Version(version) => ModelOrJob::Model(Box::new(shown(
            app.networks.get(&environment, version).await?,
        ))),
        ModelId::Job(id) => ModelOrJob::Job(job_shown(app.networks.job(&environment, id)?)),
    }))
}

/// Removes a version that is not active, for ever, or ends a job.
#[utoipa::path(
    delete,
    path = "/v1/environments/{environment}/models/{model}",
    tag = "models",
    params(IdPath),
    responses((status = 204, description = "The version is gone, or the job ends"), Refusals)
)]
pub async fn delete_model(
    Plain(app): Plain,
    Path(path): Path<IdPath>,
) -> Result<StatusCode, Failure> {
    let (environment, id) = path.find(&app)?;
    app.networks.delete(&environment, id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Makes a version the one that answers for its pair, whether it beats its baselines or not.
#[utoipa::path(
    put,
    path = "/v1/environments/{environment}/models/{model}/active",
    tag = "models",
    params(VersionPath),
    responses((status = 200, description = "The version, which answers now", body = json::Model), Refusals)
)]
pub async fn activate_model(
    Plain(app): Plain,
    Path(path): Path<VersionPath>,
) -> Result<axum::Json<json::Model>, Failure> {
    let (environment, version) = path.find(&app)?;
    Ok(axum::Json(shown(
        app.networks.activate(&environment, version).await?,
    )))
}

/// Takes a version back: the one of its pair that was active before answers again, or none.
#[utoipa::path(
    delete,
    path = "/v1/environments/{environment}/models/{model}/active",
    tag = "models",
    params(VersionPath),
    responses((status = 200, description = "What answers now", body = json::RolledBack), Refusals)
)]
pub async fn roll_back_model(
    Plain(app): Plain,
    Path(path): Path<VersionPath>,
) -> Result<axum::Json<json::RolledBack>, Failure> {
    let (environment, version) = path.find(&app)?;
    let active = app
        .networks
        .roll_back(&environment, version)
        .await?
        .map(Into::into);
    Ok(axum::Json(proto::RollBackModelResponse { active }.into()))
}

/// Returns a version as a safetensors file: its weights in PyTorch's layout, with its card.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/models/{model}/weights",
    tag = "models",
    params(VersionPath),
    responses(
        (status = 200, description = "The file", body = Safetensors, content_type = "application/octet-stream"),
        Refusals
    )
)]
pub async fn export_model(
    Plain(app): Plain,
    Path(path): Path<VersionPath>,
) -> Result<Response, Failure> {
    let (environment, version) = path.find(&app)?;
    let file = app.networks.export(&environment, version).await?;

    // A name of an environment needs no quoting.
    let disposition = format!(
        "attachment; filename=\"{}-{version}.safetensors\"",
        path.environment
    );
    let headers = [
        (header::CONTENT_TYPE, OCTETS.to_owned()),
        (header::CONTENT_DISPOSITION, disposition),
    ];
    Ok((headers, file).into_response())
}

/// Keeps a network that was trained elsewhere: a safetensors file as it is returned by `weights`,
/// of at most 16 MiB.
///
/// It is judged by the counts here, and not made active.
#[utoipa::path(
    post,
    path = "/v1/environments/{environment}/models/import",
    tag = "models",
    params(("environment" = String, Path, description = "The environment's name")),
    request_body(content = Safetensors, description = "The file", content_type = "application/octet-stream"),
    responses((status = 201, description = "The version that was made of it", body = json::Model), Refusals)
)]
pub async fn import_model(
    Plain(app): Plain,
    Path(name): Path<String>,
    File(file): File,
) -> Result<Response, Failure> {
    let environment = app.environments.find(&name)?;
    let model = app.networks.import(&environment, file.into()).await?;
    let location = format!("/v1/environments/{name}/models/{}", model.version);
    Ok((
        StatusCode::CREATED,
        [(header::LOCATION, location)],
        axum::Json(shown(model)),
    )
        .into_response())
}

fn shown(model: Model) -> json::Model {
    proto::Model::from(model).into()
}

fn job_shown(job: Job) -> json::Job {
    proto::Job::from(job).into()
}
