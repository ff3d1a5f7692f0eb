//! What operators and foreign clients meet: probes, metrics, reflection, gRPC-Web, unknown paths,
//! the OpenAPI document.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tokio::io::AsyncWriteExt;
use tokio::time::timeout;
use tokio_stream::StreamExt;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

use crate::support::TestApp;
use crate::support::raw::{LONG, Raw};

/// A probe whose headers have not all come when the service begins to drain is answered, and told
/// so; nobody else reaches it any more. On one thread: what was sent is read before a later call is
/// answered.
#[tokio::test]
async fn probes_tell_alive_ready_and_draining() {
    let app = TestApp::start().await;
    assert_eq!(app.rest("GET", "/livez", None).await.0, 200);
    let (status, checks) = app.rest("GET", "/readyz?verbose", None).await;
    assert_eq!(
        (status, &checks["checks"]),
        (
            200,
            &json!({"database": "ok", "committer": "ok", "draining": "no"})
        )
    );
    let mut health = HealthClient::new(app.channel().await)
        .watch(HealthCheckRequest::default())
        .await
        .expect("known")
        .into_inner();
    assert_eq!(
        health.message().await.expect("open").expect("told").status,
        1
    );

    let cases = [
        ("/livez", 200, "ok"),
        ("/v2/health/live", 200, "true"),
        ("/readyz", 503, "not ready"),
        (
            "/readyz?verbose",
            503,
            "\"draining\":\"the service is stopping\"",
        ),
        ("/v2/health/ready", 503, "not ready: draining"),
    ];
    let mut probes = Vec::new();
    for (path, ..) in cases {
        let half = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\n");
        probes.push(Raw::open(app.address, half.as_bytes()).await);
    }
    for _ in 0..10 {
        assert_eq!(app.rest("GET", "/livez", None).await.0, 200);
    }

    app.app.draining.cancel();
    let gone = async {
        while tokio::net::TcpStream::connect(app.address).await.is_ok() {
            tokio::task::yield_now().await;
        }
    };
    timeout(LONG, gone).await.expect("nobody new is let in");
    for ((path, status, words), probe) in cases.into_iter().zip(&mut probes) {
        probe.0.write_all(b"\r\n").await.expect("sent");
        let told = String::from_utf8(probe.end().await).expect("text");
        let expected = format!("HTTP/1.1 {status} ");
        assert!(told.starts_with(&expected), "{path}: {told}");
        assert!(told.contains(words), "{path}: {told}");
    }
    assert_eq!(
        health.message().await.expect("open").expect("told").status,
        2
    );
    drop(health);
    app.stop().await;
}

#[tokio::test]
async fn metrics_count_what_happens() {
    let app = TestApp::start().await;
    app.lane().await;
    let body = json!({"producer": "metrics", "sequence": 1, "transitions": [
        {"state": {"distance": 1, "held": 0}, "actions": {"robot": 0, "human": 0}}, {"state": {}, "actions": {}}]});
    assert_eq!(
        app.rest("POST", "/v1/environments/lane/transitions", Some(&body))
            .await
            .0,
        200
    );
    let (status, text) = app.rest("GET", "/metrics", None).await;
    let text = text.as_str().unwrap_or_default();
    assert_eq!(status, 200);
    for line in [
        "# HELP nudge_transitions_accepted_total",
        "nudge_transitions_accepted_total{environment=\"lane\"}",
        "nudge_transitions_rejected_total{environment=\"lane\",reason=\"state\"}",
        "route=\"POST /v1/environments/{environment}/transitions\",code=\"200\"",
        "nudge_build_info{",
        "nudge_commit_duration_seconds_bucket",
        "nudge_database_bytes",
        "nudge_cells{environment=\"lane\"}",
    ] {
        assert!(text.contains(line), "{line} in\n{text}");
    }
    assert!(!text.contains("producer="), "labels are bounded");
}

#[tokio::test]
async fn every_error_of_rest_is_a_problem() {
    let app = TestApp::start().await;
    let cases = [
        ("GET", "/v1/environmints", 404),
        ("GET", "/v3/nothing/here", 404),
        ("DELETE", "/v1/environments", 405),
        ("GET", "/v1/environments/lane", 404),
        ("GET", "/v1/environments?page_sise=3", 400),
        ("GET", "/v1/environments?page_size=5000", 400),
        ("PUT", "/v1/environments/lane", 415),
    ];
    for (method, path, expected) in cases {
        let request =
            reqwest::Client::new().request(method.parse().expect("a method"), app.url(path));
        let response = request.send().await.expect("answered");
        assert_eq!(response.status().as_u16(), expected, "{method} {path}");
        let kind = response
            .headers()
            .get("content-type")
            .and_then(|kind| kind.to_str().ok())
            .map(str::to_owned);
        assert_eq!(
            kind.as_deref(),
            Some("application/problem+json"),
            "{method} {path}"
        );
        let body: serde_json::Value = response.json().await.expect("JSON");
        assert_eq!(body["status"], json!(expected));
    }
}

#[tokio::test]
async fn what_nobody_knows_is_refused_before_anything_is_done() {
    let app = TestApp::start().await;
    app.lane().await;
    let none = "unknown parameter; there is none on this path";
    let lane = "/v1/environments/lane";
    let rule = json!({"rule": {"min_visits": 3}});
    let cases = [
        ("DELETE", lane.to_owned(), "foo", none, None),
        ("GET", lane.to_owned(), "view", none, None),
        ("PATCH", lane.to_owned(), "foo", none, Some(&rule)),
        ("GET", format!("{lane}/states/1.0"), "segments", none, None),
        ("GET", format!("{lane}/producers/p"), "foo", none, None),
        ("GET", format!("{lane}/models/1"), "foo", none, None),
        ("DELETE", format!("{lane}/models/1"), "foo", none, None),
        ("PUT", format!("{lane}/models/1/active"), "foo", none, None),
        (
            "GET",
            "/readyz".to_owned(),
            "verbos",
            "unknown parameter; did you mean `verbose`?",
            None,
        ),
        ("GET", "/livez".to_owned(), "verbose", none, None),
        ("GET", "/metrics".to_owned(), "foo", none, None),
    ];
    for (method, path, name, detail, body) in cases {
        let (status, told) = app.rest(method, &format!("{path}?{name}=1"), body).await;
        let fault = json!([{"pointer": format!("/{name}"), "detail": detail}]);
        assert_eq!(
            (status, &told["errors"]),
            (400, &fault),
            "{method} {path}: {told}"
        );
    }
    let (_, kept) = app.rest("GET", lane, None).await;
    assert_ne!(
        kept["rule"]["min_visits"], 3,
        "it was not changed, nor deleted"
    );
    assert_eq!(app.rest("GET", "/readyz?verbose=", None).await.0, 200);
    assert_eq!(
        app.rest("GET", "/v2/health/live?foo=1", None).await.0,
        200,
        "the inference protocol ignores it"
    );

    let batch = json!({"producer": "p", "sequence": 1, "transitions": []});
    let (status, told) = app
        .rest(
            "POST",
            &format!("{lane}/transitions?producer=p"),
            Some(&batch),
        )
        .await;
    let detail = told["errors"][0]["detail"].as_str().unwrap_or_default();
    assert_eq!(status, 400);
    assert!(
        detail.starts_with("belongs to a body of `application/x-ndjson`"),
        "{told}"
    );
    app.stop().await;
}

#[tokio::test]
async fn a_mistyped_path_is_told_what_may_be_meant() {
    let app = TestApp::start().await;
    for (path, member, meant) in [
        (
            "/v1/environments/lane/sumary",
            "detail",
            "/v1/environments/lane/summary",
        ),
        ("/ready", "detail", "/readyz"),
        ("/v2/models/lane/infr", "error", "/v2/models/lane/infer"),
    ] {
        let (status, told) = app.rest("GET", path, None).await;
        assert_eq!(
            (status, &told[member]),
            (
                404,
                &format!("nothing is served under this path; did you mean `{meant}`?").into()
            )
        );
    }
    app.stop().await;
}

#[tokio::test]
async fn every_refusal_has_a_body() {
    let app = TestApp::start().await;
    for path in ["/livez", "/readyz", "/metrics"] {
        let response = reqwest::Client::new()
            .post(app.url(path))
            .send()
            .await
            .expect("answered");
        let allowed = response.headers().get("allow").cloned();
        assert_eq!(
            (response.status().as_u16(), allowed),
            (405, Some("GET,HEAD".parse().expect("text"))),
            "{path}"
        );
        assert_eq!(
            response.headers()["content-type"],
            "application/problem+json",
            "{path}"
        );
        let told: Value = response.json().await.expect("JSON");
        assert_eq!(
            (&told["reason"], &told["instance"]),
            (&json!("METHOD_NOT_ALLOWED"), &json!(path))
        );
    }
    let call =
        reqwest::Client::new().post(app.url("/nudge.v1.EnvironmentService/ListEnvironments"));
    let response = call
        .header("content-type", "application/grpc")
        .body(vec![0; 5])
        .send()
        .await
        .expect("answered");
    assert_eq!(
        (response.status().as_u16(), response.version()),
        (400, reqwest::Version::HTTP_11)
    );
    let told: Value = response.json().await.expect("JSON");
    assert!(
        told["errors"][0]["detail"]
            .as_str()
            .is_some_and(|told| told.starts_with("got HTTP/1.1, expected HTTP/2"))
    );
    app.stop().await;
}

/// Every path of REST. Each is a promise: one that comes is written here, and none goes.
const PATHS: [&str; 18] = [
    "/v1/environments",
    "/v1/environments/{environment}",
    "/v1/environments/{environment}/explore",
    "/v1/environments/{environment}/fit",
    "/v1/environments/{environment}/graph",
    "/v1/environments/{environment}/influence",
    "/v1/environments/{environment}/models",
    "/v1/environments/{environment}/models/import",
    "/v1/environments/{environment}/models/{model}",
    "/v1/environments/{environment}/models/{model}/active",
    "/v1/environments/{environment}/models/{model}/weights",
    "/v1/environments/{environment}/producers/{producer}",
    "/v1/environments/{environment}/profile",
    "/v1/environments/{environment}/regions",
    "/v1/environments/{environment}/states",
    "/v1/environments/{environment}/states/{key}",
    "/v1/environments/{environment}/summary",
    "/v1/environments/{environment}/transitions",
];

#[tokio::test]
async fn the_openapi_document_names_every_path() {
    let app = TestApp::start().await;
    let (status, document) = app.rest("GET", "/openapi.json", None).await;
    assert_eq!(
        (
            status,
            document["openapi"].as_str().map(|version| &version[..3])
        ),
        (200, Some("3.1"))
    );
    let paths = document["paths"].as_object().expect("paths");
    let paths: BTreeSet<&str> = paths.keys().map(String::as_str).collect();
    assert_eq!(paths, BTreeSet::from(PATHS));
    assert_eq!(app.rest("GET", "/docs/", None).await.0, 200);
}

#[tokio::test]
async fn grpc_tells_its_health_and_itself() {
    let app = TestApp::start().await;
    let mut health = HealthClient::new(app.channel().await);
    for service in [
        "",
        "nudge.v1.IngestService",
        "nudge.v1.InfluenceService",
        "nudge.v1.EnvironmentService",
        "nudge.v1.ModelService",
        "inference.GRPCInferenceService",
    ] {
        let answer = health
            .check(HealthCheckRequest {
                service: service.into(),
            })
            .await
            .expect("known")
            .into_inner();
        assert_eq!(answer.status, 1, "{service} serves");
    }
    let request = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut answers = ServerReflectionClient::new(app.channel().await)
        .server_reflection_info(tokio_stream::once(request))
        .await
        .expect("reflection")
        .into_inner();
    let answer = answers
        .next()
        .await
        .expect("an answer")
        .expect("an answer")
        .message_response;
    let Some(MessageResponse::ListServicesResponse(listed)) = answer else {
        panic!("{answer:?}")
    };
    let names: Vec<String> = listed
        .service
        .into_iter()
        .map(|service| service.name)
        .collect();
    assert!(
        names.contains(&"nudge.v1.IngestService".to_owned()),
        "{names:?}"
    );
}

#[tokio::test]
async fn grpc_web_is_spoken_over_http_1() {
    let app = TestApp::start().await;
    let response = reqwest::Client::new()
        .post(app.url("/nudge.v1.EnvironmentService/ListEnvironments"))
        .header("content-type", "application/grpc-web+proto")
        .header("x-grpc-web", "1")
        .body(vec![0_u8; 5])
        .send()
        .await
        .expect("answered");
    assert_eq!(response.status().as_u16(), 200);
    let kind = response.headers()["content-type"]
        .to_str()
        .expect("text")
        .to_owned();
    assert!(kind.starts_with("application/grpc-web"), "{kind}");
    let body = response.bytes().await.expect("a body");
    assert!(
        String::from_utf8_lossy(&body).contains("grpc-status:0"),
        "{body:?}"
    );
}

#[tokio::test]
async fn browsers_get_a_page_and_others_json() {
    let app = TestApp::start().await;
    let get = async |path: &str, accept: &str| {
        let request = reqwest::Client::new()
            .get(app.url(path))
            .header("accept", accept);
        request.send().await.expect("answered")
    };

    let page = get("/", "text/html,*/*;q=0.8").await;
    assert_eq!(
        (page.status().as_u16(), &page.headers()["content-type"]),
        (200, &"text/html; charset=utf-8".parse().expect("a value"))
    );
    assert!(
        page.headers()
            .get_all("vary")
            .iter()
            .any(|vary| vary == "accept")
    );
    let text = page.text().await.expect("text");
    for part in [
        env!("CARGO_PKG_VERSION"),
        "/docs/",
        "/openapi.json",
        "/readyz",
        "/livez",
        &app.url("/v1/environments/crossing/influence"),
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }

    // Everything that either names is there.
    let told: Value = get("/", "*/*").await.json().await.expect("JSON");
    assert_eq!(
        (&told["name"], &told["version"]),
        (&"nudge".into(), &env!("CARGO_PKG_VERSION").into())
    );
    let named = told
        .as_object()
        .expect("an object")
        .values()
        .filter_map(|value| value.as_str())
        .map(str::to_owned);
    let linked = text
        .split("href=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .map(str::to_owned);
    for path in named.filter(|path| path.starts_with('/')).chain(linked) {
        assert_eq!(get(&path, "*/*").await.status().as_u16(), 200, "{path}");
    }
    assert_eq!(
        app.rest("POST", "/", None).await.1["reason"],
        "METHOD_NOT_ALLOWED"
    );

    for path in [
        "/",
        "/docs",
        "/docs/",
        "/docs/swagger-ui.css",
        "/openapi.json",
    ] {
        let headers = get(path, "text/html").await.headers().clone();
        assert_eq!(headers["x-content-type-options"], "nosniff", "{path}");
        assert_eq!(headers["x-frame-options"], "DENY", "{path}");
        let policy = headers["content-security-policy"].to_str().expect("text");
        assert!(
            policy.contains("default-src 'self'") && policy.contains("frame-ancestors 'none'"),
            "{path}: {policy}"
        );
    }
}

/// The operations of the OpenAPI document: path, method, names of its query parameters.
async fn documented(app: &TestApp) -> Vec<(String, String, BTreeSet<String>)> {
    let document = app.get("/openapi.json").await;
    let paths = document["paths"].as_object().expect("paths").clone();
    let operations = paths.into_iter().flat_map(|(path, operations)| {
        let operations = operations.as_object().expect("operations").clone();
        operations
            .into_iter()
            .map(move |(method, operation)| (path.clone(), method.to_uppercase(), operation))
    });
    let names = |operation: &Value| {
        let parameters = operation["parameters"]
            .as_array()
            .cloned()
            .unwrap_or_default();
        let queries = parameters
            .into_iter()
            .filter(|parameter| parameter["in"] == "query");
        queries
            .map(|parameter| parameter["name"].as_str().expect("a name").to_owned())
            .collect()
    };
    operations
        .map(|(path, method, operation)| (path, method, names(&operation)))
        .collect()
}

/// A path as somebody asks for it.
fn filled(path: &str) -> String {
    let path = path
        .replace("{environment}", "lane")
        .replace("{producer}", "p")
        .replace("{key}", "0.0");
    path.replace("{model}", "1")
}

/// Counts the handlers of REST that have a `#[utoipa::path]`.
fn described_handlers() -> usize {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/serve/rest");
    let files = std::fs::read_dir(folder).expect("a folder can be read");
    let count = |path: PathBuf| {
        let text = std::fs::read_to_string(path).unwrap_or_default();
        text.matches("\n#[utoipa::path(").count()
    };
    files
        .map(|entry| count(entry.expect("an entry can be read").path()))
        .sum()
}

#[tokio::test]
async fn what_is_served_is_what_is_documented() {
    let app = TestApp::start().await;
    let mut methods: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (path, method, _) in documented(&app).await {
        methods.entry(path).or_default().insert(method);
    }

    // Each handler that is described has a route.
    let described = described_handlers();
    let handlers: usize = methods.values().map(BTreeSet::len).sum();
    assert_eq!(
        described, handlers,
        "handlers with a description, and routes"
    );

    // A path takes the methods that are documented, and no other. What is read with GET is read
    // with HEAD too.
    for (path, documented) in methods {
        let request =
            reqwest::Client::new().request(reqwest::Method::TRACE, app.url(&filled(&path)));
        let response = request.send().await.expect("answered");
        assert_eq!(response.status().as_u16(), 405, "{path}");
        let allowed = response.headers()["allow"].to_str().expect("text");
        let allowed: BTreeSet<String> = allowed
            .split(',')
            .filter(|method| *method != "HEAD")
            .map(Into::into)
            .collect();
        assert_eq!(allowed, documented, "{path}");
    }
}

#[tokio::test]
async fn parameters_are_taken_where_they_are_documented_and_nowhere_else() {
    let app = TestApp::start().await;
    app.lane().await;
    let operations = documented(&app).await;
    let known: BTreeSet<String> = operations
        .iter()
        .flat_map(|(_, _, names)| names.clone())
        .collect();
    assert!(known.len() > 20, "{known:?}");
    for (path, method, names) in operations.iter().filter(|(_, _, names)| !names.is_empty()) {
        for name in known.iter().map(String::as_str).chain(["nothing"]) {
            let is_documented = names.contains(name);
            let name = match name {
                "state" => "state.distance",
                "region" => "region.distance",
                name => name,
            };
            let request = reqwest::Client::new().request(
                method.parse().expect("a method"),
                app.url(&format!("{}?{name}=%3F", filled(path))),
            );
            // With lines, whose parameters stand in the query.
            let request = if path.ends_with("/transitions") {
                request
                    .header("content-type", "application/x-ndjson")
                    .body("")
            } else {
                request
            };
            let told = request
                .send()
                .await
                .expect("answered")
                .text()
                .await
                .expect("text");
            assert_eq!(
                !told.contains("unknown parameter"),
                is_documented,
                "{method} {path}?{name}: {told}"
            );
        }
    }
}
