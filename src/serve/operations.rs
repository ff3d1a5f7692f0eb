//! Probes and metrics: liveness (is the process alive?), readiness (can it work?), and what
//! Prometheus scrapes.

use axum::extract::{Request, State};
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};

use super::figures;
use super::status::Failure;
use crate::app::App;
use crate::domain::hint;
use crate::error::{ErrorKind, Fault, Problem, pointer};
use crate::telemetry;

/// What `/livez` says.
pub const ALIVE: &str = "ok\n";

/// Returns the routes for operators.
pub fn router(app: App) -> Router {
    Router::new()
        .route("/livez", get(livez))
        .route("/readyz", get(readyz))
        .route("/metrics", get(metrics))
        .method_not_allowed_fallback(|uri: Uri| async move {
            Failure::of_http(StatusCode::METHOD_NOT_ALLOWED).tell(uri.path())
        })
        .with_state(app)
}

async fn livez(uri: Uri) -> Response {
    refusal(&uri, &[]).unwrap_or_else(|| ALIVE.into_response())
}

/// Returns the refusal of a parameter that is none of these, if there is one.
fn refusal(uri: &Uri, known: &[&str]) -> Option<Response> {
    let names = uri
        .query()
        .unwrap_or_default()
        .split('&')
        .filter_map(|part| part.split('=').next());

    let unknown = |name: &&str| !name.is_empty() && !known.contains(name);
    let fault = |name: &str| {
        let none = "; there is none on this path".to_owned();
        let hint = if known.is_empty() {
            none
        } else {
            hint(name, known.iter().copied())
        };
        Fault::new(pointer(name), format!("unknown parameter{hint}"))
    };
    let faults: Vec<Fault> = names.filter(unknown).map(fault).collect();
    (!faults.is_empty()).then(|| Failure::from(Problem::invalid("query", faults)).tell(uri.path()))
}

/// Tells whether operators ask under that path: whether the service lives, can work, and how it
/// fares.
pub fn is_asked(path: &str) -> bool {
    const PATHS: [&str; 6] = [
        "/livez",
        "/readyz",
        "/metrics",
        "/v2/health/live",
        "/v2/health/ready",
        "/grpc.health.v1.Health/Check",
    ];
    PATHS.contains(&path)
}

/// Tells whether machines ask, which know addresses and no names: kubelets, load balancers,
/// Prometheus. What they are told is for anybody, but for metrics.
pub fn is_asked_by_machines(request: &Request) -> bool {
    const OTHERS: [&str; 3] = [
        "/grpc.health.v1.Health/Watch",
        "/inference.GRPCInferenceService/ServerLive",
        "/inference.GRPCInferenceService/ServerReady",
    ];
    let (path, query) = (request.uri().path(), request.uri().query());
    (is_asked(path) && !is_verbose(query)) || OTHERS.contains(&path)
}

type Check = (&'static str, Result<(), String>);

/// Says whether the service can take and answer, or why not.
pub async fn ready(app: &App) -> Result<(), Problem> {
    for (name, check) in checks(app).await {
        check.map_err(|why| not_ready(name, &why))?;
    }
    Ok(())
}

fn not_ready(name: &str, why: &str) -> Problem {
    Problem::new(
        ErrorKind::Unavailable,
        "NOT_READY",
        format!("not ready: {name}: {why}"),
    )
}

async fn checks(app: &App) -> [Check; 3] {
    let database = app.store.ready().await.map_err(|cause| cause.to_string());
    [
        ("database", database),
        (
            "committer",
            app.ingest
                .is_running()
                .then_some(())
                .ok_or_else(|| "stopped".into()),
        ),
        (
            "draining",
            (!app.draining.is_cancelled())
                .then_some(())
                .ok_or_else(|| "the service is stopping".into()),
        ),
    ]
}

/// 200 where the service can take and answer, else 503; `?verbose` tells each check, and which
/// environments are damaged and take nothing.
async fn readyz(State(app): State<App>, uri: Uri) -> Response {
    if let Some(refusal) = refusal(&uri, &["verbose"]) {
        return refusal;
    }

    app.prove().await;
    let checks = checks(&app).await;
    let ready = checks.iter().all(|(_, check)| check.is_ok());
    let status = if ready {
        StatusCode::OK
    } else {
        StatusCode::SERVICE_UNAVAILABLE
    };

    if !is_verbose(uri.query()) {
        return (status, if ready { "ready\n" } else { "not ready\n" }).into_response();
    }

    let checks: serde_json::Map<String, serde_json::Value> = checks
        .into_iter()
        .map(|(name, check)| (name.to_owned(), outcome(name, check).into()))
        .collect();
    let background = app.in_the_background();
    let mut told =
        serde_json::json!({ "ready": ready, "checks": checks, "background": background });

    let damaged = app.store.read_only();
    if !damaged.is_empty() {
        let environments = damaged
            .into_iter()
            .map(|(name, why)| (name.to_string(), why.into()));
        told["read_only"] = serde_json::Value::Object(environments.collect());
    }
    (status, Json(told)).into_response()
}

/// Returns what is said of a check.
fn outcome(name: &str, check: Result<(), String>) -> String {
    check.err().unwrap_or_else(|| passed(name).into())
}

/// Returns what is said of a check that passed: of one that is named after its trouble, that there
/// is none.
fn passed(check: &str) -> &'static str {
    if check == "draining" { "no" } else { "ok" }
}

/// Returns whether a query string asks for each check.
pub fn is_verbose(query: Option<&str>) -> bool {
    query.is_some_and(|query| {
        query
            .split('&')
            .any(|part| part == "verbose" || part.starts_with("verbose="))
    })
}

/// The metrics in Prometheus' text format.
async fn metrics(State(app): State<App>, uri: Uri) -> Response {
    if let Some(refusal) = refusal(&uri, &[]) {
        return refusal;
    }
    let checks = checks(&app)
        .await
        .iter()
        .map(|(check, outcome)| (*check, outcome.is_ok()))
        .collect();

    let standing = figures::standing(&app, checks).await;
    (
        [("content-type", "text/plain; version=0.0.4; charset=utf-8")],
        telemetry::render(&standing),
    )
        .into_response()
}
