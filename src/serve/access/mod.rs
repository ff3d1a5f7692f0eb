//! Authentication, authorization and what browsers may be made to send: one layer before every
//! face.
//!
//! | room | for |
//! |---|---|
//! | `keyring` | the keys that are let in now, and who asks with one |
//! | `wanted` | what each endpoint wants: one table |
//! | `hosts` | by which names the service may be asked for (DNS rebinding) |
//! | `origins` | whose pages may change something (cross-site request forgery) |
//! | `denials` | how who is not let in is told, and counted |
//!
//! A request is looked at before its body is read, and as long as it is under way: a key that is
//! withdrawn while a body trickles in, or while an answer is made, ends it. Which environment it is
//! about, only its body may say: that is asked where the environment is found.

mod denials;
mod hosts;
mod keyring;
mod origins;
mod wanted;

use std::sync::Arc;

use axum::body::Body;
use axum::extract::{MatchedPath, Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use tracing::Span;

use self::denials::{unauthenticated, word};
use self::hosts::Hosts;
pub use self::keyring::{Caller, Keyring};
use self::origins::Origins;
pub use self::wanted::Wanted;
use super::operations;
use super::requests::is_grpc;
use super::settings::{Endpoint, Settings};
use super::status::{self, Failure};
use crate::access::{bearer, redacted};
use crate::error::Problem;
use crate::telemetry;

/// The middleware of authentication and authorization: who is let in. Cloning is cheap.
#[derive(Clone)]
pub struct Guard(Arc<Rules>);

struct Rules {
    keys: Option<Keyring>,
    hosts: Hosts,
    origins: Origins,
}

impl Guard {
    /// Makes the guard of a service.
    pub fn new(settings: &Settings, endpoint: &Endpoint) -> Self {
        let hosts = Hosts::new(endpoint.ip, &settings.hosts);
        let origins = Origins::new(&settings.cors_origins, endpoint.speaks_tls, &settings.hosts);

        Self(Arc::new(Rules {
            keys: settings.keys.clone(),
            hosts,
            origins,
        }))
    }
}

/// Lets a request in with its [`Caller`], or refuses it in the form of its face.
pub async fn admit(State(guard): State<Guard>, mut request: Request, next: Next) -> Response {
    match guard.0.admit(&request) {
        Ok(caller) => {
            if let Some(name) = caller.principal().name() {
                Span::current().record("principal", name.as_str());
            }
            request.extensions_mut().insert(caller.clone());
            if caller.has_key() {
                while_it_stands(&caller, request, next).await
            } else {
                next.run(request).await
            }
        }
        Err(refusal) => {
            let form = Form::of_request(&request);
            refusal.count(&form.path);
            refusal.tell(&form)
        }
    }
}

/// Answers a request unless its key is withdrawn before: what it began is dropped, as where its
/// time is over.
async fn while_it_stands(caller: &Caller, request: Request, next: Next) -> Response {
    let form = Form::of_request(&request);
    tokio::select! {
        biased;
        problem = caller.withdrawn() => Refusal::Problem(problem).tell(&form),
        response = next.run(request) => response,
    }
}

/// What a refusal has to know of its request.
struct Form {
    path: String,
    /// The content type of a call of gRPC.
    grpc: Option<HeaderValue>,
}

impl Form {
    fn of_request(request: &Request) -> Self {
        let media = request
            .headers()
            .get(header::CONTENT_TYPE)
            .filter(|_| is_grpc(request.headers()));
        Self {
            path: request.uri().path().to_owned(),
            grpc: media.cloned(),
        }
    }
}

/// Why a request is not let in.
enum Refusal {
    /// Because of who asks.
    Problem(Problem),
    /// Because it is no call of gRPC, where gRPC is served.
    Protocol(Failure),
}

impl From<Problem> for Refusal {
    fn from(problem: Problem) -> Self {
        Self::Problem(problem)
    }
}

impl Rules {
    fn admit(&self, request: &Request) -> Result<Caller, Refusal> {
        let wanted = Wanted::of_request(request);
        let caller = self.authenticate(request, wanted);
        let has_key = matches!(&caller, Ok(Some(caller)) if caller.principal().name().is_some());
        if !has_key && !operations::is_asked_by_machines(request) {
            self.hosts.admit(request)?;
        }
        self.origins.admit(request)?;
        let caller = match (wanted, caller) {
            (Wanted::Nothing, caller) => {
                is_what_its_path_takes(request)?;
                return Ok(caller.ok().flatten().unwrap_or_default());
            }
            (_, Ok(Some(caller))) => caller,
            (_, Ok(None)) => {
                return Err(
                    unauthenticated("this wants a key: send `authorization: Bearer KEY`").into(),
                );
            }
            (_, Err(problem)) => return Err(problem.into()),
        };
        wanted.authorize(caller.principal())?;
        is_what_its_path_takes(request)?;
        caller.take()?;
        Ok(caller)
    }

    /// Finds out who asks; nobody where there is no key.
    fn authenticate(&self, request: &Request, wanted: Wanted) -> Result<Option<Caller>, Problem> {
        let Some(keys) = &self.keys else {
            return Ok(Some(Caller::anonymous()));
        };

        let headers = request
            .headers()
            .get_all(header::AUTHORIZATION)
            .iter()
            .map(|value| value.as_bytes());

        let Some(key) = bearer(headers).map_err(|why| unauthenticated(why.to_string()))? else {
            return Ok(None);
        };

        let caller = keys
            .caller(key, wanted)
            .ok_or_else(|| unauthenticated("the key is not one that is let in"))?;
        Ok(Some(caller))
    }
}

/// Refuses what does not say that it is gRPC where gRPC is served: pages can make a browser send
/// every other type, and every other method that has no body, without asking.
fn is_what_its_path_takes(request: &Request) -> Result<(), Refusal> {
    let is_preflight = request.method() == Method::OPTIONS;
    // Whoever asks for what is not served is told so.
    let is_served = request.extensions().get::<MatchedPath>().is_some();
    if is_preflight || !is_served || !wanted::is_grpc_path(request.uri().path()) {
        return Ok(());
    }

    if request.method() != Method::POST {
        return Err(Refusal::Protocol(Failure::of_http(
            StatusCode::METHOD_NOT_ALLOWED,
        )));
    }

    if is_protobuf(request.headers()) {
        return Ok(());
    }

    let found = request
        .headers()
        .get(header::CONTENT_TYPE)
        .and_then(|media| media.to_str().ok())
        .unwrap_or_default();

    Err(Refusal::Protocol(Failure::of_media_type(
        found,
        "application/grpc, or application/grpc-web",
    )))
}

/// Returns whether a call is of gRPC or gRPC-Web, and its messages of the one encoding that is
/// read: `application/grpc+json` would be read as another.
fn is_protobuf(headers: &HeaderMap) -> bool {
    const TYPES: [&str; 6] = [
        "application/grpc",
        "application/grpc+proto",
        "application/grpc-web",
        "application/grpc-web+proto",
        "application/grpc-web-text",
        "application/grpc-web-text+proto",
    ];
    let media = headers
        .get(header::CONTENT_TYPE)
        .and_then(|media| media.to_str().ok())
        .unwrap_or_default();
    TYPES.contains(&media.split(';').next().unwrap_or_default().trim())
}

impl Refusal {
    fn count(&self, path: &str) {
        match self {
            Self::Protocol(_) => telemetry::denied("media"),
            Self::Problem(problem) => {
                telemetry::denied(word(problem.reason));
                tracing::debug!(
                    reason = problem.reason,
                    path = redacted(path),
                    "a request was not let in"
                );
            }
        }
    }

    fn tell(self, Form { path, grpc }: &Form) -> Response {
        match (self, grpc) {
            (Self::Protocol(failure), _) => {
                let mut response = failure.tell(path);
                if response.status() == StatusCode::METHOD_NOT_ALLOWED {
                    response
                        .headers_mut()
                        .insert(header::ALLOW, HeaderValue::from_static("POST"));
                }
                response
            }
            (Self::Problem(problem), Some(media)) => {
                let mut response = status::grpc(problem).into_http::<Body>();
                response
                    .headers_mut()
                    .insert(header::CONTENT_TYPE, media.clone());
                response.into_response()
            }
            (Self::Problem(problem), None) if path == "/v2" || path.starts_with("/v2/") => {
                Failure::from(problem).tell_text(path)
            }
            (Self::Problem(problem), None) => Failure::from(problem).tell(path),
        }
    }
}
