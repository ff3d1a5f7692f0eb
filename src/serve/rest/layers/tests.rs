//! Every error is a problem, whoever refused.

use axum::body::Body;
use axum::response::Response;
use axum::routing::{get, post};
use http::{HeaderValue, Request, StatusCode, header};
use http_body_util::BodyExt;
use serde_json::Value;
use tower::ServiceExt;

use std::time::Duration;

use tokio_util::sync::CancellationToken;

use super::*;
use crate::serve::cors;
use crate::serve::rest::extract::{File, Json, OptionalJson, Path, Query};
use crate::serve::rest::{pages, problems};
use crate::serve::status::Failure;
use crate::work::{Jobs, Progress};

async fn panics() {
    panic!("on purpose")
}

async fn name(Path(name): Path<String>) -> String {
    name
}

#[derive(Default, serde::Deserialize)]
struct Numbers {
    n: Vec<f64>,
}

async fn numbers(Json(numbers): Json<Numbers>) -> String {
    numbers.n.len().to_string()
}

async fn perhaps(OptionalJson(numbers): OptionalJson<Numbers>) -> String {
    numbers.n.len().to_string()
}

async fn file(File(bytes): File) -> String {
    bytes.len().to_string()
}

async fn nothing(Query(query): Query) -> Result<(), Failure> {
    Ok(query.finish(())?)
}

/// Asks for a result that is never made.
async fn shared() -> Result<(), Failure> {
    let jobs: Jobs<(), ()> = Jobs::new("the ranking", Duration::ZERO, CancellationToken::new());
    let make = |progress: Progress| async move {
        progress.begin("states measured", 9);
        progress.add(4);
        std::future::pending().await
    };
    Ok(jobs.ask((), make).await?)
}

fn router() -> Router {
    let router = Router::new()
        .route("/panics", get(panics))
        .route("/names/{name}", get(name))
        .route("/numbers", post(numbers))
        .route("/perhaps", post(perhaps))
        .route("/file", post(file))
        .route("/nothing", get(nothing))
        .route(
            "/slow",
            get(std::future::pending::<()>).delete(std::future::pending::<()>),
        )
        .route("/slow/transitions", post(std::future::pending::<()>))
        .route("/shared", get(shared))
        .route("/large", get(|| async { "x".repeat(2_000) }))
        .merge(pages::router())
        .fallback_service(problems::unknown_path(["/numbers".to_owned()]));
    cors::allow(
        around(router, Failure::tell),
        &["https://good.example".into(), "\n".into()],
    )
}

async fn send(request: http::request::Builder, body: impl Into<Body>) -> Response {
    router()
        .oneshot(request.body(body.into()).expect("a request"))
        .await
        .expect("infallible")
}

async fn problem(response: Response, status: u16, reason: &str) -> Value {
    assert_eq!(response.status(), status);
    assert_eq!(
        response.headers()[header::CONTENT_TYPE],
        "application/problem+json"
    );
    let bytes = response
        .into_body()
        .collect()
        .await
        .expect("a body")
        .to_bytes();
    let problem: Value = serde_json::from_slice(&bytes).expect("JSON");
    assert_eq!(
        (&problem["status"], &problem["reason"]),
        (&status.into(), &reason.into()),
        "{problem}"
    );
    problem
}

fn json() -> http::request::Builder {
    Request::post("/numbers").header(header::CONTENT_TYPE, "application/json")
}

#[tokio::test]
async fn an_unknown_path_is_a_problem() {
    let told = problem(
        send(Request::get("/v3/x?y"), ()).await,
        404,
        "PATH_NOT_FOUND",
    )
    .await;
    assert_eq!(told["instance"], "/v3/x");
    assert_eq!(told["detail"], "nothing is served under this path");
    problem(
        send(Request::get("/docs/nothing.js"), ()).await,
        404,
        "PATH_NOT_FOUND",
    )
    .await;
    let told = problem(
        send(Request::get("/nubmers"), ()).await,
        404,
        "PATH_NOT_FOUND",
    )
    .await;
    assert_eq!(
        told["detail"],
        "nothing is served under this path; did you mean `/numbers`?"
    );
}

#[tokio::test]
async fn a_wrong_method_is_a_problem_that_names_the_right_one() {
    let response = send(Request::put("/numbers"), ()).await;
    assert_eq!(response.headers()[header::ALLOW], "POST");
    problem(response, 405, "METHOD_NOT_ALLOWED").await;
}

#[tokio::test]
async fn a_panic_is_a_problem_without_its_cause() {
    let told = problem(send(Request::get("/panics"), ()).await, 500, "INTERNAL").await;
    assert!(!told.to_string().contains("on purpose"));
}

#[tokio::test(start_paused = true)]
async fn what_takes_too_long_is_a_problem_that_says_what_helps() {
    let response = send(Request::get("/slow"), ()).await;
    assert!(
        !response.headers().contains_key(header::RETRY_AFTER),
        "it would take as long again"
    );
    let told = problem(response, 503, "TIMEOUT").await;
    assert_eq!(
        told["detail"],
        "no answer within 30 seconds: ask for less at a time"
    );

    let response = send(Request::post("/slow/transitions"), ()).await;
    assert_eq!(response.headers()[header::RETRY_AFTER], "1");
    let told = problem(response, 503, "TIMEOUT").await;
    assert_eq!(
        told["detail"],
        "no answer within 30 seconds: it may have been counted; send it again, it counts once"
    );

    let told = problem(send(Request::delete("/slow"), ()).await, 503, "TIMEOUT").await;
    assert_eq!(
        told["detail"],
        "no answer within 30 seconds: it may have been done; look before you send it again"
    );
}

#[tokio::test(start_paused = true)]
async fn who_cannot_wait_for_a_shared_result_is_told_how_far_it_is() {
    let began = tokio::time::Instant::now();
    let response = send(Request::get("/shared"), ()).await;
    assert_eq!(
        began.elapsed(),
        Duration::from_secs(25),
        "five seconds before the deadline"
    );
    assert_eq!(response.headers()[header::RETRY_AFTER], "1");
    let told = problem(response, 503, "STILL_WORKING").await;
    assert_eq!(
        told["detail"],
        "the ranking is still being made: 4 of 9 states measured; it goes on, ask again"
    );
    assert_eq!((&told["done"], &told["total"]), (&4.into(), &9.into()));
}

#[tokio::test]
async fn a_body_that_may_be_empty_needs_a_type_only_where_it_is_not() {
    let typed = |media: &str| Request::post("/perhaps").header(header::CONTENT_TYPE, media);
    assert_eq!(
        send(Request::post("/perhaps"), ()).await.status(),
        StatusCode::OK
    );
    assert_eq!(send(typed("text/plain"), ()).await.status(), StatusCode::OK);
    assert_eq!(
        send(typed("application/json"), r#"{"n": [1]}"#)
            .await
            .status(),
        StatusCode::OK
    );
    problem(
        send(Request::post("/perhaps"), r#"{"n": [1]}"#).await,
        415,
        "UNSUPPORTED_MEDIA_TYPE",
    )
    .await;
    problem(
        send(typed("application/x-ndjson"), r#"{"n": [1]}"#).await,
        415,
        "UNSUPPORTED_MEDIA_TYPE",
    )
    .await;
    let told = problem(
        send(typed("application/json"), r#"{"n": ["1"]}"#).await,
        400,
        "INVALID_INPUT",
    )
    .await;
    assert_eq!(told["errors"][0]["pointer"], "/n/0");
}

#[tokio::test]
async fn a_file_has_a_type_of_its_own() {
    let typed = |media: &str| Request::post("/file").header(header::CONTENT_TYPE, media);
    assert_eq!(
        send(typed("application/octet-stream"), "\u{0}")
            .await
            .status(),
        StatusCode::OK
    );
    let told = problem(
        send(typed("application/json"), r#"{"n": [1]}"#).await,
        415,
        "UNSUPPORTED_MEDIA_TYPE",
    )
    .await;
    let expected = "got content type \"application/json\", expected application/octet-stream";
    assert_eq!(told["detail"], expected);
    let large = vec![b' '; MOST_BODY_BYTES + 1];
    problem(
        send(typed("application/octet-stream"), large).await,
        413,
        "BODY_TOO_LARGE",
    )
    .await;
}

#[tokio::test]
async fn a_body_has_a_type_and_a_limit() {
    problem(
        send(Request::post("/numbers"), r#"{"n": [1]}"#).await,
        415,
        "UNSUPPORTED_MEDIA_TYPE",
    )
    .await;
    let lines = Request::post("/numbers").header(header::CONTENT_TYPE, "application/x-ndjson");
    problem(
        send(lines, r#"{"n": [1]}"#).await,
        415,
        "UNSUPPORTED_MEDIA_TYPE",
    )
    .await;
    let large = vec![b' '; MOST_BODY_BYTES + 1];
    problem(
        send(
            json().header(header::CONTENT_LENGTH, large.len()),
            large.clone(),
        )
        .await,
        413,
        "BODY_TOO_LARGE",
    )
    .await;
    problem(send(json(), large.clone()).await, 413, "BODY_TOO_LARGE").await;
    let numbers = br#"{"n": [1]}"#;
    let fits = [numbers, &large[..MOST_BODY_BYTES - numbers.len()]].concat();
    assert_eq!(send(json(), fits).await.status(), StatusCode::OK);
}

#[tokio::test]
async fn a_fault_of_a_body_is_told_by_pointer() {
    let told = problem(
        send(json(), r#"{"n": [1, null]}"#).await,
        400,
        "INVALID_INPUT",
    )
    .await;
    assert_eq!(told["errors"][0]["pointer"], "/n/1");
}

#[tokio::test]
async fn malformed_paths_and_queries_are_problems() {
    problem(
        send(Request::get("/names/%FF"), ()).await,
        400,
        "INVALID_INPUT",
    )
    .await;
    assert_eq!(
        send(Request::get("/names/%zz"), ()).await.status(),
        StatusCode::OK
    );
    for query in ["a=%FF", "%FF=1", "a", "=", "a=%zz&b"] {
        problem(
            send(Request::get(format!("/nothing?{query}")), ()).await,
            400,
            "INVALID_INPUT",
        )
        .await;
    }
    assert_eq!(
        send(Request::get("/nothing?"), ()).await.status(),
        StatusCode::OK
    );
}

#[tokio::test]
async fn large_answers_are_compressed_on_demand() {
    let encoding = |response: Response| response.headers().get(header::CONTENT_ENCODING).cloned();
    let asking = |path: &str| Request::get(path).header(header::ACCEPT_ENCODING, "gzip");
    assert!(encoding(send(asking("/large"), ()).await).is_some());
    assert!(encoding(send(Request::get("/large"), ()).await).is_none());
    assert!(encoding(send(asking("/names/x"), ()).await).is_none());
}

#[tokio::test]
async fn no_answer_is_refused_for_its_encoding() {
    let answered = async |path: &str, accepted: &[&str]| {
        let request = Request::get(path);
        let request = accepted.iter().fold(request, |request, value| {
            request.header(header::ACCEPT_ENCODING, *value)
        });
        let response = send(request, ()).await;
        let packed = response
            .headers()
            .get(header::CONTENT_ENCODING)
            .map(|value| value.to_str().expect("text").to_owned());
        (response.status().as_u16(), packed)
    };
    for excluded in [
        &["identity;q=0"][..],
        &["*;q=0"],
        &["* ; q=0.000"],
        &["IDENTITY;Q=0"],
        &["br, identity;q=0"],
        &["gzip;q=0, identity;q=0, *"],
        &["gzip;q=0", "*;q=0"],
        &["identity;q=0", "deflate"],
    ] {
        assert_eq!(
            answered("/large", excluded).await,
            (200, None),
            "{excluded:?}"
        );
        assert_eq!(answered("/names/x", excluded).await.0, 200, "{excluded:?}");
        assert_eq!(answered("/nosuch", excluded).await.0, 404, "{excluded:?}");
    }
    for packed in [
        &["gzip, identity;q=0"][..],
        &["identity;q=0", "gzip"],
        &["*;q=0, gzip"],
        &["*, identity;q=0"],
    ] {
        assert_eq!(
            answered("/large", packed).await,
            (200, Some("gzip".into())),
            "{packed:?}"
        );
    }
}

#[tokio::test]
async fn only_listed_origins_are_allowed() {
    let allowed = async |origin: &str| {
        let response = send(Request::get("/names/x").header(header::ORIGIN, origin), ()).await;
        response
            .headers()
            .get(header::ACCESS_CONTROL_ALLOW_ORIGIN)
            .cloned()
    };
    assert_eq!(
        allowed("https://good.example").await,
        Some(HeaderValue::from_static("https://good.example"))
    );
    assert_eq!(allowed("https://bad.example").await, None);
}

#[tokio::test]
async fn the_documentation_comes_from_here() {
    let page = send(Request::get("/docs/"), ()).await;
    assert_eq!(page.status(), StatusCode::OK);
    let page = page.into_body().collect().await.expect("a body").to_bytes();
    assert!(
        !String::from_utf8_lossy(&page).contains("://"),
        "the page asks the internet for nothing"
    );
    for path in [
        "/openapi.json",
        "/docs/swagger-ui-bundle.js",
        "/docs/swagger-initializer.js",
    ] {
        assert_eq!(
            send(Request::get(path), ()).await.status(),
            StatusCode::OK,
            "{path}"
        );
    }
}
