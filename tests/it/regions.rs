//! Answers about regions: what all states of a region say together, by every face alike. A follower
//! was planted in two of four states.

use nudge::api::{json as dto, proto};
use serde_json::{Value, json};

use crate::lags::{LAG, run, street};
use crate::support::TestApp;

const PATH: &str = "/v1/environments/street/influence";

async fn asked(app: &TestApp, question: Value) -> Vec<Value> {
    let (status, answers) = app.rest("POST", PATH, Some(&question)).await;
    assert_eq!(status, 200, "{answers}");
    answers["answers"].as_array().expect("answers").clone()
}

fn figure(answer: &Value, pointer: &str) -> f64 {
    let figure = answer.pointer(pointer).and_then(Value::as_f64);
    figure.unwrap_or_else(|| panic!("no {pointer} in {answer}"))
}

#[tokio::test]
async fn a_follower_is_found_in_its_region_and_in_no_other() {
    let app = street().await;
    let regions = json!([{"place": [0, 1]}, {"place": {"from": 2}}, {}]);
    let rule = json!({"kind": "evidence", "threshold": 0.1, "unit": "nats"});
    let question = json!({"lag": LAG, "regions": regions, "rule": rule, "view": "full"});
    let answers = asked(&app, question).await;
    let [near, far, everywhere] = &answers[..] else {
        panic!("three: {answers:?}");
    };

    assert_eq!(near["region_in_words"], json!("place 0 to 1"));
    assert_eq!(near["verdict"], json!("influences"), "{near}");
    assert_eq!(near["dependence"], json!("established"));
    assert_eq!(far["verdict"], json!("no_influence"), "{far}");
    assert!(figure(near, "/p_value") < 1e-6 && figure(far, "/p_value") > 0.001);
    assert!(figure(near, "/dependent_share") > 0.9 && figure(far, "/dependent_share") < 0.5);
    assert!(figure(near, "/probability/above_threshold") > 0.95);

    let [excess, upper] =
        ["excess", "null/1"].map(|name| figure(near, &format!("/mutual_information/{name}")));
    assert!(excess > upper, "{near}");
    for counted in [
        "/visits",
        "/strata/draws",
        "/strata/states",
        "/strata/strata",
    ] {
        let sum = figure(near, counted) + figure(far, counted);
        assert_eq!(sum, figure(everywhere, counted), "{counted}");
    }
    for told in [near, far, everywhere] {
        assert_eq!(
            (told.get("state"), told.get("model")),
            (None, None),
            "{told}"
        );
        assert_eq!(told["basis"]["visits"], told["visits"]);
        assert_eq!(
            (&told["lag"], &told["directed"]),
            (&json!(LAG), &json!(true))
        );
    }
}

#[tokio::test]
async fn what_the_other_does_is_told_beside_what_it_would() {
    let app = street().await;
    let near = &asked(&app, json!({"lag": LAG, "region": {"place": [0, 1]}})).await[0];
    let actions = near["by_action"].as_array().expect("the full view");
    let draws: f64 = actions.iter().map(|action| figure(action, "/visits")).sum();
    assert_eq!(draws, figure(near, "/strata/draws"));
    for action in actions {
        let [seen, expected] = ["response", "response_if_independent"].map(|name| {
            let shares = action[name].as_array().expect("shares").iter();
            shares
                .map(|share| share.as_f64().expect("a share"))
                .collect::<Vec<f64>>()
        });
        for shares in [&seen, &expected] {
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-9, "{action}");
        }
        let index = action["index"].as_u64().expect("an index") as usize;
        assert!(
            seen[index] > expected[index] + 0.1,
            "a follower copies: {action}"
        );
        let [divergence, chance] =
            ["/plug_in_divergence", "/expected_divergence"].map(|name| figure(action, name));
        assert!(divergence > 3.0 * chance, "{action}");
    }
}

#[tokio::test]
async fn faces_tell_the_same_of_a_region() {
    let app = street().await;
    let question = json!({"lag": 3, "unit": "bits", "region": {"place": {"from": 0, "to": 1}}});
    let (status, over_rest) = app.rest("POST", PATH, Some(&question)).await;
    assert_eq!(status, 200, "{over_rest}");
    let query = "?lag=3&unit=bits&region.place=0..1";
    assert_eq!(app.get(&format!("{PATH}{query}")).await, over_rest);

    let region = proto::Region {
        conditions: vec![proto::Condition {
            feature: "place".into(),
            bins: Some(proto::condition::Bins::Numbers(proto::BinNumbers {
                numbers: vec![0, 1],
            })),
        }],
    };
    let scope = proto::Scope {
        environment: "street".into(),
        unit: "bits".into(),
        lag: 3,
        ..proto::Scope::default()
    };
    let one = proto::GetInfluenceRequest {
        scope: Some(scope.clone()),
        state: Some(proto::get_influence_request::State::Region(region.clone())),
        ..proto::GetInfluenceRequest::default()
    };
    let over_grpc = app.influence().await.get_influence(one).await;
    let over_grpc = dto::Answers::from(over_grpc.expect("valid").into_inner());
    assert_eq!(serde_json::to_value(over_grpc).expect("JSON"), over_rest);

    let several = proto::BatchGetInfluenceRequest {
        scope: Some(scope),
        regions: vec![region],
        ..proto::BatchGetInfluenceRequest::default()
    };
    let over_grpc = app.influence().await.batch_get_influence(several).await;
    let over_grpc = dto::Answers::from(over_grpc.expect("valid").into_inner());
    assert_eq!(serde_json::to_value(over_grpc).expect("JSON"), over_rest);

    let asked = [
        "query",
        "street",
        "--lag",
        "3",
        "--unit",
        "bits",
        "--region",
        "place=0,1",
    ];
    let (code, told, stderr) = run(&app, &[&asked[..], &["--json"]].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    let by_command: Value = serde_json::from_str(&told).expect("JSON");
    assert_eq!(by_command, over_rest);

    let (code, told, stderr) = run(&app, &asked).await;
    assert_eq!(code, 0, "{stderr}");
    assert!(told.contains("region: place 0 to 1"), "{told}");
    let more = ["--region", "place=2", "place=3", "--region"];
    let (code, _, stderr) = run(&app, &[&asked[..], &more].concat()).await;
    assert!(code != 0 && stderr.contains("/regions/1/place"), "{stderr}");
    let more = ["--region", "place=2", "--region"];
    let (code, told, stderr) = run(&app, &[&asked[..], &more].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    assert!(
        told.contains("place 2") && told.contains("everywhere"),
        "{told}"
    );
}

/// A light that both agents follow, and a lamp that nobody sees.
async fn lit() -> TestApp {
    let app = TestApp::start().await;
    let feature = |name: &str| json!({"name": name, "integer": {"min": 0, "max": 1}});
    let agent = |name: &str| json!({"name": name, "action": [feature("act")]});
    let description = json!({
        "state": [feature("light"), feature("lamp")],
        "agents": [agent("one"), agent("two")],
    });
    let made = app
        .rest("PUT", "/v1/environments/lit", Some(&description))
        .await;
    assert_eq!(made.0, 201, "{}", made.1);

    // Nine in ten do what the light says, each by itself.
    let transitions: Vec<Value> = [(0, 0, 81), (0, 1, 9), (1, 0, 9), (1, 1, 1)]
        .into_iter()
        .flat_map(|(one, two, count)| {
            [0, 1].into_iter().flat_map(move |light| {
                [0, 1].into_iter().map(move |lamp| {
                    json!({"state": {"light": light, "lamp": lamp}, "count": count, "entry": true,
                           "actions": {"one": one ^ light, "two": two ^ light}})
                })
            })
        })
        .collect();
    let batch = json!({"producer": "test", "sequence": 1, "transitions": transitions});
    let sent = app
        .rest("POST", "/v1/environments/lit/transitions", Some(&batch))
        .await;
    assert_eq!(sent.0, 200, "{}", sent.1);
    app
}

#[tokio::test]
async fn a_common_cause_that_a_grain_leaves_out_is_told() {
    let app = lit().await;
    let asked = async |features: Value| {
        let question = json!({"region": {}, "features": features});
        let path = "/v1/environments/lit/influence";
        let (status, answers) = app.rest("POST", path, Some(&question)).await;
        assert_eq!(status, 200, "{answers}");
        answers["answers"][0].clone()
    };

    let without_light = asked(json!(["lamp"])).await;
    assert_eq!(without_light["left_out"], json!(["light"]));
    assert_eq!(without_light["strata"]["strata"], json!(2));
    assert!(figure(&without_light, "/p_value") < 1e-6);
    let stratified = &without_light["mutual_information"]["stratified"];
    assert_eq!(stratified["strata"]["strata"], json!(4));
    assert!(figure(stratified, "/p_value") > 0.9 && figure(stratified, "/excess") < 0.0);
    assert_eq!(without_light["verdict"], json!("no_influence"));
    let warnings = without_light["warnings"].as_array().expect("a warning");
    assert!(warnings[0].as_str().expect("a sentence").contains("light"));

    let with_light = asked(json!(["light"])).await;
    assert_eq!(with_light["left_out"], json!(["lamp"]));
    assert!(figure(&with_light, "/p_value") > 0.9, "{with_light}");
    assert_eq!(with_light.get("warnings"), None, "{with_light}");

    let all = asked(json!([])).await;
    assert_eq!(all.get("left_out"), None);
    assert_eq!(all["mutual_information"].get("stratified"), None);
}

#[tokio::test]
async fn what_cannot_be_asked_of_a_region_is_refused_with_every_fault() {
    let app = street().await;
    for (question, pointers) in [
        (
            json!({"region": {"place": 9, "plaice": 1}}),
            vec!["/region/place", "/region/plaice"],
        ),
        (json!({"regions": []}), vec!["/regions"]),
        (
            json!({"regions": [{}, {"place": []}]}),
            vec!["/regions/1/place"],
        ),
        (json!({"regions": [{}], "region": {}}), vec!["/region"]),
        (json!({"keys": ["0"], "region": {}}), vec!["/region"]),
        (
            json!({"keys": ["0"], "features": ["place"]}),
            vec!["/features"],
        ),
        (
            json!({"region": {}, "features": ["place", "x"]}),
            vec!["/features/1"],
        ),
        (
            json!({"region": {}, "estimators": ["nsb"], "significance": "auto", "visits_to_decide": true}),
            vec!["/estimators", "/significance", "/visits_to_decide"],
        ),
        (
            json!({"region": {}, "lag": 9, "view": "wide"}),
            vec!["/lag", "/view"],
        ),
    ] {
        let (status, problem) = app.rest("POST", PATH, Some(&question)).await;
        assert_eq!(status, 400, "{problem}");
        let faults = problem["errors"].as_array().expect("faults").iter();
        let told: Vec<&str> = faults
            .filter_map(|fault| fault["pointer"].as_str())
            .collect();
        assert_eq!(told, pointers, "{question}");
    }

    for query in ["?region=near", "?region={}&key=0", "?region.place=9"] {
        let (status, problem) = app.rest("GET", &format!("{PATH}{query}"), None).await;
        assert_eq!(status, 400, "{query}: {problem}");
    }
}

#[tokio::test]
async fn a_region_that_nobody_saw_decides_nothing() {
    let app = TestApp::start().await;
    let feature = |name: &str, max| json!({"name": name, "integer": {"min": 0, "max": max}});
    let description = json!({
        "state": [feature("place", 3)],
        "agents": [
            {"name": "one", "action": [feature("act", 2)]},
            {"name": "two", "action": [feature("act", 2)]},
        ],
    });
    let made = app
        .rest("PUT", "/v1/environments/street", Some(&description))
        .await;
    assert_eq!(made.0, 201, "{}", made.1);

    let told = app.get(&format!("{PATH}?region={{}}")).await["answers"][0].clone();
    assert_eq!(told["verdict"], json!("undecided"), "{told}");
    assert_eq!(told["basis"], json!({"kind": "prior"}));
    assert_eq!(
        (figure(&told, "/p_value"), figure(&told, "/visits")),
        (1.0, 0.0)
    );
    let briefly = app
        .get(&format!("{PATH}?region.place=2&view=verdict"))
        .await;
    let briefly = &briefly["answers"][0];
    assert_eq!(briefly["region"], json!({"place": 2}));
    assert_eq!(briefly.get("mutual_information"), None);
}
