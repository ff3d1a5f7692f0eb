//! The documented routes. Method and path stand once, in a handler's `#[utoipa::path]`, for the
//! router and for the OpenAPI document.

use axum::Extension;
use utoipa_axum::router::{OpenApiRouter, UtoipaMethodRouterExt};
use utoipa_axum::routes;

use super::extract::MostBytes;
use super::{
    environments, graph, influence, learning, models, profile, regions, states, summary,
    transitions,
};
use crate::api::MOST_MESSAGE_BYTES;
use crate::app::App;

/// Returns the routes; those of one path stand together.
pub fn routes() -> OpenApiRouter<App> {
    let environment = routes!(
        environments::apply_environment,
        environments::get_environment,
        environments::update_environment,
        environments::delete_environment
    );
    OpenApiRouter::new()
        .routes(routes!(environments::list_environments))
        // A description is no longer than a message. How much it may describe is for the domain to
        // say.
        .routes(environment.layer(Extension(MostBytes(MOST_MESSAGE_BYTES))))
        .routes(routes!(transitions::write_transitions))
        .routes(routes!(transitions::get_producer))
        .routes(routes!(
            influence::get_influence,
            influence::batch_get_influence
        ))
        .routes(routes!(states::list_states))
        .routes(routes!(states::get_state))
        .routes(routes!(summary::summarize))
        .routes(routes!(profile::get_profile, profile::ask_profile))
        .routes(routes!(regions::get_regions, regions::ask_regions))
        .routes(routes!(graph::get_graph))
        .routes(routes!(learning::explore))
        .routes(routes!(learning::fit_prior))
        .merge(models())
}

fn models() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(models::list_models, models::train_model))
        .routes(routes!(models::import_model))
        .routes(routes!(models::get_model, models::delete_model))
        .routes(routes!(models::activate_model, models::roll_back_model))
        .routes(routes!(models::export_model))
}
