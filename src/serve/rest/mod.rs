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
mod profile;
mod refusals;
mod regions;
mod routes;
mod states;
mod summary;
mod transitions;

use axum::Router;

use super::status::Failure;
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
    let (routes, _) = routes::routes().with_state(app).split_for_parts();
    let paths = documented()
        .into_iter()
        .filter_map(|route| Some(route.split_once(' ')?.1.to_owned()));
    let unknown = problems::unknown_path(paths.chain(OTHERS.map(str::to_owned)));
    layers::around(
        routes.merge(pages::router()).fallback_service(unknown),
        Failure::tell,
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
