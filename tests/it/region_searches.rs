//! Searches for regions: a planted one is found by every face alike, by the same figures as the core
//! has of the same draws; and what is found in human play.

use nudge::api::{json as dto, proto};
use nudge::domain::{Acknowledged, Batch, Entry, Record, Records, Sequence, Widths};
use nudge::simulation::planted::regions::{
    ACTIONS, BINS, Draw, Drawn, SEGMENTS, UNORDERED, World, drawn, is_exact, searched,
};
use serde_json::{Value, json};

use crate::lags::{LAG, run, street};
use crate::support::TestApp;

/// Draws, and the seed of the worlds.
const DRAWS: usize = 8_000;
const SEED: u64 = 1;

fn path(environment: &str) -> String {
    format!("/v1/environments/{environment}/regions")
}

async fn asked(app: &TestApp, environment: &str, question: Value) -> Value {
    let (status, found) = app.rest("POST", &path(environment), Some(&question)).await;
    assert_eq!(status, 200, "{found}");
    found
}

fn figure(found: &Value, name: &str) -> f64 {
    found[name].as_f64().expect("a number")
}

fn regions(found: &Value) -> &[Value] {
    found["regions"].as_array().expect("regions")
}

fn description() -> Value {
    let integer =
        |name: &str, most: usize| json!({"name": name, "integer": {"min": 0, "max": most}});
    let feature = |(at, bins): (usize, &u32)| {
        let name = format!("f{at}");
        let labels: Vec<String> = (0..*bins).map(|bin| format!("l{bin}")).collect();
        match UNORDERED.contains(&at) {
            true => json!({"name": name, "categorical": {"labels": labels}}),
            false => integer(&name, *bins as usize - 1),
        }
    };
    let state: Vec<Value> = BINS.iter().enumerate().map(feature).collect();
    let agent = |name: &str| json!({"name": name, "action": [integer("act", ACTIONS - 1)]});
    json!({"state": state, "agents": [agent("one"), agent("two")]})
}

/// Makes an environment of what was drawn, a batch a segment.
async fn counted(app: &TestApp, name: &str, drawn: &Drawn) {
    let environment = format!("/v1/environments/{name}");
    let made = app.rest("PUT", &environment, Some(&description())).await;
    assert_eq!(made.0, 201, "{}", made.1);

    let environment = app.app.environments.find(name).expect("made");
    let widths = Widths::of_schema(&environment.schema);
    let record = |draw: &Draw| Record {
        state: drawn.states[draw.state].map(|bin| bin as f32).to_vec(),
        actions: [draw.ego, draw.other].map(|action| action as f32).to_vec(),
        actions_present: Vec::new(),
        outcomes: Vec::new(),
        outcomes_present: Vec::new(),
        entry: Entry::Unknown,
        count: 1,
        track: None,
    };
    for segment in 0..SEGMENTS {
        let draws = drawn.draws.iter().filter(|draw| draw.segment == segment);
        let records: Vec<Record> = draws.map(record).collect();
        let batch = Batch {
            sequence: Sequence::new(segment as u64 + 1).expect("above 0"),
            segment: segment.to_string().parse().ok(),
            records: Records::collect(widths.clone(), records.into_iter().map(Ok)),
        };
        let producer = "test".parse().expect("a producer");
        let told = app.app.ingest.write(&environment, producer, batch).await;
        let told = told.expect("counted");
        assert!(matches!(told, Acknowledged::Applied(receipt) if receipt.rejected_count == 0));
    }
}

#[tokio::test]
async fn a_planted_region_is_found_on_every_face_and_nothing_in_its_twin() {
    let app = TestApp::start().await;
    let planted = drawn(World::Planted(0.6), DRAWS, SEED);
    counted(&app, "planted", &planted).await;
    let over_rest = asked(&app, "planted", json!({"most": 3})).await;

    let by_core = searched(&planted);
    let (rule, pooled, _) = &by_core[0];
    assert!(is_exact(rule), "{rule:?}");
    let found = &regions(&over_rest)[0];
    assert_eq!(
        found["region"],
        json!({"f0": {"from": 1, "below": 4}, "f2": "l1"})
    );
    assert_eq!(found["region_in_words"], json!("f0 1 to 3, f2 l1"));
    assert_eq!(found["draws"], json!(pooled.visits));
    for (told, measured) in [
        ("z", pooled.z),
        ("p_value", pooled.p_value),
        ("z_searched", rule.sum.z()),
    ] {
        assert!(
            (figure(found, told) - measured).abs() < 1e-9,
            "{told}: {found}"
        );
    }
    assert!(figure(found, "p_value") < 1e-6);
    let halves = ["dealt", "segments_searched", "segments_tested"].map(|name| &over_rest[name]);
    assert_eq!(halves, [&json!("segments"), &json!(4), &json!(4)]);

    let over_get = app.get(&format!("{}?most=3", path("planted"))).await;
    assert_eq!(over_get, over_rest);
    let scope = proto::Scope {
        environment: "planted".into(),
        ..proto::Scope::default()
    };
    let request = proto::FindRegionsRequest {
        scope: Some(scope),
        most: 3,
        ..proto::FindRegionsRequest::default()
    };
    let over_grpc = app.influence().await.find_regions(request).await;
    let over_grpc = dto::RegionSearch::from(over_grpc.expect("valid").into_inner());
    assert_eq!(serde_json::to_value(over_grpc).expect("JSON"), over_rest);
    let (code, told, stderr) = run(&app, &["regions", "planted", "--most", "3", "--json"]).await;
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(
        serde_json::from_str::<Value>(&told).expect("JSON"),
        over_rest
    );

    // Inside of it, nothing else is left to tell apart; outside, nothing is there.
    let inside = json!({"region": {"f0": {"from": 1, "to": 3}, "f2": "l1"}});
    let inside = asked(&app, "planted", inside).await;
    assert_eq!(regions(&inside)[0]["region"], inside["region"]);
    let outside = asked(&app, "planted", json!({"region": {"f2": "l0"}})).await;
    assert_eq!(regions(&outside), [] as [Value; 0], "{outside}");

    counted(&app, "twin", &drawn(World::Independent, DRAWS, SEED)).await;
    let (code, told, stderr) = run(&app, &["regions", "twin"]).await;
    assert_eq!(code, 0, "{stderr}");
    assert!(told.contains("Nothing found"), "{told}");
}

#[tokio::test]
async fn where_there_is_one_segment_strata_are_dealt() {
    let app = street().await;
    let found = asked(&app, "street", json!({"lag": LAG})).await;
    assert_eq!(
        (&found["dealt"], &found["directed"]),
        (&json!("strata"), &json!(true))
    );
    let near = &regions(&found)[0];
    assert_eq!(near["region"], json!({"place": {"below": 2}}), "{found}");
    assert!(figure(near, "p_value") < 1e-6);

    let reverse = json!({"ego": "follower", "other": "leader", "lag": LAG});
    let reverse = asked(&app, "street", reverse).await;
    assert_eq!(regions(&reverse), [] as [Value; 0], "{reverse}");
}

#[tokio::test]
async fn what_cannot_be_asked_is_refused_with_every_fault() {
    let app = street().await;
    let refused = async |question: Value| {
        let told = app.rest("POST", &path("street"), Some(&question)).await;
        let (status, problem) = told;
        assert_eq!(status, 400, "{problem}");
        let faults = problem["errors"].as_array().expect("faults").clone();
        let pointers = faults.into_iter().map(|fault| fault["pointer"].clone());
        pointers.collect::<Vec<_>>()
    };

    let wrong = json!({"lag": 9, "region": {"plaice": 1}, "fdr": 1, "most": 11});
    assert_eq!(
        refused(wrong).await,
        ["/lag", "/region/plaice", "/fdr", "/most"].map(|at| json!(at))
    );
    assert_eq!(
        refused(json!({"segments": ["x"]})).await,
        [json!("/segments")]
    );
    let get = format!("{}?most=x&fdr=&region.place=", path("street"));
    assert_eq!(app.rest("GET", &get, None).await.0, 400);
}

#[tokio::test]
async fn nothing_counted_is_nothing_found() {
    let app = TestApp::start().await;
    let drawn = Drawn {
        states: Vec::new(),
        draws: Vec::new(),
    };
    counted(&app, "empty", &drawn).await;
    let found = asked(&app, "empty", json!({})).await;
    assert_eq!((&found["tested"], &found["rules"]), (&json!(0), &json!(0)));
}

#[tokio::test]
async fn people_who_wait_for_one_another_depend_everywhere_and_in_one_direction() {
    let app = TestApp::start().await;
    let games = |split: &str| {
        let root = env!("CARGO_MANIFEST_DIR");
        format!("{root}/data/overcooked/{split}.csv.gz")
    };
    let (train, test) = (games("train"), games("test"));
    let sent = ["ingest", "--format", "overcooked", &train, &test];
    let (code, _, stderr) = run(&app, &sent).await;
    assert_eq!(code, 0, "{stderr}");
    let searched = async |layout: &str, ego: usize, lag: usize| {
        let [ego, other] = [ego, 1 - ego].map(|player| format!("player_{player}"));
        asked(
            &app,
            layout,
            json!({"ego": ego, "other": other, "lag": lag}),
        )
        .await
    };

    // With six pairs of people in either half no part of the kitchen stands out from the rest.
    for lag in [5, 6] {
        let found = searched("forced_coordination", 1, lag).await;
        let [everywhere] = regions(&found) else {
            panic!("one region: {found}")
        };
        assert_eq!(everywhere["region"], json!({}), "{found}");
        assert!(figure(everywhere, "p_value") < 0.01, "{found}");
    }
    for (layout, ego, lag) in [
        ("forced_coordination", 0, 5),
        ("forced_coordination", 0, 6),
        ("forced_coordination", 1, 0),
        ("counter_circuit", 0, 4),
        ("counter_circuit", 1, 4),
        ("asymmetric_advantages", 1, 4),
    ] {
        let found = searched(layout, ego, lag).await;
        assert_eq!(regions(&found), [] as [Value; 0], "{layout}: {found}");
    }
}
