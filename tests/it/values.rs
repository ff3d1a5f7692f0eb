//! One table of values, written as JSON and as text: every face reads them alike, in states and in
//! actions.

use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::TestApp;

/// The kinds of feature that values are read for, by the name of their environment.
fn kinds() -> [(&'static str, Value); 8] {
    let labels = |labels: &[&str]| json!({"categorical": {"labels": labels}});
    let accounts = ["76561198000000001", "76561198000000003"];
    [
        ("dice", labels(&["1", "2", "3"])),
        (
            "words",
            labels(&["north", "South", "south", "true", "null", " a "]),
        ),
        (
            "odd",
            labels(&["none", "1.0", "007", "7", "0.1", accounts[0], accounts[1]]),
        ),
        (
            "huge",
            labels(&[
                "-9007199254740993",
                "1e17",
                "1e400",
                "1e300",
                "99999999999999999999",
                "-0",
                "2.50",
            ]),
        ),
        ("only", labels(&["only"])),
        ("lane", json!({"integer": {"min": -2, "max": 3}})),
        ("distance", json!({"continuous": {"edges": [0.5, 0.7, 1]}})),
        (
            "turn",
            json!({"circular": {"bins": 8, "values": "degrees"}}),
        ),
    ]
}

/// A value of the feature of an environment: as JSON, as text where a face knows no types, and the
/// bin it has.
type Row = (
    &'static str,
    &'static str,
    Option<&'static str>,
    Option<u32>,
);

const VALUES: &[Row] = &[
    // A number is the label that reads as it, never an index beside such labels.
    ("dice", "1", Some("1"), Some(0)),
    ("dice", "1.0", Some("1.0"), Some(0)),
    ("dice", "1e0", Some("1e0"), Some(0)),
    ("dice", "3", Some("3"), Some(2)),
    ("dice", "0", Some("0"), None),
    ("dice", "4", Some("4"), None),
    ("dice", "1.5", Some("1.5"), None),
    ("dice", "-1", Some("-1"), None),
    ("dice", "1e39", Some("1e39"), None),
    ("dice", "1e400", Some("1e400"), None),
    // Text is a label by its very characters, or else as the number that it is.
    ("dice", r#""1""#, Some("1"), Some(0)),
    ("dice", r#""1.0""#, Some("1.0"), Some(0)),
    ("dice", r#""1e0""#, Some("1e0"), Some(0)),
    ("dice", r#""2.5""#, Some("2.5"), None),
    ("dice", r#""+1""#, Some("+1"), None),
    ("dice", r#""01""#, Some("01"), None),
    ("dice", r#"" 1""#, Some(" 1"), None),
    ("dice", r#""""#, Some(""), None),
    ("dice", "true", Some("true"), None),
    ("dice", "null", Some("null"), None),
    ("dice", "[1]", None, None),
    // Where no label reads as a number, a number is an index, as text too.
    ("words", "0", Some("0"), Some(0)),
    ("words", "-0.0", Some("-0.0"), Some(0)),
    ("words", "5", Some("5"), Some(5)),
    ("words", "6", Some("6"), None),
    ("words", "0.5", Some("0.5"), None),
    ("words", r#""1""#, Some("1"), Some(1)),
    ("words", r#""1e0""#, Some("1e0"), Some(1)),
    ("words", r#""South""#, Some("South"), Some(1)),
    ("words", r#""south""#, Some("south"), Some(2)),
    ("words", r#""SOUTH""#, Some("SOUTH"), None),
    ("words", "true", Some("true"), Some(3)),
    ("words", r#""true""#, Some("true"), Some(3)),
    ("words", "false", Some("false"), None),
    ("words", r#""null""#, Some("null"), Some(4)),
    ("words", "null", None, None),
    ("words", r#"" a ""#, Some(" a "), Some(5)),
    ("words", r#""a""#, Some("a"), None),
    ("words", r#""nan""#, Some("nan"), None),
    ("words", "{}", None, None),
    // Of labels that read alike the shortest; numbers that a double would round only as they are
    // written.
    ("odd", "1", Some("1"), Some(1)),
    ("odd", "7", Some("7"), Some(3)),
    ("odd", r#""007""#, Some("007"), Some(2)),
    ("odd", "0.1", Some("0.1"), Some(4)),
    ("odd", "0", Some("0"), None),
    ("odd", r#""none""#, Some("none"), Some(0)),
    (
        "odd",
        "76561198000000001",
        Some("76561198000000001"),
        Some(5),
    ),
    (
        "odd",
        "76561198000000003",
        Some("76561198000000003"),
        Some(6),
    ),
    ("odd", "76561198000000002", Some("76561198000000002"), None),
    (
        "huge",
        "-9007199254740993",
        Some("-9007199254740993"),
        Some(0),
    ),
    ("huge", "-9007199254740992", Some("-9007199254740992"), None),
    ("huge", "1e17", Some("1e17"), Some(1)),
    (
        "huge",
        "100000000000000000",
        Some("100000000000000000"),
        Some(1),
    ),
    // No JSON number is as large as that, but the label can be named.
    ("huge", "1e400", None, None),
    ("huge", r#""1e400""#, Some("1e400"), Some(2)),
    ("huge", "1e300", Some("1e300"), Some(3)),
    ("huge", r#""10e299""#, Some("10e299"), Some(3)),
    ("huge", "1e200", Some("1e200"), None),
    (
        "huge",
        "99999999999999999999",
        Some("99999999999999999999"),
        Some(4),
    ),
    ("huge", "0", Some("0"), Some(5)),
    ("huge", "2.5", Some("2.5"), Some(6)),
    ("huge", r#""2.50""#, Some("2.50"), Some(6)),
    ("only", "0", Some("0"), Some(0)),
    ("only", r#""only""#, Some("only"), Some(0)),
    ("only", "1", Some("1"), None),
    // Other kinds take numbers, as text too.
    ("lane", "3", Some("3"), Some(5)),
    ("lane", "3.0", Some("3.0"), Some(5)),
    ("lane", r#""3""#, Some("3"), Some(5)),
    ("lane", "-2", Some("-2"), Some(0)),
    ("lane", "4", Some("4"), None),
    ("lane", "2.5", Some("2.5"), None),
    ("lane", "-1e400", Some("-1e400"), None),
    ("lane", r#""x""#, Some("x"), None),
    ("lane", "true", Some("true"), None),
    ("lane", "null", Some("null"), None),
    ("distance", "0.7", Some("0.7"), Some(2)),
    ("distance", r#""0.7""#, Some("0.7"), Some(2)),
    ("distance", "1e0", Some("1e0"), Some(3)),
    ("distance", "-1e38", Some("-1e38"), Some(0)),
    ("distance", "1e300", Some("1e300"), None),
    ("distance", "1e400", Some("1e400"), None),
    ("distance", r#""nan""#, Some("nan"), None),
    ("distance", r#""inf""#, Some("inf"), None),
    ("turn", "-180", Some("-180"), Some(4)),
    ("turn", "180", Some("180"), Some(4)),
    ("turn", "720", Some("720"), Some(0)),
    ("turn", "1e30", Some("1e30"), Some(3)),
    ("turn", "1e400", Some("1e400"), None),
    ("turn", r#""90""#, Some("90"), Some(2)),
];

/// A service with an environment of each kind: the state has it, and so has an action of either
/// agent.
async fn service() -> TestApp {
    let app = TestApp::start().await;
    for (name, kind) in kinds() {
        let feature = |name: &str| {
            let mut feature = kind.clone();
            feature["name"] = json!(name);
            feature
        };
        let agent = |name: &str| json!({"name": name, "action": [feature("do")]});
        let body = json!({"state": [feature("x")], "agents": [agent("a"), agent("b")]});
        let (status, made) = app
            .rest("PUT", &format!("/v1/environments/{name}"), Some(&body))
            .await;
        assert_eq!(status, 201, "{made}");
    }
    app
}

/// Returns the bin that a question's answer names, or the place of its only fault.
fn asked((status, body): (u16, Value)) -> Result<String, String> {
    match status {
        200 => Ok(body["answers"][0]["state"]["key"]
            .as_str()
            .expect("a key")
            .into()),
        400 => {
            let errors = body["errors"].as_array().expect("faults");
            assert_eq!(errors.len(), 1, "{body}");
            assert!(
                errors[0]["detail"]
                    .as_str()
                    .expect("text")
                    .contains("expected "),
                "{body}"
            );
            Err(errors[0]["pointer"].as_str().expect("a pointer").into())
        }
        other => panic!("{other}: {body}"),
    }
}

/// Sends a text as it is: there are numbers that no program's JSON holds.
async fn post(app: &TestApp, path: &str, media: &str, body: String) -> (u16, Value) {
    let request = reqwest::Client::new()
        .post(app.url(path))
        .header("content-type", media)
        .body(body);
    let response = request.send().await.expect("answered");
    (
        response.status().as_u16(),
        response.json().await.expect("JSON"),
    )
}

fn encoded(text: &str) -> String {
    text.bytes().map(|byte| format!("%{byte:02x}")).collect()
}

#[tokio::test]
async fn every_question_reads_a_value_alike() {
    let app = service().await;
    for (environment, written, text, bin) in VALUES {
        let expected = bin
            .map(|bin| bin.to_string())
            .ok_or("/states/0/x".to_owned());
        let path = format!("/v1/environments/{environment}/influence");
        let posted = post(
            &app,
            &path,
            "application/json",
            format!(r#"{{"states": [{{"x": {written}}}]}}"#),
        )
        .await;
        assert_eq!(asked(posted), expected, "{environment} {written}");
        let Some(text) = text else { continue };
        let got = app
            .rest("GET", &format!("{path}?state.x={}", encoded(text)), None)
            .await;
        assert_eq!(asked(got), expected, "{environment} {text:?}");
        let assigned = format!("x={text}");
        let query = nudge(
            &app.address.to_string(),
            &["query", environment, "--json", "--state", &assigned],
        );
        let (code, stdout, stderr) = exit_and_texts(&output(query).await);
        match bin {
            Some(bin) => {
                let answer: Value = serde_json::from_str(&stdout).expect("JSON");
                assert_eq!(
                    (code, &answer["answers"][0]["state"]["key"]),
                    (0, &json!(bin.to_string())),
                    "{text:?} {stderr}"
                );
            }
            None => assert!(
                code != 0 && stderr.contains("/states/0/x") && stderr.contains("expected "),
                "{text:?}: {stderr}"
            ),
        }
    }
}

#[tokio::test]
async fn every_transition_reads_a_value_alike() {
    let app = service().await;
    for (sequence, (environment, written, _, bin)) in (1..).zip(VALUES) {
        let line = format!(
            r#"{{"state": {{"x": {written}}}, "actions": {{"a": {written}, "b": {{"do": {written}}}}}}}"#
        );
        let path = format!("/v1/environments/{environment}/transitions");
        let body =
            format!(r#"{{"producer": "json{sequence}", "sequence": 1, "transitions": [{line}]}}"#);
        let lines = format!("{path}?producer=lines{sequence}&sequence=1");
        for (path, media, body) in [
            (&path, "application/json", body),
            (&lines, "application/x-ndjson", line),
        ] {
            let (_, receipt) = post(&app, path, media, body).await;
            assert_eq!(
                receipt["accepted"],
                json!(u32::from(bin.is_some())),
                "{environment} {written} {receipt}"
            );
            if bin.is_none() {
                let rejected = &receipt["rejected"][0];
                assert_eq!(
                    rejected["field"],
                    json!("/state/x"),
                    "{environment} {written}"
                );
                for field in ["expected ", "/actions/a", "/actions/b/do: got "] {
                    assert!(
                        rejected["reason"].as_str().expect("text").contains(field),
                        "{environment} {written}: {rejected}"
                    );
                }
            }
        }
        let Some(bin) = bin else { continue };
        let (_, state) = app
            .rest(
                "GET",
                &format!("/v1/environments/{environment}/states/{bin}"),
                None,
            )
            .await;
        let cell = json!([bin, bin]);
        assert_eq!(
            state["cells"][0]["actions"], cell,
            "{environment} {written}: {state}"
        );
        assert_eq!(
            state["cells"].as_array().map(Vec::len),
            Some(1),
            "{environment} {written}: {state}"
        );
    }
}

#[tokio::test]
async fn labels_that_are_one_number_are_refused_in_what_is_made_now() {
    let app = TestApp::start().await;
    let labels = |labels: &[&str]| json!([{"name": "do", "categorical": {"labels": labels}}]);
    let agent = |name: &str, action: Value| json!({"name": name, "action": action});
    let plain = labels(&["1", "01", "2"]);
    let body = |x: &Value, b: &Value| json!({"state": x, "agents": [agent("a", plain.clone()), agent("b", b.clone())]});
    for (body, pointer) in [
        (
            body(&labels(&["1", "2", "1.0"]), &plain),
            "/state/0/categorical/labels/2",
        ),
        (
            body(&plain, &labels(&["0.5", "5e-1"])),
            "/agents/1/action/0/categorical/labels/1",
        ),
    ] {
        let (status, problem) = app.rest("PUT", "/v1/environments/alike", Some(&body)).await;
        assert_eq!(
            (status, &problem["errors"][0]["pointer"]),
            (400, &json!(pointer)),
            "{problem}"
        );
        assert!(
            problem["errors"][0]["detail"]
                .as_str()
                .is_some_and(|text| text.contains("is the same number as"))
        );
    }
    assert_eq!(
        app.rest("PUT", "/v1/environments/alike", Some(&body(&plain, &plain)))
            .await
            .0,
        201
    );
    app.stop().await;
}

#[tokio::test]
async fn by_position_a_value_is_an_index_whatever_labels_read_as() {
    use nudge::api::proto;
    let app = service().await;
    let ask = async |index: f32| {
        let scope = Some(proto::Scope {
            environment: "dice".into(),
            ..Default::default()
        });
        let states = vec![proto::StateValues {
            values: vec![index],
        }];
        let request = proto::BatchGetInfluenceRequest {
            scope,
            states,
            ..Default::default()
        };
        app.influence().await.batch_get_influence(request).await
    };
    let answer = ask(1.0).await.expect("an index").into_inner();
    let state = answer.answers[0].state.clone().expect("present");
    assert_eq!(
        (state.key.as_str(), state.bins[0].label.as_str()),
        ("1", "2")
    );
    let refused = ask(3.0).await.expect_err("three labels");
    assert!(
        refused
            .message()
            .contains("got 3, expected an index from 0 to 2 of 1, 2, 3"),
        "{refused}"
    );
}

#[tokio::test]
async fn an_action_of_several_features_cannot_be_bare() {
    let app = TestApp::start().await;
    let feature = |name: &str| json!({"name": name, "categorical": {"labels": ["1", "2"]}});
    let agent = |name: &str| json!({"name": name, "action": [feature("hand"), feature("foot")]});
    let body = json!({"state": [feature("x")], "agents": [agent("a"), agent("b")]});
    assert_eq!(
        app.rest("PUT", "/v1/environments/limbs", Some(&body))
            .await
            .0,
        201
    );
    let transition =
        |b: Value| json!({"state": {"x": 1}, "actions": {"a": {"hand": 1, "foot": "2"}, "b": b}});
    let transitions = [
        transition(json!(1)),
        transition(json!("1")),
        transition(json!({"foot": 2.0, "hand": 2})),
    ];
    let batch = json!({"producer": "p", "sequence": 1, "transitions": transitions});
    let (_, receipt) = app
        .rest("POST", "/v1/environments/limbs/transitions", Some(&batch))
        .await;
    assert_eq!(
        (&receipt["accepted"], &receipt["rejected_count"]),
        (&json!(1), &json!(2)),
        "{receipt}"
    );
    assert_eq!(
        receipt["rejected"][0]["reason"],
        json!("got 1, expected an object of hand, foot")
    );
    let (_, state) = app
        .rest("GET", "/v1/environments/limbs/states/0", None)
        .await;
    assert_eq!(state["cells"][0]["actions"], json!([1, 3]), "{state}");
}
