//! Every route of every face on one router, and the layers around them: who is let in, and what is
//! noted of whom.

use axum::{Router, middleware};
use tower::util::MapRequestLayer;
use tower_http::catch_panic::CatchPanicLayer;

use super::access::{self, Guard};
use super::settings::{Endpoint, Settings};
use super::{cors, grpc, inference, operations, requests, rest};
use crate::app::App;

/// Returns every route of every face.
pub async fn router(
    app: App,
    settings: &Settings,
    endpoint: &Endpoint,
) -> Result<Router, tonic_reflection::server::Error> {
    // Without this an unknown REST path would answer 200 with a gRPC status.
    let grpc = grpc::routes(app.clone())
        .await?
        .into_axum_router()
        .reset_fallback();
    let grpc = grpc
        .layer(CatchPanicLayer::custom(grpc::of_panic))
        .layer(middleware::from_fn(grpc::in_time));
    let grpc = grpc
        .layer(middleware::from_fn(grpc::give_reasons))
        .layer(middleware::from_fn(requests::note_code));
    let grpc = grpc
        .layer(tonic_web::GrpcWebLayer::new())
        .layer(middleware::from_fn(grpc::over_http_2));

    let router = rest::router(app.clone())
        .merge(inference::router(app.clone()))
        .merge(operations::router(app))
        .merge(grpc);
    requests::expect(rest::documented());

    let guard = Guard::new(settings, endpoint);
    let router = router.layer(middleware::from_fn_with_state(guard, access::admit));
    Ok(cors::allow(router, &settings.cors_origins)
        .layer(MapRequestLayer::new(requests::note_route)))
}
