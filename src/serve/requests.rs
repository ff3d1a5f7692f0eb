//! Access log and request metrics: every request once, with the code that its caller saw, whoever
//! answered it: a handler, a limit, a timeout, a panic, or nobody, because the caller left first.
//!
//! A request is begun where a connection hands it over, before anything can refuse it, and is over
//! with the last byte of its answer. What is found out on the way, its route and its gRPC code, is
//! noted in its extensions.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, LazyLock, OnceLock};
use std::time::Instant;

use axum::body::Body;
use axum::extract::{MatchedPath, Request};
use axum::middleware::Next;
use axum::response::Response;
use http::request::Parts;
use http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use http_body_util::BodyExt;
use tonic::Code;
use tracing::Span;

use super::operations;
use crate::access::{has_key, redacted};
use crate::api;
use crate::telemetry;

/// The request id, by which a request is found in the logs of both sides: the caller's own, or one
/// that is given here.
pub const REQUEST_ID: HeaderName = HeaderName::from_static("x-request-id");

/// The longest id of a caller's that is kept, and the longest name of a client that is logged.
const LONGEST: usize = 128;

/// The route of everything that is on no list.
const OTHER: &str = "other";

/// Calls that last as long as their client likes: how long says nothing.
const STREAMS: [&str; 3] = ["Ingest", "Watch", "ServerReflectionInfo"];

/// What was found out about a request on its way.
#[derive(Debug, Default)]
pub struct Noted {
    route: OnceLock<String>,
    code: OnceLock<Code>,
    has_left: AtomicBool,
}

/// A request that is not over. It is counted when this is dropped.
pub struct Call {
    noted: Arc<Noted>,
    is_grpc: bool,
    is_head: bool,
    id: HeaderValue,
    span: Span,
    began: Instant,
    status: Option<StatusCode>,
    is_told: bool,
}

impl Call {
    /// Begins a request from that address.
    pub fn begin(parts: &mut Parts, peer: Option<IpAddr>) -> Self {
        let noted = Arc::new(Noted::default());
        parts.extensions.insert(noted.clone());
        let id = parts
            .headers
            .get(REQUEST_ID)
            .filter(|id| is_kept(id))
            .cloned()
            .unwrap_or_else(numbered);

        Self {
            noted,
            is_grpc: is_grpc(&parts.headers),
            is_head: parts.method == Method::HEAD,
            span: span(&id, parts, peer),
            id,
            began: Instant::now(),
            status: None,
            is_told: false,
        }
    }

    /// Returns what is found out about the request.
    pub fn noted(&self) -> Arc<Noted> {
        self.noted.clone()
    }

    /// Returns the span that what is logged for the request belongs to.
    pub fn span(&self) -> Span {
        self.span.clone()
    }

    /// Notes the beginning of the answer, and puts the request's id on it.
    pub fn answered<B>(&mut self, mut response: Response<B>) -> Response<B> {
        self.status = Some(response.status());
        // Nobody reads the body of such an answer.
        self.is_told = self.is_head;
        // Not every refusal has been through gRPC.
        self.noted.note_grpc_status(response.headers());
        response.headers_mut().insert(REQUEST_ID, self.id.clone());
        response
    }

    /// Notes that the answer was told to its end.
    pub fn completed(&mut self) {
        self.is_told = true;
    }

    fn code(&self) -> String {
        let panicked = std::thread::panicking().then_some(StatusCode::INTERNAL_SERVER_ERROR);
        let has_left = self.noted.has_left.load(Ordering::Relaxed);
        let status = self
            .status
            .filter(|_| self.is_told && !has_left)
            .or(panicked);
        if self.is_grpc {
            let code = self
                .noted
                .code
                .get()
                .copied()
                .filter(|_| !has_left)
                .or_else(|| status.map(code_of));
            return word(code.unwrap_or(Code::Cancelled)).to_owned();
        }

        // As nginx and others write it when the caller left.
        status.map_or(499, |status| status.as_u16()).to_string()
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let (face, code) = (if self.is_grpc { "grpc" } else { "rest" }, self.code());
        let route = self.noted.route.get().map_or(OTHER, String::as_str);
        let took = self.began.elapsed();
        telemetry::request(
            face,
            route,
            &code,
            (!STREAMS.contains(&route)).then_some(took),
        );
        let _in = self.span.enter();
        tracing::debug!(
            face,
            route,
            code,
            duration_ms = took.as_secs_f64() * 1e3,
            "a request is over"
        );
    }
}

/// Notes the route of a request: one of few, unlike its path and its method.
pub fn note_route(request: Request) -> Request {
    if let (Some(noted), Some(path)) = (
        request.extensions().get::<Arc<Noted>>(),
        request.extensions().get::<MatchedPath>(),
    ) {
        // It is routed once.
        let _ = noted.route.set(route(&request, path.as_str()));
    }
    request
}

/// Notes the route of a request that comes before there are any: that of a probe, or of a method of
/// gRPC.
pub fn note_closed(request: &Request) {
    let path = request.uri().path();
    let is_probe = is_grpc(request.headers()) || operations::is_asked(path);
    if let (Some(noted), true) = (request.extensions().get::<Arc<Noted>>(), is_probe) {
        // It is answered once.
        let _ = noted.route.set(route(request, path));
    }
}

/// Notes the gRPC code of an answer, which comes with its headers or after its messages.
pub async fn note_code(request: Request, next: Next) -> Response {
    let Some(noted) = request.extensions().get::<Arc<Noted>>().cloned() else {
        return next.run(request).await;
    };

    let response = next.run(request).await;
    if noted.note_grpc_status(response.headers()) {
        return response;
    }

    response.map(|body| {
        Body::new(body.map_frame(move |frame| {
            if let Some(trailers) = frame.trailers_ref() {
                noted.note_grpc_status(trailers);
            }
            frame
        }))
    })
}

/// Notes the gRPC code of a request that is answered before it reaches gRPC.
pub fn note(request: &Request, code: Code) {
    if let Some(noted) = request.extensions().get::<Arc<Noted>>() {
        // It is answered once.
        let _ = noted.code.set(code);
    }
}

impl Noted {
    /// Notes that its caller left before it had asked all: whatever it is told, nobody hears it.
    pub fn left(&self) {
        self.has_left.store(true, Ordering::Relaxed);
    }

    /// Takes note of a code if there is one, and tells whether there was.
    fn note_grpc_status(&self, headers: &HeaderMap) -> bool {
        let Some(code) = headers.get("grpc-status") else {
            return false;
        };
        self.code.set(Code::from_bytes(code.as_bytes())).is_ok()
    }
}

/// Lets every route be told before the first request, so that the first failure is seen as a
/// change.
pub fn expect(documented: impl IntoIterator<Item = String>) {
    let rest = documented
        .into_iter()
        .chain(["GET /livez", "GET /readyz", "GET /metrics"].map(str::to_owned));

    for route in rest.chain([OTHER.to_owned()]) {
        telemetry::expect_requests("rest", &route, &["200", "499", "500", "503"]);
    }

    for method in METHODS
        .iter()
        .filter_map(|path| path.rsplit('/').next())
        .chain([OTHER])
    {
        telemetry::expect_requests(
            "grpc",
            method,
            &[
                "OK",
                "CANCELLED",
                "INTERNAL",
                "UNAVAILABLE",
                "DEADLINE_EXCEEDED",
            ],
        );
    }
}

/// Every method of gRPC that is served, as a path.
static METHODS: LazyLock<Vec<String>> = LazyLock::new(|| {
    const OTHERS: [&str; 4] = [
        "/grpc.health.v1.Health/Check",
        "/grpc.health.v1.Health/Watch",
        "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
        "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
    ];
    api::grpc_methods()
        .into_iter()
        .chain(OTHERS.map(str::to_owned))
        .collect()
});

fn route(request: &Request, path: &str) -> String {
    const KNOWN: [Method; 7] = [
        Method::GET,
        Method::HEAD,
        Method::POST,
        Method::PUT,
        Method::PATCH,
        Method::DELETE,
        Method::OPTIONS,
    ];
    let asked = request.uri().path();
    match request.method() {
        _ if is_grpc(request.headers()) => {
            let is_known = METHODS.iter().any(|method| method == asked);
            let method = asked.rsplit('/').next().filter(|_| is_known);
            method.unwrap_or(OTHER).to_owned()
        }
        method if KNOWN.contains(method) => format!("{method} {path}"),
        _ => OTHER.to_owned(),
    }
}

/// Tells whether a request speaks gRPC, or gRPC-Web.
pub fn is_grpc(headers: &HeaderMap) -> bool {
    let media = headers
        .get(header::CONTENT_TYPE)
        .and_then(|media| media.as_bytes().strip_prefix(b"application/grpc"));
    media.is_some_and(|rest| rest.first().is_none_or(|next| b"+;- ".contains(next)))
}

fn is_kept(id: &HeaderValue) -> bool {
    // Long rows of digits are usual in it; a key is not.
    (1..=LONGEST).contains(&id.len()) && id.to_str().is_ok_and(|id| !has_key(id))
}

/// Numbers requests under a random beginning, which is cheaper than a random number for each.
fn numbered() -> HeaderValue {
    static RUN: LazyLock<String> =
        LazyLock::new(|| uuid::Uuid::new_v4().simple().to_string()[..16].to_owned());
    static NEXT: AtomicU64 = AtomicU64::new(0);
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    HeaderValue::try_from(format!("{}-{number:x}", *RUN))
        .unwrap_or(HeaderValue::from_static("unnumbered"))
}

/// Says of everything that is logged for a request who asked, and from where.
fn span(id: &HeaderValue, parts: &Parts, peer: Option<IpAddr>) -> Span {
    let client = parts
        .headers
        .get(header::USER_AGENT)
        .and_then(|client| client.to_str().ok());
    let client = client.map(|client| redacted(&client[..client.len().min(LONGEST)]));
    tracing::info_span!(
        "request",
        id = id.to_str().unwrap_or_default(),
        from = peer.map(tracing::field::display),
        client,
        principal = tracing::field::Empty
    )
}

/// Returns what a client of gRPC makes of an answer without a code of its own.
fn code_of(status: StatusCode) -> Code {
    match status.as_u16() {
        400 => Code::Internal,
        401 => Code::Unauthenticated,
        403 => Code::PermissionDenied,
        404 => Code::Unimplemented,
        429 | 502 | 503 | 504 => Code::Unavailable,
        500 => Code::Internal,
        _ => Code::Unknown,
    }
}

/// Returns the word of a code as the protocol writes it.
fn word(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

#[cfg(test)]
mod tests {
    use axum::Router;
    use axum::middleware;
    use axum::routing::get;
    use tower::ServiceExt;
    use tower::util::MapRequestLayer;

    use super::*;

    fn begun(request: http::request::Builder) -> (Call, Request) {
        let (mut parts, ()) = request.body(()).expect("a request").into_parts();
        let call = Call::begin(&mut parts, None);
        (call, Request::from_parts(parts, Body::empty()))
    }

    async fn panics() {
        panic!("on purpose")
    }

    /// A face of gRPC that answers one method with a code, and panics in all others.
    fn grpc() -> Router {
        let refuse = || async { tonic::Status::not_found("no").into_http::<Body>() };
        let panic = tower_http::catch_panic::CatchPanicLayer::custom(crate::serve::grpc::of_panic);
        Router::new()
            .route("/nudge.v1.IngestService/Write", get(refuse))
            .route("/{service}/{*rest}", get(panics))
            .layer(panic)
            .layer(middleware::from_fn(note_code))
            .layer(MapRequestLayer::new(note_route))
    }

    #[tokio::test]
    async fn a_call_of_grpc_has_the_code_that_its_client_reads() {
        let asked = async |path: &str| {
            let (mut call, request) =
                begun(Request::get(path).header(header::CONTENT_TYPE, "application/grpc"));
            let response = call.answered(grpc().oneshot(request).await.expect("infallible"));
            assert!(!response.headers()[REQUEST_ID].is_empty());
            (call.noted.route.get().cloned(), call.code())
        };
        assert_eq!(
            asked("/nudge.v1.IngestService/Write").await,
            (Some("Write".into()), "NOT_FOUND".into())
        );
        assert_eq!(
            asked("/nudge.v1.EnvironmentService/GetEnvironment").await.1,
            "INTERNAL",
            "it panicked"
        );
        assert_eq!(
            asked("/nudge.v1.EnvironmentService/Invented").await.0,
            Some("other".into())
        );
    }

    #[test]
    fn a_refusal_before_grpc_has_its_code() {
        let (mut call, request) = begun(
            Request::post("/grpc.health.v1.Health/Check")
                .header(header::CONTENT_TYPE, "application/grpc"),
        );
        note_closed(&request);
        drop(call.answered(tonic::Status::unavailable("not ready").into_http::<Body>()));
        assert_eq!(
            (call.noted.route.get().cloned(), call.code()),
            (Some("Check".into()), "UNAVAILABLE".into())
        );
    }

    #[test]
    fn probes_are_told_apart_before_there_are_routes() {
        let routed = |path: &str| {
            let (call, request) = begun(Request::get(path));
            note_closed(&request);
            call.noted.route.get().cloned()
        };
        assert_eq!(routed("/readyz"), Some("GET /readyz".into()));
        assert_eq!(routed("/v1/environments/invented"), None);
    }

    #[test]
    fn who_left_saw_no_code() {
        let grpc = || Request::post("/x").header(header::CONTENT_TYPE, "application/grpc");
        assert_eq!(begun(Request::get("/x")).0.code(), "499");
        assert_eq!(begun(grpc()).0.code(), "CANCELLED");
        let told = |request, status, is_read| {
            let (mut call, _) = begun(request);
            let response = Response::builder()
                .status(status)
                .body(())
                .expect("an answer");
            drop(call.answered(response));
            if is_read {
                call.completed();
            }
            call.code()
        };
        assert_eq!(
            told(Request::get("/x"), 200, false),
            "499",
            "it left before the end"
        );
        assert_eq!(told(Request::get("/x"), 503, true), "503");
        assert_eq!(
            told(Request::head("/x"), 200, false),
            "200",
            "there is nothing to read"
        );
        assert_eq!(
            told(grpc(), 404, true),
            "UNIMPLEMENTED",
            "as a client takes it"
        );
        for (request, code) in [(Request::post("/x"), "499"), (grpc(), "CANCELLED")] {
            let (mut call, _) = begun(request);
            call.noted().left();
            drop(call.answered(tonic::Status::internal("its body ended early").into_http::<()>()));
            call.completed();
            assert_eq!(call.code(), code, "it left in mid-body");
        }
    }

    #[test]
    fn every_method_of_grpc_is_known() {
        for method in [
            "/nudge.v1.IngestService/Ingest",
            "/inference.GRPCInferenceService/ModelInfer",
        ] {
            assert!(METHODS.iter().any(|known| known == method), "{method}");
        }
    }
}
