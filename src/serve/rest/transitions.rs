//! Ingest of transitions, each counted once (idempotency), and how far a producer is.

use std::sync::Arc;

use super::extract::{Asked, Document, Media, Path, Plain, Query};
use super::refusals::Refusals;
use crate::api::json::Incoming;
use crate::api::{grpc, json, proto};
use crate::app::App;
use crate::domain::{Environment, Schema};
use crate::environments::is_known_as;
use crate::error::Problem;
use crate::serve::status::Failure;
use crate::telemetry;
use crate::work::aside;

/// Counts one batch of transitions, once however often it is sent, and answers after it is on
/// stable storage.
///
/// A transition that cannot be counted is rejected on its own, and the receipt says why: read its
/// `status`, for a batch of which nothing was counted is answered by 200 too, because its number is
/// used. As `application/x-ndjson` the body is a transition a line, and producer, sequence, segment
/// and environment_uid are query parameters.
#[utoipa::path(
    post,
    path = "/v1/environments/{environment}/transitions",
    tag = "transitions",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        ("producer" = Option<String>, Query, description = "Who sends; with `application/x-ndjson` only, and required there"),
        ("sequence" = Option<u64>, Query, minimum = 1, maximum = 9_223_372_036_854_775_807_i64, description = "The batch's number; with `application/x-ndjson` only, and required there"),
        ("segment" = Option<String>, Query, max_length = 64, description = "Where its transitions come from, absent or empty for no segment; with `application/x-ndjson` only"),
        ("environment_uid" = Option<String>, Query, description = "The environment's uid if the sender knows it; with `application/x-ndjson` only"),
    ),
    request_body(content((json::Transitions = "application/json"), (json::Transition = "application/x-ndjson"))),
    responses((status = 200, description = "The receipt", body = json::Receipt), Refusals)
)]
pub async fn write_transitions(
    Asked(app): Asked,
    Path(name): Path<String>,
    query: Query,
    document: Document,
) -> Result<axum::Json<json::Receipt>, Failure> {
    let decoding = decoded(&app, &name, query, document).await;
    let (
        environment,
        Incoming {
            producer, batch, ..
        },
    ) = decoding.inspect_err(|problem| telemetry::refused(problem.reason))?;

    let sequence = batch.sequence;
    let told = app.ingest.write(&environment, producer, batch).await?;
    Ok(axum::Json(grpc::receipt(sequence, told).into()))
}

/// Returns the last committed sequence of a producer, so that it knows what to send next.
#[utoipa::path(
    get,
    path = "/v1/environments/{environment}/producers/{producer}",
    tag = "transitions",
    params(
        ("environment" = String, Path, description = "The environment's name"),
        ("producer" = String, Path, description = "The producer's id"),
    ),
    responses((status = 200, description = "How far the producer is", body = json::Producer), Refusals)
)]
pub async fn get_producer(
    Plain(app): Plain,
    Path((name, producer)): Path<(String, String)>,
) -> Result<axum::Json<json::Producer>, Failure> {
    let environment = app.environments.find(&name)?;
    let committed = app
        .ingest
        .committed(&environment, &grpc::producer(&producer)?)
        .await?;
    let environment_uid = environment.uid.to_string();

    Ok(axum::Json(
        proto::GetProducerResponse {
            committed_sequence: committed.get(),
            environment_uid,
        }
        .into(),
    ))
}

/// Finds out for whom a batch is and what is in it, before ingestion sees it.
async fn decoded(
    app: &App,
    name: &str,
    query: Query,
    document: Document,
) -> Result<(Arc<Environment>, Incoming), Problem> {
    let environment = app.environments.find(name)?;
    let schema = environment.schema.clone();
    let Query(query) = query;
    let incoming = aside(document.bytes.len(), move || {
        decode(&schema, query, &document)
    })
    .await??;
    is_known_as(&environment, &incoming.environment_uid)?;
    Ok((environment, incoming))
}

fn decode(
    schema: &Schema,
    query: json::Parameters,
    document: &Document,
) -> Result<Incoming, Problem> {
    match document.media {
        Media::Json => {
            json::no_head(query).and_then(|()| json::batch_of_json(schema, &document.bytes))
        }
        Media::Lines => json::batch_of_lines(schema, json::head_of_query(query)?, &document.bytes),
    }
}
