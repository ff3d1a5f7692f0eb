//! Networks, asked for, watched, switched, moved and removed: over REST, over gRPC and by the
//! command line.

use std::process::{Command, Stdio};
use std::time::Duration;

use nudge::api::{json as dto, proto};
use nudge::domain::{JobState, ModelId};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use tempfile::TempDir;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::{TestApp, reason};

const WORLD: &str = "/v1/environments/world";

/// Places along a corridor; the human copies the robot in the nearer half.
const PLACES: u64 = 20;

/// How often a joint of place and light is seen.
const VISITS: u64 = 24;

/// A world of two agents in which the network has something to learn from its neighbours: what the
/// human does depends on the place alone.
async fn world() -> TestApp {
    let app = TestApp::start().await;
    let agent = |name: &str| json!({"name": name, "action": [{"name": "move", "integer": {"min": 0, "max": 2}}]});
    let description = json!({
        "state": [
            {"name": "place", "integer": {"min": 0, "max": PLACES - 1}},
            {"name": "light", "categorical": {"labels": ["red", "green", "out"]}},
        ],
        "agents": [agent("robot"), agent("human")],
    });
    let (status, answer) = app.rest("PUT", WORLD, Some(&description)).await;
    assert_eq!(status, 201, "{answer}");
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions()});
    let (status, receipt) = app
        .rest("POST", &format!("{WORLD}/transitions"), Some(&body))
        .await;
    assert_eq!(
        (status, &receipt["rejected_count"]),
        (200, &json!(0)),
        "{receipt}"
    );
    app
}

/// Nothing is seen while the light is out.
fn transitions() -> Vec<Value> {
    let mut random = StdRng::seed_from_u64(1);
    let mut transitions = Vec::new();
    for (place, light) in (0..PLACES).flat_map(|place| [(place, "red"), (place, "green")]) {
        for _ in 0..VISITS {
            let robot = random.random_range(0..3);
            let copies = place < PLACES / 2 && random.random_bool(0.95);
            let human = if copies {
                robot
            } else {
                random.random_range(0..3)
            };
            let state = json!({"place": place, "light": light});
            transitions.push(json!({"state": state, "actions": {"robot": robot, "human": human}}));
        }
    }
    transitions
}

/// A training that is over in a moment.
fn quick() -> Value {
    json!({"width": 4, "members": 2, "folds": 2, "epochs": 5, "activate": true})
}

/// A training that outlasts every test.
fn endless() -> Value {
    json!({"width": 1_024, "members": 16, "folds": 16, "epochs": 10_000})
}

async fn rest(app: &TestApp, method: &str, path: &str, body: Option<&Value>) -> (u16, Value) {
    app.rest(method, &format!("{WORLD}/models{path}"), body)
        .await
}

async fn get(app: &TestApp, path: &str) -> Value {
    let (status, answer) = rest(app, "GET", path, None).await;
    assert_eq!(status, 200, "{path}: {answer}");
    answer
}

/// Asks for a training and returns the name of its job.
async fn asked(app: &TestApp, body: &Value) -> String {
    let (status, job) = rest(app, "POST", "", Some(body)).await;
    assert_eq!(status, 202, "{job}");
    job["id"].as_str().expect("a name").to_owned()
}

/// Returns the number in the name of a job.
fn number_of(job: &str) -> u64 {
    let number = job.strip_prefix("job-").and_then(|id| id.parse().ok());
    number.expect("a job")
}

/// Waits until a job is in one of these states.
async fn until(app: &TestApp, job: &str, states: &[&str]) -> Value {
    loop {
        let told = get(app, &format!("/{job}")).await;
        let state = told["state"].as_str().expect("a word");
        if states.contains(&state) {
            return told;
        }
        assert!(["queued", "running"].contains(&state), "{told}");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

/// Trains a version and returns its number.
async fn trained(app: &TestApp, body: &Value) -> u64 {
    let job = asked(app, body).await;
    until(app, &job, &["done"]).await["version"]
        .as_u64()
        .expect("a version")
}

/// The versions that are active.
async fn active(app: &TestApp) -> Vec<u64> {
    let list = get(app, "").await;
    let models = list["models"].as_array().expect("a list").clone();
    let active = models.iter().filter(|model| model["active"] == true);
    active
        .map(|model| model["version"].as_u64().expect("a number"))
        .collect()
}

#[tokio::test]
async fn trainings_end_with_their_environment() {
    let app = world().await;
    let running = asked(&app, &endless()).await;
    until(&app, &running, &["running"]).await;
    let waiting = asked(&app, &endless()).await;
    let environment = app.app.environments.find("world").expect("made");
    assert_eq!(app.rest("DELETE", WORLD, None).await.0, 204);
    for job in [running, waiting] {
        let over = app
            .app
            .networks
            .finished(&environment, number_of(&job))
            .await
            .expect("known");
        assert_eq!(over.state, JobState::Cancelled, "{over:?}");
    }
}

/// Between the removal of an environment and the word to its trainings some may take their turn.
#[tokio::test]
async fn a_training_that_finds_its_environment_gone_was_cancelled() {
    let app = world().await;
    let running = asked(&app, &endless()).await;
    // What it learns from is read: only its end can end it.
    while until(&app, &running, &["running"]).await["progress"] == 0.0 {
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let waiting = asked(&app, &endless()).await;
    let environment = app.app.environments.find("world").expect("made");
    let [running, waiting] = [running, waiting].map(|job| number_of(&job));

    let networks = &app.app.networks;
    app.app.store.delete(environment.id).await.expect("deleted");
    networks
        .delete(&environment, ModelId::Job(running))
        .await
        .expect("it runs");

    for job in [running, waiting] {
        let over = networks.finished(&environment, job).await.expect("known");
        assert_eq!(over.state, JobState::Cancelled, "{over:?}");
    }
    app.stop().await;
}

#[tokio::test]
async fn a_share_is_a_threshold_for_networks_too() {
    let app = world().await;
    let rule = async |rule: Value| {
        assert_eq!(
            app.rest("PATCH", WORLD, Some(&json!({"rule": rule})))
                .await
                .0,
            200
        )
    };
    rule(json!({"share": 0.5})).await;
    let mut direct = quick();
    direct["kind"] = json!("direct");
    let version = trained(&app, &direct).await;
    let model = get(&app, &format!("/{version}")).await;
    assert_eq!(
        (&model["card"]["threshold"], &model["stale"]),
        (&json!(0.5 * 3_f64.ln()), &json!(false)),
        "{model}"
    );
    for (changed, stale) in [
        (json!({"unit": "bits"}), false),
        (json!({"share": 0.4}), true),
        (json!({"share": 0.5}), false),
    ] {
        rule(changed.clone()).await;
        assert_eq!(
            get(&app, &format!("/{version}")).await["stale"],
            json!(stale),
            "{changed}"
        );
    }
}

#[tokio::test]
async fn a_training_becomes_a_version_with_a_card() {
    let app = world().await;
    assert_eq!(
        get(&app, "").await,
        json!({"models": [], "jobs": [], "next_page_token": null})
    );
    let request = reqwest::Client::new()
        .post(app.url(&format!("{WORLD}/models")))
        .json(&quick());
    let response = request.send().await.expect("answered");
    assert_eq!(response.status(), 202);
    let location = response.headers()["location"]
        .to_str()
        .expect("text")
        .to_owned();
    let job: Value = response.json().await.expect("JSON");
    let id = job["id"].as_str().expect("a name");
    assert_eq!(location, format!("{WORLD}/models/{id}"));
    assert_eq!(
        (&job["ego"], &job["other"]),
        (&json!("robot"), &json!("human"))
    );
    let done = until(&app, id, &["done"]).await;
    assert_eq!(
        (&done["version"], &done["progress"]),
        (&json!(1), &json!(1.0)),
        "{done}"
    );

    let list = get(&app, "").await;
    assert_eq!(list["jobs"], json!([done]));
    let model = get(&app, "/1").await;
    assert_eq!(list["models"], json!([model]));
    assert_eq!(
        (&model["version"], &model["active"], &model["stale"]),
        (&json!(1), &json!(true), &json!(false))
    );
    let card = &model["card"];
    assert_eq!(card["training"]["members"], 2);
    assert_eq!(
        (&card["states"], &card["visits"]),
        (&json!(2 * PLACES), &json!(2 * PLACES * VISITS))
    );
    assert_eq!(
        (&card["imported"], &card["score"]["name"]),
        (&json!(false), &json!("network"))
    );
    let names: Vec<&Value> = card["baselines"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|score| &score["name"])
        .collect();
    assert_eq!(
        names,
        [
            "all_positive",
            "majority",
            "look_up",
            "back_off",
            "shuffled"
        ]
    );
    app.stop().await;
}

#[tokio::test]
async fn a_body_may_be_empty_and_a_wrong_one_is_faulted_in_full() {
    let app = world().await;
    let url = app.url(&format!("{WORLD}/models"));
    let empty = reqwest::Client::new()
        .post(&url)
        .send()
        .await
        .expect("answered");
    assert_eq!(empty.status(), 202);
    let job: Value = empty.json().await.expect("JSON");
    assert_eq!(
        rest(
            &app,
            "DELETE",
            &format!("/{}", job["id"].as_str().expect("a name")),
            None
        )
        .await
        .0,
        204
    );
    let text = reqwest::Client::new()
        .post(&url)
        .body("{}")
        .send()
        .await
        .expect("answered");
    assert_eq!(text.status(), 415, "a browser sends such a body unasked");
    let (status, problem) = rest(&app, "POST", "", Some(&json!({"widht": 64}))).await;
    assert_eq!(
        (status, &problem["errors"][0]["pointer"]),
        (400, &json!("/widht"))
    );
    app.stop().await;
}

fn violations(status: &Status) -> Vec<String> {
    let violations = status
        .get_details_bad_request()
        .map(|details| details.field_violations)
        .unwrap_or_default();
    violations
        .into_iter()
        .map(|violation| violation.field)
        .collect()
}

#[tokio::test]
async fn wrong_options_are_faulted_alike() {
    let app = world().await;
    let body = json!({"ego": "cat", "kind": "deep", "width": 0, "epochs": 10_001, "weighting": "x", "members": 6});
    let request = proto::TrainModelRequest {
        environment: "world".into(),
        ego: "cat".into(),
        kind: 7,
        width: Some(0),
        epochs: Some(10_001),
        weighting: 7,
        members: Some(6),
        ..Default::default()
    };
    let expected = [
        "/ego",
        "/kind",
        "/width",
        "/epochs",
        "/weighting",
        "/members",
    ];
    let (status, problem) = rest(&app, "POST", "", Some(&body)).await;
    let errors = problem["errors"].as_array().cloned().unwrap_or_default();
    let pointers: Vec<&str> = errors
        .iter()
        .filter_map(|error| error["pointer"].as_str())
        .collect();
    assert_eq!((status, pointers), (400, expected.to_vec()), "{problem}");
    let refused = app
        .models()
        .await
        .train_model(request)
        .await
        .expect_err("wrong");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::InvalidArgument, "INVALID_INPUT".into())
    );
    assert_eq!(violations(&refused), expected);
    assert_eq!(
        get(&app, "").await["jobs"],
        json!([]),
        "nothing was asked for"
    );
    app.stop().await;
}

#[tokio::test]
async fn versions_are_switched_rolled_back_and_deleted() {
    let app = world().await;
    assert_eq!(trained(&app, &quick()).await, 1);
    assert_eq!(trained(&app, &quick()).await, 2);
    assert_eq!(active(&app).await, [2], "one a pair");
    let (status, first) = rest(&app, "PUT", "/1/active", None).await;
    assert_eq!(
        (status, &first["version"], &first["active"]),
        (200, &json!(1), &json!(true)),
        "{first}"
    );
    assert_eq!(active(&app).await, [1]);
    let (status, problem) = rest(&app, "DELETE", "/1", None).await;
    assert_eq!(status, 409, "it answers: {problem}");
    let (status, back) = rest(&app, "DELETE", "/1/active", None).await;
    assert_eq!(
        (status, &back["active"]["version"]),
        (200, &json!(2)),
        "{back}"
    );
    let (status, back) = rest(&app, "DELETE", "/2/active", None).await;
    assert_eq!((status, back), (200, json!({"active": null})));
    assert_eq!(active(&app).await, [0_u64; 0]);
    assert_eq!(rest(&app, "DELETE", "/2", None).await, (204, json!("")));
    for (method, path) in [
        ("GET", "/2"),
        ("GET", "/2/weights"),
        ("PUT", "/2/active"),
        ("DELETE", "/2"),
    ] {
        let (status, problem) = rest(&app, method, path, None).await;
        assert_eq!(
            (status, &problem["detail"]),
            (404, &json!("unknown model version 2; known: 1")),
            "{method} {path}"
        );
    }
    assert_eq!(trained(&app, &quick()).await, 3, "no number is used twice");
    app.stop().await;
}

#[tokio::test]
async fn trainings_are_ended_whether_they_run_or_wait() {
    let app = world().await;
    let first = asked(&app, &endless()).await;
    until(&app, &first, &["running"]).await;
    let second = asked(&app, &quick()).await;
    assert_eq!(get(&app, &format!("/{second}")).await["state"], "queued");
    for job in [&second, &first] {
        assert_eq!(
            rest(&app, "DELETE", &format!("/{job}"), None).await,
            (204, json!(""))
        );
        until(&app, job, &["cancelled"]).await;
    }
    assert_eq!(get(&app, "").await["models"], json!([]));
    assert_eq!(
        trained(&app, &quick()).await,
        1,
        "the next one is not held up"
    );
    app.stop().await;
}

/// A call on what does not exist, over REST.
const UNKNOWN: [(&str, &str); 8] = [
    ("GET", "/9"),
    ("GET", "/job-9"),
    ("PUT", "/9/active"),
    ("DELETE", "/9/active"),
    ("GET", "/9/weights"),
    ("DELETE", "/9"),
    ("DELETE", "/job-9"),
    ("GET", "/job-18446744073709551615"),
];

/// The same over gRPC, in that order.
async fn unknown_over_grpc(app: &TestApp, environment: &str) -> Vec<Status> {
    let (mut client, environment) = (app.models().await, environment.to_owned());
    macro_rules! refused {
        ($call:ident, $request:ident { $field:ident: $value:expr }) => {{
            let request = proto::$request {
                environment: environment.clone(),
                $field: $value,
            };
            client.$call(request).await.map(drop).expect_err("unknown")
        }};
    }
    vec![
        refused!(get_model, GetModelRequest { version: 9 }),
        refused!(get_job, GetJobRequest { id: 9 }),
        refused!(activate_model, ActivateModelRequest { version: 9 }),
        refused!(roll_back_model, RollBackModelRequest { version: 9 }),
        refused!(export_model, ExportModelRequest { version: 9 }),
        refused!(delete_model, DeleteModelRequest { version: 9 }),
        refused!(cancel_job, CancelJobRequest { id: 9 }),
        refused!(get_job, GetJobRequest { id: u64::MAX }),
    ]
}

#[tokio::test]
async fn what_does_not_exist_is_refused_alike() {
    let app = world().await;
    for environment in ["world", "word"] {
        for ((method, path), status) in UNKNOWN
            .into_iter()
            .zip(unknown_over_grpc(&app, environment).await)
        {
            let path = format!("/v1/environments/{environment}/models{path}");
            let (code, problem) = app.rest(method, &path, None).await;
            assert_eq!(
                (code, status.code()),
                (404, Code::NotFound),
                "{method} {path}: {problem}"
            );
            assert_eq!(problem["reason"], json!(reason(&status)), "{method} {path}");
            assert_eq!(
                problem["detail"],
                json!(status.message()),
                "{method} {path}"
            );
        }
    }
    for path in [
        "/three",
        "/job-",
        "/03/active",
        "/job-1/active",
        "/job-1/weights",
    ] {
        let method = if path.ends_with("active") {
            "PUT"
        } else {
            "GET"
        };
        let (code, problem) = rest(&app, method, path, None).await;
        assert_eq!(
            (code, &problem["errors"][0]["pointer"]),
            (400, &json!("/model")),
            "{path}: {problem}"
        );
    }
    app.stop().await;
}

#[tokio::test]
async fn a_job_of_another_start_is_unknown() {
    let app = world().await;
    let (_, before) = rest(&app, "POST", "", Some(&json!({"epochs": 1}))).await;
    let app = app.restart().await;
    let (_, after) = rest(&app, "POST", "", Some(&json!({"epochs": 1}))).await;
    assert_ne!(
        before["id"], after["id"],
        "one is never taken for the other"
    );
    for method in ["GET", "DELETE"] {
        let (status, told) = rest(
            &app,
            method,
            &format!("/{}", before["id"].as_str().expect("a name")),
            None,
        )
        .await;
        assert_eq!(
            (status, &told["reason"]),
            (404, &json!("JOB_NOT_FOUND")),
            "{told}"
        );
        assert!(
            told["detail"]
                .as_str()
                .is_some_and(|told| told.contains(after["id"].as_str().expect("a name")))
        );
    }
    app.stop().await;
}

#[tokio::test]
async fn the_faces_say_the_same() {
    let app = world().await;
    let mut client = app.models().await;
    let environment = || "world".to_owned();
    let request = proto::TrainModelRequest {
        environment: environment(),
        width: Some(4),
        members: Some(1),
        folds: Some(2),
        epochs: Some(5),
        activate: true,
        ..Default::default()
    };
    let job = client
        .train_model(request)
        .await
        .expect("valid")
        .into_inner()
        .job
        .expect("a job");
    let name = format!("job-{}", job.id);
    let over_rest = until(&app, &name, &["done"]).await;
    let request = proto::GetJobRequest {
        environment: environment(),
        id: job.id,
    };
    let job = client
        .get_job(request)
        .await
        .expect("known")
        .into_inner()
        .job
        .expect("a job");
    assert_eq!(json!(dto::Job::from(job)), over_rest);
    let list = client
        .list_models(proto::ListModelsRequest {
            environment: environment(),
            ..Default::default()
        })
        .await
        .expect("known");
    assert_eq!(
        json!(dto::Models::from(list.into_inner())),
        get(&app, "").await
    );
    let request = proto::GetModelRequest {
        environment: environment(),
        version: 1,
    };
    let model = client
        .get_model(request)
        .await
        .expect("known")
        .into_inner()
        .model
        .expect("a model");
    assert_eq!(json!(dto::Model::from(model)), get(&app, "/1").await);
    let request = proto::ActivateModelRequest {
        environment: environment(),
        version: 1,
    };
    let model = client
        .activate_model(request)
        .await
        .expect("known")
        .into_inner()
        .model
        .expect("a model");
    assert_eq!(
        json!(dto::Model::from(model)),
        rest(&app, "PUT", "/1/active", None).await.1
    );
    let request = proto::RollBackModelRequest {
        environment: environment(),
        version: 1,
    };
    assert_eq!(
        client
            .roll_back_model(request)
            .await
            .expect("known")
            .into_inner()
            .active,
        None
    );
    let request = proto::DeleteModelRequest {
        environment: environment(),
        version: 1,
    };
    client.delete_model(request).await.expect("not active");
    assert_eq!(get(&app, "").await["models"], json!([]));
    app.stop().await;
}

/// Sends a file and returns the status and the answer.
async fn import(app: &TestApp, media: &str, file: Vec<u8>) -> (u16, Value) {
    let request = reqwest::Client::new()
        .post(app.url(&format!("{WORLD}/models/import")))
        .header("content-type", media);
    let response = request.body(file).send().await.expect("answered");
    (
        response.status().as_u16(),
        response.json().await.expect("JSON"),
    )
}

#[tokio::test]
async fn weights_leave_and_come_back() {
    let app = world().await;
    trained(&app, &quick()).await;
    let response = reqwest::get(app.url(&format!("{WORLD}/models/1/weights")))
        .await
        .expect("answered");
    assert_eq!(response.status(), 200);
    assert_eq!(
        response.headers()["content-type"],
        "application/octet-stream"
    );
    assert_eq!(
        response.headers()["content-disposition"],
        "attachment; filename=\"world-1.safetensors\""
    );
    let file = response.bytes().await.expect("a file").to_vec();
    let request = proto::ExportModelRequest {
        environment: "world".into(),
        version: 1,
    };
    let exported = app
        .models()
        .await
        .export_model(request)
        .await
        .expect("small")
        .into_inner()
        .file;
    assert_eq!(exported, file, "the same bytes on both faces");

    let (status, imported) = import(&app, "application/octet-stream", file.clone()).await;
    assert_eq!(
        (status, &imported["version"], &imported["active"]),
        (201, &json!(2), &json!(false)),
        "{imported}"
    );
    assert_eq!(imported["card"]["imported"], true);
    assert_eq!(get(&app, "/2").await, imported);
    let request = proto::ImportModelRequest {
        environment: "world".into(),
        file,
    };
    let imported = app
        .models()
        .await
        .import_model(request)
        .await
        .expect("valid")
        .into_inner()
        .model
        .expect("a model");
    assert_eq!(json!(dto::Model::from(imported)), get(&app, "/3").await);

    let (status, problem) = import(&app, "application/octet-stream", b"no network".to_vec()).await;
    let request = proto::ImportModelRequest {
        environment: "world".into(),
        file: b"no network".to_vec(),
    };
    let refused = app
        .models()
        .await
        .import_model(request)
        .await
        .expect_err("no network");
    assert_eq!(
        (status, refused.code()),
        (400, Code::InvalidArgument),
        "{problem}"
    );
    assert_eq!(problem["reason"], json!(reason(&refused)));
    assert_eq!(
        import(&app, "application/json", b"{}".to_vec()).await.0,
        415
    );
    app.stop().await;
}

#[tokio::test]
async fn the_same_seed_gives_the_same_file() {
    let mut files = Vec::new();
    for _ in 0..2 {
        let app = world().await;
        trained(&app, &quick()).await;
        let response = reqwest::get(app.url(&format!("{WORLD}/models/1/weights")))
            .await
            .expect("answered");
        files.push(response.bytes().await.expect("a file"));
        app.stop().await;
    }
    let file = &files[0];
    assert!(
        *file == files[1],
        "{} and {} bytes",
        file.len(),
        files[1].len()
    );

    let size = u64::from_le_bytes(*file.first_chunk().expect("a size")) as usize;
    let header: Value = serde_json::from_slice(&file[8..8 + size]).expect("a header in JSON");
    assert_eq!(
        (size % 8, &header["__metadata__"]["format"]),
        (0, &json!("nudge/1"))
    );
    assert!(
        file[8..].starts_with(br#"{"__metadata__":{"card":"{"#),
        "in the order of names"
    );
}

#[tokio::test]
async fn files_beyond_the_limits_are_told_where_to_go() {
    let app = world().await;
    let request = proto::ImportModelRequest {
        environment: "world".into(),
        file: vec![0; 5 << 20],
    };
    let refused = app
        .models()
        .await
        .import_model(request)
        .await
        .expect_err("too large");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::OutOfRange, "FILE_TOO_LARGE".into())
    );
    let expected = "at most 4194304 bytes: use REST, POST /v1/environments/world/models/import";
    assert!(
        refused.message().ends_with(expected),
        "{}",
        refused.message()
    );
    let (status, problem) = import(&app, "application/octet-stream", vec![0; (16 << 20) + 1]).await;
    assert_eq!(
        (status, &problem["reason"]),
        (413, &json!("BODY_TOO_LARGE"))
    );
    app.stop().await;
}

async fn run(app: &TestApp, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
}

const TRAIN: [&str; 11] = [
    "train",
    "world",
    "--width",
    "4",
    "--members",
    "1",
    "--folds",
    "2",
    "--epochs",
    "5",
    "--activate",
];

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_command_line_trains_and_switches() {
    let app = world().await;
    let (code, stdout, stderr) = run(&app, &TRAIN).await;
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stdout.starts_with("world: robot on human, model version 1\n"),
        "{stdout}"
    );
    for name in [
        "network ",
        "all_positive ",
        "majority ",
        "look_up ",
        "back_off ",
        "shuffled ",
    ] {
        assert!(
            stdout.lines().any(|line| line.starts_with(name)),
            "{name}: {stdout}"
        );
    }
    assert!(
        stderr
            .lines()
            .last()
            .is_some_and(|line| line.starts_with("job-") && line.contains(" done")),
        "{stderr}"
    );
    let (code, stdout, _) = run(&app, &[&TRAIN[..], &["--json"]].concat()).await;
    let model: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!((code, &model), (0, &get(&app, "/2").await));
    let (_, stdout, _) = run(&app, &["model", "list", "world"]).await;
    assert_eq!(
        stdout
            .lines()
            .filter(|line| line.contains(" joint  active "))
            .count(),
        1,
        "{stdout}"
    );
    let (_, stdout, _) = run(&app, &["model", "activate", "world", "1"]).await;
    assert_eq!(
        stdout,
        "version 1 of `world` answers for robot on human now\n"
    );
    let (_, stdout, _) = run(&app, &["model", "rollback", "world", "1"]).await;
    let expected =
        "version 1 of `world` is taken back; version 2 of `world` answers for robot on human now\n";
    assert_eq!(stdout, expected);
    assert_eq!(
        run(&app, &["model", "delete", "world", "1"]).await.1,
        "version 1 of `world` deleted\n"
    );
    let (code, stdout, stderr) = run(&app, &["model", "show", "world", "1"]).await;
    assert_eq!(
        (code, stdout.as_str(), stderr.lines().count()),
        (1, "", 1),
        "{stderr}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_command_line_moves_files() {
    let app = world().await;
    trained(&app, &quick()).await;
    let directory = TempDir::new().expect("a temporary directory");
    let file = directory.path().join("world.safetensors");
    let file = file.to_str().expect("text");
    let (code, _, stderr) = run(&app, &["model", "export", "world", "1", "--out", file]).await;
    assert_eq!(code, 0, "{stderr}");
    let (code, stdout, stderr) = run(&app, &["model", "import", "world", file, "--json"]).await;
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(
        serde_json::from_str::<Value>(&stdout).expect("JSON"),
        get(&app, "/2").await
    );
    let (code, _, stderr) = run(
        &app,
        &["model", "export", "world", "1", "--out", "/no/such/file"],
    )
    .await;
    assert_eq!((code, stderr.lines().count()), (2, 1), "{stderr}");
    assert!(
        stderr.starts_with("error: cannot write /no/such/file: No such file"),
        "{stderr}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_training_that_fails_ends_with_its_message() {
    let app = TestApp::start().await;
    app.lane().await;
    let (code, stdout, stderr) = run(&app, &["train", "lane"]).await;
    assert_eq!(
        (code, stdout.as_str()),
        (1, ""),
        "nothing was counted: {stderr}"
    );
    assert!(
        stderr
            .lines()
            .last()
            .is_some_and(|line| line.starts_with("error: ")),
        "{stderr}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn ctrl_c_ends_the_training() {
    let app = world().await;
    let options = [
        "train",
        "world",
        "--width",
        "1024",
        "--members",
        "16",
        "--folds",
        "16",
        "--epochs",
        "10000",
    ];
    let mut command = nudge(&app.address.to_string(), &options);
    let child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("it starts");
    let job = running(&app).await;
    let killed = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .expect("kill is there");
    assert!(killed.success());
    let ended = tokio::task::spawn_blocking(|| child.wait_with_output())
        .await
        .expect("no panic")
        .expect("it ends");
    let (code, stdout, stderr) = exit_and_texts(&ended);
    assert_eq!((code, stdout.as_str()), (130, ""), "{stderr}");
    assert_eq!(
        stderr.lines().last(),
        Some(format!("{job} of `world` cancelled").as_str()),
        "{stderr}"
    );
    until(&app, &job, &["cancelled"]).await;
    app.stop().await;
}

/// Waits until some job runs, and returns its name.
async fn running(app: &TestApp) -> String {
    loop {
        let list = get(app, "").await;
        if let Some(job) = list["jobs"]
            .as_array()
            .expect("a list")
            .iter()
            .find(|job| job["state"] == "running")
        {
            return job["id"].as_str().expect("a name").to_owned();
        }
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}
