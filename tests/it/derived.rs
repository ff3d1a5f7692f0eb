//! Derived features on every face: set when an environment is made, changed later, refused by
//! pointer, kept over a restart, and no part of what is counted.

use nudge::api::proto::{self, derived_feature::Kind};
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::TestApp;

const KITCHEN: &str = "/v1/environments/kitchen";

/// Two players on a grid, and what they hold.
fn kitchen() -> Value {
    let held = json!({"labels": ["nothing", "onion"]});
    let player = |name: &str| {
        [
            json!({"name": format!("{name}.x"), "integer": {"min": 1, "max": 3}}),
            json!({"name": format!("{name}.y"), "integer": {"min": 0, "max": 2}}),
            json!({"name": format!("{name}.held"), "categorical": held}),
        ]
    };
    let go = json!([{"name": "go", "integer": {"min": 0, "max": 1}}]);
    let state = [player("a"), player("b")].concat();
    json!({
        "state": state,
        "agents": [{"name": "a", "action": go}, {"name": "b", "action": go}],
        "lags": [1],
    })
}

fn derived() -> Value {
    json!([
        {"name": "dx", "difference": ["b.x", "a.x"]},
        {"name": "distance", "manhattan": [["a.x", "b.x"], ["a.y", "b.y"]]},
        {"name": "same", "equal": ["a.held", "b.held"]},
    ])
}

fn with(derived: Value) -> Value {
    let mut description = kitchen();
    description["derived"] = derived;
    description
}

/// The same as proto.
fn messages() -> proto::DerivedFeatures {
    let pair = |first: &str, second: &str| proto::FeaturePair {
        first: first.into(),
        second: second.into(),
    };
    let pairs = vec![pair("a.x", "b.x"), pair("a.y", "b.y")];
    let kinds = [
        ("dx", Kind::Difference(pair("b.x", "a.x"))),
        ("distance", Kind::Manhattan(proto::Manhattan { pairs })),
        ("same", Kind::Equal(pair("a.held", "b.held"))),
    ];
    let feature = |(name, kind): (&str, Kind)| proto::DerivedFeature {
        name: name.into(),
        kind: Some(kind),
    };
    proto::DerivedFeatures {
        features: kinds.map(feature).to_vec(),
    }
}

async fn put(app: &TestApp, body: &Value) -> (u16, Value) {
    app.rest("PUT", KITCHEN, Some(body)).await
}

async fn patch(app: &TestApp, body: Value) -> (u16, Value) {
    app.rest("PATCH", KITCHEN, Some(&body)).await
}

async fn update(
    app: &TestApp,
    rule: Option<proto::Rule>,
    derived: Option<proto::DerivedFeatures>,
) -> Result<proto::Environment, tonic::Status> {
    let request = proto::UpdateEnvironmentRequest {
        name: "kitchen".into(),
        rule,
        derived,
    };
    let updated = app.environments().await.update_environment(request).await?;
    Ok(updated.into_inner().environment.expect("present"))
}

#[tokio::test]
async fn what_is_given_is_set_and_what_is_absent_is_kept() {
    let app = TestApp::start().await;
    let (status, plain) = put(&app, &kitchen()).await;
    assert_eq!((status, plain.get("derived")), (201, None));

    let (status, told) = put(&app, &with(derived())).await;
    assert_eq!((status, &told["derived"]), (200, &derived()));
    assert_eq!(told["schema_hash"], plain["schema_hash"]);
    assert_eq!(put(&app, &kitchen()).await, (200, told.clone()));

    let (status, ruled) = patch(&app, json!({"rule": {"min_visits": 3}})).await;
    assert_eq!((status, &ruled["derived"]), (200, &derived()));
    let one = json!([{"name": "dy", "difference": ["b.y", "a.y"]}]);
    let (status, other) = patch(&app, json!({"derived": one})).await;
    assert_eq!((status, &other["derived"]), (200, &one));
    assert_eq!(other["rule"], ruled["rule"]);
    assert_eq!(patch(&app, json!({})).await, (200, other.clone()));

    let app = app.restart().await;
    assert_eq!(app.get(KITCHEN).await, other);
    let (status, none) = patch(&app, json!({"derived": [], "rule": {"min_visits": 8}})).await;
    assert_eq!((status, none), (200, plain));
    app.stop().await;
}

#[tokio::test]
async fn both_faces_set_and_tell_the_same() {
    let app = TestApp::start().await;
    let (_, told) = put(&app, &with(derived())).await;
    let request = proto::GetEnvironmentRequest {
        name: "kitchen".into(),
    };
    let environment = app.environments().await.get_environment(request).await;
    let environment = environment.expect("there").into_inner().environment;
    let environment = environment.expect("present");
    assert_eq!(environment.derived, messages().features);

    let nothing = proto::DerivedFeatures::default();
    let none = update(&app, None, Some(nothing)).await.expect("valid");
    assert_eq!(none.derived, []);
    let rule = proto::Rule {
        min_visits: Some(3),
        ..proto::Rule::default()
    };
    let both = update(&app, Some(rule), Some(messages()))
        .await
        .expect("valid");
    assert_eq!(both.derived, messages().features);
    let kept = update(&app, None, None).await.expect("valid");
    assert_eq!(kept, both);

    let request = proto::ApplyEnvironmentRequest {
        name: "other".into(),
        schema: environment.schema,
        rule: None,
        derived: Some(messages()),
    };
    let applied = app.environments().await.apply_environment(request).await;
    let applied = applied.expect("valid").into_inner();
    assert!(applied.created);
    let other = app.get("/v1/environments/other").await;
    assert_eq!(other["derived"], told["derived"]);
    app.stop().await;
}

#[tokio::test]
async fn every_fault_is_told_by_its_pointer_on_both_faces() {
    let app = TestApp::start().await;
    put(&app, &with(derived())).await;
    let wrong = json!([
        {"name": "a.x", "difference": ["b.x", "a.z"]},
        {"name": "b@1", "equal": ["a.x", "a.held"]},
        {"name": "far", "manhattan": [["a.held", "b.held"]]},
        {"name": "none"},
    ]);
    let pointers = [
        "/derived/0/name",
        "/derived/0/difference/1",
        "/derived/1/name",
        "/derived/1/equal",
        "/derived/2/manhattan/0",
        "/derived/3",
    ];
    let told = |problem: &Value| -> Vec<String> {
        let errors = problem["errors"].as_array().expect("a list").iter();
        let pointer = |error: &Value| error["pointer"].as_str().expect("text").to_owned();
        errors.map(pointer).collect()
    };
    let (status, made) = put(&app, &with(wrong.clone())).await;
    let (patched, changed) =
        patch(&app, json!({"derived": wrong, "rule": {"confidence": 2}})).await;
    assert_eq!((status, patched), (400, 400));
    let mut expected = pointers.to_vec();
    expected.sort_unstable();
    let mut found = told(&made);
    found.sort_unstable();
    found.dedup();
    assert_eq!(found, expected, "{made}");
    assert!(told(&changed).contains(&"/rule/confidence".to_owned()));

    // Two names are all that the wire has room for; with none, it is no kind.
    let features = vec![proto::DerivedFeature {
        name: "dx".into(),
        kind: None,
    }];
    let refused = update(&app, None, Some(proto::DerivedFeatures { features })).await;
    let refused = refused.expect_err("no kind");
    assert_eq!(refused.code(), tonic::Code::InvalidArgument);
    assert!(
        refused.message().contains("/derived/0: got 0 kinds"),
        "{refused}"
    );
    let three = json!([{"name": "dx", "difference": ["a.x", "b.x", "a.y"]}]);
    let (status, problem) = patch(&app, json!({"derived": three})).await;
    assert_eq!(
        (status, told(&problem)),
        (400, vec!["/derived/0/difference".into()])
    );

    assert_eq!(
        app.get(KITCHEN).await["derived"],
        derived(),
        "nothing changed"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn files_set_them_and_people_see_them() {
    let app = TestApp::start().await;
    let run = async |arguments: &[&str]| {
        exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
    };
    let file = tempfile::NamedTempFile::new().expect("a file");
    let path = file.path().to_str().expect("text");
    let write = |description: &Value| {
        std::fs::write(path, description.to_string()).expect("written");
    };

    write(&with(json!([{"name": "dx", "difference": ["b.x", "c.x"]}])));
    let apply = ["env", "apply", path, "--name", "kitchen"];
    let (code, _, stderr) = run(&apply).await;
    assert_eq!(code, 2);
    assert!(
        stderr.contains("/derived/0/difference/1: unknown feature \"c.x\" of the state"),
        "{stderr}"
    );
    write(&with(derived()));
    let (code, _, stderr) = run(&apply).await;
    assert_eq!((code, stderr.as_str()), (0, ""));

    let (_, shown, _) = run(&["env", "show", "kitchen"]).await;
    for line in [
        "derived dx is b.x - a.x",
        "derived distance is |a.x - b.x| + |a.y - b.y|",
        "derived same is a.held = b.held",
    ] {
        assert!(shown.lines().any(|shown| shown == line), "{line}: {shown}");
    }
    let row = |name: &str| -> Vec<String> {
        let mut rows = shown.lines().map(|line| line.split_whitespace());
        let row = rows.find(|row| {
            row.clone().take(2).eq(["derived", name]) && row.clone().nth(2) != Some("is")
        });
        row.expect("a row").skip(2).map(String::from).collect()
    };
    assert_eq!(row("dx").join(" "), "5 a whole number from -2 to 2");
    assert_eq!(row("distance").join(" "), "5 a whole number from 0 to 4");
    assert!(row("same").join(" ").starts_with("2 one of false, true"));

    let (_, json, _) = run(&["env", "show", "kitchen", "--json"]).await;
    let told: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(told["derived"], derived());
    app.stop().await;
}
