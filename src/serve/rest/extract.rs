//! Extractors: what handlers take out of a request. What cannot be taken is a problem, as
//! everywhere.

use std::convert::Infallible;
use std::error::Error;
use std::sync::Arc;

use axum::extract::{self, FromRequest, FromRequestParts, Request};
use bytes::{Bytes, BytesMut};
use http::request::Parts;
use http::{HeaderMap, header};
use http_body::Body;
use http_body_util::{BodyExt, LengthLimitError};
use serde::de::DeserializeOwned;

use super::layers::MOST_BODY_BYTES;
use super::packed::Packing;
use crate::api::json::{self, Parameters};
use crate::app::App;
use crate::error::{Fault, Problem};
use crate::serve::access::Caller;
use crate::serve::connections::memory::Charge;
use crate::serve::status::Failure;
use crate::work::{aside, beside};

/// The rooms of the service as they are for whoever asks.
pub struct Asked(pub App);

impl FromRequestParts<App> for Asked {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Infallible> {
        let caller = parts
            .extensions
            .get::<Caller>()
            .cloned()
            .unwrap_or_default();
        Ok(Self(app.asked_by(caller.asker())))
    }
}

/// The rooms of the service for whoever asks without parameters: one that is given is unknown.
pub struct Plain(pub App);

impl FromRequestParts<App> for Plain {
    type Rejection = Failure;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Failure> {
        let Query(query) = Query::from_request_parts(parts, app).await?;
        query.finish(())?;
        let Ok(Asked(app)) = Asked::from_request_parts(parts, app).await;
        Ok(Self(app))
    }
}

/// The variable parts of the path.
pub struct Path<T>(pub T);

/// The parameters of the query string.
pub struct Query(pub Parameters);

/// A body that is one JSON document.
pub struct Json<T>(pub T);

/// A body that is one JSON document, or empty: then it is the default.
pub struct OptionalJson<T>(pub T);

/// A body of any type.
pub struct Octets(pub Bytes);

/// The most bytes that a body may have on a path, unpacked, where that is less than everywhere.
#[derive(Debug, Clone, Copy)]
pub struct MostBytes(pub usize);

/// A body that is a file.
pub struct File(pub Bytes);

/// The media type of a file.
pub const OCTETS: &str = "application/octet-stream";

/// A body with its media type.
pub struct Document {
    /// What the bytes are.
    pub media: Media,
    /// The body.
    pub bytes: Bytes,
}

/// A media type that some path takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Media {
    /// One JSON document.
    Json,
    /// A JSON document a line.
    Lines,
}

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Path<T> {
    type Rejection = Failure;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Failure> {
        match extract::Path::from_request_parts(parts, state).await {
            Ok(extract::Path(path)) => Ok(Self(path)),
            Err(rejection) => {
                Err(Problem::invalid("path", vec![Fault::new("", rejection.body_text())]).into())
            }
        }
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Query {
    type Rejection = Failure;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Failure> {
        match extract::Query::try_from_uri(&parts.uri) {
            Ok(extract::Query(pairs)) => Ok(Self(Parameters::new(pairs))),
            Err(rejection) => {
                Err(Problem::invalid("query", vec![Fault::new("", rejection.body_text())]).into())
            }
        }
    }
}

impl<T: DeserializeOwned + Send + 'static, S: Send + Sync> FromRequest<S> for Json<T> {
    type Rejection = Failure;

    async fn from_request(request: Request, state: &S) -> Result<Self, Failure> {
        Self::from_document(Document::from_request(request, state).await?).await
    }
}

impl<T: DeserializeOwned + Send + 'static> Json<T> {
    async fn from_document(document: Document) -> Result<Self, Failure> {
        match document.media {
            Media::Json => {
                let bytes = document.bytes;
                Ok(Self(
                    aside(bytes.len(), move || json::decode("body", &bytes)).await??,
                ))
            }
            Media::Lines => Err(Failure::of_media_type(LINES[0], JSON)),
        }
    }
}

impl<S: Send + Sync> FromRequest<S> for Document {
    type Rejection = Failure;

    async fn from_request(request: Request, _: &S) -> Result<Self, Failure> {
        let media = media(request.headers())?;
        Ok(Self {
            media,
            bytes: body(request).await?,
        })
    }
}

impl<T: DeserializeOwned + Default + Send + 'static, S: Send + Sync> FromRequest<S>
    for OptionalJson<T>
{
    type Rejection = Failure;

    async fn from_request(request: Request, _: &S) -> Result<Self, Failure> {
        let headers = request.headers().clone();
        let bytes = body(request).await?;
        match bytes.is_empty() {
            true => Ok(Self(T::default())),
            false => {
                let document = Document {
                    media: media(&headers)?,
                    bytes,
                };
                Json::from_document(document)
                    .await
                    .map(|Json(value)| Self(value))
            }
        }
    }
}

impl<S: Send + Sync> FromRequest<S> for File {
    type Rejection = Failure;

    async fn from_request(request: Request, _: &S) -> Result<Self, Failure> {
        match content_type(request.headers()) {
            (_, essence) if essence == OCTETS => Ok(Self(body(request).await?)),
            (found, _) => Err(Failure::of_media_type(found, OCTETS)),
        }
    }
}

impl<S: Send + Sync> FromRequest<S> for Octets {
    type Rejection = Failure;

    async fn from_request(request: Request, _: &S) -> Result<Self, Failure> {
        Ok(Self(body(request).await?))
    }
}

/// Collects a body, and unpacks it if it is packed. Its bytes are bounded, and charged as they
/// come.
async fn body(request: Request) -> Result<Bytes, Failure> {
    let packing = Packing::from_headers(request.headers())?;
    let MostBytes(most) = request
        .extensions()
        .get()
        .copied()
        .unwrap_or(MostBytes(MOST_BODY_BYTES));

    let charge: Option<Arc<Charge>> = request.extensions().get().cloned();
    let sent = collected(request.into_body(), most, charge.as_deref()).await?;

    match packing {
        // Who has nothing to send may say that it is packed.
        Some(packing) if !sent.is_empty() => {
            beside(move || packing.unpack(&sent, most, charge.as_deref())).await?
        }
        _ => Ok(sent),
    }
}

async fn collected(
    mut body: axum::body::Body,
    most: usize,
    charge: Option<&Charge>,
) -> Result<Bytes, Failure> {
    if body.size_hint().lower() > most as u64 {
        return Err(Failure::of_size(most));
    }
    let (mut only, mut joined) = (Bytes::new(), BytesMut::new());
    while let Some(frame) = body.frame().await {
        let Ok(data) = frame.map_err(|error| unreadable(&error))?.into_data() else {
            continue;
        };
        if let Some(charge) = charge {
            charge.grow(data.len())?;
        }
        if only.len() + joined.len() + data.len() > most {
            return Err(Failure::of_size(most));
        }

        // Most bodies are of one piece, which needs no copy.
        if only.is_empty() && joined.is_empty() {
            only = data;
        } else {
            joined.extend_from_slice(&std::mem::take(&mut only));
            joined.extend_from_slice(&data);
        }
    }
    Ok(if joined.is_empty() {
        only
    } else {
        joined.freeze()
    })
}

/// Tells why a body cannot be read: what our own layers say of it, or what is wrong with its bytes.
fn unreadable(error: &axum::Error) -> Failure {
    let mut cause: &dyn Error = error;
    loop {
        if let Some(problem) = cause.downcast_ref::<Problem>() {
            return problem.clone().into();
        }
        if cause.is::<LengthLimitError>() {
            return Failure::of_size(MOST_BODY_BYTES);
        }
        match cause.source() {
            Some(deeper) => cause = deeper,
            None => {
                return Problem::invalid(
                    "body",
                    vec![Fault::new("", format!("it cannot be read: {cause}"))],
                )
                .into();
            }
        }
    }
}

const JSON: &str = "application/json";
const LINES: [&str; 3] = [
    "application/x-ndjson",
    "application/ndjson",
    "application/jsonl",
];

/// A body without a type is refused too: a browser sends such a body to another site without asking
/// that site first.
fn media(headers: &HeaderMap) -> Result<Media, Failure> {
    let (found, essence) = content_type(headers);
    let structured = essence.starts_with("application/") && essence.ends_with("+json");
    match essence.as_str() {
        JSON => Ok(Media::Json),
        _ if structured => Ok(Media::Json),
        lines if LINES.contains(&lines) => Ok(Media::Lines),
        _ => Err(Failure::of_media_type(
            found,
            "application/json, or application/x-ndjson for transitions",
        )),
    }
}

/// Returns the type as it was given, and without its parameters.
fn content_type(headers: &HeaderMap) -> (&str, String) {
    let found = headers
        .get(header::CONTENT_TYPE)
        .and_then(|value| value.to_str().ok())
        .unwrap_or_default();
    (
        found,
        found
            .split(';')
            .next()
            .unwrap_or_default()
            .trim()
            .to_ascii_lowercase(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn media_of(text: &str) -> Option<Media> {
        let mut headers = HeaderMap::new();
        headers.insert(header::CONTENT_TYPE, text.parse().expect("a header"));
        media(&headers).ok()
    }

    #[test]
    fn media_types_are_read_without_their_parameters() {
        assert_eq!(media_of("application/json"), Some(Media::Json));
        assert_eq!(
            media_of("Application/JSON; charset=utf-8"),
            Some(Media::Json)
        );
        assert_eq!(media_of("application/merge-patch+json"), Some(Media::Json));
        assert_eq!(media_of("application/x-ndjson"), Some(Media::Lines));
        for other in [
            "text/plain",
            "application/x-www-form-urlencoded",
            "application/jsonp",
            "",
            "json",
            ";",
        ] {
            assert_eq!(media_of(other), None, "{other}");
        }
        assert!(media(&HeaderMap::new()).is_err());
    }
}
