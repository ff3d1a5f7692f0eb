//! What somebody meets who does not know the service yet: names misspelt, commands that wait, media
//! types that are not there.

use std::path::Path;
use std::time::Duration;

use nudge::api::proto;
use nudge::domain::JobState;
use nudge::domain::draft::TrainingDraft;
use serde_json::{Value, json};
use tempfile::TempDir;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

use crate::cli::{exit_and_texts, nudge, output};
use crate::fake::{CALM, Fake};
use crate::support::TestApp;

async fn run(app: &TestApp, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
}

/// Counts one transition a segment in the lane.
async fn count(app: &TestApp, segments: &[&str]) {
    for segment in segments {
        let transition =
            json!({"state": {"distance": 1, "held": 0}, "actions": {"robot": 0, "human": 0}});
        let body = json!({"producer": segment, "sequence": 1, "segment": segment, "transitions": [transition]});
        let (status, receipt) = app
            .rest("POST", "/v1/environments/lane/transitions", Some(&body))
            .await;
        assert_eq!(
            (status, &receipt["accepted"]),
            (200, &json!(1)),
            "{receipt}"
        );
    }
}

#[tokio::test]
async fn a_misspelt_environment_is_told_with_those_near_it() {
    let app = TestApp::start().await;
    let nothing = app.rest("GET", "/v1/environments/lane", None).await.1;
    assert_eq!(
        nothing["detail"], "unknown environment `lane`",
        "there is none to name"
    );
    app.lane().await;
    let expected = "unknown environment `lan`; did you mean `lane`?";
    let body = json!({"keys": ["0.0"]});
    let calls = [
        ("GET", "/v1/environments/lan", None),
        ("GET", "/v1/environments/lan/summary", None),
        ("POST", "/v1/environments/lan/influence", Some(&body)),
        ("DELETE", "/v1/environments/lan", None),
    ];
    for (method, path, body) in calls {
        let (status, problem) = app.rest(method, path, body).await;
        assert_eq!(
            (status, &problem["detail"]),
            (404, &json!(expected)),
            "{method} {path}"
        );
    }
    let request = proto::GetEnvironmentRequest { name: "lan".into() };
    let refused = app
        .environments()
        .await
        .get_environment(request)
        .await
        .expect_err("unknown");
    assert_eq!(
        (refused.code(), refused.message()),
        (Code::NotFound, expected)
    );
    let (_, inferred) = app.rest("GET", "/v2/models/lan", None).await;
    assert_eq!(inferred["error"], expected);
    for command in [
        &["env", "show", "lan"][..],
        &["query", "lan", "--key", "0.0"],
        &["env", "delete", "lan", "--yes"],
    ] {
        let (code, _, stderr) = run(&app, command).await;
        assert_eq!(
            (code, stderr),
            (1, format!("error: {expected}\n")),
            "{command:?}"
        );
    }
    let far = app.rest("GET", "/v1/environments/kitchen", None).await.1;
    assert_eq!(
        far["detail"], "unknown environment `kitchen`; known: `lane`",
        "so few are all named"
    );
    let long = app
        .rest(
            "GET",
            &format!("/v1/environments/{}", "x".repeat(5_000)),
            None,
        )
        .await;
    assert_eq!(long.0, 404);
    app.stop().await;
}

#[tokio::test]
async fn misspelt_parameters_segments_and_features_are_told_with_those_there_are() {
    let app = TestApp::start().await;
    app.lane().await;
    count(&app, &["trial-1", "trial-2", "warm-up"]).await;
    let cases = [
        (
            "/v1/environments?page_sise=3",
            "/page_sise",
            "unknown parameter; did you mean `page_size`?",
        ),
        (
            "/v1/environments/lane/influence?key=0.0&rule.treshold=1",
            "/rule.treshold",
            "did you mean `rule.threshold`?",
        ),
        (
            "/v1/environments/lane/graph?keys=0.0",
            "/keys",
            "did you mean `key`?",
        ),
        (
            "/v1/environments/lane/summary?segment=trial-1",
            "/segment",
            "did you mean `segments`, `omit_segments` or `policy.segments`?",
        ),
        (
            "/v1/environments/lane/summary?segments=trial1",
            "/segments",
            "unknown segment \"trial1\"; did you mean `trial-1`",
        ),
        (
            "/v1/environments/lane/summary?segments=x",
            "/segments",
            "; known: `trial-1`, `trial-2`, `warm-up`",
        ),
        (
            "/v1/environments/lane/influence?state.distnce=1",
            "/states/0/distnce",
            "unknown feature, expected distance, held",
        ),
        (
            "/v1/environments/lane/summary?ego=robt",
            "/ego",
            "unknown agent \"robt\", expected one of robot, human",
        ),
    ];
    for (path, pointer, detail) in cases {
        let (status, problem) = app.rest("GET", path, None).await;
        let errors = problem["errors"].as_array().cloned().unwrap_or_default();
        let found = errors.iter().find(|error| error["pointer"] == pointer);
        let found = found
            .and_then(|error| error["detail"].as_str())
            .unwrap_or_default();
        assert!(status == 400 && found.contains(detail), "{path}: {problem}");
    }
    app.stop().await;
}

#[tokio::test]
async fn deleting_looks_before_it_asks_to_be_sure() {
    let app = TestApp::start().await;
    app.lane().await;
    let (code, _, stderr) = run(&app, &["env", "delete", "nosuch"]).await;
    assert_eq!(
        (code, stderr.as_str()),
        (1, "error: unknown environment `nosuch`; known: `lane`\n")
    );
    let (code, _, stderr) = run(&app, &["env", "delete", "lane"]).await;
    assert!(
        code == 2 && stderr.contains("for ever: add --yes to do it"),
        "{stderr}"
    );
    assert_eq!(
        app.rest("GET", "/v1/environments/lane", None).await.0,
        200,
        "it is there"
    );
    app.stop().await;
}

#[test]
fn limits_of_nothing_are_refused_by_name() {
    for flag in [
        "--max-cells",
        "--max-segments",
        "--max-producers",
        "--max-models",
        "--max-environments",
    ] {
        for value in ["0", "-1", "many", ""] {
            let arguments = ["serve", "--print-config", &format!("{flag}={value}")];
            let (code, stdout, stderr) =
                exit_and_texts(&nudge("", &arguments).output().expect("it starts"));
            assert_eq!((code, stdout.as_str()), (2, ""), "{flag} {value}");
            let expected = format!("got {value:?}, expected a whole number of at least 1");
            assert!(
                stderr.contains(flag) && (value.is_empty() || stderr.contains(&expected)),
                "{stderr}"
            );
        }
        let (code, ..) = exit_and_texts(
            &nudge("", &["serve", "--print-config", flag, "1"])
                .output()
                .expect("it starts"),
        );
        assert_eq!(code, 0);
    }
}

#[tokio::test]
async fn a_graph_is_told_in_what_is_accepted_or_not_at_all() {
    let app = TestApp::start().await;
    app.lane().await;
    let graph = async |accept: &str| {
        let request = reqwest::Client::new()
            .get(app.url("/v1/environments/lane/graph?key=0.0"))
            .header("accept", accept);
        let response = request.send().await.expect("answered");
        let media = response.headers()["content-type"]
            .to_str()
            .expect("text")
            .to_owned();
        (
            response.status().as_u16(),
            media,
            response.text().await.expect("text"),
        )
    };
    assert_eq!(graph("*/*").await.1, "application/json");
    let (status, media, text) = graph("text/vnd.graphviz").await;
    assert!(
        status == 200 && media == "text/vnd.graphviz" && text.contains("graph"),
        "{text}"
    );
    let (status, media, text) = graph("image/svg+xml").await;
    let problem: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((status, media.as_str()), (406, "application/problem+json"));
    assert_eq!(problem["reason"], "NOT_ACCEPTABLE");
    assert_eq!(
        problem["detail"],
        "got accept \"image/svg+xml\", expected application/json or text/vnd.graphviz"
    );
    app.stop().await;
}

#[tokio::test]
async fn segments_can_be_left_out_of_a_summary() {
    let app = TestApp::start().await;
    app.lane().await;
    count(&app, &["trial-1", "trial-2"]).await;
    let summary = async |query: &str| {
        app.get(&format!("/v1/environments/lane/summary{query}"))
            .await
    };
    let whole = summary("").await;
    assert_eq!(whole["segments"], json!(["trial-1", "trial-2"]));
    assert_eq!(summary("?omit_segments=false").await, whole);
    let mut short = summary("?omit_segments=true").await;
    assert_eq!(
        (&short["segments"], &short["segmentation"]["count"]),
        (&json!([]), &json!(2)),
        "how many stays"
    );
    short["segments"] = whole["segments"].clone();
    assert_eq!(short, whole, "nothing else is left out");
    let (status, problem) = app
        .rest(
            "GET",
            "/v1/environments/lane/summary?omit_segments=yes",
            None,
        )
        .await;
    assert_eq!(
        (status, &problem["errors"][0]["detail"]),
        (400, &json!("got \"yes\", expected true or false"))
    );
    let scope = proto::Scope {
        environment: "lane".into(),
        ..Default::default()
    };
    let request = proto::SummarizeRequest {
        scope: Some(scope),
        omit_segments: true,
        ..Default::default()
    };
    let told = app
        .influence()
        .await
        .summarize(request)
        .await
        .expect("valid")
        .into_inner();
    assert_eq!((told.segments.len(), told.transitions), (0, 2));
    app.stop().await;
}

/// A training that waits for the fit which it begins with, and one behind it.
async fn two_trainings(app: &TestApp) -> [u64; 2] {
    app.lane().await;
    let environment = app.app.environments.find("lane").expect("made");
    let draft = TrainingDraft::default();
    let first = app
        .app
        .networks
        .train(&environment, &draft)
        .await
        .expect("valid");
    let second = app
        .app
        .networks
        .train(&environment, &draft)
        .await
        .expect("valid");
    assert_eq!((first.ahead, second.ahead), (0, 1));
    assert_eq!(second.id, first.id + 1);
    assert!(
        second
            .message
            .starts_with(&format!("waits for job-{} of `lane`", first.id)),
        "{}",
        second.message
    );
    [first.id, second.id]
}

#[tokio::test]
async fn a_training_that_waits_says_for_what() {
    let app = TestApp::start().await;
    let fitting = app.app.work.fits.enter().await.expect("free");
    let [first, second] = two_trainings(&app).await;
    let request = proto::TrainModelRequest {
        environment: "lane".into(),
        ..Default::default()
    };
    let third = app
        .models()
        .await
        .train_model(request)
        .await
        .expect("valid");
    let third = third.into_inner().job.expect("a job");
    assert_eq!((third.ahead, third.seconds_left), (2, None));
    assert!(
        third.message.ends_with(", and for 1 more"),
        "{}",
        third.message
    );
    let job = app
        .get(&format!("/v1/environments/lane/models/job-{second}"))
        .await;
    assert_eq!(
        (&job["state"], &job["ahead"]),
        (&json!("queued"), &json!(1))
    );
    let (_, stdout, _) = run(&app, &["model", "list", "lane"]).await;
    assert!(
        stdout.contains(&format!("waits for job-{first} of `lane`")),
        "{stdout}"
    );
    app.rest(
        "DELETE",
        &format!("/v1/environments/lane/models/job-{second}"),
        None,
    )
    .await;
    let environment = app.app.environments.find("lane").expect("made");
    assert_eq!(
        app.app
            .networks
            .finished(&environment, second)
            .await
            .expect("known")
            .state,
        JobState::Cancelled
    );
    assert_eq!(
        app.app
            .networks
            .job(&environment, third.id)
            .expect("known")
            .ahead,
        1,
        "one fewer"
    );
    drop(fitting);
    app.app
        .networks
        .finished(&environment, first)
        .await
        .expect("known");
    app.stop().await;
}

#[tokio::test]
async fn a_stop_while_the_prior_is_fitted_cancels_a_training_and_does_not_fail_it() {
    let app = TestApp::start().await;
    // Nobody is told to end yet: streams end first, as after SIGTERM, but whatever computes stops
    // at once.
    let _fitting = app.app.work.fits.enter().await.expect("free");
    let jobs = two_trainings(&app).await;
    let environment = app.app.environments.find("lane").expect("made");
    while app
        .app
        .networks
        .job(&environment, jobs[0])
        .expect("known")
        .state
        != JobState::Running
    {
        tokio::task::yield_now().await;
    }
    app.app.draining.cancel();
    for job in jobs {
        let over = app
            .app
            .networks
            .finished(&environment, job)
            .await
            .expect("known");
        assert_eq!(
            (over.state, over.message.as_str()),
            (JobState::Cancelled, "cancelled; no network is made")
        );
    }
    app.stop().await;
}

fn still_working(far: &str) -> Status {
    let message = format!("the ranking is still being made: {far}; it goes on, ask again");
    let mut details = ErrorDetails::with_error_info("STILL_WORKING", "nudge", []);
    details.set_retry_info(Some(Duration::from_millis(10)));
    Status::with_error_details(Code::Unavailable, message, details)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn commands_ask_again_by_themselves_and_say_how_far_it_is() {
    let fake = Fake::start(CALM, 0).await;
    fake.describe("lane", crate::support::lane_schema().into());
    let far = [
        "1 of 3 states measured",
        "1 of 3 states measured",
        "2 of 3 states measured",
    ];
    for graph in [false, true] {
        fake.memory().not_yet = far.iter().rev().map(|far| still_working(far)).collect();
        let more: &[&str] = if graph {
            &["--graph", "--json"]
        } else {
            &["--json"]
        };
        let arguments = [&["query", "lane", "--key", "0.0"], more].concat();
        let (code, stdout, stderr) =
            exit_and_texts(&output(nudge(&fake.address.to_string(), &arguments)).await);
        assert_eq!(code, 0, "{stderr}");
        assert!(
            serde_json::from_str::<Value>(&stdout).is_ok(),
            "the answer alone: {stdout}"
        );
        let line = |far| format!("the ranking is still being made: {far}; asking again\n");
        assert_eq!(
            stderr,
            [line(far[1]), line(far[2])].concat(),
            "what is new is said once"
        );
        assert!(fake.memory().not_yet.is_empty(), "it was asked four times");
    }
}

#[test]
fn a_demo_that_ends_early_says_so() {
    let directory = TempDir::new().expect("a directory");
    let data = directory.path().to_str().expect("text");
    let demo = |duration: &str| {
        let arguments = [
            "demo",
            "--listen",
            "127.0.0.1:0",
            "--data",
            data,
            "--duration",
            duration,
        ];
        let (code, stdout, stderr) =
            exit_and_texts(&nudge("", &arguments).output().expect("it starts"));
        assert_eq!(code, 0, "{stderr}");
        assert!(stdout.contains("ended by --duration while "), "{stdout}");
        assert!(stdout.contains(": it was about to show "), "{stdout}");
        stdout
    };
    assert!(
        demo("0s").contains("counting games and a hallway"),
        "nothing is counted yet"
    );
    // Until something is counted, however slow the machine is.
    let counted = |told: &str| {
        let mut lines = told
            .lines()
            .filter(|line| line.ends_with(" states, counted before"))
            .peekable();
        // No environment that anybody else describes is the demo's.
        lines.peek().is_some() && lines.all(|line| line.starts_with("demo."))
    };
    let shows = |seconds: u32| counted(&demo(&format!("{seconds}s")));
    assert!(
        (3..10).any(shows),
        "what was counted before is told at once"
    );
}

/// Returns the reason words of a kind of error that is retried, as the sources have them.
fn reasons_to_retry() -> Vec<String> {
    let mut reasons = Vec::new();
    let mut waiting = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("src")];
    while let Some(path) = waiting.pop() {
        if path.is_dir() {
            waiting.extend(
                std::fs::read_dir(path)
                    .expect("readable")
                    .map(|entry| entry.expect("readable").path()),
            );
            continue;
        }
        let text: String = std::fs::read_to_string(path)
            .expect("text")
            .split_whitespace()
            .collect();
        for kind in ["ErrorKind::Unavailable,\"", "ErrorKind::Overloaded,\""] {
            let after = text.split(kind).skip(1);
            reasons.extend(after.filter_map(|rest| Some(rest.split_once('"')?.0.to_owned())));
        }
    }
    reasons
}

#[test]
fn the_page_of_the_protocol_names_every_reason_to_try_again() {
    const PAGE: &str = include_str!("../../docs/protocol.md");
    /// Not told by ingestion nor by questions: of trainings, of tests, and of HTTP alone.
    const ELSEWHERE: [&str; 3] = ["TOO_MANY_TRAININGS", "NO_TEMPORARY_SERVICE", "UNAVAILABLE"];
    let reasons = reasons_to_retry();
    assert!(reasons.len() >= 8, "{reasons:?}");
    for reason in reasons
        .iter()
        .filter(|reason| !ELSEWHERE.contains(&reason.as_str()))
    {
        assert!(
            PAGE.contains(&format!("`{reason}`")),
            "{reason} is not in docs/protocol.md"
        );
    }
    for word in [
        "RECONNECT",
        "STOPPING",
        "NOT_READY",
        "STORE_UNAVAILABLE",
        "OUTCOME_UNKNOWN",
        "FENCED",
        "UNVERIFIED",
    ] {
        assert!(PAGE.contains(&format!("`{word}`")), "{word}");
    }
}
