//! Connections are bounded in number, in time and in memory, and what is refused is told.

use std::convert::Infallible;
use std::io::Write as _;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use flate2::Compression;
use flate2::write::GzEncoder;
use futures::StreamExt;
use http_body::Frame;
use http_body_util::{BodyExt, Full, StreamBody};
use hyper_util::rt::{TokioExecutor, TokioIo};
use nudge::api::MOST_MESSAGE_BYTES;
use nudge::api::proto::{self, ApplyEnvironmentRequest, ListEnvironmentsRequest};
use nudge::client::Connection;
use nudge::domain::{Entry, Record};
use nudge::serve::Settings;
use nudge::serve::connections::limits::Limits;
use nudge::store::Options;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::io::AsyncWriteExt;
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{sleep, timeout};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status};

use crate::support::faulty::{Failure, Faulty};
use crate::support::raw::{LONG, PREFACE, Raw, call, frame};
use crate::support::{RawStream, TestApp, hello, lane_schema, open, reason, row, rows};

const ALIVE: &[u8] = b"GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n";
const LANE: &str = "/v1/environments/lane";
const TRANSITIONS: &str = "/v1/environments/lane/transitions";

/// Limits in which the thing to be tested takes a second, and all else as long as ever.
fn second() -> Duration {
    Duration::from_secs(1)
}

async fn start(limits: Limits) -> TestApp {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    TestApp::set(
        directory,
        store,
        Settings {
            limits,
            ..Settings::default()
        },
    )
    .await
}

fn post(path: &str, media: &str, length: usize) -> Vec<u8> {
    format!("POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {media}\r\ncontent-length: {length}\r\n\r\n")
        .into()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).expect("in memory");
    encoder.finish().expect("in memory")
}

#[tokio::test]
async fn headers_have_their_time_and_no_more() {
    let app = start(Limits {
        head: second(),
        ..Limits::default()
    })
    .await;
    let half = [PREFACE, &call("/nudge.v1.IngestService/Ingest")[..20]].concat();
    let silent: [&[u8]; 6] = [
        b"",
        b"GET /liv",
        b"GET /livez HTTP/1.1\r\nhost: ",
        &PREFACE[..12],
        PREFACE,
        &half,
    ];
    let mut ended = JoinSet::new();
    for first in silent.map(<[u8]>::to_vec) {
        let address = app.address;
        ended.spawn(async move { Raw::open(address, &first).await.end().await });
    }
    // Drop by drop, of a first request and of a later one.
    for first in [
        b"GET /livez HTTP/1.1\r\nx: ".to_vec(),
        [ALIVE, b"GET /"].concat(),
    ] {
        let mut raw = Raw::open(app.address, &first).await;
        ended.spawn(async move {
            raw.drip(b'a').await;
            Vec::new()
        });
    }
    while let Some(ended) = ended.join_next().await {
        ended.expect("it is ended");
    }
    assert_eq!(app.rest("GET", "/livez", None).await.0, 200);
}

#[tokio::test]
async fn a_client_that_connects_early_connects_again() {
    let app = start(Limits {
        head: second(),
        ..Limits::default()
    })
    .await;
    let mut early = app.environments().await;
    Raw::open(app.address, PREFACE).await.end().await;
    early
        .list_environments(ListEnvironmentsRequest::default())
        .await
        .expect("on another connection");
}

#[tokio::test]
async fn idle_connections_are_ended_and_streams_are_never_idle() {
    let app = start(Limits {
        idle: second(),
        stalled: second(),
        ..Limits::default()
    })
    .await;
    app.lane().await;
    let (_, mut stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    let answer = Raw::open(app.address, ALIVE).await.end().await;
    assert!(answer.starts_with(b"HTTP/1.1 200"));
    // A call that is refused at once is a request all the same, and then there is none.
    let refused = [
        PREFACE,
        &call("/nudge.v1.Nothing/Nothing"),
        &frame(0, 1, 1, &[]),
    ]
    .concat();
    Raw::open(app.address, &refused).await.end().await;
    // Both took longer than a stream without a word might.
    stream
        .send(rows(1, vec![row([0.1, 0.0], [0.0, 2.0])]))
        .await
        .expect("open");
    assert_eq!(
        stream
            .acknowledged()
            .await
            .expect("open")
            .committed_sequence,
        1
    );
}

#[tokio::test]
async fn bodies_that_stall_are_told_and_ended() {
    let app = start(Limits {
        stalled: second(),
        ..Limits::default()
    })
    .await;
    app.lane().await;
    let half = [&post(TRANSITIONS, "application/json", 100)[..], b"{"].concat();
    let mut rest = Raw::open(app.address, &half).await;
    assert!(rest.until("}").await.contains("BODY_STALLED"));
    for (path, data) in [
        ("/nudge.v1.IngestService/Write", &b""[..]),
        (
            "/nudge.v1.ModelService/ImportModel",
            b"\0\0\x10\0\0half a message",
        ),
        (
            "/nudge.v1.EnvironmentService/ListEnvironments",
            b"\0\0\0\0\0",
        ),
        (
            "/nudge.v1.IngestService/Ingest",
            b"\0\0\x10\0\0half a message",
        ),
    ] {
        let (body, call) = begin(&app, path).await;
        body.send(Bytes::from_static(data)).await.expect("open");
        assert_stalled(call, path).await;
    }
}

#[tokio::test]
async fn a_message_that_comes_drop_by_drop_has_its_time_and_no_more() {
    let app = start(Limits {
        message: second(),
        ..Limits::default()
    })
    .await;
    for path in [
        "/nudge.v1.ModelService/ImportModel",
        "/nudge.v1.IngestService/Ingest",
    ] {
        let (body, call) = begin(&app, path).await;
        body.send(Bytes::from_static(b"\0\0\x10\0\0"))
            .await
            .expect("open");
        tokio::spawn(async move {
            while body.send(Bytes::from_static(b"x")).await.is_ok() {
                sleep(Duration::from_millis(20)).await;
            }
        });
        assert_stalled(call, path).await;
    }
}

/// Begins a call whose body is what is sent, and goes on for as long as its sender lives.
async fn begin(app: &TestApp, path: &str) -> (mpsc::Sender<Bytes>, JoinHandle<Status>) {
    let stream = TokioIo::new(TcpStream::connect(app.address).await.expect("it listens"));
    let (mut client, connection) =
        hyper::client::conn::http2::handshake(TokioExecutor::new(), stream)
            .await
            .expect("HTTP/2");
    tokio::spawn(connection);
    let (sender, data) = mpsc::channel(1);
    let body = StreamBody::new(
        ReceiverStream::new(data).map(|data| Ok::<_, Infallible>(Frame::data(data))),
    );
    let request = http::Request::post(app.url(path))
        .header("content-type", "application/grpc")
        .body(body);
    let call = tokio::spawn(async move {
        let answer = client
            .send_request(request.expect("a request"))
            .await
            .expect("answered");
        if let Some(status) = Status::from_header_map(answer.headers()) {
            return status;
        }
        let trailers = answer
            .into_body()
            .collect()
            .await
            .expect("whole")
            .trailers()
            .cloned();
        Status::from_header_map(&trailers.expect("a stream ends with trailers")).expect("a status")
    });
    (sender, call)
}

async fn assert_stalled(call: JoinHandle<Status>, path: &str) {
    let status = timeout(LONG, call)
        .await
        .expect("it is ended")
        .expect("answered");
    assert_eq!(
        (status.code(), reason(&status).as_str()),
        (Code::Unavailable, "BODY_STALLED"),
        "{path}"
    );
}

#[tokio::test]
async fn answers_that_nobody_reads_are_ended() {
    let app = start(Limits {
        stalled: second(),
        ..Limits::default()
    })
    .await;
    // More than sockets hold.
    let many = b"GET /docs/swagger-ui-bundle.js HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(30);
    let mut raw = Raw::open(app.address, &many).await;
    let writing = async { while raw.0.write_all(ALIVE).await.is_ok() {} };
    timeout(LONG, writing).await.expect("it is ended");
    assert_eq!(app.rest("GET", "/livez", None).await.0, 200);
}

#[tokio::test]
async fn an_answer_is_whole_however_large() {
    let app = start(Limits::default()).await;
    let large = "/docs/swagger-ui-bundle.js";
    let plain = reqwest::get(app.url(large)).await.expect("answered");
    let length = plain.headers()["content-length"]
        .to_str()
        .expect("text")
        .parse::<usize>()
        .expect("a number");
    assert_eq!(plain.bytes().await.expect("whole").len(), length);
    assert!(length > 1 << 20, "of many pieces");
}

#[tokio::test]
async fn who_waits_makes_room() {
    let app = start(Limits {
        connections: 2,
        guests: 0,
        ..Limits::default()
    })
    .await;
    let mut idle = Raw::open(app.address, ALIVE).await;
    idle.until("ok\n").await;
    let mut silent = Raw::open(app.address, b"").await;
    for _ in 0..3 {
        let mut raw = Raw::open(app.address, ALIVE).await;
        raw.until("ok\n").await;
    }
    idle.end().await;
    silent.end().await;
}

#[tokio::test]
async fn operators_are_answered_where_everybody_is_busy() {
    let app = start(Limits {
        connections: 2,
        guests: 2,
        ..Limits::default()
    })
    .await;
    app.lane().await;
    let mut streams = Vec::new();
    for producer in ["p", "q"] {
        streams.push(
            RawStream::open(app.ingest().await, hello(producer))
                .await
                .expect("welcome"),
        );
    }
    for path in ["/livez", "/readyz", "/metrics", "/v2/health/live"] {
        assert_eq!(app.rest("GET", path, None).await.0, 200, "{path}");
    }
    let (status, problem) = app.rest("GET", LANE, None).await;
    assert_eq!(
        (status, &problem["reason"]),
        (503, &json!("TOO_MANY_CONNECTIONS"))
    );
    let refused = app
        .environments()
        .await
        .list_environments(ListEnvironmentsRequest::default())
        .await;
    let refused = refused.expect_err("busy");
    assert_eq!(
        (refused.code(), reason(&refused).as_str()),
        (Code::Unavailable, "TOO_MANY_CONNECTIONS")
    );
    drop(streams);
    let served = async { while app.rest("GET", LANE, None).await.0 != 200 {} };
    timeout(LONG, served).await.expect("there is room again");
}

#[tokio::test]
async fn unfinished_messages_share_their_memory() {
    let app = start(Limits {
        unfinished_bytes: 1 << 20,
        ..Limits::default()
    })
    .await;
    app.lane().await;
    let spaces = vec![b' '; 400 << 10];
    let large = async || {
        let request = reqwest::Client::new()
            .post(app.url(TRANSITIONS))
            .header("content-type", "application/json");
        request
            .body(spaces.clone())
            .send()
            .await
            .expect("answered")
            .json::<Value>()
            .await
            .expect("JSON")["reason"]
            .clone()
    };
    assert_eq!(large().await, "INVALID_INPUT", "there is enough for one");

    // A message of gRPC and a body, half sent.
    let import = [
        PREFACE,
        &call("/nudge.v1.ModelService/ImportModel")[..],
        &frame(0, 0, 1, b"\0\0\x10\0\0"),
    ]
    .concat();
    let mut holders = vec![Raw::open(app.address, &import).await];
    for _ in 0..20 {
        holders[0]
            .0
            .write_all(&frame(0, 0, 1, &[0; 10 << 10]))
            .await
            .expect("taken");
    }
    let head = post(TRANSITIONS, "application/json", spaces.len());
    holders.push(Raw::open(app.address, &[&head[..], &spaces[8..]].concat()).await);

    let refused = async { while large().await != "TOO_MANY_UNFINISHED_BYTES" {} };
    timeout(LONG, refused).await.expect("they hold too much");
    assert_eq!(app.rest("GET", LANE, None).await.0, 200);
    let small = json!({"producer": "p", "sequence": 1, "transitions": []});
    assert_eq!(
        app.rest("POST", TRANSITIONS, Some(&small)).await.0,
        200,
        "small ones are taken"
    );
    drop(holders);
    let taken = async { while large().await != "INVALID_INPUT" {} };
    timeout(LONG, taken)
        .await
        .expect("what they held comes back");
}

#[tokio::test]
async fn refusals_arrive_at_clients_that_send_everything_first() {
    let app = start(Limits::default()).await;
    app.lane().await;
    let cases = [
        (LANE, "application/json", 3 << 20, 405),
        (TRANSITIONS, "text/plain", 3 << 20, 415),
        (TRANSITIONS, "application/json", 24 << 20, 413),
        ("/v1/nothing", "application/json", 3 << 20, 404),
    ];
    for (path, media, length, status) in cases {
        let mut raw = Raw::open(app.address, &post(path, media, length)).await;
        let sent = timeout(LONG, raw.0.write_all(&vec![b' '; length]))
            .await
            .expect("it is read");
        sent.expect("it is read");
        assert!(
            raw.until("}")
                .await
                .starts_with(&format!("HTTP/1.1 {status}")),
            "{path} {media}"
        );
        raw.0.write_all(ALIVE).await.expect("open");
        assert!(
            raw.until("ok\n").await.starts_with("HTTP/1.1 200"),
            "the connection goes on"
        );

        let stream = TokioIo::new(TcpStream::connect(app.address).await.expect("it listens"));
        let (mut client, connection) =
            hyper::client::conn::http2::handshake(TokioExecutor::new(), stream)
                .await
                .expect("HTTP/2");
        tokio::spawn(connection);
        let request = http::Request::post(app.url(path)).header("content-type", media);
        let request = request
            .body(Full::new(Bytes::from(vec![b' '; length])))
            .expect("a request");
        let answer = client.send_request(request).await.expect("answered");
        assert_eq!(answer.status(), status, "{path} {media} over HTTP/2");
        assert!(
            !answer
                .into_body()
                .collect()
                .await
                .expect("whole")
                .to_bytes()
                .is_empty()
        );
    }
}

#[tokio::test]
async fn who_asks_first_whether_to_send_is_told_without_sending() {
    let app = start(Limits::default()).await;
    let head = post(TRANSITIONS, "text/plain", 3 << 20);
    let asking = [&head[..head.len() - 2], b"expect: 100-continue\r\n\r\n"].concat();
    let told = Raw::open(app.address, &asking).await.end().await;
    assert!(
        told.starts_with(b"HTTP/1.1 415"),
        "{}",
        String::from_utf8_lossy(&told)
    );
}

#[tokio::test]
async fn packed_bodies_are_read_or_named() {
    let app = start(Limits::default()).await;
    app.lane().await;
    let whole = gzip(br#"{"producer": "p", "sequence": 1, "transitions": []}"#);
    let torn = whole[..whole.len() - 8].to_vec();
    let cases = [
        ("gzip", whole, 200, ""),
        ("gzip", torn, 400, "cannot be read"),
        ("gzip", b"{}".to_vec(), 400, "cannot be read"),
        (
            "gzip",
            gzip(&vec![b' '; 17 << 20]),
            413,
            "larger than 16 MiB",
        ),
        (
            "br",
            b"{}".to_vec(),
            415,
            "got content encoding \"br\", expected gzip, deflate or identity",
        ),
    ];
    for (encoding, body, status, detail) in cases {
        let request = reqwest::Client::new()
            .post(app.url(TRANSITIONS))
            .header("content-encoding", encoding);
        let answer = request
            .header("content-type", "application/json")
            .body(body)
            .send()
            .await
            .expect("answered");
        assert_eq!(answer.status().as_u16(), status, "{encoding} {detail}");
        let told: Value = answer.json().await.expect("JSON");
        assert!(
            told["detail"].as_str().unwrap_or_default().contains(detail),
            "{told}"
        );
    }
}

#[tokio::test]
async fn descriptions_have_a_limit_of_their_own() {
    let app = start(Limits::default()).await;
    let labels: Vec<String> = (0..160_000).map(|i| format!("{i:032}")).collect();
    let feature = json!({"name": "wide", "categorical": {"labels": labels}});
    let (status, told) = app
        .rest(
            "PUT",
            LANE,
            Some(&json!({"state": [feature], "agents": []})),
        )
        .await;
    assert_eq!(
        (status, &told["reason"]),
        (413, &json!("BODY_TOO_LARGE")),
        "{told}"
    );
    assert_eq!(
        told["detail"],
        "the body is larger than 4 MiB; send less at a time"
    );

    let mut schema = lane_schema();
    let kind = proto::feature::Kind::Categorical(proto::Categorical { labels });
    schema.state.push(proto::Feature {
        name: "wide".into(),
        unit: String::new(),
        kind: Some(kind),
    });
    let request = ApplyEnvironmentRequest {
        name: "lane".into(),
        schema: Some(schema),
        rule: None,
        derived: None,
    };
    let refused = app
        .environments()
        .await
        .apply_environment(request)
        .await
        .expect_err("too large");
    assert_eq!(refused.code(), Code::OutOfRange, "{refused}");

    let edges: Vec<f32> = (0..65_535).map(|i| i as f32).collect();
    let mut largest = crate::support::lane_json();
    largest["state"][0]["continuous"]["edges"] = json!(edges);
    assert!(largest.to_string().len() < MOST_MESSAGE_BYTES);
    assert_eq!(
        app.rest("PUT", LANE, Some(&largest)).await.0,
        201,
        "the most bins fit"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn old_connections_are_left_without_loss() {
    let app = start(Limits {
        age: Duration::from_millis(300),
        ..Limits::default()
    })
    .await;
    app.lane().await;
    let connection = Connection::open(&app.address.to_string())
        .await
        .expect("it listens");
    let mut producer = connection
        .producer("lane", "p")
        .batch_size(10)
        .open()
        .await
        .expect("known");
    let record = || Record {
        entry: Entry::Entered,
        ..Record::new(vec![0.1, 0.0], vec![0.0, 2.0])
    };
    for _ in 0..200 {
        for _ in 0..10 {
            producer.send(record()).await.expect("taken");
        }
        sleep(Duration::from_millis(10)).await;
    }
    let totals = producer.close().await.expect("acknowledged");
    assert_eq!(totals.sent, 2_000);
    assert_eq!(
        app.cells("0.0").await[0].2,
        2_000,
        "nothing is lost and nothing doubled"
    );
    let (_, mut stream) = RawStream::open(app.ingest().await, hello("by-hand"))
        .await
        .expect("welcome");
    let end = timeout(LONG, stream.acknowledged())
        .await
        .expect("it is ended")
        .expect_err("it is ended");
    assert_eq!(
        (end.code(), reason(&end).as_str()),
        (Code::Unavailable, "RECONNECT")
    );
    let (_, metrics) = app.rest("GET", "/metrics", None).await;
    assert!(
        metrics
            .as_str()
            .unwrap_or_default()
            .contains("nudge_connections_ended_total{reason=\"age\"}")
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_waits_for_nobody_who_does_not_care() {
    let app = start(Limits {
        drain: second(),
        ..Limits::default()
    })
    .await;
    app.lane().await;
    let unread = b"GET /docs/swagger-ui-bundle.js HTTP/1.1\r\nhost: localhost\r\n\r\n".repeat(30);
    let half = [&post(TRANSITIONS, "application/json", 100)[..], b"{"].concat();
    let open = [PREFACE, &call("/nudge.v1.IngestService/Ingest")].concat();
    let mut others = Vec::new();
    for first in [&b""[..], b"GET /l", ALIVE, &unread, &half, PREFACE, &open] {
        others.push(Raw::open(app.address, first).await);
    }
    let mut streams = Vec::new();
    for i in 0..20 {
        let (_, stream) = RawStream::open(app.ingest().await, hello(&format!("p{i}")))
            .await
            .expect("welcome");
        for sequence in 1..=20 {
            stream
                .send(rows(sequence, vec![row([0.1, 0.0], [0.0, 2.0]); 10]))
                .await
                .expect("open");
        }
        streams.push(stream);
    }
    let directory = app.directory.clone();
    timeout(LONG, app.stop()).await.expect("it stops");

    let mut told = 0;
    for mut stream in streams {
        let mut committed = 0;
        while let Ok(acknowledged) = stream.acknowledged().await {
            committed = acknowledged.committed_sequence;
        }
        told += committed * 10;
    }
    let again = TestApp::on(directory).await;
    let counted = again.cells("0.0").await.first().map_or(0, |cell| cell.2);
    assert!(
        counted >= told && told > 0,
        "{counted} counted, {told} acknowledged"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn single_calls_get_through_where_streams_take_all_they_can() {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let held = Faulty::new(store, Failure::Held);
    let app = TestApp::with(directory, held.clone()).await;
    app.lane().await;
    let mut streams = Vec::new();
    for producer in 0..4 {
        streams.push(
            RawStream::open(app.ingest().await, hello(&format!("p{producer}")))
                .await
                .expect("welcome")
                .1,
        );
    }
    held.arm();
    let mut receipts = Vec::new();
    for stream in streams {
        let (requests, responses) = stream.split();
        tokio::spawn(async move {
            for sequence in 1..=20 {
                let transitions = vec![row([0.1, 0.0], [0.0, 2.0]); 10_000];
                let message = Some(proto::ingest_request::Message::Batch(rows(
                    sequence,
                    transitions,
                )));
                if requests
                    .send(proto::IngestRequest { message })
                    .await
                    .is_err()
                {
                    return;
                }
            }
        });
        receipts.push(responses);
    }
    let full = async {
        while app.app.ingest.queued() < 320_000 {
            sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(LONG, full).await.expect("streams fill their share");

    let body = json!({"producer": "rest", "sequence": 1, "transitions": [
        {"state": {"distance": 0.1, "held": 1}, "actions": {"robot": 0, "human": 0}}]});
    let call = app.rest("POST", TRANSITIONS, Some(&body));
    let free = async {
        while app.app.ingest.queued() < 320_001 {
            sleep(Duration::from_millis(5)).await;
        }
        held.disarm();
    };
    let ((status, told), ()) = timeout(LONG, futures::future::join(call, free))
        .await
        .expect("the call is queued");
    assert_eq!(
        (status, &told["status"]),
        (200, &json!("applied")),
        "{told}"
    );
    drop(receipts);
}

#[tokio::test]
async fn a_request_that_does_not_say_once_whom_it_is_for_is_refused() {
    let app = start(Limits::default()).await;
    for (request, status) in [
        ("GET /livez HTTP/1.1\r\n\r\n", 400),
        ("GET /livez HTTP/1.1\r\nHost: a\r\nHost: a\r\n\r\n", 400),
        ("GET /livez HTTP/1.1\r\nHost: a b\r\n\r\n", 400),
        ("GET http://a/livez HTTP/1.1\r\n\r\n", 400),
        (
            "POST /v1/environments/e/transitions HTTP/1.1\r\nContent-Length: 100000\r\n\r\n{",
            400,
        ),
        ("GET /livez HTTP/1.0\r\nHost: a\r\nHost: b\r\n\r\n", 400),
        ("GET /livez HTTP/1.0\r\n\r\n", 200),
        (
            "GET /livez HTTP/1.1\r\nHost: a:8080\r\nConnection: close\r\n\r\n",
            200,
        ),
        (
            "GET /livez HTTP/1.1\r\nHost:\r\nConnection: close\r\n\r\n",
            200,
        ),
    ] {
        let told = Raw::open(app.address, request.as_bytes()).await.end().await;
        let told = String::from_utf8(told).expect("text");
        assert_eq!(
            told.split(' ').nth(1),
            Some(status.to_string().as_str()),
            "{request:?}: {told}"
        );
        assert!(
            status == 200 || told.contains("application/problem+json"),
            "{told}"
        );
    }
    app.stop().await;
}
