//! JSON answers, serialised beside the executor where they are long, so that nobody waits for it.

use axum::response::{IntoResponse, Response};
use http::header;
use serde::Serialize;

use crate::error::{ErrorKind, Problem};
use crate::serve::status::Failure;
use crate::work::aside;

/// Answers with what is made, which takes about so many bytes of JSON.
pub async fn json_answer<T: Serialize>(
    bytes: usize,
    make: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<Response, Failure> {
    let encode = move || serde_json::to_vec(&make()?).map_err(|error| unencodable(&error));
    let body = aside(bytes, encode).await??;
    Ok(([(header::CONTENT_TYPE, "application/json")], body).into_response())
}

fn unencodable(error: &serde_json::Error) -> Problem {
    tracing::error!(%error, "an answer could not be encoded");
    Problem::new(
        ErrorKind::Internal,
        "INTERNAL",
        "the service failed; the cause is in its log",
    )
}
