//! What cannot be read does not vanish: it is said at the start, listed with the reason, and can be
//! deleted. A store that cannot be read for a moment switches nothing off.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use nudge::api::{json as dto, proto};
use nudge::domain::Pair;
use nudge::priors::PriorRegistry;
use nudge::store::{NewModel, Options, StoreError};
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use tonic::Code;

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::faulty::{Failure, Faulty};
use crate::support::fixtures::{BEFORE_VERSIONS, Fixture};
use crate::support::{TestApp, open, reason};

const CORNER: &str = "/v1/environments/corner";

/// A state that was never seen: only a network can say something of it.
const UNSEEN: &str = "/v1/environments/corner/influence?key=0.1.0.0.0.2.1";

/// The database of a build in which something was changed behind its back.
async fn spoiled(changes: &[&'static str]) -> Fixture {
    let fixture = Fixture::named(BEFORE_VERSIONS);
    for change in changes {
        execute(&fixture.path(), change).await;
    }
    fixture
}

async fn execute(path: &Path, sql: &'static str) {
    let mut connection = SqliteConnectOptions::new()
        .filename(path)
        .connect()
        .await
        .expect("a connection");
    let done = sqlx::query(sql)
        .execute(&mut connection)
        .await
        .expect("a statement that works");
    assert_eq!(done.rows_affected(), 1, "{sql}");
    connection.close().await.expect("closed");
}

const NEWER_CARD: &str = "update models set card = json_set(card, '$.form', 9) where version = 1";
const CARD_WITHOUT_TRAINING: &str =
    "update models set card = json_remove(card, '$.training') where version = 2";
const NO_WEIGHTS: &str = "update model_weights set weights = x'00' where version = 3";
const NEWER_FIT: &str = "update fits set body = json_set(body, '$.form', 9) where pair = '0,1'";
const FIT_OF_ANOTHER_SHAPE: &str =
    "update fits set body = json_set(body, '$.nulls', json('[1]')) where pair = '0,1|2'";
const NEWER_SCHEMA: &str =
    "update environments set schema = json_set(schema, '$.form', 9) where name = 'far'";
const WRONG_RULE: &str =
    "update environments set rule = json_set(rule, '$.kind', 'guess') where name = 'trio'";

async fn models(app: &TestApp) -> Vec<Value> {
    let (status, list) = app.rest("GET", &format!("{CORNER}/models"), None).await;
    assert_eq!(status, 200, "{list}");
    list["models"].as_array().expect("a list").clone()
}

fn why(model: &Value) -> &str {
    model["unreadable"].as_str().unwrap_or_default()
}

#[tokio::test]
async fn networks_stay_listed_with_the_reason() {
    let fixture = spoiled(&[NEWER_CARD, CARD_WITHOUT_TRAINING, NO_WEIGHTS]).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    let listed = models(&app).await;
    assert_eq!(
        listed
            .iter()
            .map(|model| model["version"].as_u64())
            .collect::<Vec<_>>(),
        [Some(1), Some(2), Some(3)]
    );
    assert_eq!(
        why(&listed[0]),
        "its card: it has form 9 of a newer build, and this one reads up to 2"
    );
    assert!(
        why(&listed[1])
            .starts_with("its card: it is not as it was written: missing field `training`"),
        "{}",
        listed[1]
    );
    assert!(
        why(&listed[2]).starts_with("its weights: invalid network: is no safetensors file"),
        "{}",
        listed[2]
    );
    for model in &listed {
        let told = (
            &model["card"],
            &model["ego"],
            &model["other"],
            &model["stale"],
        );
        assert_eq!(
            told,
            (
                &Value::Null,
                &json!("robot"),
                &json!("human"),
                &json!(false)
            )
        );
    }
    assert_eq!(listed[0]["active"], true, "nobody took it back");

    let (mut client, environment) = (app.models().await, "corner".to_owned());
    let list = client
        .list_models(proto::ListModelsRequest {
            environment: environment.clone(),
            ..Default::default()
        })
        .await
        .expect("known");
    assert_eq!(
        json!(dto::Models::from(list.into_inner()).models),
        json!(listed),
        "the faces agree"
    );
    let (status, one) = app.rest("GET", &format!("{CORNER}/models/2"), None).await;
    assert_eq!((status, &one), (200, &listed[1]));
    app.stop().await;
}

#[tokio::test]
async fn a_row_that_is_none_of_its_environment_keeps_no_other_network_away() {
    const CASES: [(&str, &str); 4] = [
        (
            "update models set ego = 9 where version = 1",
            "its ego: got position 9, expected 0 to 1",
        ),
        (
            "update models set other = 2 where version = 1",
            "its other: got position 2, expected 0 to 1",
        ),
        (
            "update models set ego = 1, other = 0 where version = 1",
            "its agents: got positions (1, 0), expected those",
        ),
        (
            "delete from model_weights where version = 1",
            "its weights: they are missing",
        ),
    ];
    for (change, expected) in CASES {
        let fixture = spoiled(&[change]).await;
        let app = TestApp::on(fixture.directory.clone()).await;
        let listed = models(&app).await;
        assert_eq!(
            listed
                .iter()
                .map(|model| why(model).is_empty())
                .collect::<Vec<_>>(),
            [false, true, true],
            "{change}"
        );
        assert!(
            why(&listed[0]).starts_with(expected),
            "{change}: {}",
            listed[0]
        );
        let (status, answer) = app.rest("GET", UNSEEN, None).await;
        assert_eq!(
            (status, &answer["answers"][0]["model"]),
            (200, &Value::Null),
            "{change}: {answer}"
        );
        for path in ["states", "summary", "explore", "graph?key=0.1.0.0.0.2.1"] {
            let (status, told) = app.rest("GET", &format!("{CORNER}/{path}"), None).await;
            assert_eq!(status, 200, "{change}, {path}: {told}");
        }

        let (status, problem) = app
            .rest("PUT", &format!("{CORNER}/models/1/active"), None)
            .await;
        assert_eq!(
            (status, &problem["reason"]),
            (409, &json!("MODEL_UNREADABLE")),
            "{change}: {problem}"
        );
        let exported = reqwest::get(app.url(&format!("{CORNER}/models/1/weights")))
            .await
            .expect("answered");
        assert_eq!(
            exported.status(),
            if change.starts_with("delete") {
                409
            } else {
                200
            },
            "{change}"
        );
        assert_eq!(
            app.rest("DELETE", &format!("{CORNER}/models/1/active"), None)
                .await
                .0,
            200,
            "{change}"
        );
        assert_eq!(
            app.rest("DELETE", &format!("{CORNER}/models/1"), None)
                .await
                .0,
            204,
            "{change}"
        );
        assert_eq!(
            app.rest("PUT", &format!("{CORNER}/models/3/active"), None)
                .await
                .0,
            200,
            "{change}"
        );
        let (_, answer) = app.rest("GET", UNSEEN, None).await;
        assert_eq!(
            answer["answers"][0]["model"]["version"], 3,
            "{change}: {answer}"
        );
        app.stop().await;

        let fixture = spoiled(&[change]).await;
        let warned = log(fixture.directory.path(), 1)
            .into_iter()
            .filter(|line| line.contains("a network cannot be read"));
        let warned: Vec<String> = warned.collect();
        assert!(
            warned.len() == 1 && warned[0].contains("WARN") && warned[0].contains(expected),
            "{change}: {warned:?}"
        );
    }
}

#[tokio::test]
async fn a_network_that_cannot_be_read_answers_nothing_and_can_be_taken_along_and_deleted() {
    let fixture = spoiled(&[NEWER_CARD, CARD_WITHOUT_TRAINING]).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    let (status, answer) = app.rest("GET", UNSEEN, None).await;
    assert_eq!(
        (status, &answer["answers"][0]["model"]),
        (200, &Value::Null),
        "the counts answer: {answer}"
    );

    let mut client = app.models().await;
    for (version, what) in [(2, "activate"), (1, "activate the active")] {
        let path = format!("{CORNER}/models/{version}/active");
        let (status, problem) = app.rest("PUT", &path, None).await;
        let request = proto::ActivateModelRequest {
            environment: "corner".into(),
            version,
        };
        let refused = client
            .activate_model(request)
            .await
            .expect_err("unreadable");
        assert_eq!(
            (status, refused.code()),
            (409, Code::FailedPrecondition),
            "{what}: {problem}"
        );
        assert_eq!(
            (&problem["reason"], reason(&refused).as_str()),
            (&json!("MODEL_UNREADABLE"), "MODEL_UNREADABLE")
        );
        assert!(
            problem["detail"]
                .as_str()
                .is_some_and(|text| text.contains("its card: it ")),
            "{problem}"
        );
    }
    for name in ["/v2/models/corner", "/v2/models/corner/versions/2"] {
        let (status, problem) = app.rest("GET", name, None).await;
        assert!(
            problem["error"]
                .as_str()
                .is_some_and(|text| text.contains("cannot be read")),
            "{name}: {problem}"
        );
        assert_eq!(status, 409, "{name}");
    }

    let exported = reqwest::get(app.url(&format!("{CORNER}/models/2/weights")))
        .await
        .expect("answered");
    assert_eq!(exported.status(), 200, "its bytes are still there");
    let (status, problem) = app
        .rest("DELETE", &format!("{CORNER}/models/1"), None)
        .await;
    assert_eq!(
        (status, &problem["reason"]),
        (409, &json!("MODEL_ACTIVE")),
        "as of any other: {problem}"
    );
    assert_eq!(
        app.rest("DELETE", &format!("{CORNER}/models/1/active"), None)
            .await
            .0,
        200
    );
    for version in [1, 2] {
        assert_eq!(
            app.rest("DELETE", &format!("{CORNER}/models/{version}"), None)
                .await
                .0,
            204
        );
    }
    assert_eq!(models(&app).await.len(), 1);
    assert_eq!(
        app.rest("PUT", &format!("{CORNER}/models/3/active"), None)
            .await
            .0,
        200
    );
    let (_, answer) = app.rest("GET", UNSEEN, None).await;
    assert_eq!(answer["answers"][0]["model"]["version"], 3, "{answer}");
    app.stop().await;

    let fixture = spoiled(&[CARD_WITHOUT_TRAINING]).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    let (status, metadata) = app.rest("GET", "/v2/models/corner", None).await;
    assert_eq!(
        (status, &metadata["versions"]),
        (200, &json!(["1", "3"])),
        "only what can be asked: {metadata}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_command_line_tells_which_network_cannot_be_read() {
    let fixture = spoiled(&[NEWER_CARD, CARD_WITHOUT_TRAINING]).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    let address = app.address.to_string();
    let run = async |arguments: &[&str]| exit_and_texts(&output(nudge(&address, arguments)).await);
    let (code, stdout, _) = run(&["model", "list", "corner"]).await;
    assert_eq!(code, 0);
    assert!(
        stdout
            .lines()
            .any(|line| line.starts_with("1 ") && line.contains("unreadable, active")),
        "{stdout}"
    );
    let (_, stdout, _) = run(&["model", "show", "corner", "1"]).await;
    assert!(
        stdout.contains("cannot be read, answers nothing: its card: it has form 9"),
        "{stdout}"
    );
    assert!(
        stdout.contains("`nudge model rollback corner 1` takes it back"),
        "{stdout}"
    );
    assert_eq!(
        run(&["model", "delete", "corner", "2"]).await,
        (0, "version 2 of `corner` deleted\n".into(), String::new())
    );
    app.stop().await;
}

#[tokio::test]
async fn a_store_that_cannot_be_read_for_a_moment_switches_no_network_off() {
    for failure in [Failure::Models, Failure::Model] {
        let fixture = Fixture::named(BEFORE_VERSIONS);
        let faulty = Faulty::new(
            open(fixture.directory.path(), Options::default()).await,
            failure,
        );
        faulty.arm();
        let app = TestApp::with(fixture.directory.clone(), faulty.clone()).await;
        for path in [UNSEEN, "/v1/environments/corner/models", UNSEEN] {
            let (status, problem) = app.rest("GET", path, None).await;
            assert_eq!(
                (status, &problem["reason"]),
                (500, &json!("INTERNAL")),
                "{path}: nobody pretends: {problem}"
            );
        }
        faulty.disarm();
        assert!(models(&app).await.iter().all(|model| why(model).is_empty()));
        let (status, answer) = app.rest("GET", UNSEEN, None).await;
        assert_eq!(
            (status, &answer["answers"][0]["model"]["version"]),
            (200, &json!(1)),
            "{answer}"
        );
        app.stop().await;
    }
}

#[tokio::test]
async fn fits_are_made_again_and_no_version_is_used_twice() {
    let fixture = spoiled(&[NEWER_FIT, FIT_OF_ANOTHER_SHAPE]).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    let (store, fits) = (
        app.app.store.clone(),
        PriorRegistry::new(app.app.store.clone()),
    );
    for (name, given) in [("corner", vec![]), ("trio", vec![2])] {
        let environment = store.environment(name).expect("there");
        let stored = store
            .fits(environment.id)
            .await
            .expect("read")
            .pop()
            .expect("one")
            .id;
        let pair = Pair::new(0, 1, given);
        let cold = fits
            .get(&environment, &pair)
            .await
            .expect("read")
            .expect("not too large");
        assert_eq!(
            (cold.id.version, cold.id.revision, cold.fit.states),
            (0, 0, 0),
            "{name}: as if nothing was fitted"
        );
        let made = fits
            .fit(&environment, &pair)
            .await
            .expect("fitted")
            .expect("not too large");
        assert_eq!(
            (made.id.version, made.id.revision),
            (stored.version + 1, stored.revision),
            "{name}"
        );
        let again = PriorRegistry::new(store.clone())
            .get(&environment, &pair)
            .await
            .expect("read")
            .expect("not too large");
        assert_eq!((again.id, &again.fit), (made.id, &made.fit), "{name}");
    }
    app.stop().await;
}

#[tokio::test]
async fn an_environment_that_cannot_be_read_keeps_nobody_else_away() {
    let fixture = spoiled(&[NEWER_SCHEMA, WRONG_RULE]).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    assert_eq!(app.rest("GET", "/readyz", None).await.0, 200);
    let (_, page) = app.rest("GET", "/v1/environments", None).await;
    let names = |list: &Value| {
        list.as_array()
            .expect("a list")
            .iter()
            .map(|one| one["name"].clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(
        (names(&page["environments"]), names(&page["unreadable"])),
        (vec![json!("corner")], vec![json!("far"), json!("trio")])
    );
    let expected = "its schema: it has form 9 of a newer build, and this one reads up to 2";
    assert_eq!(page["unreadable"][0]["unreadable"], expected);
    let rule = page["unreadable"][1]["unreadable"].as_str().expect("text");
    assert!(
        rule.starts_with(
            "its rule: it is not as it was written: invalid rule: /kind: got \"guess\""
        ),
        "{rule}"
    );
    let request = proto::ListEnvironmentsRequest::default();
    let over_grpc = app
        .environments()
        .await
        .list_environments(request)
        .await
        .expect("a page")
        .into_inner();
    assert_eq!(
        json!(dto::EnvironmentPage::from(over_grpc)),
        page,
        "the faces agree"
    );

    let body = json!({"producer": "p", "sequence": 2, "transitions": []});
    let description = json!({"state": [], "agents": []});
    let calls = [
        ("GET", "", None),
        ("GET", "/summary", None),
        ("GET", "/models", None),
        ("POST", "/transitions", Some(&body)),
    ];
    for (method, path, body) in calls {
        let (status, problem) = app
            .rest(method, &format!("/v1/environments/far{path}"), body)
            .await;
        assert_eq!(
            (status, &problem["reason"]),
            (409, &json!("ENVIRONMENT_UNREADABLE")),
            "{method} {path}: {problem}"
        );
    }
    let request = proto::GetEnvironmentRequest { name: "far".into() };
    let refused = app
        .environments()
        .await
        .get_environment(request)
        .await
        .expect_err("unreadable");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::FailedPrecondition, "ENVIRONMENT_UNREADABLE".into())
    );
    assert_eq!(
        app.rest("PUT", "/v1/environments/far", Some(&description))
            .await
            .0,
        400,
        "a wrong description first"
    );
    let (_, corner) = app.rest("GET", CORNER, None).await;
    let same = json!({"state": corner["state"], "agents": corner["agents"]});
    let (status, problem) = app.rest("PUT", "/v1/environments/far", Some(&same)).await;
    assert_eq!(
        (status, &problem["reason"]),
        (409, &json!("ENVIRONMENT_UNREADABLE")),
        "the name is taken: {problem}"
    );

    assert_eq!(
        app.rest("DELETE", "/v1/environments/far", None).await.0,
        204
    );
    assert_eq!(app.rest("GET", "/v1/environments/far", None).await.0, 404);
    assert_eq!(
        app.rest("PUT", "/v1/environments/far", Some(&same)).await.0,
        201,
        "the name is free again"
    );
    let app = app.restart().await;
    let (_, page) = app.rest("GET", "/v1/environments", None).await;
    assert_eq!(
        names(&page["unreadable"]),
        [json!("trio")],
        "the other is left alone"
    );
    app.stop().await;
}

#[tokio::test]
async fn a_receipt_that_cannot_be_read_holds_nobody_up() {
    const NEWER: &str = "update batches set receipt = json_set(receipt, '$.form', 9) where producer = 1 and sequence = 1";
    let fixture = spoiled(&[NEWER]).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    let (path, body, _) = fixture.posted().next().expect("the first batch");
    let (status, receipt) = app
        .rest("POST", &format!("/v1/environments{path}"), Some(body))
        .await;
    assert_eq!(
        (status, &receipt["status"], &receipt["unverified"]),
        (200, &json!("duplicate"), &json!(true)),
        "{receipt}"
    );
    let other = json!({"producer": "game-7", "sequence": 1, "transitions": []});
    let (status, problem) = app
        .rest("POST", &format!("/v1/environments{path}"), Some(&other))
        .await;
    assert_eq!(status, 409, "its content is still known: {problem}");
    let (_, state) = app
        .rest("GET", &format!("{CORNER}/states/2.1.3.0.0.0.0"), None)
        .await;
    let (_, before) = fixture
        .got()
        .find(|(path, _)| path.ends_with("/states/2.1.3.0.0.0.0"))
        .expect("asked");
    assert_eq!(
        state["visits"], before["visits"],
        "nothing is counted twice"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn check_names_each_network_that_cannot_be_read() {
    const WITHOUT_WEIGHTS: &str = "delete from model_weights where version = 3";
    let fixture = spoiled(&[NEWER_CARD, WITHOUT_WEIGHTS]).await;
    let data = fixture.directory.path().to_str().expect("text").to_owned();
    let (code, stdout, stderr) =
        exit_and_texts(&output(nudge("", &["check", "--data", &data])).await);
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("2 networks cannot be read"), "{stderr}");
    for line in [
        "version 1: CANNOT BE READ, its card: it has form 9",
        "version 3: CANNOT BE READ, its weights: they are",
    ] {
        assert!(
            stdout.contains(&format!("corner, network {line}")),
            "{stdout}"
        );
    }
    let (_, stdout, _) =
        exit_and_texts(&output(nudge("", &["check", "--json", "--data", &data])).await);
    let report: Value = serde_json::from_str(&stdout).expect("JSON");
    let first = &report["unreadable_networks"][0];
    assert_eq!(
        (&first["environment"], &first["version"]),
        (&json!("corner"), &json!(1)),
        "{report}"
    );
    assert_eq!(report.get("unreadable"), None, "{report}");
}

#[tokio::test]
async fn versions_that_are_used_up_are_told_so() {
    const FIT: &str = "update fits set version = 9223372036854775807 where pair = '0,1'";
    const MODEL: &str = "update model_versions set last = 9223372036854775807";
    let fixture = spoiled(&[FIT]).await;
    execute(&fixture.path(), MODEL).await;
    let app = TestApp::on(fixture.directory.clone()).await;
    let (status, problem) = app.rest("POST", &format!("{CORNER}/fit"), None).await;
    assert_eq!(
        (status, &problem["reason"]),
        (409, &json!("VERSIONS_USED_UP")),
        "{problem}"
    );
    let weights = reqwest::get(app.url(&format!("{CORNER}/models/1/weights")))
        .await
        .expect("answered");
    let weights = weights.bytes().await.expect("read");
    let environment = app.app.store.environment("corner").expect("there");
    let model = NewModel {
        ego: 0,
        other: 1,
        kind: "joint".into(),
        card: "{}".into(),
        weights: weights.to_vec(),
    };
    let refused = app
        .app
        .store
        .keep_model(environment.id, &model)
        .await
        .expect_err("no number is left");
    assert!(
        matches!(refused, StoreError::VersionsUsedUp(_)),
        "{refused}"
    );
    app.stop().await;
}

/// Starts the real binary, stops it once it has told of so many networks, and returns what it
/// logged.
fn log(data: &Path, networks: usize) -> Vec<String> {
    // A line that never comes must not be waited for without end. In the foreground, for else the
    // signal to stop would arrive twice.
    let mut child = Command::new("timeout")
        .args(["--foreground", "30", env!("CARGO_BIN_EXE_nudge")])
        .args([
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--fit-every",
            "0s",
            "--log",
            "json",
            "--data",
        ])
        .arg(data)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts");
    let stderr = child.stderr.take().expect("piped");
    let stop = || {
        Command::new("kill")
            .args(["-TERM", &child.id().to_string()])
            .status()
            .expect("kill is there")
    };
    let mut lines = Vec::new();
    let mut told = 0;
    for line in BufReader::new(stderr).lines() {
        lines.push(line.expect("text"));
        // The networks are looked at last.
        told += usize::from(
            lines
                .last()
                .is_some_and(|line| line.contains("a network cannot be read")),
        );
        if told == networks {
            assert!(stop().success());
            told = 0;
        }
    }
    assert!(child.wait().expect("it ends").success(), "{lines:#?}");
    lines
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_line_at_the_start_names_each_thing_its_version_and_the_reason() {
    let changes = [
        NEWER_CARD,
        CARD_WITHOUT_TRAINING,
        NO_WEIGHTS,
        NEWER_FIT,
        NEWER_SCHEMA,
    ];
    let fixture = spoiled(&changes).await;
    let directory = fixture.directory.clone();
    let lines = tokio::task::spawn_blocking(move || log(directory.path(), 3))
        .await
        .expect("no panic");
    let warned: Vec<Value> = lines
        .iter()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    let warned: Vec<&Value> = warned
        .iter()
        .filter(|line| line["level"] == "WARN")
        .collect();
    let said = |line: &&Value, name: &str| line[name].clone();
    let told: Vec<[Value; 3]> = warned
        .iter()
        .map(|line| ["environment", "version", "message"].map(|name| said(line, name)))
        .collect();
    let network = |version: u64| {
        [
            json!("corner"),
            json!(version),
            json!("a network cannot be read: it answers nothing"),
        ]
    };
    let expected = [
        [
            json!("far"),
            Value::Null,
            json!("an environment cannot be read: it can only be deleted"),
        ],
        [
            json!("corner"),
            json!(6),
            json!(
                "a fit cannot be read: version 0 answers until another is made, by --fit-every or POST .../fit"
            ),
        ],
        network(1),
        network(2),
        network(3),
    ];
    assert_eq!(told, expected, "{lines:#?}");
    assert!(
        warned.iter().all(|line| line["why"]
            .as_str()
            .is_some_and(|why| why.starts_with("it"))),
        "{lines:#?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn check_and_env_list_name_an_environment_that_cannot_be_read() {
    let fixture = spoiled(&[NEWER_SCHEMA]).await;
    let data = fixture.directory.path().to_str().expect("text").to_owned();
    let (code, stdout, stderr) =
        exit_and_texts(&output(nudge("", &["check", "--data", &data])).await);
    assert_eq!(code, 1, "{stderr}");
    assert!(
        stdout.contains("far: CANNOT BE READ, its schema: it has form 9"),
        "{stdout}"
    );
    let (_, stdout, _) =
        exit_and_texts(&output(nudge("", &["check", "--json", "--data", &data])).await);
    let report: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(report["unreadable"][0]["name"], "far", "{report}");

    let app = TestApp::on(fixture.directory.clone()).await;
    let run = async |arguments: &[&str]| {
        exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
    };
    let (code, stdout, _) = run(&["env", "list"]).await;
    assert_eq!(code, 0);
    let last = stdout.lines().last().expect("a line");
    assert!(
        last.starts_with("far  CANNOT BE READ (") && last.contains("its schema: it has form 9"),
        "{stdout}"
    );
    let (code, _, stderr) = run(&["env", "show", "far"]).await;
    assert_eq!((code, stderr.lines().count()), (1, 1), "{stderr}");
    assert_eq!(run(&["env", "delete", "far", "--yes"]).await.0, 0);
    let (_, stdout, _) = run(&["env", "list", "--json"]).await;
    let list: Value = serde_json::from_str(&stdout).expect("JSON");
    assert_eq!(
        (
            list["environments"].as_array().map(Vec::len),
            list.get("unreadable")
        ),
        (Some(2), None)
    );
    app.stop().await;
}
