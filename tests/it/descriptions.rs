//! What a service tells of an environment is a description: it comes back in, on every face and
//! into another service.

use std::io::{Seek, Write};

use nudge::api::proto;
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::TestApp;

const WORLD: &str = "/v1/environments/world";

/// A world with every kind of feature, floats that are awkward to write, and letters of many
/// scripts.
fn world() -> Value {
    let edges = json!([
        -3.402_823_4e38,
        -0.1,
        0.0,
        1e-45,
        1.175_494_4e-38,
        0.1,
        0.7,
        16_777_216,
        3.402_823_4e38
    ]);
    let labels = json!([
        "1", "2", "01", " a ", "näher", "左", "🤖", "\"\\", "null", "true"
    ]);
    json!({
        "state": [
            {"name": "x", "unit": "m/s²", "continuous": {"edges": edges}},
            {"name": "none", "continuous": {"edges": []}},
            {"name": "rad", "unit": "rad", "circular": {"bins": 8}},
            {"name": "plain", "circular": {"bins": 3}},
            {"name": "deg", "unit": "deg", "circular": {"bins": 8}},
            {"name": "sign", "unit": "°", "circular": {"bins": 8}},
            {"name": "old", "unit": "deg", "circular": {"bins": 8, "values": "radians"}},
            {"name": "turns", "unit": "turns", "circular": {"bins": 8, "values": "radians"}},
            {"name": "lane", "integer": {"min": -16_777_216, "max": -16_777_000}},
            {"name": "goal", "integer": {"min": -16_777_000, "max": -8_777_216}},
            {"name": "held", "categorical": {"labels": labels}}
        ],
        "agents": [
            {"name": "robot", "action": [{"name": "turn", "unit": "degrees", "circular": {"bins": 2}}, {"name": "go", "integer": {"min": 0, "max": 2}}]},
            {"name": "human", "action": [{"name": "move", "categorical": {"labels": ["1", "2", "3"]}}]},
            {"name": "cat", "action": [{"name": "sleep", "categorical": {"labels": ["always"]}}]}
        ],
        "derived": [
            {"name": "turned", "difference": ["deg", "sign"]},
            {"name": "same", "equal": ["rad", "old"]},
            {"name": "apart", "manhattan": [["lane", "goal"], ["goal", "lane"]]}
        ]
    })
}

fn rules() -> Vec<Value> {
    vec![
        json!({}),
        json!({"kind": "paper", "threshold": 0.300_000_000_000_000_04, "estimators": ["nsb", "uniform_policy"]}),
        json!({"share": 0.1, "unit": "bits", "confidence": 0.999_999_999_999_999_9}),
        json!({"kind": "evidence", "threshold": 1.584_96, "unit": "bits", "min_visits": 9_007_199_254_740_993_u64}),
        json!({"threshold": 0, "min_visits": 0}),
    ]
}

fn described(rule: &Value) -> Value {
    let mut body = world();
    body["rule"] = rule.clone();
    body
}

/// Runs a command with text on its standard input.
async fn piped(app: &TestApp, arguments: &[&str], text: &str) -> (i32, String, String) {
    let mut file = tempfile::tempfile().expect("a file");
    file.write_all(text.as_bytes()).expect("written");
    file.rewind().expect("at its start");
    let mut command = nudge(&app.address.to_string(), arguments);
    command.stdin(file);
    exit_and_texts(&output(command).await)
}

#[tokio::test]
async fn what_is_told_comes_back_in() {
    let (app, other) = (TestApp::start().await, TestApp::start().await);
    for (i, rule) in rules().iter().enumerate() {
        let (status, made) = app.rest("PUT", WORLD, Some(&described(rule))).await;
        assert_eq!(status, if i == 0 { 201 } else { 200 }, "{made}");
        let (_, got) = app.rest("GET", WORLD, None).await;
        assert_eq!(got, made);
        assert_eq!(
            app.rest("PUT", WORLD, Some(&got)).await,
            (200, got.clone()),
            "GET, then PUT"
        );
        let (_, list) = app.rest("GET", "/v1/environments", None).await;
        assert_eq!(
            app.rest("PUT", WORLD, Some(&list["environments"][0])).await,
            (200, got.clone()),
            "list, then PUT"
        );
        let request = proto::GetEnvironmentRequest {
            name: "world".into(),
        };
        let environment = app
            .environments()
            .await
            .get_environment(request)
            .await
            .expect("there")
            .into_inner()
            .environment;
        let proto::Environment {
            name,
            schema,
            rule,
            derived,
            ..
        } = environment.clone().expect("present");
        let request = proto::ApplyEnvironmentRequest {
            name,
            schema,
            rule,
            derived: Some(proto::DerivedFeatures { features: derived }),
        };
        let applied = app
            .environments()
            .await
            .apply_environment(request)
            .await
            .expect("the same")
            .into_inner();
        assert_eq!(
            (applied.created, &applied.environment),
            (false, &environment),
            "gRPC"
        );
        let (_, shown, _) = piped(&app, &["env", "show", "world", "--json"], "").await;
        let (code, stdout, stderr) = piped(&app, &["env", "apply", "-", "--json"], &shown).await;
        assert_eq!((code, stderr.as_str()), (0, ""));
        assert_eq!(
            serde_json::from_str::<Value>(&stdout).expect("JSON"),
            got,
            "the command"
        );
        // Another service knows nothing of it yet.
        let (code, stdout, stderr) = piped(
            &other,
            &["env", "apply", "-", "--json", "--name", &format!("copy{i}")],
            &shown,
        )
        .await;
        assert_eq!((code, stderr.as_str()), (0, ""));
        let copy: Value = serde_json::from_str(&stdout).expect("JSON");
        for field in ["schema_hash", "state", "agents", "rule"] {
            assert_eq!(copy[field], got[field], "{field}");
        }
    }
}

#[tokio::test]
async fn a_file_may_name_what_it_describes() {
    let app = TestApp::start().await;
    assert_eq!(app.rest("PUT", WORLD, Some(&world())).await.0, 201);
    let (_, shown, _) = piped(&app, &["env", "show", "world", "--json"], "").await;
    let file = tempfile::Builder::new()
        .prefix("backup")
        .suffix(".json")
        .tempfile()
        .expect("a file");
    std::fs::write(file.path(), &shown).expect("written");
    let (code, stdout, _) = piped(
        &app,
        &["env", "apply", file.path().to_str().expect("text")],
        "",
    )
    .await;
    assert_eq!(code, 0);
    assert!(
        stdout.starts_with("environment `world` exists with this description\n"),
        "{stdout}"
    );
    let (code, _, stderr) = piped(&app, &["env", "apply", "-"], &world().to_string()).await;
    assert_eq!(
        (code, stderr.trim_end()),
        (
            2,
            "error: a description from standard input has no name of its own: add --name NAME"
        )
    );
}

#[tokio::test]
async fn what_contradicts_itself_and_what_nobody_knows_is_refused() {
    let app = TestApp::start().await;
    assert_eq!(app.rest("PUT", WORLD, Some(&world())).await.0, 201);
    let (_, got) = app.rest("GET", WORLD, None).await;
    let changed = |at: &str, value: Value| {
        let mut body = got.clone();
        let (parent, name) = at.rsplit_once('/').expect("a pointer");
        body.pointer_mut(parent).expect("there")[name] = value;
        body
    };
    for (at, value, pointer) in [
        ("/name", json!("moon"), "/name"),
        ("/schema_hash", json!("f".repeat(64)), "/schema_hash"),
        ("/schema_hash", json!("abc"), "/schema_hash"),
        ("/state/0/unit", json!("km/h"), "/schema_hash"),
        ("/uuid", json!("x"), "/uuid"),
        ("/rule/treshold", json!(1), "/rule/treshold"),
        (
            "/state/4/circular/value",
            json!("degrees"),
            "/state/4/circular/value",
        ),
        (
            "/state/4/circular/values",
            json!("turns"),
            "/state/4/circular/values",
        ),
        ("/state/4/unit", json!("rad"), "/state/4/unit"),
    ] {
        let (status, problem) = app.rest("PUT", WORLD, Some(&changed(at, value))).await;
        assert_eq!(
            (status, &problem["errors"][0]["pointer"]),
            (400, &json!(pointer)),
            "{at}: {problem}"
        );
    }
    // Another uid is another service's, and a copy has another name.
    let mut copy = changed("/uid", json!("somebody else's"));
    assert_eq!(
        app.rest("PUT", WORLD, Some(&copy)).await,
        (200, got.clone())
    );
    copy.as_object_mut().expect("an object").remove("name");
    assert_eq!(
        app.rest("PUT", "/v1/environments/moon", Some(&copy))
            .await
            .0,
        201
    );
}

/// An environment that was made before units of angles were read: it is stored as it would be now
/// if it said "radians".
async fn with_old_angles() -> (TestApp, Value) {
    let app = TestApp::start().await;
    let body = |values: Option<&str>| {
        let circular = |unit: &str| {
            let mut feature = json!({"name": unit, "unit": unit, "circular": {"bins": 8}});
            if let Some(values) = values {
                feature["circular"]["values"] = json!(values);
            }
            feature
        };
        let agent = |name: &str| json!({"name": name, "action": [{"name": "go", "integer": {"min": 0, "max": 1}}]});
        json!({"state": [circular("deg"), circular("turns")], "agents": [agent("a"), agent("b")]})
    };
    assert_eq!(
        app.rest("PUT", WORLD, Some(&body(Some("radians")))).await.0,
        201
    );
    (app.restart().await, body(None))
}

#[tokio::test]
async fn angles_that_were_radians_stay_radians_and_say_so() {
    let (app, original) = with_old_angles().await;
    let (_, got) = app.rest("GET", WORLD, None).await;
    assert_eq!(
        got["state"][0],
        json!({"name": "deg", "unit": "deg", "circular": {"bins": 8, "values": "radians"}})
    );
    assert_eq!(app.rest("PUT", WORLD, Some(&got)).await, (200, got.clone()));
    assert_eq!(
        app.rest("PUT", WORLD, Some(&original)).await,
        (200, got.clone()),
        "as it was described then"
    );
    let (_, answer) = app
        .rest(
            "GET",
            &format!("{WORLD}/influence?state.deg=1.5707964&state.turns=0"),
            None,
        )
        .await;
    assert_eq!(
        answer["answers"][0]["state"]["bins"]["deg"],
        json!({"bin": 2, "label": "1.571"})
    );
    let (_, shown, _) = piped(&app, &["env", "show", "world"], "").await;
    for (feature, unit) in [("deg", "deg"), ("turns", "turns")] {
        assert!(
            shown.contains(&format!(
                "note    {feature}: values are radians although the unit is {unit}, as in"
            )),
            "{shown}"
        );
    }
    let (code, applied, stderr) = piped(
        &app,
        &["env", "apply", "-", "--name", "world"],
        &original.to_string(),
    )
    .await;
    assert_eq!((code, stderr.as_str()), (0, ""));
    assert!(
        applied.contains("deg: values are radians although the unit is deg"),
        "{applied}"
    );
    // Under another name it is new, and what was unreadable then is refused now.
    let (status, problem) = app
        .rest("PUT", "/v1/environments/new", Some(&original))
        .await;
    assert_eq!(
        (status, &problem["errors"][0]["pointer"]),
        (400, &json!("/state/1/unit")),
        "{problem}"
    );
}

#[tokio::test]
async fn angles_in_degrees_are_read_in_degrees() {
    let app = TestApp::start().await;
    assert_eq!(app.rest("PUT", WORLD, Some(&world())).await.0, 201);
    let (app, rest) = (
        app.restart().await,
        "state.x=0&state.none=0&state.rad=0&state.plain=0&state.old=0&state.turns=0",
    );
    let rest =
        format!("{rest}&state.lane=-16777216&state.goal=-16777000&state.held=1&state.sign=-45");
    for (degrees, bin, label) in [
        ("90", 2, "90"),
        ("-180", 4, "180"),
        ("360", 0, "0"),
        ("22.5", 1, "45"),
        ("-22.500002", 7, "-45"),
    ] {
        let (_, answer) = app
            .rest(
                "GET",
                &format!("{WORLD}/influence?state.deg={degrees}&{rest}"),
                None,
            )
            .await;
        let bins = &answer["answers"][0]["state"]["bins"];
        assert_eq!(
            bins["deg"],
            json!({"bin": bin, "label": label}),
            "{degrees}"
        );
        assert_eq!(bins["sign"], json!({"bin": 7, "label": "-45"}));
    }
}
