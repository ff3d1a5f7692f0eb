//! The faces agree: one table of questions and one of faults, asked over REST and over gRPC.

use std::collections::BTreeSet;

use nudge::api::{json as dto, proto};
use serde_json::{Value, json};
use tonic::{Code, Status};
use tonic_types::StatusExt;

use crate::support::{TestApp, lane_json, reason, row, rows};

const INFLUENCE: &str = "/v1/environments/lane/influence";

/// A lane where the human answers the robot in one state, and nearly nothing is known of another.
async fn lane_with_play() -> TestApp {
    let app = TestApp::start().await;
    app.lane().await;
    let mut transitions = Vec::new();
    for i in 0..40 {
        let robot = (i % 2) as f32;
        transitions.push(row(
            [0.1, 0.0],
            [robot, if i % 8 == 0 { 2.0 } else { robot }],
        ));
    }
    transitions.push(row([2.0, 1.0], [0.0, 1.0]));
    let batch = proto::Batch {
        segment: "trial-1".into(),
        ..rows(1, transitions)
    };
    let write = proto::WriteRequest {
        environment: "lane".into(),
        producer: "p".into(),
        batch: Some(batch),
        ..Default::default()
    };
    app.ingest().await.write(write).await.expect("valid");
    app
}

fn scope() -> proto::Scope {
    proto::Scope {
        environment: "lane".into(),
        ..Default::default()
    }
}

fn by_keys(keys: &[&str]) -> proto::BatchGetInfluenceRequest {
    let keys = keys.iter().map(ToString::to_string).collect();
    proto::BatchGetInfluenceRequest {
        scope: Some(scope()),
        keys,
        ..Default::default()
    }
}

fn by_values(states: &[[f32; 2]]) -> proto::BatchGetInfluenceRequest {
    let states = states
        .iter()
        .map(|values| proto::StateValues {
            values: values.to_vec(),
        })
        .collect();
    proto::BatchGetInfluenceRequest {
        scope: Some(scope()),
        states,
        ..Default::default()
    }
}

/// The same question in the words of each face.
fn questions() -> Vec<(Value, proto::BatchGetInfluenceRequest)> {
    let scoped = |scope: proto::Scope, request: proto::BatchGetInfluenceRequest| {
        proto::BatchGetInfluenceRequest {
            scope: Some(scope),
            ..request
        }
    };
    let rule = proto::Rule {
        threshold: Some(0.2),
        min_visits: Some(1),
        ..Default::default()
    };
    let full = proto::View::Full.into();
    vec![
        (json!({"keys": ["0.0"]}), by_keys(&["0.0"])),
        (
            json!({"keys": ["0.0", "3.1", "1.1"]}),
            by_keys(&["0.0", "3.1", "1.1"]),
        ),
        (
            json!({"states": [{"distance": 0.1, "held": "nothing"}, {"held": 1, "distance": 2}], "view": "full"}),
            proto::BatchGetInfluenceRequest {
                view: full,
                ..by_values(&[[0.1, 0.0], [2.0, 1.0]])
            },
        ),
        (
            json!({"keys": ["0.0"], "view": "verdict"}),
            proto::BatchGetInfluenceRequest {
                view: proto::View::Verdict.into(),
                ..by_keys(&["0.0"])
            },
        ),
        (
            json!({"keys": ["0.0"], "ego": "human", "other": "robot", "unit": "bits"}),
            scoped(
                proto::Scope {
                    ego: "human".into(),
                    other: "robot".into(),
                    unit: "bits".into(),
                    ..scope()
                },
                by_keys(&["0.0"]),
            ),
        ),
        (
            json!({"keys": ["0.0", "3.1"], "rule": {"threshold": 0.2, "min_visits": 1}, "segments": ["trial-1"]}),
            scoped(
                proto::Scope {
                    rule: Some(rule),
                    segments: vec!["trial-1".into()],
                    ..scope()
                },
                by_keys(&["0.0", "3.1"]),
            ),
        ),
        (
            json!({"keys": ["0.0"], "rule": {"kind": "evidence"}, "estimators": ["miller_madow", "excess"]}),
            proto::BatchGetInfluenceRequest {
                estimators: vec!["miller_madow".into(), "excess".into()],
                ..scoped(
                    proto::Scope {
                        rule: Some(proto::Rule {
                            kind: Some("evidence".into()),
                            ..Default::default()
                        }),
                        ..scope()
                    },
                    by_keys(&["0.0"]),
                )
            },
        ),
    ]
}

#[tokio::test]
async fn the_same_question_gets_the_same_answer() {
    let app = lane_with_play().await;
    let mut client = app.influence().await;
    for (body, request) in questions() {
        let (status, over_rest) = app.rest("POST", INFLUENCE, Some(&body)).await;
        assert_eq!(status, 200, "{body}: {over_rest}");
        let over_grpc = client
            .batch_get_influence(request)
            .await
            .expect("valid")
            .into_inner();
        let over_grpc = serde_json::to_value(dto::Answers::from(over_grpc)).expect("JSON");
        assert_eq!(over_rest, over_grpc, "{body}");
    }
}

#[tokio::test]
async fn one_state_in_a_query_string_is_the_same_question() {
    let app = lane_with_play().await;
    let (_, posted) = app
        .rest(
            "POST",
            INFLUENCE,
            Some(&json!({"keys": ["0.0"], "unit": "bits"})),
        )
        .await;
    for query in [
        "key=0.0&unit=bits",
        "state.distance=0.1&state.held=nothing&unit=bits",
        "state.held=0&state.distance=1e-1&unit=bits&view=full",
    ] {
        let (status, got) = app.rest("GET", &format!("{INFLUENCE}?{query}"), None).await;
        assert_eq!((status, &got), (200, &posted), "{query}");
    }
}

/// The same fault in the words of each face, and its reason.
fn faults() -> Vec<(
    Value,
    proto::BatchGetInfluenceRequest,
    &'static str,
    &'static [&'static str],
)> {
    let scoped = |scope: proto::Scope| proto::BatchGetInfluenceRequest {
        scope: Some(scope),
        ..by_keys(&["0.0"])
    };
    let rule = proto::Rule {
        kind: Some("papper".into()),
        threshold: Some(-1.0),
        ..Default::default()
    };
    vec![
        (
            json!({"states": [{"distance": 0.1, "held": 0}, {"distance": 0.1, "held": 7}]}),
            by_values(&[[0.1, 0.0], [0.1, 7.0]]),
            "INVALID_INPUT",
            &["/states/1/held"],
        ),
        (
            json!({"keys": ["9.0", "0"]}),
            by_keys(&["9.0", "0"]),
            "INVALID_INPUT",
            &["/keys/0", "/keys/1"],
        ),
        (
            json!({"keys": []}),
            by_keys(&[]),
            "INVALID_INPUT",
            &["/states"],
        ),
        (
            json!({"keys": ["0.0"], "ego": "robbot", "unit": "hartleys"}),
            scoped(proto::Scope {
                ego: "robbot".into(),
                unit: "hartleys".into(),
                ..scope()
            }),
            "INVALID_INPUT",
            &["/ego", "/unit"],
        ),
        (
            json!({"keys": ["0.0"], "ego": "robot", "other": "robot"}),
            scoped(proto::Scope {
                ego: "robot".into(),
                other: "robot".into(),
                ..scope()
            }),
            "INVALID_INPUT",
            &["/other"],
        ),
        (
            json!({"keys": ["0.0"], "given": ["human"]}),
            scoped(proto::Scope {
                given: vec!["human".into()],
                ..scope()
            }),
            "INVALID_INPUT",
            &["/given/0"],
        ),
        (
            json!({"keys": ["0.0"], "rule": {"kind": "papper", "threshold": -1}}),
            scoped(proto::Scope {
                rule: Some(rule),
                ..scope()
            }),
            "INVALID_INPUT",
            &["/rule/kind", "/rule/threshold"],
        ),
        (
            json!({"keys": ["0.0"], "segments": ["trial-9"]}),
            scoped(proto::Scope {
                segments: vec!["trial-9".into()],
                ..scope()
            }),
            "INVALID_INPUT",
            &["/segments"],
        ),
        (
            json!({"keys": ["0.0"], "estimators": ["nsv"]}),
            proto::BatchGetInfluenceRequest {
                estimators: vec!["nsv".into()],
                ..by_keys(&["0.0"])
            },
            "INVALID_INPUT",
            &["/estimators/0"],
        ),
    ]
}

fn pointers(problem: &Value) -> Vec<String> {
    let errors = problem["errors"].as_array().cloned().unwrap_or_default();
    errors
        .iter()
        .filter_map(|error| error["pointer"].as_str().map(str::to_owned))
        .collect()
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
async fn the_same_fault_gets_the_same_reason() {
    let app = lane_with_play().await;
    let mut client = app.influence().await;
    for (body, request, word, fields) in faults() {
        let (status, problem) = app.rest("POST", INFLUENCE, Some(&body)).await;
        assert_eq!(
            (status, &problem["reason"]),
            (400, &json!(word)),
            "{body}: {problem}"
        );
        assert_eq!(pointers(&problem), fields, "{body}");
        let refused = client
            .batch_get_influence(request)
            .await
            .expect_err("wrong");
        assert_eq!(
            (refused.code(), reason(&refused)),
            (Code::InvalidArgument, word.into()),
            "{body}"
        );
        assert_eq!(violations(&refused), fields, "{body}");
        assert_eq!(problem["detail"], json!(refused.message()), "{body}");
    }
}

#[tokio::test]
async fn kinds_of_error_have_their_codes_on_both_faces() {
    let app = lane_with_play().await;
    let unknown = proto::BatchGetInfluenceRequest {
        scope: Some(proto::Scope {
            environment: "lame".into(),
            ..Default::default()
        }),
        ..by_keys(&["0.0"])
    };
    let refused = app
        .influence()
        .await
        .batch_get_influence(unknown)
        .await
        .expect_err("unknown");
    let (status, problem) = app
        .rest(
            "POST",
            "/v1/environments/lame/influence",
            Some(&json!({"keys": ["0.0"]})),
        )
        .await;
    assert_eq!((refused.code(), status), (Code::NotFound, 404));
    assert_eq!(problem["reason"], json!(reason(&refused)));

    let mut other = lane_json();
    other["state"][0]["continuous"]["edges"] = json!([0.5]);
    let (status, problem) = app.rest("PUT", "/v1/environments/lane", Some(&other)).await;
    assert_eq!(
        (status, &problem["reason"]),
        (409, &json!("SCHEMA_CONFLICT"))
    );
    let mut schema = crate::support::lane_schema();
    schema.state.pop();
    let request = proto::ApplyEnvironmentRequest {
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
        .expect_err("another schema");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::AlreadyExists, "SCHEMA_CONFLICT".into())
    );

    let gap = json!({"producer": "p", "sequence": 9, "transitions": []});
    let (status, problem) = app
        .rest("POST", "/v1/environments/lane/transitions", Some(&gap))
        .await;
    assert_eq!(
        (status, &problem["reason"], &problem["expected_sequence"]),
        (409, &json!("OUT_OF_ORDER"), &json!(2))
    );
}

#[tokio::test]
async fn descriptions_are_faulted_alike() {
    let app = TestApp::start().await;
    let body = json!({
        "state": [{"name": "../x", "integer": {"min": 3, "max": 1}}, {"name": "a", "continuous": {"edges": [1, 1]}},
                  {"name": "b", "unit": "turns", "circular": {"bins": 8}},
                  {"name": "c", "circular": {"bins": 8, "values": "turns"}}],
        "agents": [{"name": "a", "action": [{"name": "go", "categorical": {"labels": []}}]}]
    });
    let feature = |name: &str, kind| proto::Feature {
        name: name.into(),
        unit: String::new(),
        kind: Some(kind),
    };
    use proto::feature::Kind;
    let schema = proto::Schema {
        state: vec![
            feature("../x", Kind::Integer(proto::Integer { min: 3, max: 1 })),
            feature(
                "a",
                Kind::Continuous(proto::Continuous {
                    edges: vec![1.0, 1.0],
                }),
            ),
            proto::Feature {
                unit: "turns".into(),
                ..feature(
                    "b",
                    Kind::Circular(proto::Circular {
                        bins: 8,
                        values: String::new(),
                    }),
                )
            },
            feature(
                "c",
                Kind::Circular(proto::Circular {
                    bins: 8,
                    values: "turns".into(),
                }),
            ),
        ],
        agents: vec![proto::Agent {
            name: "a".into(),
            action: vec![feature(
                "go",
                Kind::Categorical(proto::Categorical { labels: vec![] }),
            )],
            ..proto::Agent::default()
        }],
        ..proto::Schema::default()
    };
    let (status, problem) = app.rest("PUT", "/v1/environments/x", Some(&body)).await;
    let request = proto::ApplyEnvironmentRequest {
        name: "x".into(),
        schema: Some(schema),
        rule: None,
        derived: None,
    };
    let refused = app
        .environments()
        .await
        .apply_environment(request)
        .await
        .expect_err("wrong");
    assert_eq!((status, refused.code()), (400, Code::InvalidArgument));
    assert_eq!(pointers(&problem), violations(&refused));
    assert_eq!(pointers(&problem).len(), 8, "{problem}");
}

#[tokio::test]
async fn answers_that_do_not_fit_are_refused_with_the_smaller_view() {
    let app = TestApp::start().await;
    let wide = |name: &str| json!({"name": name, "action": [{"name": "to", "integer": {"min": 0, "max": 4095}}]});
    let body = json!({"state": [{"name": "x", "circular": {"bins": 4}}], "agents": [wide("a"), wide("b")]});
    assert_eq!(
        app.rest("PUT", "/v1/environments/wide", Some(&body))
            .await
            .0,
        201
    );
    let path = "/v1/environments/wide/influence";
    let (status, problem) = app.rest("POST", path, Some(&json!({"keys": ["0"]}))).await;
    assert_eq!(
        (status, &problem["reason"]),
        (413, &json!("ANSWER_TOO_LARGE"))
    );
    assert!(
        problem["detail"]
            .as_str()
            .is_some_and(|text| text.contains("4194304") && text.contains("figures"))
    );
    let scope = proto::Scope {
        environment: "wide".into(),
        ..Default::default()
    };
    let request = proto::BatchGetInfluenceRequest {
        scope: Some(scope),
        keys: vec!["0".into()],
        ..Default::default()
    };
    let refused = app
        .influence()
        .await
        .batch_get_influence(request)
        .await
        .expect_err("too large");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::OutOfRange, "ANSWER_TOO_LARGE".into())
    );
    assert_eq!(
        app.rest(
            "POST",
            path,
            Some(&json!({"keys": ["0"], "view": "figures"}))
        )
        .await
        .0,
        200
    );
}

#[tokio::test]
async fn states_and_summary_agree() {
    let app = lane_with_play().await;
    let mut client = app.influence().await;
    for (order, first) in [
        ("visits desc", "0.0"),
        ("visits asc", "3.1"),
        ("plug_in desc", "0.0"),
        ("plug_in", "0.0"),
    ] {
        let path = format!(
            "/v1/environments/lane/states?page_size=1&order_by={}",
            order.replace(' ', "%20")
        );
        let (status, page) = app.rest("GET", &path, None).await;
        assert_eq!(
            (status, &page["states"][0]["state"]["key"]),
            (200, &json!(first)),
            "{order}: {page}"
        );
        let request = proto::ListStatesRequest {
            scope: Some(scope()),
            order_by: order.into(),
            page_size: 1,
            page_token: page["next_page_token"]
                .as_str()
                .expect("a second page")
                .into(),
            ..Default::default()
        };
        let rest = client
            .list_states(request)
            .await
            .expect("valid")
            .into_inner();
        assert_eq!((rest.states.len(), rest.next_page_token.as_str()), (1, ""));
        assert_ne!(rest.states[0].state.as_ref().expect("present").key, first);
    }
    let (_, over_rest) = app
        .rest("GET", "/v1/environments/lane/summary?unit=bits", None)
        .await;
    let request = proto::SummarizeRequest {
        scope: Some(proto::Scope {
            unit: "bits".into(),
            ..scope()
        }),
        ..Default::default()
    };
    let over_grpc = client.summarize(request).await.expect("valid").into_inner();
    assert_eq!(
        over_rest,
        serde_json::to_value(dto::Summary::from(over_grpc)).expect("JSON")
    );
    assert_eq!(
        (&over_rest["transitions"], &over_rest["states"]),
        (&json!(41), &json!(2))
    );
}

#[tokio::test]
async fn a_third_agent_held_fixed_reveals_what_it_hid() {
    let app = TestApp::start().await;
    let agent = |name: &str| json!({"name": name, "action": [{"name": "go", "integer": {"min": 0, "max": 1}}]});
    let body = json!({"state": [{"name": "x", "circular": {"bins": 4}}], "agents": [agent("a"), agent("b"), agent("c")]});
    assert_eq!(
        app.rest("PUT", "/v1/environments/xor", Some(&body)).await.0,
        201
    );
    // b is the exclusive or of a and c: alone, a says nothing about it.
    let played = [(0, 0, 0), (0, 1, 1), (1, 1, 0), (1, 0, 1)];
    let played: Vec<Value> = played
        .iter()
        .map(|(a, b, c)| json!({"state": {"x": 0}, "actions": {"a": a, "b": b, "c": c}, "count": 25}))
        .collect();
    let body = json!({"producer": "p", "sequence": 1, "transitions": played});
    assert_eq!(
        app.rest("POST", "/v1/environments/xor/transitions", Some(&body))
            .await
            .0,
        200
    );
    let plug_in = async |query: &str| {
        let (status, answer) = app
            .rest(
                "GET",
                &format!("/v1/environments/xor/influence?key=0&{query}"),
                None,
            )
            .await;
        assert_eq!(status, 200, "{answer}");
        answer["answers"][0]["mutual_information"]["plug_in"]
            .as_f64()
            .expect("a figure")
    };
    assert_eq!(plug_in("unit=bits").await, 0.0);
    assert!((plug_in("unit=bits&given=c").await - 1.0).abs() < 1e-12);
    assert!((plug_in("ego=c&other=b&given=a").await - 2_f64.ln()).abs() < 1e-12);
}

/// Every whole number that the body of a request has, with one that is right: by the schema of the
/// document, and where it stands.
const WHOLE: [(&str, &str); 14] = [
    ("Circular.bins", "8"),
    ("Integer.max", "3"),
    ("Integer.min", "0"),
    ("Outcome.lag", "2"),
    // Before the one that ends alike.
    ("RegionSearchQuestion.lag", "2"),
    ("RegionSearchQuestion.most", "3"),
    ("Question.lag", "2"),
    ("Rule.min_visits", "8"),
    ("TrainingRequest.epochs", "5"),
    ("TrainingRequest.folds", "2"),
    ("TrainingRequest.lag", "2"),
    ("TrainingRequest.members", "1"),
    ("TrainingRequest.seed", "7"),
    ("TrainingRequest.width", "4"),
];

/// Waits until the job that was told is over, whatever came of it.
async fn over(app: &TestApp, told: &str) {
    let job: Value = serde_json::from_str(told).expect("a job");
    let id = job["id"].as_str().and_then(|id| id.strip_prefix("job-"));
    let id = id.and_then(|id| id.parse().ok()).expect("a number");
    let environment = app.app.environments.find("whole").expect("made");
    let over = app.app.networks.finished(&environment, id).await;
    assert!(over.expect("known").state.is_over());
}

/// Those of a batch, which are decoded apart.
const WHOLE_OF_BATCHES: [&str; 3] = [
    "Transition.count",
    "Transition.track",
    "Transitions.sequence",
];

/// Returns the schemas that bodies of requests lead to.
fn schemas_of_bodies(document: &Value) -> BTreeSet<String> {
    let names = |value: &Value| {
        let text = value.to_string();
        let parts = text.split("\"#/components/schemas/").skip(1);
        parts
            .filter_map(|part| part.split('"').next().map(str::to_owned))
            .collect::<Vec<_>>()
    };
    let operations = document["paths"]
        .as_object()
        .expect("paths")
        .values()
        .flat_map(|path| path.as_object().expect("operations").values());
    let mut waiting: Vec<String> = operations
        .flat_map(|operation| names(&operation["requestBody"]))
        .collect();
    let mut found = BTreeSet::new();
    while let Some(name) = waiting.pop() {
        waiting.extend(
            names(&document["components"]["schemas"][&name])
                .into_iter()
                .filter(|name| !found.contains(name)),
        );
        found.insert(name);
    }
    found
}

#[tokio::test]
async fn a_whole_number_is_one_however_it_is_written() {
    let app = TestApp::start().await;
    let (_, document) = app.rest("GET", "/openapi.json", None).await;
    let mut members = BTreeSet::new();
    for name in schemas_of_bodies(&document) {
        let Some(properties) = document["components"]["schemas"][&name]["properties"].as_object()
        else {
            continue;
        };
        let is_whole = |schema: &Value| {
            schema["type"] == "integer"
                || schema["type"]
                    .as_array()
                    .is_some_and(|types| types.contains(&json!("integer")))
        };
        members.extend(
            properties
                .iter()
                .filter(|(_, schema)| is_whole(schema))
                .map(|(member, _)| format!("{name}.{member}")),
        );
    }
    let listed: BTreeSet<String> = WHOLE
        .iter()
        .map(|(member, _)| *member)
        .chain(WHOLE_OF_BATCHES)
        .map(str::to_owned)
        .collect();
    assert_eq!(members, listed, "this test tries each");

    let description = r#"{"state": [{"name": "a", "circular": {"bins": Circular.bins}}, {"name": "b", "integer": {"min": Integer.min, "max": Integer.max}}],
        "agents": [{"name": "c", "action": [{"name": "x", "integer": {"min": 0, "max": 1}}]}, {"name": "d", "action": [{"name": "x", "integer": {"min": 0, "max": 1}}]}],
        "outcomes": [{"agent": "c", "lag": Outcome.lag}],
        "rule": {"min_visits": Rule.min_visits}}"#;
    let training = r#"{"ego": "d", "other": "c", "lag": TrainingRequest.lag, "epochs": TrainingRequest.epochs, "folds": TrainingRequest.folds,
        "members": TrainingRequest.members,
        "seed": TrainingRequest.seed, "width": TrainingRequest.width}"#;
    let question = r#"{"ego": "d", "other": "c", "keys": ["0.0"], "lag": Question.lag}"#;
    let search = r#"{"ego": "d", "other": "c", "lag": RegionSearchQuestion.lag, "most": RegionSearchQuestion.most}"#;
    let written = |text: &str, odd: &str, ending: &str| {
        let fill = |text: String, (member, number): &(&str, &str)| {
            text.replace(
                member,
                &format!("{number}{}", if *member == odd { ending } else { "" }),
            )
        };
        WHOLE.iter().fold(text.to_owned(), fill)
    };
    let ask = async |method: &str, path: &str, body: String| {
        let request =
            reqwest::Client::new().request(method.parse().expect("a method"), app.url(path));
        let response = request
            .header("content-type", "application/json")
            .body(body)
            .send()
            .await
            .expect("answered");
        (
            response.status().as_u16(),
            response.text().await.expect("text"),
        )
    };
    for (member, _) in WHOLE {
        let (_, name) = member.split_once('.').expect("a member");
        let (method, path, body) = match member.split_once('.') {
            _ if description.contains(member) => ("PUT", "/v1/environments/whole", description),
            Some(("RegionSearchQuestion", _)) => ("POST", "/v1/environments/whole/regions", search),
            Some(("Question", _)) => ("POST", "/v1/environments/whole/influence", question),
            _ => ("POST", "/v1/environments/whole/models", training),
        };
        for ending in [".0", "e0", ".000"] {
            let (status, told) = ask(method, path, written(body, member, ending)).await;
            // An environment that nobody played in has nothing to learn from, which a training says
            // for itself.
            assert!(
                [200, 201, 202].contains(&status),
                "{member}{ending}: {told}"
            );
            // Only so many may wait.
            if path.ends_with("/models") {
                over(&app, &told).await;
            }
        }
        let (status, told) = ask(method, path, written(body, member, ".5")).await;
        let problem: Value = serde_json::from_str(&told).expect("a problem");
        assert_eq!(status, 400, "{member}: {told}");
        let pointer = problem["errors"][0]["pointer"].as_str().expect("a pointer");
        assert!(
            pointer.ends_with(&format!("/{name}")) && told.contains("expected a whole number"),
            "{told}"
        );
    }

    let batch = |sequence: &str, count: &str, track: &str| {
        format!(
            r#"{{"producer": "p", "sequence": {sequence}, "transitions": [{{"state": {{"a": 0, "b": 1}}, "actions": {{"c": 0, "d": 1}}, "entry": true, "count": {count}, "track": {track}}}]}}"#
        )
    };
    let path = "/v1/environments/whole/transitions";
    let (status, told) = ask("POST", path, batch("1.0", "2.0", "7.0")).await;
    assert_eq!(
        (status, told.contains(r#""accepted":1"#)),
        (200, true),
        "{told}"
    );
    let (_, summary) = app
        .rest("GET", "/v1/environments/whole/summary", None)
        .await;
    assert_eq!(summary["transitions"], 2);
    let (status, told) = ask("POST", path, batch("2.5", "1", "7")).await;
    assert!(
        status == 400
            && told.contains("/sequence")
            && told.contains("2.5`, expected a whole number"),
        "{told}"
    );
    for (at, count, track, field) in [("2", "1.5", "7", "/count"), ("3", "1", "1.5", "/track")] {
        let (status, told) = ask("POST", path, batch(at, count, track)).await;
        assert!(
            status == 200 && told.contains(field) && told.contains("1.5, expected a whole number"),
            "{told}"
        );
    }
}
