//! What counts support, asked of the running service: a world in which it is known which states
//! depend.

use nudge::api::{json as dto, proto};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};

use crate::support::TestApp;

const WORLD: &str = "/v1/environments/world";

/// Places below this are those where the human answers the robot.
const DEPENDENT: u64 = 20;
const PLACES: u64 = 60;

/// How often a place is seen: rarely, sometimes, often.
fn visits(place: u64) -> u64 {
    [3, 20, 400][place as usize % 3]
}

/// A world of three agents. Where the place says so the human mostly does what the robot does; the
/// dog never cares.
async fn world() -> TestApp {
    let app = TestApp::start().await;
    let agent = |name: &str, actions: u64| {
        let action = json!([{"name": "move", "integer": {"min": 0, "max": actions - 1}}]);
        json!({"name": name, "action": action})
    };
    let description = json!({
        "state": [{"name": "place", "integer": {"min": 0, "max": PLACES}}],
        "agents": [agent("robot", 4), agent("human", 4), agent("dog", 2)],
    });
    let (status, answer) = app.rest("PUT", WORLD, Some(&description)).await;
    assert_eq!(status, 201, "{answer}");
    for (sequence, segment) in [(1, "morning"), (2, "evening")] {
        let body = json!({
            "producer": "p", "sequence": sequence, "segment": segment, "transitions": transitions(sequence),
        });
        let (status, receipt) = app
            .rest("POST", &format!("{WORLD}/transitions"), Some(&body))
            .await;
        assert_eq!(
            (status, &receipt["rejected_count"]),
            (200, &json!(0)),
            "{receipt}"
        );
    }
    app
}

/// Half of the visits of every place.
fn transitions(seed: u64) -> Vec<Value> {
    let mut random = StdRng::seed_from_u64(seed);
    let mut transitions = Vec::new();
    for place in 0..PLACES {
        for _ in 0..visits(place).div_ceil(2) {
            let robot = random.random_range(0..4);
            let copies = place < DEPENDENT && random.random_bool(0.9);
            let human = if copies {
                robot
            } else {
                random.random_range(0..4)
            };
            let actions = json!({"robot": robot, "human": human, "dog": random.random_range(0..2)});
            transitions.push(json!({"state": {"place": place}, "actions": actions}));
        }
    }
    transitions
}

async fn get(app: &TestApp, path: &str) -> Value {
    app.get(&format!("{WORLD}/{path}")).await
}

async fn answer(app: &TestApp, query: &str) -> Value {
    get(app, &format!("influence?{query}")).await["answers"][0].take()
}

async fn fit(app: &TestApp) -> Value {
    let (status, fits) = app.rest("POST", &format!("{WORLD}/fit"), None).await;
    assert_eq!(status, 200, "{fits}");
    fits
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{value} is no number"))
}

#[tokio::test]
async fn verdicts_are_earned_by_counts() {
    let app = world().await;
    fit(&app).await;
    for place in 0..PLACES {
        let told = answer(&app, &format!("key={place}&view=verdict")).await;
        let expected: &[&str] = match (visits(place), place < DEPENDENT) {
            (400, true) => &["influences"],
            (400, false) => &["no_influence"],
            // A few visits may decide rightly or not at all.
            (_, true) => &["influences", "undecided"],
            (_, false) => &["no_influence", "undecided"],
        };
        assert!(
            expected.contains(&told["verdict"].as_str().expect("a word")),
            "{told}"
        );
    }
    let unseen = answer(&app, &format!("key={PLACES}")).await;
    assert_eq!(
        (&unseen["verdict"], &unseen["basis"]["kind"]),
        (&json!("undecided"), &json!("prior"))
    );
    assert_eq!(
        (&unseen["dependence"], &unseen["visits"]),
        (&json!("open"), &json!(0))
    );
}

#[tokio::test]
async fn pages_and_explorations_name_their_fit() {
    let app = world().await;
    let paths = [
        "states",
        "states?order_by=p_dependent",
        "states?fdr=0.05",
        "explore",
    ];
    for version in 0..2 {
        for path in paths {
            let told = get(&app, path).await;
            assert_eq!(told["fit"]["version"], json!(version), "{path}: {told}");
        }
        fit(&app).await;
    }
}

#[tokio::test]
async fn figures_stand_beside_their_evidence() {
    let app = world().await;
    fit(&app).await;
    let told = answer(&app, "key=2").await;
    let (information, probability) = (&told["mutual_information"], &told["probability"]);
    let [low, high] = [0, 1].map(|end| number(&information["interval"][end]));
    let mean = number(&information["posterior_mean"]);
    assert!(
        low > 0.5 && low < mean && mean < high && high < 4_f64.ln(),
        "{told}"
    );
    assert!(
        number(&probability["dependent"]) > 0.999 && number(&probability["above_threshold"]) > 0.95,
        "{told}"
    );
    assert_eq!(
        (&told["dependence"], &told["independence"]),
        (&json!("established"), &json!("assumed"))
    );
    assert_eq!(told["fit"]["version"], 1);
    let independent = answer(&app, "key=32").await;
    assert!(
        number(&independent["mutual_information"]["posterior_mean"]) < 0.02,
        "{independent}"
    );
    assert_eq!(independent["mutual_information"]["interval"][0], 0.0);
}

#[tokio::test]
async fn both_directions_and_both_faces_say_the_same() {
    let app = world().await;
    fit(&app).await;
    let forth = answer(&app, "key=4&ego=robot&other=human").await;
    let back = answer(&app, "key=4&ego=human&other=robot").await;
    for field in ["probability", "dependence", "verdict", "fit"] {
        assert_eq!(forth[field], back[field], "{field}");
    }
    let query = format!(
        "{WORLD}/influence?key=4&significance=pooled&visits_to_decide=true&estimators=nsb,adjusted"
    );
    let (_, over_rest) = app.rest("GET", &query, None).await;
    let request = proto::BatchGetInfluenceRequest {
        scope: Some(proto::Scope {
            environment: "world".into(),
            ..Default::default()
        }),
        keys: vec!["4".into()],
        significance: proto::Permutations::Pooled.into(),
        visits_to_decide: true,
        estimators: vec!["nsb".into(), "adjusted".into()],
        ..Default::default()
    };
    let over_grpc = app
        .influence()
        .await
        .batch_get_influence(request)
        .await
        .expect("valid")
        .into_inner();
    assert_eq!(
        over_rest,
        serde_json::to_value(dto::Answers::from(over_grpc)).expect("JSON")
    );
}

#[tokio::test]
async fn a_fit_is_kept_and_named() {
    let app = world().await;
    assert_eq!(
        answer(&app, "key=2").await["fit"],
        json!({"version": 0, "revision": 0})
    );
    let fits = fit(&app).await;
    assert_eq!(
        fits["fits"].as_array().expect("a list").len(),
        3,
        "one a pair: {fits}"
    );
    let dependent = number(&fits["fits"][0]["dependent_share"]);
    assert!(
        (0.25..0.6).contains(&dependent),
        "a third of the places depend, and a third tell little: {dependent}"
    );
    for dog in [1, 2] {
        let share = number(&fits["fits"][dog]["dependent_share"]);
        assert!(
            share < dependent && share < 0.4,
            "nobody minds the dog: {fits}"
        );
    }
    let before = answer(&app, "key=5").await;
    let app = app.restart().await;
    assert_eq!(
        answer(&app, "key=5").await,
        before,
        "a fit survives a restart to the bit"
    );
    fit(&app).await;
    assert_eq!(answer(&app, "key=5").await["fit"]["version"], 2);
}

#[tokio::test]
async fn tests_of_independence_are_made_on_request() {
    let app = world().await;
    let p = async |query: &str| number(&answer(&app, query).await["significance"]["p_value"]);
    assert!(p("key=2&significance=pooled").await < 0.001);
    assert!(p("key=2&significance=within_segments").await < 0.001);
    assert!(answer(&app, "key=2").await.get("significance").is_none());
    assert_eq!(
        p(&format!("key={PLACES}&significance=pooled")).await,
        1.0,
        "nothing seen, nothing significant"
    );
    let independent = p("key=32&significance=pooled").await;
    assert!(independent > 0.001 && independent <= 1.0, "{independent}");
    let (status, problem) = app
        .rest(
            "GET",
            &format!("{WORLD}/influence?key=2&significance=yes"),
            None,
        )
        .await;
    assert_eq!(
        (status, &problem["errors"][0]["pointer"]),
        (400, &json!("/significance"))
    );
}

#[tokio::test]
async fn entries_take_the_place_of_visits_where_they_are_known() {
    let app = world().await;
    let step = |i: u64, entry: bool| {
        let actions = json!({"robot": i % 4, "human": i % 4, "dog": 0});
        json!({"state": {"place": PLACES}, "actions": actions, "entry": entry})
    };
    // Two entries, of which each is held for twenty steps.
    let held: Vec<Value> = (0..40).map(|i| step(i / 20, i % 20 == 0)).collect();
    let body = json!({"producer": "p", "sequence": 3, "transitions": held});
    let (status, _) = app
        .rest("POST", &format!("{WORLD}/transitions"), Some(&body))
        .await;
    assert_eq!(status, 200);
    let told = answer(&app, &format!("key={PLACES}&significance=pooled")).await;
    assert_eq!(
        (&told["visits"], &told["entries"], &told["independence"]),
        (&json!(40), &json!(2), &json!("entries"))
    );
    assert_eq!(
        told["dependence"], "open",
        "forty steps of two stays are two draws"
    );
    assert_eq!(
        told["significance"]["p_value"], 1.0,
        "two draws: either order of two is as likely"
    );
}

#[tokio::test]
async fn states_are_ranked_by_what_the_counts_support() {
    let app = world().await;
    fit(&app).await;
    let page = get(&app, "states?order_by=p_dependent%20desc&page_size=7").await;
    for state in page["states"].as_array().expect("a list") {
        let place: u64 = state["state"]["key"]
            .as_str()
            .expect("a key")
            .parse()
            .expect("a place");
        assert!(
            place < DEPENDENT && state["dependence"] == "established",
            "{state}"
        );
    }
    let next = page["next_page_token"].as_str().expect("more").to_owned();
    let second = get(
        &app,
        &format!("states?order_by=p_dependent%20desc&page_size=7&page_token={next}"),
    )
    .await;
    let p = |page: &Value, at: usize| number(&page["states"][at]["probability"]["dependent"]);
    assert!(p(&page, 6) >= p(&second, 0), "the order goes on");
}

#[tokio::test]
async fn discoveries_keep_to_their_rate() {
    let app = world().await;
    fit(&app).await;
    for method in ["bayes", "bh"] {
        let page = get(
            &app,
            &format!("states?fdr=0.05&method={method}&page_size=100"),
        )
        .await;
        let found: Vec<u64> = page["states"]
            .as_array()
            .expect("a list")
            .iter()
            .map(|state| {
                state["state"]["key"]
                    .as_str()
                    .expect("a key")
                    .parse()
                    .expect("a place")
            })
            .collect();
        let wrong = found.iter().filter(|place| **place >= DEPENDENT).count();
        assert!(found.len() >= 13 && wrong <= 2, "{method}: {found:?}");
        let summary = get(&app, &format!("summary?fdr=0.05&method={method}")).await;
        assert_eq!(summary["discoveries"]["states"], found.len(), "{summary}");
        assert_eq!(page["states"][0].get("p_value").is_some(), method == "bh");
    }
    let (status, problem) = app
        .rest("GET", &format!("{WORLD}/states?fdr=1.5&method=ba"), None)
        .await;
    let pointers: Vec<&Value> = problem["errors"]
        .as_array()
        .expect("faults")
        .iter()
        .map(|f| &f["pointer"])
        .collect();
    assert_eq!(
        (status, pointers),
        (400, vec![&json!("/method"), &json!("/fdr")])
    );
}

#[tokio::test]
async fn a_graph_draws_what_is_established_and_marks_what_is_open() {
    let app = world().await;
    fit(&app).await;
    let graph = get(&app, "graph?key=2").await;
    assert_eq!(graph["nodes"], json!(["robot", "human", "dog"]));
    let edges = graph["edges"].as_array().expect("a list");
    assert_eq!(edges.len(), 3);
    assert!(
        edges
            .iter()
            .all(|edge| edge["directed"] == false && edge["lag"] == 0)
    );
    assert_eq!(edges[0]["answer"]["dependence"], "established");
    let dot = reqwest::Client::new()
        .get(app.url(&format!("{WORLD}/graph?key=2")))
        .header("accept", "text/vnd.graphviz")
        .send()
        .await
        .expect("answered");
    assert_eq!(dot.headers()["content-type"], "text/vnd.graphviz");
    let dot = dot.text().await.expect("text");
    assert!(
        dot.contains(r#""robot" -- "human" [style=solid"#) && !dot.contains("->"),
        "{dot}"
    );
    let dot = get(&app, &format!("graph?key={PLACES}")).await;
    assert_eq!(dot["edges"][0]["answer"]["dependence"], "open");
}

#[tokio::test]
async fn more_visits_are_asked_for_where_they_are_worth_most() {
    let app = world().await;
    fit(&app).await;
    let exploration = get(&app, "explore?limit=5").await;
    let trials = exploration["trials"].as_array().expect("a list");
    assert_eq!(trials.len(), 5);
    let gains: Vec<f64> = trials
        .iter()
        .map(|trial| number(&trial["information_gain"]))
        .collect();
    assert!(
        gains.is_sorted_by(|a, b| a >= b) && gains[0] > 0.0,
        "{gains:?}"
    );
    for trial in trials {
        assert!(
            number(&trial["visits"]) < 400.0,
            "what is decided needs no more: {trial}"
        );
    }
    let first = trials[0]["state"]["key"].as_str().expect("a key");
    let open = answer(&app, &format!("key={first}&visits_to_decide=true")).await;
    assert_eq!(open["verdict"], "undecided");
    let needed = open["visits_to_decide"]
        .as_u64()
        .expect("some number decides");
    assert!((1..=1_000).contains(&needed), "{needed}");
    assert!(
        answer(&app, &format!("key={first}"))
            .await
            .get("visits_to_decide")
            .is_none()
    );
}

#[tokio::test]
async fn actions_are_ranked_by_what_they_do() {
    let app = world().await;
    fit(&app).await;
    let told = answer(&app, "key=2&ego=human&other=robot").await;
    let actions = told["by_action"].as_array().expect("a list");
    assert_eq!(actions.len(), 4);
    for action in actions {
        let (mean, interval) = (number(&action["divergence"]), &action["interval"]);
        assert!(
            number(&interval[0]) < mean && mean < number(&interval[1]),
            "{action}"
        );
        let response = action["response"].as_array().expect("a list");
        assert!(
            (response.iter().map(number).sum::<f64>() - 1.0).abs() < 1e-9,
            "{action}"
        );
        let index = action["index"].as_u64().expect("an index") as usize;
        assert!(
            number(&response[index]) > 0.8,
            "the robot does what the human does: {action}"
        );
        let ends = &action["response_intervals"][index];
        assert!(
            number(&ends[0]) < number(&response[index])
                && number(&response[index]) < number(&ends[1])
        );
    }
}

#[tokio::test]
async fn an_environment_says_which_estimators_it_tells() {
    let app = world().await;
    let change = json!({"rule": {"estimators": ["nsb", "uniform_policy"]}});
    let (status, changed) = app.rest("PATCH", WORLD, Some(&change)).await;
    assert_eq!(
        (status, &changed["rule"]["estimators"]),
        (200, &json!(["nsb", "uniform_policy"]))
    );
    let told = |answer: Value| {
        let estimates = answer["mutual_information"]["estimates"]
            .as_object()
            .expect("an object")
            .clone();
        estimates.keys().cloned().collect::<Vec<String>>()
    };
    assert_eq!(told(answer(&app, "key=2").await), ["nsb", "uniform_policy"]);
    assert_eq!(
        told(answer(&app, "key=2&estimators=dirichlet").await),
        ["dirichlet"]
    );
    let wrong = json!({"rule": {"estimators": ["nsb", "best"]}});
    let (status, problem) = app.rest("PATCH", WORLD, Some(&wrong)).await;
    assert_eq!(
        (status, &problem["errors"][0]["pointer"]),
        (400, &json!("/rule/estimators/1"))
    );
}

#[tokio::test]
async fn given_others_has_a_fit_of_its_own() {
    let app = world().await;
    let (status, fits) = app
        .rest(
            "POST",
            &format!("{WORLD}/fit?ego=human&other=robot&given=dog"),
            None,
        )
        .await;
    assert_eq!((status, &fits["fits"][0]["given"]), (200, &json!(["dog"])));
    let told = answer(&app, "key=2&given=dog").await;
    assert_eq!(
        (&told["fit"]["version"], &told["dependence"]),
        (&json!(1), &json!("established"))
    );
    assert_eq!(answer(&app, "key=2").await["fit"]["version"], 0);
}
