//! Thresholds and shares: the same on every face, for every pair, and none that nobody can reach.

use nudge::api::{json as dto, proto};
use nudge::domain::{Threshold, WrittenRule};
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::{TestApp, open, reason};

const WORLD: &str = "/v1/environments/world";
const LN_2: f64 = std::f64::consts::LN_2;

/// A world of agents a, b, c ... with so many actions.
async fn world(actions: &[i64]) -> TestApp {
    let app = TestApp::start().await;
    let (status, made) = app.rest("PUT", WORLD, Some(&description(actions))).await;
    assert_eq!(status, 201, "{made}");
    app
}

fn description(actions: &[i64]) -> Value {
    let agent = |(name, actions): (char, &i64)| json!({"name": name.to_string(), "action": [{"name": "do", "integer": {"min": 1, "max": actions}}]});
    let agents: Vec<Value> = ('a'..).zip(actions).map(agent).collect();
    json!({"state": [{"name": "x", "integer": {"min": 0, "max": 3}}], "agents": agents})
}

async fn run(app: &TestApp, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
}

fn pointers(problem: &Value) -> Vec<&str> {
    let errors = problem["errors"].as_array().expect("faults");
    errors
        .iter()
        .map(|error| error["pointer"].as_str().expect("a pointer"))
        .collect()
}

async fn answer(app: &TestApp, question: Value) -> Value {
    let (status, answers) = app
        .rest("POST", &format!("{WORLD}/influence"), Some(&question))
        .await;
    assert_eq!(status, 200, "{answers}");
    answers["answers"][0].clone()
}

fn close(value: &Value, expected: f64) -> bool {
    value
        .as_f64()
        .is_some_and(|value| (value - expected).abs() < 1e-12)
}

#[tokio::test]
async fn a_threshold_that_nobody_can_reach_is_refused_with_the_figure_on_every_face() {
    let app = world(&[2, 2]).await;
    let detail = "got 0.8 nats, expected less than 0.693147 nats = ln 2, the most two agents with 2 and 2 actions can have";
    let rule = json!({"rule": {"threshold": 0.8}});
    let mut again = description(&[2, 2]);
    again["rule"] = rule["rule"].clone();
    let asked = json!({"keys": ["0"], "rule": {"threshold": 0.8}});
    let influence = format!("{WORLD}/influence");
    for (method, path, body) in [
        ("PUT", WORLD.to_owned(), Some(&again)),
        ("PUT", "/v1/environments/new".to_owned(), Some(&again)),
        ("PATCH", WORLD.to_owned(), Some(&rule)),
        ("POST", influence.clone(), Some(&asked)),
        ("GET", format!("{influence}?key=0&rule.threshold=0.8"), None),
        ("GET", format!("{WORLD}/states?rule.threshold=0.8"), None),
        ("GET", format!("{WORLD}/summary?rule.threshold=0.8"), None),
        ("GET", format!("{WORLD}/explore?rule.threshold=0.8"), None),
        (
            "GET",
            format!("{WORLD}/graph?key=0&rule.threshold=0.8"),
            None,
        ),
    ] {
        let (status, problem) = app.rest(method, &path, body).await;
        assert_eq!(
            (status, pointers(&problem)),
            (400, vec!["/rule/threshold"]),
            "{method} {path}: {problem}"
        );
        assert_eq!(problem["errors"][0]["detail"], json!(detail));
    }
    let rule = Some(proto::Rule {
        threshold: Some(0.8),
        ..Default::default()
    });
    let request = proto::UpdateRuleRequest {
        name: "world".into(),
        rule: rule.clone(),
    };
    let refused = app
        .environments()
        .await
        .update_rule(request)
        .await
        .expect_err("beyond reach");
    assert!(
        reason(&refused) == "INVALID_INPUT" && refused.message().contains(detail),
        "{refused}"
    );
    let scope = Some(proto::Scope {
        environment: "world".into(),
        rule,
        ..Default::default()
    });
    let request = proto::BatchGetInfluenceRequest {
        scope,
        keys: vec!["0".into()],
        ..Default::default()
    };
    let refused = app
        .influence()
        .await
        .batch_get_influence(request)
        .await
        .expect_err("beyond reach");
    assert!(refused.message().contains(detail), "{refused}");
    let (code, _, stderr) = run(
        &app,
        &["query", "world", "--key", "0", "--rule-threshold", "0.8"],
    )
    .await;
    assert!(code == 1 && stderr.contains(detail), "{stderr}");
}

#[tokio::test]
async fn what_can_be_reached_is_not_refused() {
    let app = world(&[2, 2]).await;
    for (rule, status) in [
        (json!({"threshold": 0.693}), 200),
        (json!({"threshold": LN_2}), 400),
        (json!({"threshold": 0.999, "unit": "bits"}), 200),
        (json!({"threshold": 1, "unit": "bits"}), 400),
        (json!({"unit": "bits"}), 200),
        (json!({"share": 0.999}), 200),
        (json!({"share": 1}), 400),
        (json!({"share": -0.1}), 400),
        (json!({"kind": "paper"}), 200),
    ] {
        let (got, told) = app.rest("PATCH", WORLD, Some(&json!({"rule": rule}))).await;
        assert_eq!(got, status, "{rule}: {told}");
    }
}

#[tokio::test]
async fn of_threshold_and_share_the_one_given_later_counts() {
    let app = world(&[2, 25]).await;
    let patched = async |rule: Value| {
        app.rest("PATCH", WORLD, Some(&json!({"rule": rule})))
            .await
            .1["rule"]
            .clone()
    };
    let rule = patched(json!({"share": 0.25})).await;
    assert_eq!(
        (&rule["share"], rule.get("threshold")),
        (&json!(0.25), None)
    );
    let told = answer(&app, json!({"keys": ["0"]})).await;
    assert!(
        close(&told["threshold"], 0.25 * LN_2) && told["share"] == json!(0.25),
        "{told}"
    );
    let told = answer(&app, json!({"keys": ["0"], "unit": "bits"})).await;
    assert!(
        close(&told["threshold"], 0.25) && told["share"] == json!(0.25),
        "{told}"
    );
    let told = answer(&app, json!({"keys": ["0"], "rule": {"threshold": 0.1}})).await;
    assert!(
        close(&told["threshold"], 0.1) && close(&told["share"], 0.1 / LN_2),
        "{told}"
    );
    // A unit alone leaves a share as it is.
    let rule = patched(json!({"unit": "bits"})).await;
    assert_eq!(
        (&rule["share"], &rule["unit"], rule.get("threshold")),
        (&json!(0.25), &json!("bits"), None)
    );
    let rule = patched(json!({"threshold": 0.5})).await;
    assert_eq!((&rule["threshold"], rule.get("share")), (&json!(0.5), None));
    let (_, answers) = app
        .rest(
            "GET",
            &format!("{WORLD}/influence?key=0&rule.share=0.75"),
            None,
        )
        .await;
    assert!(
        close(&answers["answers"][0]["threshold"], 0.75),
        "in bits: {answers}"
    );
    let (_, stdout, _) = run(
        &app,
        &["query", "world", "--key", "0", "--rule-share", "0.75"],
    )
    .await;
    assert!(
        stdout.contains("evidence rule, threshold 0.75 bits, 75 % of the most the two can have"),
        "{stdout}"
    );

    let both = json!({"threshold": 0.1, "share": 0.1});
    let (status, problem) = app.rest("PATCH", WORLD, Some(&json!({"rule": both}))).await;
    assert_eq!(
        (status, pointers(&problem)),
        (400, vec!["/rule/threshold", "/rule/share"]),
        "{problem}"
    );
    let question = json!({"keys": ["0"], "rule": both});
    let (status, problem) = app
        .rest("POST", &format!("{WORLD}/influence"), Some(&question))
        .await;
    assert_eq!(
        (status, pointers(&problem)),
        (400, vec!["/rule/threshold", "/rule/share"]),
        "{problem}"
    );
}

#[tokio::test]
async fn a_rule_is_for_every_pair_and_a_question_for_its_own() {
    let app = world(&[2, 5, 5, 1]).await;
    let set = json!({"rule": {"threshold": 1}});
    assert_eq!(
        app.rest("PATCH", WORLD, Some(&set)).await.0,
        200,
        "b and c can have more"
    );
    let told = answer(&app, json!({"keys": ["0"]})).await;
    assert!(
        close(&told["share"], 1.0 / LN_2),
        "a and b cannot, and are told so: {told}"
    );
    let given = json!({"keys": ["0"], "rule": {"threshold": 1}});
    let (status, problem) = app
        .rest("POST", &format!("{WORLD}/influence"), Some(&given))
        .await;
    assert_eq!((status, pointers(&problem)), (400, vec!["/rule/threshold"]));
    let wide = json!({"keys": ["0"], "ego": "c", "other": "b", "rule": {"threshold": 1}});
    assert!(close(&answer(&app, wide).await["share"], 1.0 / 5_f64.ln()));
    let single = json!({"keys": ["0"], "ego": "d", "other": "b", "rule": {"threshold": 99}});
    assert_eq!(answer(&app, single).await["share"], Value::Null);
    let graph = async |threshold: &str| {
        app.rest(
            "GET",
            &format!("{WORLD}/graph?key=0&rule.threshold={threshold}"),
            None,
        )
        .await
    };
    assert_eq!(
        (
            graph("1").await.0,
            graph("1.6").await.0,
            graph("1.61").await.0
        ),
        (200, 200, 400)
    );
    let (status, shared) = app
        .rest("GET", &format!("{WORLD}/graph?key=0&rule.share=0.5"), None)
        .await;
    assert_eq!(status, 200);
    let thresholds: Vec<&Value> = shared["edges"]
        .as_array()
        .expect("edges")
        .iter()
        .map(|edge| &edge["answer"]["threshold"])
        .collect();
    for (threshold, actions) in thresholds
        .into_iter()
        .zip([2.0_f64, 2.0, 1.0, 5.0, 1.0, 1.0])
    {
        assert!(close(threshold, 0.5 * actions.ln()), "{shared}");
    }
    let (_, shown, _) = run(&app, &["env", "show", "world"]).await;
    for line in [
        "always undecided between a and d, b and d, c and d: one of the two has a single action",
        "influence above 1 nats (1.44 bits; 144 % of the most a and b, a and c can have: out of reach)",
        "influence above 1 nats (1.44 bits; 62 % of the most b and c can have)",
    ] {
        assert!(shown.contains(line), "{shown}");
    }
}

#[tokio::test]
async fn a_pair_with_a_single_action_is_never_decided() {
    let app = world(&[1, 3]).await;
    let played: Vec<Value> = (1..=3)
        .map(|b| json!({"state": {"x": 0}, "actions": {"a": 1, "b": b}, "count": 100 * b}))
        .collect();
    let batch = json!({"producer": "p", "sequence": 1, "transitions": played});
    assert_eq!(
        app.rest("POST", &format!("{WORLD}/transitions"), Some(&batch))
            .await
            .1["accepted"],
        json!(3)
    );
    assert_eq!(app.rest("POST", &format!("{WORLD}/fit"), None).await.0, 200);
    for rule in [
        json!({"kind": "paper"}),
        json!({"kind": "evidence"}),
        json!({"threshold": 7}),
        json!({"share": 0.5}),
    ] {
        assert_eq!(
            app.rest("PATCH", WORLD, Some(&json!({"rule": rule})))
                .await
                .0,
            200,
            "{rule}"
        );
        let told = answer(&app, json!({"keys": ["0"], "visits_to_decide": true})).await;
        assert_eq!(
            (&told["verdict"], &told["visits"]),
            (&json!("undecided"), &json!(600)),
            "{rule}: {told}"
        );
        assert_eq!(
            (&told["visits_to_decide"], told.get("share")),
            (&Value::Null, None),
            "{rule}: {told}"
        );
        let (_, summary) = app.rest("GET", &format!("{WORLD}/summary"), None).await;
        assert_eq!(
            (
                &summary["verdicts"]["undecided"],
                &summary["thresholds"]["share"]
            ),
            (&json!(1), &Value::Null),
            "{summary}"
        );
    }
}

#[tokio::test]
async fn the_threshold_is_told_in_nats_bits_and_as_a_share() {
    let app = world(&[2, 2]).await;
    let (_, summary) = app
        .rest("GET", &format!("{WORLD}/summary?unit=bits"), None)
        .await;
    let told = &summary["thresholds"];
    assert!(
        close(&told["nats"], 0.5)
            && close(&told["bits"], 0.5 / LN_2)
            && close(&told["share"], 0.5 / LN_2),
        "{told}"
    );
    let scope = Some(proto::Scope {
        environment: "world".into(),
        unit: "bits".into(),
        ..Default::default()
    });
    let request = proto::SummarizeRequest {
        scope,
        ..Default::default()
    };
    let over_grpc = app
        .influence()
        .await
        .summarize(request)
        .await
        .expect("valid")
        .into_inner();
    assert_eq!(
        summary,
        serde_json::to_value(dto::Summary::from(over_grpc)).expect("JSON")
    );

    let file = tempfile::NamedTempFile::new().expect("a file");
    let mut body = description(&[2, 2]);
    for (rule, line) in [
        (
            json!({"threshold": 0.5}),
            "influence above 0.5 nats (0.721 bits; 72 % of the most a and b can have)",
        ),
        (
            json!({"threshold": 0.5, "unit": "bits"}),
            "influence above 0.347 nats (0.5 bits; 50 % of the most a and b can have)",
        ),
        (
            json!({"share": 0.25}),
            "influence above 0.173 nats (0.25 bits; 25 % of the most a and b can have)",
        ),
    ] {
        body["rule"] = rule;
        std::fs::write(file.path(), body.to_string()).expect("written");
        let path = file.path().to_str().expect("text");
        let (code, stdout, stderr) = run(&app, &["env", "apply", path, "--name", "world"]).await;
        assert_eq!((code, stderr.as_str()), (0, ""));
        assert_eq!(
            stdout,
            format!("environment `world` exists with this description\n{line}\n")
        );
        let (_, shown, _) = run(&app, &["env", "show", "world"]).await;
        assert!(shown.contains(line), "{shown}");
    }
    let (_, listed, _) = run(&app, &["env", "list"]).await;
    assert!(
        listed.contains("evidence, above 25 % of what two agents can have at 0.8"),
        "{listed}"
    );
}

#[tokio::test]
async fn a_rule_that_was_kept_before_stays_and_comes_back_in() {
    let app = world(&[2, 2]).await;
    let directory = app.directory.clone();
    app.stop().await;
    let store = open(directory.path(), Default::default()).await;
    let id = store.environment("world").expect("made").id;
    let beyond = WrittenRule {
        threshold: Threshold::Information(0.8),
        ..WrittenRule::default()
    };
    store.change(id, &beyond.into()).await.expect("set");
    let app = TestApp::with(directory, store).await;

    let (status, got) = app.rest("GET", WORLD, None).await;
    assert_eq!((status, &got["rule"]["threshold"]), (200, &json!(0.8)));
    assert_eq!(app.rest("PUT", WORLD, Some(&got)).await, (200, got.clone()));
    assert_eq!(
        app.rest(
            "PATCH",
            WORLD,
            Some(&json!({"rule": {"threshold": 0.8, "min_visits": 3}}))
        )
        .await
        .0,
        200
    );
    assert_eq!(
        app.rest("PATCH", WORLD, Some(&json!({"rule": {"threshold": 0.9}})))
            .await
            .0,
        400
    );
    assert!(close(
        &answer(&app, json!({"keys": ["0"]})).await["share"],
        0.8 / LN_2
    ));
    let (_, shown, _) = run(&app, &["env", "show", "world"]).await;
    assert!(
        shown.contains("115 % of the most a and b can have: out of reach"),
        "{shown}"
    );
}
