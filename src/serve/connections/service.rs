//! Middleware between a connection and the routes: it notes when requests begin and end, and
//! watches their bodies.

use std::convert::Infallible;
use std::net::IpAddr;
use std::sync::Arc;

use axum::Router;
use axum::body::Body;
use futures::FutureExt;
use futures::future::BoxFuture;
use http::request::Parts;
use http::uri::Authority;
use http::{Request, Response, Version, header};
use hyper::body::Incoming;
use tower::ServiceExt;
use tracing::Instrument;

use super::crowd::Standing;
use super::framing::Framing;
use super::leaving::Leaving;
use super::memory::{Budget, Charge};
use super::received::{BodyProperties, Form, Received};
use super::sent::Sent;
use super::vitals::Vitals;
use crate::error::{ErrorKind, Fault, Problem};
use crate::serve::operations;
use crate::serve::requests::{Call, is_grpc};
use crate::serve::status::{self, Failure};
use crate::telemetry;

/// Calls whose sender goes on for as long as it likes.
const STREAMS: [&str; 3] = [
    "/nudge.v1.IngestService/Ingest",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
];

/// The routes, for one connection.
pub struct Watched {
    /// What is served.
    pub router: Router,
    /// The connection.
    pub vitals: Arc<Vitals>,
    /// What it may do.
    pub standing: Standing,
    /// Where the bytes of its messages come from.
    pub budget: Arc<Budget>,
    /// From where it comes.
    pub peer: Option<IpAddr>,
}

impl hyper::service::Service<Request<Incoming>> for Watched {
    type Response = Response<Sent>;
    type Error = Infallible;
    type Future = BoxFuture<'static, Result<Response<Sent>, Infallible>>;

    fn call(&self, request: Request<Incoming>) -> Self::Future {
        let progress = Arc::new(self.vitals.begin(request.version()));
        let charge = Arc::new(Charge::new(self.budget.clone()));
        let (mut parts, body) = request.into_parts();
        let mut call = Call::begin(&mut parts, self.peer);
        let body = Received::new(
            body,
            body_properties(&parts),
            charge.clone(),
            progress.clone(),
            call.noted(),
        );

        if let Some(refusal) = self.refusal(&parts) {
            self.vitals.leaving.cancel();
            let refusal = call
                .answered(refused(&parts, refusal))
                .map(|body| Sent::new(body, progress, call));
            return async { Ok(refusal) }.boxed();
        }

        if self.standing == Standing::Guest {
            self.vitals.leaving.cancel();
        }
        parts.extensions.insert(charge.clone());
        parts
            .extensions
            .insert(Leaving(self.vitals.leaving.clone()));
        let answer = self
            .router
            .clone()
            .oneshot(Request::from_parts(parts, body));
        let span = call.span();
        let answer = async move {
            let Ok(response) = answer.await;
            // What was asked is in other hands now, or done with.
            charge.release();
            Ok(call
                .answered(response)
                .map(|body| Sent::new(body, progress, call)))
        };

        answer.instrument(span).boxed()
    }
}

fn body_properties(parts: &Parts) -> BodyProperties {
    let media = parts
        .headers
        .get(header::CONTENT_TYPE)
        .map_or(&[][..], |media| media.as_bytes());
    let is_web = media.starts_with(b"application/grpc-web");
    let path = parts.uri.path();
    let form = match path {
        _ if path.starts_with("/v1/") || path.starts_with("/v2/") => Form::Document,
        _ if STREAMS.contains(&path) && !is_web => Form::Messages(Framing::default()),
        _ => Form::Message,
    };

    BodyProperties {
        form,
        is_grpc: is_grpc(&parts.headers),
        is_announced: parts.headers.contains_key(header::EXPECT),
    }
}

impl Watched {
    /// Returns why a request goes no further, if so.
    fn refusal(&self, parts: &Parts) -> Option<Problem> {
        if self.standing == Standing::Guest && !operations::is_asked(parts.uri.path()) {
            return Some(too_many());
        }
        host(parts)
            .err()
            .map(|detail| Problem::invalid("request", vec![Fault::new("Host", detail)]))
    }
}

/// Looks whether a request says once whom it is for, as HTTP/1.1 must (RFC 9112, section 3.2).
/// HTTP/2 says it in another place.
fn host(parts: &Parts) -> Result<(), String> {
    let mut hosts = parts.headers.get_all(header::HOST).iter();
    let expected = "expected one `Host` header with a name and perhaps a port";

    // HTTP/2 has it in its URI, and a user before the name hides the name from whoever reads.
    if parts
        .uri
        .authority()
        .is_some_and(|authority| authority.as_str().contains('@'))
    {
        return Err(format!(
            "got a user before the name in the authority, {expected}"
        ));
    }

    match (hosts.next(), hosts.next()) {
        (None, _) if parts.version == Version::HTTP_11 => Err(format!("got none, {expected}")),
        (None, _) => Ok(()),
        (Some(_), Some(_)) => Err(format!("got several, {expected}")),
        (Some(host), None) if is_host(host.as_bytes()) => Ok(()),
        (Some(host), None) => Err(format!(
            "got {:?}, {expected}",
            String::from_utf8_lossy(host.as_bytes())
        )),
    }
}

/// Returns whether that is a name, perhaps with a port. It is empty where what is asked for has
/// none.
fn is_host(text: &[u8]) -> bool {
    let is_host = |authority: Authority| {
        authority
            .as_str()
            .strip_prefix(authority.host())
            .is_some_and(is_port)
    };
    text.is_empty() || Authority::try_from(text).is_ok_and(is_host)
}

/// Returns whether that is a colon and a number, or no number.
fn is_port(text: &str) -> bool {
    text.strip_prefix(':')
        .is_none_or(|port| port.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Says to a guest that only residents may ask for that.
fn too_many() -> Problem {
    telemetry::shed("TOO_MANY_CONNECTIONS");
    let message = "there are as many connections as the service takes, and all are busy; try again";
    Problem::new(ErrorKind::Overloaded, "TOO_MANY_CONNECTIONS", message)
}

fn refused(parts: &Parts, problem: Problem) -> Response<Body> {
    match is_grpc(&parts.headers) {
        true => status::grpc(problem).into_http(),
        false => Failure::from(problem).tell(parts.uri.path()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(version: Version, hosts: &[&str]) -> Result<(), String> {
        let request = hosts
            .iter()
            .fold(Request::builder().version(version), |request, host| {
                request.header("host", *host)
            });
        host(&request.body(()).expect("a request").into_parts().0)
    }

    #[test]
    fn a_request_says_once_whom_it_is_for() {
        for host in [
            "localhost",
            "127.0.0.1:8080",
            "[::1]:8080",
            "nudge.example.org",
            "a:",
            "",
        ] {
            assert_eq!(asked(Version::HTTP_11, &[host]), Ok(()), "{host:?}");
        }
        for (version, hosts) in [
            (Version::HTTP_10, vec![]),
            (Version::HTTP_10, vec!["a"]),
            (Version::HTTP_2, vec![]),
        ] {
            assert_eq!(asked(version, &hosts), Ok(()), "{version:?} {hosts:?}");
        }
        for wrong in ["a b", "a/b", "user@a", "a:port", "a:1:2"] {
            assert!(asked(Version::HTTP_11, &[wrong]).is_err(), "{wrong:?}");
        }
        for version in [Version::HTTP_10, Version::HTTP_11, Version::HTTP_2] {
            assert!(asked(version, &["a", "a"]).is_err(), "{version:?}");
        }
        for version in [Version::HTTP_11, Version::HTTP_2] {
            let request = Request::builder()
                .version(version)
                .uri("http://user@localhost/")
                .header("host", "localhost");
            assert!(
                host(&request.body(()).expect("a request").into_parts().0).is_err(),
                "{version:?}"
            );
        }
        let told = asked(Version::HTTP_11, &[]).expect_err("none");
        assert_eq!(
            told,
            "got none, expected one `Host` header with a name and perhaps a port"
        );
    }
}
