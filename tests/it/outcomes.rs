//! Outcomes and absent agents on every face: what a description stands for, one content in every
//! form, and what is wrong with a record told by its pointer.

use std::sync::Arc;

use bytes::Bytes;
use nudge::api::proto::{self, BatchStatus};
use nudge::domain::{Environment, Family, Pair, Presence, StateKey, Values};
use nudge::store::{Options, Store};
use serde_json::{Value, json};
use tempfile::TempDir;
use tonic::Code;

use crate::support::{TestApp, lane_json, lane_schema, open};

/// The lane whose human may be absent, with what each does one and two steps later, and a pot.
fn later_json() -> Value {
    let mut lane = lane_json();
    lane["agents"][1]["may_be_absent"] = json!(true);
    lane["lags"] = json!([2, 1]);
    lane["outcomes"] = json!([pot()]);
    lane
}

fn pot() -> Value {
    json!({"name": "pot", "lag": 1, "value": [
        {"name": "holds", "categorical": {"labels": ["2", "1", "onion"]}},
        {"name": "heat", "continuous": {"edges": [0.5]}},
    ]})
}

/// The same as proto.
fn later_schema() -> proto::Schema {
    let mut schema = lane_schema();
    schema.agents[1].may_be_absent = true;
    schema.lags = vec![2, 1];
    let feature = |name: &str, kind| proto::Feature {
        name: name.into(),
        unit: String::new(),
        kind: Some(kind),
    };
    let labels = ["2", "1", "onion"].map(String::from).to_vec();
    let edges = vec![0.5];
    use proto::feature::Kind;
    schema.outcomes = vec![proto::Outcome {
        name: "pot".into(),
        lag: 1,
        value: vec![
            feature("holds", Kind::Categorical(proto::Categorical { labels })),
            feature("heat", Kind::Continuous(proto::Continuous { edges })),
        ],
        ..proto::Outcome::default()
    }];
    schema
}

async fn apply(app: &TestApp, name: &str, schema: proto::Schema) -> Result<bool, tonic::Status> {
    let request = proto::ApplyEnvironmentRequest {
        name: name.into(),
        schema: Some(schema),
        rule: None,
        derived: None,
    };
    let applied = app.environments().await.apply_environment(request).await;
    applied.map(|applied| applied.into_inner().created)
}

/// A service, and its store.
struct Later {
    app: TestApp,
    store: Arc<dyn Store>,
}

impl std::ops::Deref for Later {
    type Target = TestApp;

    fn deref(&self) -> &TestApp {
        &self.app
    }
}

async fn started() -> Later {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let app = TestApp::with(directory, store.clone()).await;
    let made = app
        .rest("PUT", "/v1/environments/later", Some(&later_json()))
        .await;
    assert_eq!(made.0, 201, "{}", made.1);
    Later { app, store }
}

#[tokio::test]
async fn what_is_told_is_the_long_form_and_means_the_same_on_every_face() {
    let app = started().await;
    let told = app.get("/v1/environments/later").await;
    let action = |agent: &str, lag: u32| json!({"name": format!("{agent}@{lag}"), "agent": agent, "lag": lag});
    let expected = json!([
        action("robot", 1),
        action("robot", 2),
        action("human", 1),
        action("human", 2),
        pot(),
    ]);
    assert_eq!(told["outcomes"], expected);
    assert_eq!(told["agents"][1]["may_be_absent"], json!(true));
    assert_eq!(told["agents"][0].get("may_be_absent"), None);
    assert_eq!(told.get("lags"), None);

    // What is told is a description of it, and so are the short and the long form of gRPC.
    let again = app.rest("PUT", "/v1/environments/later", Some(&told)).await;
    assert_eq!(again.0, 200, "{}", again.1);
    assert!(
        !apply(&app, "later", later_schema())
            .await
            .expect("the same")
    );
    let request = proto::GetEnvironmentRequest {
        name: "later".into(),
    };
    let got = app.environments().await.get_environment(request).await;
    let got = got.expect("there").into_inner().environment.expect("there");
    let schema = got.schema.expect("small");
    assert_eq!((schema.lags.len(), schema.outcomes.len()), (0, 5));
    assert!(!apply(&app, "later", schema).await.expect("the same"));

    // Another one is another schema.
    let fewer = proto::Schema {
        lags: vec![1],
        ..later_schema()
    };
    let refused = apply(&app, "later", fewer)
        .await
        .expect_err("another schema");
    assert_eq!(refused.code(), Code::AlreadyExists);
    let Later { app, store } = app;
    drop(store);
    let app = app.restart().await;
    assert_eq!(app.get("/v1/environments/later").await, told);
    app.stop().await;
}

#[tokio::test]
async fn a_description_without_outcomes_is_told_as_ever() {
    let app = TestApp::start().await;
    let made = app
        .rest("PUT", "/v1/environments/lane", Some(&lane_json()))
        .await;
    assert_eq!(made.0, 201);
    let told = app.get("/v1/environments/lane").await;
    let members: Vec<&String> = told.as_object().expect("an object").keys().collect();
    let known = ["agents", "name", "rule", "schema_hash", "state", "uid"];
    assert_eq!(members, known);
    assert_eq!(told["agents"], lane_json()["agents"]);
}

/// Makes the same fault in a description in proto.
type Change = fn(&mut proto::Schema);

#[tokio::test]
async fn both_faces_tell_the_faults_of_outcomes_by_pointer() {
    let app = TestApp::start().await;
    let cases: [(Value, Change, &str, &str); 5] = [
        (
            json!({"lags": [0]}),
            |s| s.lags = vec![0],
            "/lags/0",
            "got 0, expected 1 to 64",
        ),
        (
            json!({"lags": [65]}),
            |s| s.lags = vec![65],
            "/lags/0",
            "got 65, expected 1 to 64",
        ),
        (
            json!({"outcomes": [{"agent": "humen", "lag": 1}]}),
            |s| s.outcomes = vec![outcome("", "humen", 1)],
            "/outcomes/0/agent",
            "unknown agent \"humen\"; did you mean `human`?",
        ),
        (
            json!({"outcomes": [{"name": "reply", "agent": "human", "lag": 1}]}),
            |s| s.outcomes = vec![outcome("reply", "human", 1)],
            "/outcomes/0/name",
            "got \"reply\", expected \"human@1\", as an action at that lag is called",
        ),
        (
            json!({"lags": [1], "outcomes": [{"agent": "human", "lag": 1}]}),
            |s| (s.lags, s.outcomes) = (vec![1], vec![outcome("", "human", 1)]),
            "/outcomes/0/name",
            "\"human@1\" is used twice",
        ),
    ];
    for (members, change, pointer, detail) in cases {
        let mut description = lane_json();
        for (name, value) in members.as_object().expect("an object") {
            description[name] = value.clone();
        }
        let (status, told) = app
            .rest("PUT", "/v1/environments/bad", Some(&description))
            .await;
        assert_eq!(status, 400, "{told}");
        assert_eq!(
            told["errors"][0],
            json!({"pointer": pointer, "detail": detail}),
            "{told}"
        );

        let mut schema = lane_schema();
        change(&mut schema);
        let refused = apply(&app, "bad", schema).await.expect_err(detail);
        assert_eq!(refused.code(), Code::InvalidArgument);
        let wanted = format!("{pointer}: {detail}");
        assert!(refused.message().contains(&wanted), "{}", refused.message());
    }

    // Misspelt members are told with what was meant.
    for (members, near) in [
        (json!({"lag": [1]}), "lags"),
        (json!({"outcome": []}), "outcomes"),
    ] {
        let mut description = lane_json();
        let (name, value) = members
            .as_object()
            .and_then(|one| one.iter().next())
            .expect("one");
        description[name] = value.clone();
        let (status, told) = app
            .rest("PUT", "/v1/environments/bad", Some(&description))
            .await;
        assert_eq!(status, 400);
        assert!(told.to_string().contains(near), "{told}");
    }
}

fn outcome(name: &str, agent: &str, lag: u32) -> proto::Outcome {
    proto::Outcome {
        name: name.into(),
        agent: agent.into(),
        lag,
        ..proto::Outcome::default()
    }
}

/// Four transitions, one of which the human is absent from, with what is known of what came later.
fn transitions() -> [Value; 4] {
    let state = json!({"distance": 0.6, "held": "dish"});
    let of = |actions: Value, outcomes: Value| json!({"state": state, "actions": actions, "outcomes": outcomes});
    [
        of(
            json!({"robot": "go", "human": "left"}),
            json!({"robot@1": "stop", "robot@2": {"move": "go"}, "human@1": "right", "human@2": 2, "pot": {"holds": 1, "heat": 0.7}}),
        ),
        of(
            json!({"robot": "stop", "human": null}),
            json!({"robot@1": "stop", "human@1": null, "human@2": "left"}),
        ),
        of(json!({"robot": "go", "human": "stay"}), json!({})),
        json!({"state": state, "actions": {"robot": "go", "human": "stay"}}),
    ]
}

/// The same as rows.
fn rows() -> Vec<proto::Transition> {
    let row = |actions: [f32; 2], acted: u8, outcomes: &[f32], seen: u8| proto::Transition {
        state: vec![0.6, 1.0],
        actions: actions.into(),
        actions_present: Bytes::from(vec![acted]),
        outcomes: outcomes.to_vec(),
        outcomes_present: match outcomes.is_empty() {
            true => Bytes::new(),
            false => Bytes::from(vec![seen]),
        },
        ..proto::Transition::default()
    };
    vec![
        row([0.0, 0.0], 0b11, &[1.0, 0.0, 1.0, 2.0, 1.0, 0.7], 0b11111),
        // What stands in the slot of what is missing is no content.
        row(
            [1.0, 9.0],
            0b01,
            &[1.0, 7.0, 7.0, 0.0, 7.0, f32::NAN],
            0b01001,
        ),
        row([0.0, 2.0], 0b11, &[], 0),
        row([0.0, 2.0], 0b11, &[0.0; 6], 0b00000),
    ]
}

/// The same as columns.
fn columns() -> proto::Columns {
    let (mut states, mut actions, mut outcomes) = (Vec::new(), Vec::new(), Vec::new());
    let (mut acted, mut seen) = (Vec::new(), Vec::new());
    let flag = |bits: &Bytes, slot: usize| bits.first().is_some_and(|bits| bits >> slot & 1 == 1);
    for row in rows() {
        states.extend(&row.state);
        actions.extend(&row.actions);
        acted.extend((0..2).map(|slot| flag(&row.actions_present, slot)));
        seen.extend((0..5).map(|slot| flag(&row.outcomes_present, slot)));
        outcomes.extend(match row.outcomes.is_empty() {
            true => vec![0.0; 6],
            false => row.outcomes,
        });
    }
    let bytes = |values: Vec<f32>| Values::from(values).into_le_bytes();
    proto::Columns {
        count: 4,
        states_le: bytes(states),
        actions_le: bytes(actions),
        outcomes_le: bytes(outcomes),
        actions_present: Presence::of(acted).bits().clone(),
        outcomes_present: Presence::of(seen).bits().clone(),
        ..proto::Columns::default()
    }
}

async fn write(app: &TestApp, transitions: proto::batch::Transitions) -> proto::Receipt {
    let request = proto::WriteRequest {
        environment: "later".into(),
        producer: "p".into(),
        batch: Some(proto::Batch {
            sequence: 1,
            transitions: Some(transitions),
            ..proto::Batch::default()
        }),
        ..proto::WriteRequest::default()
    };
    let written = app.ingest().await.write(request).await;
    written
        .expect("a batch")
        .into_inner()
        .receipt
        .expect("there")
}

/// Visits by cell of a family, each taken apart: the letters of robot and human, and the value.
async fn told(app: &Later, family: Family) -> Vec<([u64; 3], u64)> {
    let (environment, counts) = counts(app).await;
    let schema = &environment.schema;
    let cells = counts.of_family(family).iter().map(|cell| {
        let (joint, value) = schema.split(family, cell.joint);
        let [robot, human] = [0, 1].map(|agent| schema.action_of(joint, agent));
        ([robot, human, value], cell.tally.n)
    });
    cells.collect()
}

async fn counts(app: &Later) -> (Arc<Environment>, Arc<nudge::domain::Counts>) {
    let store = &app.store;
    let environment = store.environment("later").expect("made");
    let key = StateKey::new(&[1, 1]);
    let counts = store.counts(environment.id, &[key]).await.expect("counts");
    (environment, counts[0].counts.clone())
}

#[tokio::test]
async fn one_content_in_every_form_counts_once() {
    let app = started().await;
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions()});
    let path = "/v1/environments/later/transitions";
    let (status, receipt) = app.rest("POST", path, Some(&body)).await;
    assert_eq!(
        (status, &receipt["accepted"]),
        (200, &json!(4)),
        "{receipt}"
    );

    let rows = proto::Rows {
        transitions: rows(),
    };
    for form in [
        proto::batch::Transitions::Rows(rows),
        proto::batch::Transitions::Columns(columns()),
    ] {
        let receipt = write(&app, form).await;
        assert_eq!(receipt.status(), BatchStatus::Duplicate);
    }
    let lines = transitions().map(|line| line.to_string()).join("\n");
    let url = app.url(&format!("{path}?producer=p&sequence=1"));
    let request = reqwest::Client::new().post(url).body(lines);
    let request = request.header("content-type", "application/x-ndjson");
    let answer: Value = request
        .send()
        .await
        .expect("answered")
        .json()
        .await
        .expect("JSON");
    assert_eq!(answer["status"], "duplicate", "{answer}");

    // The absent human is the letter 3; robot@2 is beside robot@1, and human@2 beside human@1, or
    // beside its absence, where the human may have been absent.
    assert_eq!(
        told(&app, Family::JOINT).await,
        [([0, 0, 0], 1), ([0, 2, 0], 2), ([1, 3, 0], 1)]
    );
    let outcome = |at| told(&app, Family::of_outcome(at));
    assert_eq!(outcome(0).await, [([0, 0, 1], 1), ([1, 3, 1], 1)]);
    assert_eq!(outcome(1).await, [([1, 0, 0], 1)]);
    assert_eq!(outcome(2).await, [([0, 0, 1], 1)]);
    assert_eq!(outcome(3).await, [([0, 1, 2], 1), ([1, 3, 0], 1)]);
    assert_eq!(outcome(4).await, [([0, 0, 3], 1)]);
}

#[tokio::test]
async fn a_wrong_outcome_rejects_its_record_and_a_missing_one_none() {
    let app = started().await;
    let state = json!({"distance": 0.6, "held": "dish"});
    let both = json!({"robot": "go", "human": "left"});
    let record = |actions: &Value, outcomes: Value| json!({"state": state, "actions": actions, "outcomes": outcomes});
    let wrong = [
        (
            record(&both, json!({"human@1": "up"})),
            "/outcomes/human@1/move",
            "got \"up\", expected one of left",
        ),
        (
            record(&both, json!({"human@1": {"move": "up"}})),
            "/outcomes/human@1/move",
            "got \"up\", expected one of left",
        ),
        (
            record(&both, json!({"human@1": 7})),
            "/outcomes/human@1/move",
            "got 7, expected one of left",
        ),
        (
            record(&json!({"robot": "go", "human": "up"}), json!({})),
            "/actions/human/move",
            "got \"up\", expected one of left",
        ),
        (
            record(&both, json!({"human@3": "left"})),
            "/outcomes/human@3",
            "unknown outcome, expected robot@1",
        ),
        (
            record(&both, json!({"pot": {"holds": 3, "heat": 0}})),
            "/outcomes/pot/holds",
            "got 3, expected one of 2, 1, onion",
        ),
        (
            record(&both, json!({"pot": "onion"})),
            "/outcomes/pot",
            "got \"onion\", expected an object of holds, heat",
        ),
        (
            record(&both, json!([])),
            "/outcomes",
            "got a list of 0, expected an object",
        ),
        (
            record(&json!({"robot": null, "human": "left"}), json!({})),
            "/actions/robot",
            "got null, expected one of go",
        ),
        (
            record(&json!({"robot": "go"}), json!({})),
            "/actions/human",
            "missing, expected an action, or null where it took none",
        ),
    ];
    let good = [
        record(&both, json!({})),
        record(&both, json!(null)),
        record(
            &json!({"robot": "go", "human": null}),
            json!({"human@2": null}),
        ),
    ];
    let all: Vec<&Value> = wrong
        .iter()
        .map(|(record, ..)| record)
        .chain(&good)
        .collect();
    let body = json!({"producer": "p", "sequence": 1, "transitions": all});
    let path = "/v1/environments/later/transitions";
    let (status, receipt) = app.rest("POST", path, Some(&body)).await;
    assert_eq!(
        (status, &receipt["accepted"]),
        (200, &json!(3)),
        "{receipt}"
    );
    let rejected = receipt["rejected"].as_array().expect("a list");
    assert_eq!(rejected.len(), wrong.len());
    for ((_, pointer, reason), told) in wrong.iter().zip(rejected) {
        assert_eq!(told["field"], *pointer, "{told}");
        let said = told["reason"].as_str().expect("text");
        assert!(said.starts_with(reason), "{said}");
    }

    // By position the same: a value without a bin, and an agent that has to act.
    let mut columns = columns();
    let mut outcomes = vec![0.0_f32; 24];
    outcomes[4] = 3.0;
    columns.outcomes_le = Values::from(outcomes).into_le_bytes();
    columns.actions_present = Bytes::from(vec![0b1011_1111]);
    columns.outcomes_present = Bytes::new();
    let mut request = proto::Batch {
        sequence: 2,
        ..proto::Batch::default()
    };
    request.transitions = Some(proto::batch::Transitions::Columns(columns));
    let request = proto::WriteRequest {
        environment: "later".into(),
        producer: "p".into(),
        batch: Some(request),
        ..proto::WriteRequest::default()
    };
    let written = app.ingest().await.write(request).await.expect("a batch");
    let receipt = written.into_inner().receipt.expect("there");
    let told: Vec<_> = receipt
        .rejected
        .iter()
        .map(|told| (told.index, told.field.as_str()))
        .collect();
    let expected = [
        (0, "/outcomes/pot/holds"),
        (1, "/actions/human/move"),
        (3, "/actions/robot"),
    ];
    assert_eq!(told, expected, "{receipt:?}");
}

/// Two players who take turns and choose at random: whose turn it is is no influence. With a label
/// for waiting it would be certain.
#[tokio::test]
async fn taking_turns_is_no_influence() {
    let app = started().await;
    let state = json!({"distance": 0.6, "held": "dish"});
    let path = "/v1/environments/later/transitions";
    let turns = (0..200).map(|turn| {
        let human = (turn % 2 == 0).then(|| json!(["left", "right"][turn / 2 % 2]));
        let robot = ["go", "stop"][turn / 4 % 2];
        json!({"state": state, "actions": {"robot": robot, "human": human}})
    });
    let turns: Vec<Value> = turns.collect();
    let body = json!({"producer": "p", "sequence": 1, "transitions": turns});
    assert_eq!(app.rest("POST", path, Some(&body)).await.0, 200);
    let answer = app
        .get("/v1/environments/later/influence?key=1.1&significance=auto")
        .await;
    let answer = &answer["answers"][0];
    assert_eq!(answer["visits"], 100, "those in which both acted: {answer}");
    assert_eq!(answer["mutual_information"]["plug_in"], 0.0, "{answer}");

    // The robot always acts, and so does its later action; nothing was observed of that.
    let (environment, counts) = counts(&app).await;
    let pair = Pair::new(1, 0, Vec::new());
    let later = pair.at_lag(&environment.schema, 1).expect("declared");
    assert_eq!(counts.of_pair(&environment.schema, &later, None).count(), 0);
    assert_eq!(counts.of_pair(&environment.schema, &pair, None).count(), 4);
}
