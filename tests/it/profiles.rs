//! Lag profiles: what all states of a region say together. A follower that was planted in two of four
//! states is found at its lag, in its direction and its region, by every face alike.

use nudge::api::{json as dto, proto};
use serde_json::{Value, json};

use crate::lags::{LAG, run, street};
use crate::support::TestApp;

const PATH: &str = "/v1/environments/street/profile";

async fn asked(app: &TestApp, question: Value) -> Value {
    let (status, profile) = app.rest("POST", PATH, Some(&question)).await;
    assert_eq!(status, 200, "{profile}");
    profile
}

fn at(profile: &Value, lag: usize) -> &Value {
    let mut points = profile["profile"].as_array().expect("points").iter();
    points
        .find(|point| point["lag"] == json!(lag))
        .expect("a point of that lag")
}

fn figure(point: &Value, name: &str) -> f64 {
    point[name].as_f64().expect("a number")
}

#[tokio::test]
async fn a_follower_is_found_at_its_lag_in_its_direction_and_region() {
    let app = street().await;
    let lags = |profile: &Value| -> Vec<u64> {
        let points = profile["profile"].as_array().expect("points").iter();
        points.filter_map(|point| point["lag"].as_u64()).collect()
    };

    let everywhere = asked(&app, json!({})).await;
    assert_eq!(lags(&everywhere), [0, 1, 2, 3, 4]);
    assert_eq!(everywhere["peak"], json!(LAG));
    assert_eq!(
        (&everywhere["region"], &everywhere["region_in_words"]),
        (&json!({}), &json!("everywhere"))
    );
    for lag in 0..=4 {
        let point = at(&everywhere, lag);
        let [excess, p] = ["excess", "p_value"].map(|name| figure(point, name));
        assert_eq!(p < 1e-6, lag == LAG, "lag {lag}: {point}");
        assert_eq!(
            excess > point["null"][1].as_f64().expect("an end"),
            lag == LAG
        );
        assert_eq!(point["directed"], json!(lag > 0));
    }

    let reverse = asked(&app, json!({"ego": "follower", "other": "leader"})).await;
    assert_eq!(reverse["peak"], Value::Null);

    let near = asked(&app, json!({"region": {"place": [0, 1]}, "lags": [3]})).await;
    let far = asked(&app, json!({"region": {"place": {"from": 2}}, "lags": [3]})).await;
    assert_eq!((&near["peak"], &far["peak"]), (&json!(LAG), &Value::Null));
    assert_eq!(
        near["labels"]["other"]["name"],
        everywhere["labels"]["other"]["name"]
    );
    let [near, far] = [near, far].map(|profile| at(&profile, LAG).clone());
    assert!(figure(&near, "size") > 5.0 * figure(&far, "size").abs());
    assert_eq!((&near["states"], &far["states"]), (&json!(2), &json!(2)));
    for counted in ["visits", "draws", "strata"] {
        let sum = figure(&near, counted) + figure(&far, counted);
        assert_eq!(sum, figure(at(&everywhere, LAG), counted), "{counted}");
    }
}

#[tokio::test]
async fn faces_tell_the_same_profile() {
    let app = street().await;
    let region = json!({"place": {"from": 0, "to": 1}});
    let over_rest = asked(
        &app,
        json!({"lags": [3, 1], "unit": "bits", "region": region}),
    )
    .await;

    let query = "?lags=1,3&unit=bits&region.place=0..1";
    assert_eq!(app.get(&format!("{PATH}{query}")).await, over_rest);

    let condition = proto::Condition {
        feature: "place".into(),
        bins: Some(proto::condition::Bins::Numbers(proto::BinNumbers {
            numbers: vec![0, 1],
        })),
    };
    let request = proto::GetProfileRequest {
        scope: Some(proto::Scope {
            environment: "street".into(),
            unit: "bits".into(),
            ..proto::Scope::default()
        }),
        region: Some(proto::Region {
            conditions: vec![condition],
        }),
        lags: vec![1, 3],
    };
    let over_grpc = app.influence().await.get_profile(request).await;
    let over_grpc = dto::Profile::from(over_grpc.expect("valid").into_inner());
    assert_eq!(serde_json::to_value(over_grpc).expect("JSON"), over_rest);

    let asked = [
        "query",
        "street",
        "--profile",
        "--lags",
        "1",
        "3",
        "--unit",
        "bits",
    ];
    let region = ["--region", "place=0,1"];
    for written in ["place=0,1", "place=0..1", "place=#0,#1", "place=..1"] {
        let region = ["--region", written, "--json"];
        let (code, told, stderr) = run(&app, &[&asked[..], &region].concat()).await;
        assert_eq!(code, 0, "{stderr}");
        let by_command: Value = serde_json::from_str(&told).expect("JSON");
        assert_eq!(by_command, over_rest, "{written}");
    }

    let both = ["--ego", "follower", "--other", "leader", "--both"];
    let (code, told, stderr) = run(&app, &[&asked[..], &both].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    let [first, second] = ["follower -> leader", "leader -> follower"].map(|pair| told.find(pair));
    assert!(first < second && first.is_some(), "{told}");

    let directory = tempfile::tempdir().expect("a temporary directory");
    let file = directory.path().join("profile.svg");
    let file = file.to_str().expect("UTF-8");
    let (code, told, stderr) = run(&app, &[&asked[..], &region, &["--svg", file]].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    assert!(told.contains("The peak is at lag 3"), "{told}");
    let svg = std::fs::read_to_string(file).expect("drawn");
    // A mark is its inside and its edge; one more says what it means.
    assert_eq!(svg.matches("<circle").count(), 2 * 3);
}

#[tokio::test]
async fn a_summary_has_the_point_of_its_lag() {
    let app = street().await;
    for (lag, unit) in [(0, "nats"), (LAG, "bits")] {
        let question = json!({"lags": [lag], "unit": unit});
        let point = at(&asked(&app, question).await, lag).clone();
        let path = format!("/v1/environments/street/summary?lag={lag}&unit={unit}");
        let over_rest = app.get(&path).await;
        assert_eq!(over_rest["pooled"], point);
        assert_eq!(over_rest["habits_differ"], Value::Null, "one segment alone");

        let scope = proto::Scope {
            environment: "street".into(),
            unit: unit.into(),
            lag: lag as i32,
            ..proto::Scope::default()
        };
        let request = proto::SummarizeRequest {
            scope: Some(scope),
            ..proto::SummarizeRequest::default()
        };
        let over_grpc = app.influence().await.summarize(request).await;
        let over_grpc = dto::Summary::from(over_grpc.expect("valid").into_inner());
        assert_eq!(serde_json::to_value(over_grpc).expect("JSON"), over_rest);
    }
}

#[tokio::test]
async fn what_cannot_be_asked_is_refused_with_every_fault() {
    let app = street().await;
    let refused = async |question: Value| {
        let (status, problem) = app.rest("POST", PATH, Some(&question)).await;
        assert_eq!(status, 400, "{problem}");
        let faults = problem["errors"].as_array().expect("faults").clone();
        let pointers = faults.into_iter().map(|fault| fault["pointer"].clone());
        pointers.collect::<Vec<_>>()
    };

    let wrong = json!({"within": "sometimes", "region": {"plaice": 1, "place": 9}});
    assert_eq!(
        refused(wrong).await,
        ["/within", "/region/place", "/region/plaice"].map(|at| json!(at))
    );
    assert_eq!(
        refused(json!({"lags": [0, 9, -1]})).await,
        ["/lags/1", "/lags/2"].map(|at| json!(at))
    );
    assert_eq!(
        refused(json!({"segments": ["x"]})).await,
        [json!("/segments")]
    );
    assert_eq!(
        refused(json!({"ego": "leader", "other": "leader"})).await,
        [json!("/other")]
    );

    let (status, problem) = app
        .rest("GET", &format!("{PATH}?lags=x&region.place=&lag=1"), None)
        .await;
    assert_eq!(status, 400, "{problem}");
}

/// Lags and the excess in nats of player 1 on player 0 in forced_coordination, measured by another
/// program on the same games (entries alone, pairs of people apart).
const MEASURED: [(usize, f64); 12] = [
    (0, -0.0013),
    (1, 0.0),
    (2, 0.0026),
    (3, 0.0063),
    (4, 0.0075),
    (5, 0.0096),
    (6, 0.0117),
    (7, 0.0064),
    (8, 0.0069),
    (9, 0.0061),
    (10, 0.0057),
    (12, 0.0050),
];

#[tokio::test]
async fn people_who_wait_for_one_another_are_found_to_influence_each_other() {
    let app = TestApp::start().await;
    let games = |split: &str| {
        format!(
            "{}/data/overcooked/{split}.csv.gz",
            env!("CARGO_MANIFEST_DIR")
        )
    };
    let (train, test) = (games("train"), games("test"));
    let sent = ["ingest", "--format", "overcooked", &train, &test];
    let (code, _, stderr) = run(&app, &sent).await;
    assert_eq!(code, 0, "{stderr}");

    let profile = async |layout: &str, ego: usize| {
        let asked = format!(
            "/v1/environments/{layout}/profile?ego=player_{ego}&other=player_{}",
            1 - ego
        );
        app.get(&asked).await
    };
    let excess = |profile: &Value| -> Vec<f64> {
        let points = profile["profile"].as_array().expect("points").iter();
        points.map(|point| figure(point, "excess")).collect()
    };

    let found = profile("forced_coordination", 1).await;
    assert_eq!(found["peak"], json!(6));
    for (lag, measured) in MEASURED {
        let told = excess(&found)[lag];
        assert!(
            (told - measured).abs() <= 0.0006,
            "lag {lag}: {told}, not {measured}"
        );
    }

    let weaker = profile("forced_coordination", 0).await;
    assert!(excess(&weaker).iter().all(|excess| *excess < 0.006));
    for layout in ["asymmetric_advantages", "counter_circuit"] {
        for ego in [0, 1] {
            let nothing = profile(layout, ego).await;
            assert_eq!(nothing["peak"], Value::Null, "{layout}: {nothing}");
        }
    }
}

#[tokio::test]
async fn nothing_counted_is_nothing_found() {
    let app = TestApp::start().await;
    let description = json!({
        "state": [{"name": "place", "integer": {"min": 0, "max": 1}}],
        "agents": [
            {"name": "one", "action": [{"name": "act", "integer": {"min": 0, "max": 0}}]},
            {"name": "two", "action": [{"name": "act", "integer": {"min": 0, "max": 2}}]},
        ],
    });
    let made = app
        .rest("PUT", "/v1/environments/street", Some(&description))
        .await;
    assert_eq!(made.0, 201, "{}", made.1);
    let profile = asked(&app, json!({})).await;
    assert_eq!(profile["peak"], Value::Null);
    let point = at(&profile, 0);
    for (name, expected) in [
        ("excess", 0.0),
        ("plug_in", 0.0),
        ("p_value", 1.0),
        ("draws", 0.0),
    ] {
        assert_eq!(figure(point, name), expected, "{name}: {point}");
    }
}
