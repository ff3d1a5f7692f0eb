//! The REST face: paths, and what is done for every request on them.
//!
//! A handler decodes a draft, asks the room that knows, and encodes what it says. What is wrong
//! with the input is decided further in.

mod accept;
mod environments;
pub mod extract;
mod graph;
mod influence;
mod json_answer;
pub mod layers;
mod learning;
mod models;
mod nearest;
mod openapi;
mod packed;
mod pages;
mod parameters;
pub mod problems;
mod refusals;
mod states;
mod summary;
mod transitions;

use axum::routing::{get, post, put};
use axum::{Extension, Router};

use self::extract::MostBytes;
use super::status::Failure;
use crate::api::MOST_MESSAGE_BYTES;
use crate::app::App;

/// What is served beside the documented routes.
const OTHERS: [&str; 6] = [
    "/livez",
    "/readyz",
    "/metrics",
    "/openapi.json",
    "/docs",
    "/v2",
];

/// Returns the REST face with its pages.
pub fn router(app: App) -> Router {
    let routes = routes().with_state(app);
    let paths = documented()
        .into_iter()
        .filter_map(|route| Some(route.split_once(' ')?.1.to_owned()));
    let unknown = problems::unknown_path(paths.chain(OTHERS.map(str::to_owned)));
    layers::around(
        routes.merge(pages::router()).fallback_service(unknown),
        Failure::tell,
    )
}

fn routes() -> Router<App> {
    let environment = put(environments::apply_environment)
        .get(environments::get_environment)
        .patch(environments::update_rule)
        .delete(environments::delete_environment)
        // A description is no longer than a message. How much it may describe is for the domain to
        // say.
        .layer(Extension(MostBytes(MOST_MESSAGE_BYTES)));
    let influence = get(influence::get_influence).post(influence::batch_get_influence);
    Router::new()
        .route("/v1/environments", get(environments::list_environments))
        .route("/v1/environments/{environment}", environment)
        .route(
            "/v1/environments/{environment}/transitions",
            post(transitions::write_transitions),
        )
        .route(
            "/v1/environments/{environment}/producers/{producer}",
            get(transitions::get_producer),
        )
        .route("/v1/environments/{environment}/influence", influence)
        .route(
            "/v1/environments/{environment}/states",
            get(states::list_states),
        )
        .route(
            "/v1/environments/{environment}/states/{key}",
            get(states::get_state),
        )
        .route(
            "/v1/environments/{environment}/summary",
            get(summary::summarize),
        )
        .route(
            "/v1/environments/{environment}/graph",
            get(graph::get_graph),
        )
        .route(
            "/v1/environments/{environment}/explore",
            get(learning::explore),
        )
        .route(
            "/v1/environments/{environment}/fit",
            post(learning::fit_prior),
        )
        .merge(models())
}

fn models() -> Router<App> {
    let active = put(models::activate_model).delete(models::roll_back_model);
    Router::new()
        .route(
            "/v1/environments/{environment}/models",
            get(models::list_models).post(models::train_model),
        )
        .route(
            "/v1/environments/{environment}/models/import",
            post(models::import_model),
        )
        .route(
            "/v1/environments/{environment}/models/{model}",
            get(models::get_model).delete(models::delete_model),
        )
        .route(
            "/v1/environments/{environment}/models/{model}/active",
            active,
        )
        .route(
            "/v1/environments/{environment}/models/{model}/weights",
            get(models::export_model),
        )
}

/// Returns every documented route: `GET /v1/environments`.
pub fn documented() -> Vec<String> {
    let document = serde_json::to_value(openapi::document()).unwrap_or_default();
    let paths = document["paths"].as_object().into_iter().flatten();
    let routes = paths.flat_map(|(path, methods)| {
        let methods = methods
            .as_object()
            .into_iter()
            .flatten()
            .map(|(method, _)| method.to_uppercase());
        methods.map(move |method| format!("{method} {path}"))
    });
    routes
        .filter(|route| route.starts_with(|first: char| first.is_ascii_uppercase()))
        .collect()
}
