//! The Open Inference Protocol, version 2, over REST: `/v2` at the root. Over gRPC it is in
//! `serve::grpc`; both ask [`served`].
//!
//! Its errors are `{"error": text}`, for paths that are not served too. It is not in the OpenAPI
//! document, every operation of which refuses with a problem: the protocol has a document of its
//! own.

pub mod served;

use axum::Router;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use http::{HeaderMap, HeaderName, header};
use serde::Deserialize;
use serde_json::{Value, json};

use self::served::{ModelName, Served};
use super::operations;
use super::rest::extract::{Asked, Octets, Path};
use super::rest::{layers, problems};
use super::status::Failure;
use crate::api::inference::grpc;
use crate::api::inference::rest::{self, Encoded};
use crate::api::inference_proto::ModelMetadataResponse;
use crate::app::App;
use crate::work::aside;

const HEADER_LENGTH: HeaderName = HeaderName::from_static(rest::HEADER_LENGTH);

/// Returns the routes below `/v2`.
pub fn router(app: App) -> Router {
    let routes = routes().with_state(app);
    let unknown = Router::new().route(
        "/v2/{*path}",
        problems::unknown_path(PATHS.map(str::to_owned)),
    );
    layers::around(routes.merge(unknown), Failure::tell_text)
}

/// Every path, for those who mistype one.
const PATHS: [&str; 9] = [
    "/v2",
    "/v2/health/live",
    "/v2/health/ready",
    "/v2/models/{model}",
    "/v2/models/{model}/ready",
    "/v2/models/{model}/infer",
    "/v2/models/{model}/versions/{version}",
    "/v2/models/{model}/versions/{version}/ready",
    "/v2/models/{model}/versions/{version}/infer",
];

fn routes() -> Router<App> {
    Router::new()
        .route("/v2", get(server))
        .route("/v2/", get(server))
        .route("/v2/health/live", get(live))
        .route("/v2/health/ready", get(ready))
        .route("/v2/models/{model}", get(metadata))
        .route("/v2/models/{model}/ready", get(model_ready))
        .route("/v2/models/{model}/infer", post(infer))
        .route("/v2/models/{model}/versions/{version}", get(metadata))
        .route(
            "/v2/models/{model}/versions/{version}/ready",
            get(model_ready),
        )
        .route("/v2/models/{model}/versions/{version}/infer", post(infer))
}

/// What a path names.
#[derive(Deserialize)]
struct Named {
    model: String,
    #[serde(default)]
    version: String,
}

impl Named {
    fn name(&self) -> ModelName<'_> {
        ModelName {
            model: &self.model,
            version: &self.version,
        }
    }
}

async fn server() -> axum::Json<rest::Server> {
    axum::Json(grpc::server().into())
}

async fn live() -> axum::Json<Value> {
    axum::Json(json!({ "live": true }))
}

async fn ready(Asked(app): Asked) -> Result<axum::Json<Value>, Failure> {
    app.prove().await;
    operations::ready(&app).await?;
    Ok(axum::Json(json!({ "ready": true })))
}

async fn model_ready(
    Asked(app): Asked,
    Path(named): Path<Named>,
) -> Result<axum::Json<Value>, Failure> {
    Served::find(&app, named.name()).await?;
    operations::ready(&app).await?;
    Ok(axum::Json(json!({ "name": named.model, "ready": true })))
}

async fn metadata(
    Asked(app): Asked,
    Path(named): Path<Named>,
) -> Result<axum::Json<rest::Model>, Failure> {
    let metadata = Served::find(&app, named.name())
        .await?
        .metadata(&app)
        .await?;
    Ok(axum::Json(ModelMetadataResponse::from(metadata).into()))
}

/// Takes a body of any type: clients send none, and what a page could make a browser send changes
/// nothing here.
async fn infer(
    Asked(app): Asked,
    Path(named): Path<Named>,
    headers: HeaderMap,
    Octets(body): Octets,
) -> Result<Response, Failure> {
    let header_length = headers
        .get(HEADER_LENGTH)
        .map(|value| value.to_str().unwrap_or_default());
    let header_length = header_length.map(ToOwned::to_owned);
    let bytes = body.len();
    let (request, form) = aside(bytes, move || {
        rest::request(&body, header_length.as_deref())
    })
    .await??;
    let answer = served::infer(&app, named.name(), request).await?;

    Ok(response(
        aside(bytes, move || Encoded::new(&answer, &form)).await?,
    ))
}

fn response(encoded: Encoded) -> Response {
    let Encoded {
        header_length,
        body,
    } = encoded;
    match header_length {
        None => ([(header::CONTENT_TYPE, "application/json")], body).into_response(),
        Some(length) => {
            let headers = [
                (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
                (HEADER_LENGTH, length.to_string()),
            ];
            (headers, body).into_response()
        }
    }
}
