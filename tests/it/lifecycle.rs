//! The life of the service as its operators see it: what it is configured to, what it answers when
//! its queue is full, and how it ends.

use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use futures::future::join_all;
use nudge::api::proto;
use nudge::store::Options;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::time::{sleep, timeout};
use tonic::Code;
use tonic_types::StatusExt;

use crate::cli::{exit_and_texts, nudge, output};
use crate::server::Server;
use crate::support::faulty::{Failure, Faulty};
use crate::support::raw::{LONG, Raw};
use crate::support::{RawStream, TestApp, hello, lane_json, open, reason, row, rows};

#[tokio::test]
async fn flags_are_stronger_than_variables_and_variables_than_defaults() {
    let mut command = nudge(
        "",
        &[
            "serve",
            "--print-config",
            "--max-cells",
            "7",
            "--hosts",
            "a.example",
        ],
    );
    command
        .env("NUDGE_MAX_CELLS", "8")
        .env("NUDGE_HOSTS", "b.example")
        .env("NUDGE_FIT_EVERY", "120s")
        .env("NUDGE_INSECURE", "yes")
        .env("NUDGE_DATA", "elsewhere")
        .env("NUDGE_CORS_ORIGINS", "https://a.example,https://b.example");
    let (code, printed, stderr) = exit_and_texts(&output(command).await);
    assert_eq!((code, stderr.as_str()), (0, ""));
    for line in [
        "listen = \"127.0.0.1:8080\"",
        "data = \"elsewhere\"",
        "max_cells = 7",
        "max_segments = 4096",
        "fit_every = \"2m\"",
        "insecure = true",
        "hosts = [\"a.example\"]",
        "cors_origins = [\"https://a.example\", \"https://b.example\"]",
        "log = \"human\"",
    ] {
        assert!(
            printed.lines().any(|one| one == line),
            "{line} in {printed}"
        );
    }
}

/// Room in the queue for what streams send, and beside it for single calls.
const STREAMS: usize = 512_000;
const CALLS: usize = 64_000;

/// Returns so many equal transitions under a number.
fn batch(sequence: u64, transitions: usize) -> proto::Batch {
    rows(sequence, vec![row([0.1, 0.0], [0.0, 2.0]); transitions])
}

async fn write(
    app: &TestApp,
    producer: &str,
    transitions: usize,
) -> Result<proto::WriteResponse, tonic::Status> {
    let request = proto::WriteRequest {
        environment: "lane".into(),
        producer: producer.into(),
        batch: Some(batch(1, transitions)),
        ..proto::WriteRequest::default()
    };
    let answer = app.ingest().await.write(request).await;
    answer.map(tonic::Response::into_inner)
}

async fn queued(app: &TestApp, transitions: usize) {
    let filled = async {
        while app.app.ingest.queued() < transitions {
            sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(LONG, filled).await.expect("the queue fills");
}

/// Back-pressure, honestly: whoever finds the queue full is told so and counted nothing; whoever had
/// a place is counted; and who was refused comes again.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_queue_is_overloaded_and_loses_nothing() {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let held = Faulty::new(store, Failure::Held);
    let app = TestApp::with(directory, held.clone()).await;
    app.lane().await;

    // A hello waits for what is queued before it, so all are said before nothing is committed.
    let mut streams = Vec::new();
    for producer in 0..4 {
        let stream = RawStream::open(app.ingest().await, hello(&format!("stream-{producer}")));
        streams.push(stream.await.expect("welcome").1);
    }

    // Streams fill what they may.
    held.arm();
    for stream in &streams {
        for sequence in 1..=16 {
            let sent = stream.send(batch(sequence, STREAMS / 64)).await;
            sent.expect("the stream is open");
        }
    }
    queued(&app, STREAMS).await;

    // So do single calls.
    let calls = (0..8).map(|call| {
        let producer = format!("call-{call}");
        let app = &app;
        async move { write(app, &producer, CALLS / 8).await }
    });
    let calls = join_all(calls);
    let body = json!({"producer": "rest", "sequence": 1, "transitions": [
        {"state": {"distance": 0.1, "held": 0}, "actions": {"robot": 0, "human": 2}}]});
    let refused = async {
        queued(&app, STREAMS + CALLS).await;
        let path = "/v1/environments/lane/transitions";
        let answer = reqwest::Client::new()
            .post(app.url(path))
            .json(&body)
            .send();
        let (rest, grpc) = tokio::join!(answer, write(&app, "grpc", 1));
        held.disarm();
        (rest.expect("answered"), grpc.expect_err("no room"))
    };
    let (calls, (rest, grpc)) = timeout(LONG, futures::future::join(calls, refused))
        .await
        .expect("nobody waits for ever");

    assert_eq!(rest.status().as_u16(), 503);
    assert!(rest.headers().contains_key("retry-after"));
    let problem: Value = rest.json().await.expect("a problem");
    assert_eq!(problem["reason"], "OVERLOADED", "{problem}");
    assert_eq!(
        (grpc.code(), reason(&grpc).as_str()),
        (Code::Unavailable, "OVERLOADED")
    );
    assert!(grpc.get_details_retry_info().is_some(), "{grpc:?}");

    // Whoever had a place is counted once the store commits again.
    for call in calls {
        let receipt = call.expect("it had a place").receipt.expect("a receipt");
        assert_eq!(receipt.accepted, CALLS as u64 / 8);
    }
    for stream in streams {
        let (receipts, _) = stream.finish().await;
        let accepted: u64 = receipts.iter().map(|receipt| receipt.accepted).sum();
        assert_eq!(accepted, STREAMS as u64 / 4);
    }
    assert_eq!(visits(&app).await, (STREAMS + CALLS) as u64);

    // What was refused was not counted: sent again it is new.
    let (status, receipt) = app
        .rest("POST", "/v1/environments/lane/transitions", Some(&body))
        .await;
    assert_eq!((status, &receipt["status"]), (200, &json!("applied")));
    let again = write(&app, "grpc", 1).await.expect("there is room");
    let again = again.receipt.expect("a receipt");
    assert_eq!(again.status(), proto::BatchStatus::Applied);
    assert_eq!(visits(&app).await, (STREAMS + CALLS + 2) as u64);
    app.stop().await;
}

async fn visits(app: &TestApp) -> u64 {
    app.cells("0.0").await.iter().map(|cell| cell.2).sum()
}

/// A shutdown waits for a request whose body is still coming; another signal does not.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_second_signal_ends_a_slow_shutdown_at_once() {
    for signal in ["INT", "TERM"] {
        let directory = TempDir::new().expect("a directory");
        let log = directory.path().join("log");
        let mut command = Server::command(&directory.path().join("data"), "127.0.0.1:0");
        command.stderr(std::fs::File::create(&log).expect("made"));
        let mut server = Server::run(&mut command).expect("it starts");

        // Its headers have come, and the service asks for the rest.
        let head = "POST /v1/environments/lane/transitions HTTP/1.1\r\nhost: localhost\r\n\
            content-type: application/json\r\ncontent-length: 100\r\nexpect: 100-continue\r\n\r\n";
        let mut slow = Raw::open(server.address, head.as_bytes()).await;
        slow.until("100 Continue").await;

        server.signal(signal);
        let said = |words: &str| {
            let log = std::fs::read_to_string(&log).expect("text");
            log.contains(words)
        };
        let stopping = async {
            while !said("stopping: streams end after their last receipt") {
                sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(LONG, stopping).await.expect("it heard the first");
        let still = server.ended_within(Duration::from_millis(500)).await;
        assert!(still.is_none(), "{signal}: it did not wait for the body");

        server.signal(signal);
        let ended = server.ended_within(Duration::from_secs(3)).await;
        let ended = ended.unwrap_or_else(|| panic!("{signal}: the second was not heard"));
        assert_eq!(ended.code(), Some(1));
        assert!(said("stopped at once by a second signal"));
    }
}

/// A log that is full, or that nobody reads any more, ends nothing: neither the start, nor an
/// answer, nor the stop.
#[tokio::test]
async fn a_log_that_cannot_be_written_ends_nothing() {
    let nobody_reads = {
        let (reader, writer) = std::io::pipe().expect("a pipe");
        drop(reader);
        Stdio::from(writer)
    };
    let is_full = Stdio::from(std::fs::File::create("/dev/full").expect("linux"));
    for log in [nobody_reads, is_full] {
        let directory = TempDir::new().expect("a directory");
        let mut command = Server::command(directory.path(), "127.0.0.1:0");
        command.stderr(log);
        let server = Server::run(&mut command).expect("it starts");

        let url = format!("http://{}/v1/environments/lane", server.address);
        let made = reqwest::Client::new().put(&url).json(&lane_json()).send();
        assert_eq!(made.await.expect("answered").status(), 201);
        let removed = reqwest::Client::new().delete(&url).send();
        assert_eq!(removed.await.expect("answered").status(), 204);
        assert_eq!(server.terminate(), Some(0));
    }
}

/// Whoever tells all services to read their files again ends none that has no files.
#[tokio::test]
async fn a_hangup_ends_no_service_without_keys() {
    let directory = TempDir::new().expect("a directory");
    let server = Server::start(directory.path(), "127.0.0.1:0");
    server.signal("HUP");
    let url = format!("http://{}/livez", server.address);
    assert_eq!(reqwest::get(url).await.expect("answered").status(), 200);
    assert_eq!(server.terminate(), Some(0));
}

/// A demo belongs to its terminal: one that is closed (SIGHUP) ends it.
#[tokio::test]
async fn a_hangup_ends_a_demo() {
    let directory = TempDir::new().expect("a directory");
    let mut demo = Command::new(env!("CARGO_BIN_EXE_nudge"))
        .args(["demo", "--listen", "127.0.0.1:0", "--data"])
        .arg(directory.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the binary starts");

    let mut told = BufReader::new(demo.stdout.take().expect("piped"));
    let mut line = String::new();
    told.read_line(&mut line).expect("a line");
    assert!(line.starts_with("listening on "), "{line}");

    let sent = Command::new("kill")
        .args(["-HUP", &demo.id().to_string()])
        .status();
    assert!(sent.expect("kill is there").success());
    let ended = demo.wait().expect("it was started");
    assert_eq!(ended.signal(), Some(1), "{ended}");
}
