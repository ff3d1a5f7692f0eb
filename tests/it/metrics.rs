//! Metrics and logs say what users see: every request once with its code, figures of what exists,
//! and a line for every change.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use nudge::api::proto::environment_service_client::EnvironmentServiceClient;
use nudge::api::proto::ingest_service_client::IngestServiceClient;
use nudge::api::proto::{self, Hello};
use nudge::store::Options;
use nudge::telemetry::{ALL, Kind};
use prost::Message;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::server::Server;
use crate::support::faulty::{Failure, Faulty};
use crate::support::raw::PREFACE;
use crate::support::{RawStream, TestApp, channel, lane_json, open, row, rows};

/// The binary, whose metrics and log are nobody else's.
struct Alone {
    server: Server,
    directory: TempDir,
}

impl Alone {
    fn start() -> Self {
        let directory = TempDir::new().expect("a temporary directory");
        let mut command = Server::command(directory.path(), "127.0.0.1:0");
        let log = File::create(directory.path().join("log")).expect("a file");
        let server = Server::run(command.args(["--log", "json"]).stderr(log)).expect("it starts");
        Self { server, directory }
    }

    fn url(&self, path: &str) -> String {
        format!("http://{}{path}", self.server.address)
    }

    async fn send(&self, method: &str, path: &str, body: Option<Value>) -> reqwest::Response {
        let request =
            reqwest::Client::new().request(method.parse().expect("a method"), self.url(path));
        let request = request.header("user-agent", "tester/1");
        let request = if let Some(body) = body {
            request.json(&body)
        } else {
            request
        };
        request.send().await.expect("answered")
    }

    async fn status(&self, method: &str, path: &str, body: Option<Value>) -> u16 {
        self.send(method, path, body).await.status().as_u16()
    }

    /// Asks a method of gRPC-Web with an empty message.
    async fn web(&self, path: &str) -> u16 {
        web(&self.url(path), &[], "10S").await
    }

    async fn metrics(&self) -> Figures {
        Figures::parse(
            &self
                .send("GET", "/metrics", None)
                .await
                .text()
                .await
                .expect("text"),
        )
    }

    /// Returns the figure once it is that; what a client that left caused is noticed a moment
    /// later.
    async fn until(&self, series: &str, expected: f64) {
        for _ in 0..200 {
            if self.metrics().await.get(series) == Some(expected) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(25)).await;
        }
        panic!(
            "{series} is {:?}, expected {expected}",
            self.metrics().await.get(series)
        );
    }

    /// Returns how many streams ended well and how many were cancelled, once so many have ended.
    async fn until_streams_ended(&self, expected: f64) -> (f64, f64) {
        for _ in 0..200 {
            let figures = self.metrics().await;
            let of = |code| figures.requests("grpc", "Ingest", code);
            let ended = (of("OK"), of("CANCELLED"));
            if ended.0 + ended.1 == expected {
                return ended;
            }
            tokio::time::sleep(Duration::from_millis(25)).await;
        }
        panic!("never did {expected} streams end");
    }

    fn log(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(self.directory.path().join("log")).expect("a log");
        text.lines()
            .map(|line| serde_json::from_str(line).expect("JSON"))
            .collect()
    }
}

/// Asks a method of gRPC-Web, and says how long the answer may take.
async fn web(url: &str, message: &[u8], timeout: &str) -> u16 {
    let request = reqwest::Client::new()
        .post(url)
        .header("content-type", "application/grpc-web+proto");
    let framed = [
        &[0][..],
        &u32::try_from(message.len()).expect("small").to_be_bytes(),
        message,
    ]
    .concat();
    let response = request
        .header("grpc-timeout", timeout)
        .body(framed)
        .send()
        .await
        .expect("answered");
    let status = response.status().as_u16();
    response.bytes().await.expect("to its end");
    status
}

/// A scrape: each series and its number.
struct Figures(BTreeMap<String, f64>, String);

impl Figures {
    fn parse(text: &str) -> Self {
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let figure = |line: &str| {
            let (series, number) = line.rsplit_once(' ').expect("a series and a number");
            (series.to_owned(), number.parse().expect("a number"))
        };
        let all: Vec<_> = lines.map(figure).collect();
        let figures = Self(all.iter().cloned().collect(), text.to_owned());
        assert_eq!(figures.0.len(), all.len(), "each series once");
        figures
    }

    fn get(&self, series: &str) -> Option<f64> {
        self.0.get(series).copied()
    }

    fn requests(&self, face: &str, route: &str, code: &str) -> f64 {
        self.get(&requests(face, route, code)).unwrap_or_default()
    }
}

fn requests(face: &str, route: &str, code: &str) -> String {
    format!("nudge_requests_total{{face=\"{face}\",route=\"{route}\",code=\"{code}\"}}")
}

const ENVIRONMENT: &str = "/v1/environments/{environment}";
const INFLUENCE: &str = "POST /v1/environments/{environment}/influence";

fn transitions(sequence: u64) -> Value {
    json!({"producer": "p", "sequence": sequence, "transitions": [
        {"state": {"distance": 1, "held": 0}, "actions": {"robot": 0, "human": 0}}, {"state": {}, "actions": {}}]})
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_request_is_counted_once_with_the_code_that_its_caller_saw() {
    let alone = Alone::start();
    assert_eq!(
        alone
            .status("PUT", "/v1/environments/lane", Some(lane_json()))
            .await,
        201
    );
    assert_eq!(
        alone
            .status(
                "POST",
                "/v1/environments/lane/transitions",
                Some(transitions(1))
            )
            .await,
        200
    );
    assert_eq!(
        alone
            .status(
                "POST",
                "/v1/environments/nosuch/transitions",
                Some(transitions(1))
            )
            .await,
        404
    );
    assert_eq!(alone.status("DELETE", "/v1/environments", None).await, 405);
    assert_eq!(alone.status("GET", "/v3/nothing", None).await, 404);
    assert_eq!(alone.status("HEAD", "/v1/environments", None).await, 200);
    assert_eq!(alone.status("GET", "/docs/nothing.js", None).await, 404);
    let large = json!(" ".repeat(17 << 20));
    assert_eq!(
        alone
            .status("POST", "/v1/environments/lane/influence", Some(large))
            .await,
        413
    );
    assert_eq!(
        alone
            .web("/nudge.v1.EnvironmentService/ListEnvironments")
            .await,
        200
    );
    assert_eq!(
        alone
            .web("/nudge.v1.EnvironmentService/GetEnvironment")
            .await,
        200
    );
    assert_eq!(
        alone.web("/nudge.v1.EnvironmentService/Invented").await,
        200
    );

    let figures = alone.metrics().await;
    let transitions = format!("POST {ENVIRONMENT}/transitions");
    for (face, route, code) in [
        ("rest", format!("PUT {ENVIRONMENT}").as_str(), "201"),
        ("rest", &transitions, "200"),
        ("rest", &transitions, "404"),
        ("rest", "DELETE /v1/environments", "405"),
        ("rest", "HEAD /v1/environments", "200"),
        ("rest", &format!("POST {ENVIRONMENT}/influence"), "413"),
        ("rest", "other", "404"),
        ("grpc", "ListEnvironments", "OK"),
        ("grpc", "GetEnvironment", "NOT_FOUND"),
        ("grpc", "other", "UNIMPLEMENTED"),
    ] {
        assert_eq!(
            figures.requests(face, route, code),
            1.0,
            "{face} {route} {code} in\n{}",
            figures.1
        );
    }
    let counted = figures
        .0
        .iter()
        .filter(|(series, _)| series.starts_with("nudge_requests_total"))
        .map(|(_, n)| n);
    assert_eq!(counted.sum::<f64>(), 11.0, "each once");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_callers_invent_is_one_series() {
    let alone = Alone::start();
    let before = alone.metrics().await.1.len();
    for number in 0..60 {
        let method = format!("M{number}{}", "X".repeat(8_000));
        let status = alone
            .status(&method, &format!("/v1/environments/{number}"), None)
            .await;
        assert_eq!(status, 405);
        alone
            .status("GET", &format!("/invented/{number}"), None)
            .await;
        alone
            .web(&format!("/nudge.v1.EnvironmentService/Invented{number}"))
            .await;
        alone
            .web(&format!("/invented.v{number}.Service/Method"))
            .await;
    }
    let figures = alone.metrics().await;
    assert_eq!(figures.requests("rest", "other", "405"), 60.0);
    assert_eq!(figures.requests("rest", "other", "404"), 60.0);
    assert_eq!(figures.requests("grpc", "other", "UNIMPLEMENTED"), 120.0);
    assert!(
        figures.1.len() < before + 8_000,
        "{} bytes after {before}",
        figures.1.len()
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_request_is_counted_by_its_reason() {
    let service = Alone::start();
    let large = [
        b"GET / HTTP/1.1\r\nhost: nudge\r\nx: ".to_vec(),
        vec![b'a'; 100_000],
        b"\r\n\r\n".to_vec(),
    ]
    .concat();
    let long = [
        b"GET /".to_vec(),
        vec![b'a'; 100_000],
        b" HTTP/1.1\r\nhost: nudge\r\n\r\n".to_vec(),
    ]
    .concat();
    // Data on no stream, and a setting that may not be.
    let [data, setting] = [&[0; 9][..], &[0, 0, 6, 4, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 9]];
    let tls = [b"\x16\x03\x01\x02\x00".to_vec(), vec![0; 100]].concat();
    for (first, answer) in [
        (b"nonsense\r\n\r\n".to_vec(), "HTTP/1.1 400"),
        (
            b"GET / HTTP/9.9\r\nhost: nudge\r\n\r\n".to_vec(),
            "HTTP/1.1 400",
        ),
        (tls, "HTTP/1.1 400"),
        (large, "HTTP/1.1 431"),
        (long, "HTTP/1.1 431"),
        ([PREFACE, data].concat(), ""),
        ([PREFACE, setting].concat(), ""),
        // These only leave.
        (PREFACE.to_vec(), ""),
        (b"GET / HTTP/1.1\r\nho".to_vec(), ""),
        (Vec::new(), ""),
    ] {
        let mut raw = TcpStream::connect(service.server.address)
            .await
            .expect("accepted");
        // It may be refused before it is read to its end.
        let _ = raw.write_all(&first).await;
        let _ = raw.shutdown().await;
        let mut told = Vec::new();
        let _ = raw.read_to_end(&mut told).await;
        assert!(
            String::from_utf8_lossy(&told).starts_with(answer),
            "{}",
            String::from_utf8_lossy(&told)
        );
    }
    for (reason, times) in [
        ("malformed", 3.0),
        ("head_too_large", 2.0),
        ("http2", 2.0),
        ("silent", 0.0),
    ] {
        service
            .until(
                &format!("nudge_connections_ended_total{{reason=\"{reason}\"}}"),
                times,
            )
            .await;
    }
    let figures = service.metrics().await;
    assert_eq!(
        [
            figures.requests("rest", "other", "400"),
            figures.requests("rest", "other", "431")
        ],
        [3.0, 2.0]
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_are_counted_when_they_end() {
    let alone = Alone::start();
    alone
        .send("PUT", "/v1/environments/lane", Some(lane_json()))
        .await;
    let client = || async {
        IngestServiceClient::new(channel(alone.server.address).await.expect("it listens"))
    };
    let hello = |environment: &str| Hello {
        environment: environment.into(),
        producer: "p".into(),
        ..Hello::default()
    };

    let (_, stream) = RawStream::open(client().await, hello("lane"))
        .await
        .expect("welcome");
    alone.until("nudge_streams", 1.0).await;
    stream
        .send(rows(1, vec![row([0.1, 0.0], [0.0, 2.0])]))
        .await
        .expect("open");
    assert_eq!(stream.finish().await.0.len(), 1);
    assert!(
        RawStream::open(client().await, hello("nosuch"))
            .await
            .is_err()
    );
    alone
        .until(&requests("grpc", "Ingest", "NOT_FOUND"), 1.0)
        .await;

    // Who leaves ends its requests too, and which of the two is seen first is a race.
    let (mut ended, mut cancelled) = (1.0, 0.0);
    for opened in 1..=100 {
        let (_, left) = RawStream::open(client().await, hello("lane"))
            .await
            .expect("welcome");
        drop(left);
        (ended, cancelled) = alone.until_streams_ended(1.0 + f64::from(opened)).await;
        if cancelled > 0.0 {
            break;
        }
    }
    assert!(ended >= 1.0 && cancelled == 1.0, "{ended} and {cancelled}");
    alone.until("nudge_streams", 0.0).await;
    let figures = alone.metrics().await;
    assert!(
        !figures.1.contains("route=\"Ingest\",le="),
        "how long a stream lasts is its client's affair"
    );
    assert_eq!(
        figures.get("nudge_transitions_accepted_total{environment=\"lane\"}"),
        Some(1.0)
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn clients_that_left_and_commits_that_failed_are_counted() {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let held = Faulty::new(store, Failure::Held);
    let app = TestApp::with(directory, held.clone()).await;
    app.lane().await;
    let route = format!("POST {ENVIRONMENT}/transitions");
    let figures = async || Figures::parse(app.get("/metrics").await.as_str().expect("text"));
    let before = figures().await;

    held.arm();
    let body = transitions(1).to_string();
    let mut left = TcpStream::connect(app.address).await.expect("it listens");
    let head = "POST /v1/environments/lane/transitions HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n";
    let sent = format!("{head}content-length: {}\r\n\r\n{body}", body.len());
    left.write_all(sent.as_bytes()).await.expect("sent");
    let mut client = app.ingest().await;
    let batch = Some(rows(1, vec![row([0.1, 0.0], [0.0, 2.0])]));
    let (environment, producer) = ("lane".into(), "q".into());
    let write = proto::WriteRequest {
        environment,
        producer,
        batch,
        ..proto::WriteRequest::default()
    };
    let url = app.url("/nudge.v1.IngestService/Write");
    assert_eq!(web(&url, &write.encode_to_vec(), "100m").await, 200);
    let call = tokio::spawn(async move { client.write(write).await });
    tokio::time::sleep(Duration::from_millis(300)).await;
    drop(left);
    call.abort();
    let more = async |face: &str, route: &str, code: &str| {
        for _ in 0..200 {
            if figures().await.requests(face, route, code) > before.requests(face, route, code) {
                return;
            }
            tokio::time::sleep(Duration::from_millis(25)).await;
        }
        panic!("{face} {route} {code} is not counted");
    };
    more("rest", &route, "499").await;
    more("grpc", "Write", "CANCELLED").await;
    more("grpc", "Write", "DEADLINE_EXCEEDED").await;
    held.disarm();

    let infer = "/v2/models/lane/infer";
    let unfinished = [
        (
            "POST",
            "/v1/environments/lane/transitions",
            "application/json",
            "rest",
            route.as_str(),
            "499",
        ),
        (
            "POST",
            "/v1/environments/lane/influence",
            "application/json",
            "rest",
            INFLUENCE,
            "499",
        ),
        (
            "PUT",
            "/v1/environments/lane",
            "application/json",
            "rest",
            "PUT /v1/environments/{environment}",
            "499",
        ),
        (
            "POST",
            infer,
            "application/json",
            "rest",
            "POST /v2/models/{model}/infer",
            "499",
        ),
        (
            "POST",
            "/nudge.v1.IngestService/Write",
            "application/grpc-web+proto",
            "grpc",
            "Write",
            "CANCELLED",
        ),
    ];
    for (method, path, media, face, route, code) in unfinished {
        for body in [
            "content-length: 100\r\n\r\n{\"a",
            "transfer-encoding: chunked\r\n\r\n20\r\n{\"a",
        ] {
            let before = figures().await;
            let mut left = TcpStream::connect(app.address).await.expect("it listens");
            let sent = format!(
                "{method} {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {media}\r\n{body}"
            );
            left.write_all(sent.as_bytes()).await.expect("sent");
            tokio::time::sleep(Duration::from_millis(50)).await;
            drop(left);
            let mut times = 0;
            while figures().await.requests(face, route, code) <= before.requests(face, route, code)
            {
                times += 1;
                assert!(times < 200, "{route} {code} is not counted: {body}");
                tokio::time::sleep(Duration::from_millis(25)).await;
            }
            let other = if face == "rest" {
                "400"
            } else {
                "INVALID_ARGUMENT"
            };
            assert_eq!(
                figures().await.requests(face, route, other),
                before.requests(face, route, other),
                "{route}"
            );
        }
    }
    let before = figures().await;
    let mut wrong = TcpStream::connect(app.address).await.expect("it listens");
    let sent = "POST /v1/environments/lane/influence HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n\
        transfer-encoding: chunked\r\n\r\nnonsense\r\n";
    wrong.write_all(sent.as_bytes()).await.expect("sent");
    let mut told = Vec::new();
    let _ = wrong.read_to_end(&mut told).await;
    assert!(
        told.starts_with(b"HTTP/1.1 400"),
        "{}",
        String::from_utf8_lossy(&told)
    );
    assert!(
        figures().await.requests("rest", INFLUENCE, "400")
            > before.requests("rest", INFLUENCE, "400")
    );
    app.stop().await;

    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let failing = Faulty::new(store, Failure::BeforeCommit);
    let app = TestApp::with(directory, failing.clone()).await;
    app.lane().await;
    let figures = async || Figures::parse(app.get("/metrics").await.as_str().expect("text"));
    let before = figures().await;
    failing.arm();
    assert_eq!(
        app.rest(
            "POST",
            "/v1/environments/lane/transitions",
            Some(&transitions(1))
        )
        .await
        .0,
        503
    );
    let after = figures().await;
    for series in [
        requests("rest", &route, "503"),
        "nudge_commits_total{outcome=\"failed\"}".to_owned(),
        "nudge_batches_refused_total{reason=\"STORE_UNAVAILABLE\"}".to_owned(),
    ] {
        assert!(
            after.get(&series) > before.get(&series),
            "{series}: {:?}",
            after.get(&series)
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn figures_of_an_environment_go_with_it_and_begin_anew() {
    let alone = Alone::start();
    let accepted = "nudge_transitions_accepted_total{environment=\"lane\"}";
    for _ in 0..2 {
        alone
            .send("PUT", "/v1/environments/lane", Some(lane_json()))
            .await;
        let figures = alone.metrics().await;
        assert_eq!(
            figures.get(accepted),
            Some(0.0),
            "from the start, and from 0"
        );
        assert_eq!(
            figures.get("nudge_last_batch_timestamp_seconds{environment=\"lane\"}"),
            None
        );
        alone
            .send(
                "POST",
                "/v1/environments/lane/transitions",
                Some(transitions(1)),
            )
            .await;
        alone
            .send(
                "POST",
                "/v1/environments/lane/transitions",
                Some(transitions(1)),
            )
            .await;
        alone
            .send(
                "POST",
                "/v1/environments/lane/influence",
                Some(json!({"keys": ["3.0", "0.1"]})),
            )
            .await;
        alone
            .send("POST", "/v1/environments/lane/fit", Some(json!({})))
            .await;
        let figures = alone.metrics().await;
        for (series, expected) in [
            (accepted, 1.0),
            (
                "nudge_transitions_rejected_total{environment=\"lane\",reason=\"state\"}",
                1.0,
            ),
            ("nudge_batches_duplicate_total{environment=\"lane\"}", 1.0),
            ("nudge_states{environment=\"lane\"}", 1.0),
            ("nudge_models{environment=\"lane\"}", 0.0),
            ("nudge_models_active{environment=\"lane\"}", 0.0),
            (
                "nudge_quota_used_ratio{environment=\"lane\",quota=\"producers\"}",
                1e-4,
            ),
            ("nudge_quota_used_ratio{quota=\"environments\"}", 1e-3),
            ("nudge_fit_behind_transitions{environment=\"lane\"}", 0.0),
            ("nudge_environments", 1.0),
        ] {
            assert_eq!(figures.get(series), Some(expected), "{series}");
        }
        assert!(
            figures
                .get("nudge_fit_age_seconds{environment=\"lane\"}")
                .is_some_and(|age| age < 60.0)
        );
        assert!(
            figures
                .get("nudge_last_batch_timestamp_seconds{environment=\"lane\"}")
                .is_some_and(|at| at > 1.7e9)
        );
        assert_eq!(
            alone.status("DELETE", "/v1/environments/lane", None).await,
            204
        );
        assert!(
            !alone.metrics().await.1.contains("environment=\"lane\""),
            "nothing is left of it"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn counters_are_there_before_anything_happens() {
    let alone = Alone::start();
    let figures = alone.metrics().await;
    for series in [
        requests("rest", &format!("GET {ENVIRONMENT}/influence"), "500"),
        requests("rest", "other", "499"),
        requests("grpc", "Ingest", "UNAVAILABLE"),
        requests("grpc", "ModelInfer", "INTERNAL"),
        "nudge_commits_total{outcome=\"failed\"}".into(),
        "nudge_batches_refused_total{reason=\"OVERLOADED\"}".into(),
        "nudge_trainings_total{outcome=\"failed\"}".into(),
        "nudge_training_jobs{state=\"running\"}".into(),
        "nudge_verdicts_total{verdict=\"influences\",basis=\"model\"}".into(),
        "nudge_cache_states_total{outcome=\"miss\"}".into(),
        "nudge_commit_duration_seconds_count".into(),
        "nudge_training_duration_seconds_bucket{outcome=\"done\",le=\"14400\"}".into(),
        "nudge_work_waiting_turns{lane=\"questions\"}".into(),
        "nudge_requests_shed_total{reason=\"TOO_MANY_CONNECTIONS\"}".into(),
    ] {
        assert_eq!(
            figures.get(&series),
            Some(0.0),
            "{series} in\n{}",
            figures.1
        );
    }
    for series in [
        "process_cpu_seconds_total",
        "process_resident_memory_bytes",
        "process_open_fds",
        "process_max_fds",
        "process_start_time_seconds",
        "nudge_uptime_seconds",
        "nudge_disk_free_bytes",
        "nudge_database_bytes",
    ] {
        assert!(
            figures.get(series).is_some_and(|number| number > 0.0),
            "{series}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn both_faces_have_request_ids_and_each_change_is_a_line_with_who_and_from_where() {
    let alone = Alone::start();
    let send = async |method: &str, path: &str, body: Option<Value>, id: &str| {
        let client =
            reqwest::Client::new().request(method.parse().expect("a method"), alone.url(path));
        let request = client
            .header("user-agent", "tester/1")
            .header("x-request-id", id);
        let request = if let Some(body) = body {
            request.json(&body)
        } else {
            request
        };
        let response = request.send().await.expect("answered");
        assert_eq!(response.headers()["x-request-id"], id);
        response.status().as_u16()
    };
    assert_eq!(
        send("PUT", "/v1/environments/lane", Some(lane_json()), "made").await,
        201
    );
    assert_eq!(
        send(
            "PATCH",
            "/v1/environments/lane",
            Some(json!({"rule": {"confidence": 0.9}})),
            "rule"
        )
        .await,
        200
    );
    assert_eq!(
        send(
            "POST",
            "/v1/environments/lane/models",
            Some(json!({})),
            "trained"
        )
        .await,
        202
    );
    let mut client =
        EnvironmentServiceClient::new(channel(alone.server.address).await.expect("it listens"));
    let mut request = tonic::Request::new(proto::DeleteEnvironmentRequest {
        name: "lane".into(),
    });
    request
        .metadata_mut()
        .insert("x-request-id", "gone".parse().expect("ASCII"));
    let answer = client
        .delete_environment(request)
        .await
        .expect("it was there");
    assert_eq!(
        answer
            .metadata()
            .get("x-request-id")
            .map(|id| id.as_bytes()),
        Some(&b"gone"[..])
    );
    let refused = client
        .get_environment(proto::GetEnvironmentRequest {
            name: "lane".into(),
        })
        .await
        .expect_err("gone");
    assert!(
        refused
            .metadata()
            .get("x-request-id")
            .is_some_and(|id| !id.is_empty()),
        "one is given"
    );
    let long = "x".repeat(5_000);
    let response = reqwest::Client::new()
        .get(alone.url("/livez"))
        .header("x-request-id", &long)
        .send()
        .await;
    assert_ne!(
        response.expect("answered").headers()["x-request-id"],
        long.as_str(),
        "none of any length"
    );

    let lines = alone.log();
    for (message, id, client) in [
        ("an environment was made", "made", "tester/1"),
        ("a rule was changed", "rule", "tester/1"),
        ("a training was asked for", "trained", "tester/1"),
        ("an environment was deleted", "gone", "tonic/"),
    ] {
        let line = lines
            .iter()
            .find(|line| line["message"] == message)
            .unwrap_or_else(|| panic!("{message}: {lines:?}"));
        let request = line["spans"]
            .as_array()
            .and_then(|spans| spans.first())
            .expect("within a request");
        assert_eq!(
            (&line["level"], &line["environment"]),
            (&json!("INFO"), &json!("lane"))
        );
        assert_eq!(
            (&request["id"], &request["from"]),
            (&json!(id), &json!("127.0.0.1")),
            "{line}"
        );
        assert!(
            request["client"]
                .as_str()
                .is_some_and(|found| found.starts_with(client)),
            "{line}"
        );
    }
}

/// Writes the table anew where `NUDGE_WRITE_DOCS` is set.
#[test]
fn the_table_of_metrics_is_made_of_the_code() {
    const MARKS: [&str; 2] = [
        "<!-- the table: made of src/telemetry/list.rs -->\n",
        "<!-- its end -->",
    ];
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/metrics.md");
    let text = std::fs::read_to_string(&path).expect("the page");
    let (before, rest) = text.split_once(MARKS[0]).expect("the begin of the table");
    let (table, after) = rest.split_once(MARKS[1]).expect("the end of the table");
    let mut made = "| metric | kind | labels | what it says |\n|---|---|---|---|\n".to_owned();
    for metric in ALL {
        let labels = metric
            .labels
            .iter()
            .map(|label| format!("`{label}`"))
            .collect::<Vec<_>>()
            .join(", ");
        made += &format!(
            "| `{}` | {} | {labels} | {} |\n",
            metric.name,
            metric.kind.as_str(),
            metric.help
        );
    }
    if std::env::var_os("NUDGE_WRITE_DOCS").is_some() {
        std::fs::write(&path, [before, MARKS[0], &made, MARKS[1], after].concat())
            .expect("written");
        return;
    }
    assert_eq!(table, made, "run this test with NUDGE_WRITE_DOCS=1");
}

#[test]
fn metrics_have_names_that_say_what_they_are() {
    const UNITS: [&str; 6] = [
        "_seconds",
        "_bytes",
        "_ratio",
        "_transitions",
        "_info",
        "_total",
    ];
    const LABELS: [&str; 14] = [
        "version",
        "revision",
        "check",
        "face",
        "route",
        "code",
        "reason",
        "environment",
        "quota",
        "outcome",
        "verdict",
        "basis",
        "lane",
        "state",
    ];
    let mut names: Vec<&str> = ALL.iter().map(|metric| metric.name).collect();
    names.sort_unstable();
    assert!(
        names.windows(2).all(|pair| pair[0] != pair[1]),
        "each is declared once"
    );
    for metric in ALL {
        assert!(
            metric.name.starts_with("nudge_") || metric.name.starts_with("process_"),
            "{}",
            metric.name
        );
        assert_eq!(
            metric.kind == Kind::Counter,
            metric.name.ends_with("_total"),
            "{}",
            metric.name
        );
        let is_measure = matches!(metric.kind, Kind::Histogram(_));
        assert!(
            !is_measure || UNITS.iter().any(|unit| metric.name.ends_with(unit)),
            "{}",
            metric.name
        );
        assert!(
            metric.labels.iter().all(|label| LABELS.contains(label)),
            "{}: labels are bounded",
            metric.name
        );
        assert!(
            !metric.help.ends_with('.') && !metric.help.contains('|'),
            "{}",
            metric.help
        );
    }
}
