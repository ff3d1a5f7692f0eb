//! Questions with a lag (transfer entropy) on every face: a follower that was planted and counted
//! through the service is found at its lag, by the same figures as the core has of the same tables,
//! and what cannot be asked is refused everywhere in the same words.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use nudge::api::{json as dto, proto};
use nudge::domain::{
    Acknowledged, Batch, Entry, Environment, Pair, Record, Records, Sequence, Widths,
};
use nudge::evidence::{Counted, Fit, Habits, Prior};
use nudge::information::{self, Alphabet, Table};
use nudge::priors::PriorRegistry;
use nudge::recordings::overcooked;
use nudge::simulation::planted::lagged::{Hold, Options, Step, Tracks, World};
use nudge::tracks::{self, EntryRule, Track};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::TestApp;

/// The lag at which the follower copies, in the first two of four states.
pub const LAG: usize = 3;
const NEAR: usize = 2;
const STATES: usize = 4;

/// Actions of each agent.
const LETTERS: u64 = 4;

const PATH: &str = "/v1/environments/street";

/// How close figures are that are sums in another order.
const TOLERANCE: f64 = 1e-12;

/// Returns the steps of every track: the leader is agent 0.
fn played() -> Vec<Vec<Step>> {
    let world = World {
        name: "copies",
        lag: Some(LAG),
        hold: Hold::Free,
        roams: None,
        shuffled: false,
    };
    let options = Options {
        letters: LETTERS as usize,
        states: STATES,
        near: NEAR,
        copied: 0.6,
        ..Options::default()
    };
    Tracks::new(world, options).take(40).collect()
}

fn description() -> Value {
    let integer = |name: &str, most: u64| json!({"name": name, "integer": {"min": 0, "max": most}});
    let agent = |name: &str| json!({"name": name, "action": [integer("act", LETTERS - 1)]});
    json!({
        "state": [integer("place", STATES as u64 - 1)],
        "agents": [agent("leader"), agent("follower")],
        "lags": [1, 2, 3, 4],
    })
}

/// Returns a service that counted every track, a segment each.
pub async fn street() -> TestApp {
    let app = TestApp::start().await;
    let made = app.rest("PUT", PATH, Some(&description())).await;
    assert_eq!(made.0, 201, "{}", made.1);

    let environment = app.app.environments.find("street").expect("made");
    for (sequence, track) in (1..).zip(played()) {
        let mut followed = Track::new(&environment.schema);
        let step = |step: &Step| {
            let actions = step.actions.map(|action| action as f32).to_vec();
            tracks::Step::new(vec![step.state as f32], actions)
        };
        let mut records: Vec<Record> = track
            .iter()
            .filter_map(|one| followed.step(step(one)))
            .collect();
        records.extend(followed.end());
        write(&app, &environment, sequence, records).await;
    }
    app
}

async fn write(app: &TestApp, environment: &Arc<Environment>, sequence: u64, records: Vec<Record>) {
    let widths = Widths::of_schema(&environment.schema);
    let batch = Batch {
        sequence: Sequence::new(sequence).expect("above 0"),
        segment: None,
        records: Records::collect(widths, records.into_iter().map(Ok)),
    };
    let told = app
        .app
        .ingest
        .write(environment, "test".parse().expect("a producer"), batch)
        .await
        .expect("counted");
    assert!(matches!(told, Acknowledged::Applied(receipt) if receipt.rejected_count == 0));
}

/// The tables of one state as they follow from the tracks themselves: of each action that the other
/// took a step before it is observed; over all visits, and over entries.
#[derive(Default)]
struct Expected {
    visits: BTreeMap<u64, Vec<(u64, u64, u64)>>,
    entries: BTreeMap<u64, Vec<(u64, u64, u64)>>,
}

impl Expected {
    fn of(ego: usize, lag: usize, state: usize) -> Self {
        let (other, mut expected) = (1 - ego, Self::default());
        for track in played() {
            let mut rule = EntryRule::new([LETTERS; 2]);
            for (at, step) in track.iter().enumerate() {
                let entry = rule.entry(&step.state, &step.actions.map(Some));
                let Some(later) = track.get(at + lag) else {
                    continue;
                };
                if step.state != state {
                    continue;
                }
                let own = lag.checked_sub(1).map(|before| track[at + before]);
                let own = own.map_or(0, |step| step.actions[other]);
                let cell = (step.actions[ego], later.actions[other], 1);
                expected.visits.entry(own).or_default().push(cell);
                if entry == Entry::Entered {
                    expected.entries.entry(own).or_default().push(cell);
                }
            }
        }
        expected
    }

    fn tables(cells: &BTreeMap<u64, Vec<(u64, u64, u64)>>) -> Vec<Table> {
        cells
            .values()
            .map(|cells| Table::from_counts(cells.iter().copied()))
            .collect()
    }
}

fn totals(tables: &[Table]) -> u64 {
    tables.iter().map(Table::total).sum()
}

fn figure(of: &Value, pointer: &str) -> f64 {
    of.pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("{pointer}: {of}"))
}

fn near(told: f64, expected: f64, what: &str) {
    assert!(
        (told - expected).abs() <= TOLERANCE,
        "{what}: {told}, not {expected}"
    );
}

pub async fn run(app: &TestApp, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
}

/// Asks all there is of state 0 in one call of gRPC, and by the command with `asked`: both answer as
/// REST did.
pub async fn assert_same_by_grpc_and_command(
    app: &TestApp,
    scope: proto::Scope,
    asked: &[&str],
    over_rest: &Value,
) {
    let request = proto::BatchGetInfluenceRequest {
        scope: Some(scope),
        keys: vec!["0".into()],
        view: proto::View::Full.into(),
        significance: proto::Permutations::Auto.into(),
        visits_to_decide: true,
        estimators: vec!["nsb".into()],
        ..proto::BatchGetInfluenceRequest::default()
    };
    let over_grpc = app.influence().await.batch_get_influence(request).await;
    let over_grpc = dto::Answers::from(over_grpc.expect("valid").into_inner());
    assert_eq!(&serde_json::to_value(over_grpc).expect("JSON"), over_rest);

    let more = [
        "--significance",
        "auto",
        "--visits-to-decide",
        "--estimators",
        "nsb",
        "--json",
    ];
    let (code, by_command, stderr) = run(app, &[asked, &more].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    let by_command: Value = serde_json::from_str(&by_command).expect("JSON");
    assert_eq!(&by_command, over_rest);
}

const BOTH: [[&str; 2]; 2] = [["leader", "follower"], ["follower", "leader"]];

#[tokio::test(flavor = "multi_thread")]
async fn a_follower_is_found_at_its_lag_and_at_no_other() {
    let app = street().await;
    for (at, [ego, other]) in BOTH.into_iter().enumerate() {
        for lag in 0..=4 {
            let pair = format!("ego={ego}&other={other}&lag={lag}");
            let fitted = app.rest("POST", &format!("{PATH}/fit?{pair}"), None).await;
            assert_eq!(fitted.0, 200, "{}", fitted.1);
            for state in 0..STATES {
                let told = app
                    .get(&format!("{PATH}/influence?{pair}&key={state}"))
                    .await;
                let answer = &told["answers"][0];
                // At lag 0 both directions have one, which is made twice.
                let version = if lag == 0 { at + 1 } else { 1 };
                assert_eq!(answer["fit"]["version"], json!(version), "{pair}");
                let is_planted = at == 0 && lag == LAG && state < NEAR;
                let dependent = figure(answer, "/probability/dependent");
                assert_eq!(
                    dependent >= 0.95,
                    is_planted,
                    "{pair} in {state}: {dependent}"
                );
            }
        }
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn figures_are_those_of_the_core_on_the_same_tables() {
    let (app, draws) = (street().await, draws());
    for (at, [ego, other]) in BOTH.into_iter().enumerate() {
        for (lag, state) in [(1, 0), (2, 3), (3, 0), (3, 1), (3, 2), (4, 1)] {
            let expected = Expected::of(at, lag, state);
            let query = format!("ego={ego}&other={other}&lag={lag}&key={state}&estimators=nsb");
            let told = app.get(&format!("{PATH}/influence?{query}")).await;
            let answer = &told["answers"][0];

            let tables = Expected::tables(&expected.visits);
            assert_eq!(answer["visits"], json!(totals(&tables)), "{query}");
            let plug_in = information::conditional(&tables, information::plug_in);
            near(
                figure(answer, "/mutual_information/plug_in"),
                plug_in,
                &query,
            );
            let independent = information::conditional(&tables, |table| {
                information::expected_if_independent(table).0
            });
            let said = figure(answer, "/mutual_information/expected_if_independent");
            near(said, independent, &query);
            let alphabet = Alphabet {
                rows: LETTERS,
                columns: LETTERS,
            };
            let nsb = information::conditional(&tables, |table| information::nsb(table, alphabet));
            near(
                figure(answer, "/mutual_information/estimates/nsb"),
                nsb,
                &query,
            );

            // Nothing was fitted: the evidence is of the cold prior, and of how often each agent
            // does what now.
            let strata = Expected::tables(&expected.entries);
            assert_eq!(answer["entries"], json!(totals(&strata)), "{query}");
            assert_eq!(answer["fit"]["version"], json!(0));
            let habits = Habits::new(&draws[at], &draws[1 - at]);
            let prior = Prior::new(&Fit::cold(alphabet));
            let counted = Counted {
                slices: &strata,
                parts: &[],
            };
            let posterior = prior.posterior(&habits, counted);
            near(
                figure(answer, "/mutual_information/posterior_mean"),
                posterior.mean(),
                &query,
            );
            let dependent = posterior.beliefs(0.5).dependent;
            near(figure(answer, "/probability/dependent"), dependent, &query);

            assert_eq!(
                (&answer["lag"], &answer["directed"]),
                (&json!(lag), &json!(true))
            );
            assert_eq!(told["labels"]["ego"]["name"], json!(ego));
            assert_eq!(
                told["labels"]["other"]["name"],
                json!(format!("{other}@{lag}"))
            );
            let own = match lag {
                1 => other.to_owned(),
                lag => format!("{other}@{}", lag - 1),
            };
            assert_eq!(told["labels"]["given"][0]["name"], json!(own));
        }
    }
    app.stop().await;
}

/// Returns how often each agent took each action in the steps that were entries.
fn draws() -> [Vec<u64>; 2] {
    let mut draws = [(); 2].map(|()| vec![0; LETTERS as usize]);
    for track in played() {
        let mut rule = EntryRule::new([LETTERS; 2]);
        for step in track {
            if rule.entry(&step.state, &step.actions.map(Some)) == Entry::Entered {
                step.actions
                    .iter()
                    .enumerate()
                    .for_each(|(agent, action)| draws[agent][*action as usize] += 1);
            }
        }
    }
    draws
}

#[tokio::test(flavor = "multi_thread")]
async fn every_face_tells_the_same_at_a_lag() {
    let app = street().await;
    let query = "lag=3&key=0&significance=auto&visits_to_decide=true&estimators=nsb";
    let over_rest = app.get(&format!("{PATH}/influence?{query}")).await;
    let body = json!({"lag": 3, "keys": ["0"], "significance": "auto", "visits_to_decide": true, "estimators": ["nsb"]});
    let posted = app
        .rest("POST", &format!("{PATH}/influence"), Some(&body))
        .await;
    assert_eq!(posted, (200, over_rest.clone()));

    let scope = proto::Scope {
        environment: "street".into(),
        lag: 3,
        ..proto::Scope::default()
    };
    let asked = ["query", "street", "--key", "0", "--lag", "3"];
    assert_same_by_grpc_and_command(&app, scope, &asked, &over_rest).await;

    let (code, text, stderr) = run(&app, &asked).await;
    assert_eq!(code, 0, "{stderr}");
    let heading = "street: leader on follower@3 given follower@2, 3 steps later";
    assert_eq!(text.lines().next(), Some(heading));
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lag_of_nothing_is_the_same_tick_as_ever() {
    let started = street().await;
    let app = &started;
    let paths = [
        "influence?key=0",
        "states?page_size=2",
        "summary?fdr=0.1",
        "explore?limit=2",
        "graph?key=0",
    ];
    for path in paths {
        let without = app.get(&format!("{PATH}/{path}")).await;
        for lag in ["&lag=0", "&lag="] {
            assert_eq!(
                app.get(&format!("{PATH}/{path}{lag}")).await,
                without,
                "{path}{lag}"
            );
        }
    }
    let answer = app.get(&format!("{PATH}/influence?key=0")).await["answers"][0].clone();
    assert_eq!(
        (&answer["lag"], &answer["directed"]),
        (&json!(0), &json!(false))
    );

    let to = format!("{PATH}/influence");
    let to = &to;
    let posted = |body: Value| async move { app.rest("POST", to, Some(&body)).await };
    let without = posted(json!({"keys": ["0"]})).await;
    for lag in [json!(0), json!(null)] {
        assert_eq!(posted(json!({"keys": ["0"], "lag": lag})).await, without);
    }
    started.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_asked_is_refused_in_the_same_words() {
    let app = street().await;
    let declared = "expected 0 or a lag that is declared for follower: 1, 2, 3, 4";
    let later = "observed 3 steps after the actions: what comes later influences nothing before it";
    let cases = [
        (
            ["leader", "follower", "5"],
            "/lag",
            format!("got 5, {declared}"),
        ),
        (
            ["leader", "follower", "-2"],
            "/lag",
            format!(
                "got -2: leader would be observed after follower, and what comes later influences nothing before it; {declared}. Exchange ego and other for the other direction"
            ),
        ),
        (
            ["follower@3", "leader", "0"],
            "/ego",
            format!("got \"follower@3\", which is {later}, expected one of leader, follower"),
        ),
        (
            ["leader", "follower@3", "0"],
            "/other",
            "got \"follower@3\", expected \"follower\" with the lag 3 beside it".into(),
        ),
    ];
    for ([ego, other, lag], pointer, detail) in cases {
        let pair = format!("ego={ego}&other={other}&lag={lag}");
        let expected = json!([{"pointer": pointer, "detail": detail}]);
        for path in [
            "influence?key=0&",
            "states?",
            "states?fdr=0.1&",
            "summary?",
            "explore?",
        ] {
            let (status, told) = app.rest("GET", &format!("{PATH}/{path}{pair}"), None).await;
            assert_eq!((status, &told["errors"]), (400, &expected), "{path}{pair}");
        }
        let (status, told) = app.rest("POST", &format!("{PATH}/fit?{pair}"), None).await;
        assert_eq!((status, &told["errors"]), (400, &expected), "{pair}");
        let lag: i32 = lag.parse().expect("a number");
        let body = json!({"ego": ego, "other": other, "lag": lag, "keys": ["0"]});
        let (status, told) = app
            .rest("POST", &format!("{PATH}/influence"), Some(&body))
            .await;
        assert_eq!((status, &told["errors"]), (400, &expected), "{pair}");

        let scope = proto::Scope {
            environment: "street".into(),
            ego: ego.into(),
            other: other.into(),
            lag,
            ..proto::Scope::default()
        };
        let request = proto::ListStatesRequest {
            scope: Some(scope),
            ..proto::ListStatesRequest::default()
        };
        let refused = app.influence().await.list_states(request).await;
        let refused = refused.expect_err("refused");
        assert_eq!(refused.code(), tonic::Code::InvalidArgument);
        assert!(refused.message().contains(&detail), "{}", refused.message());

        let lag = lag.to_string();
        let arguments = [
            "query", "street", "--key", "0", "--ego", ego, "--other", other, "--lag", &lag,
        ];
        let (code, _, stderr) = run(&app, &arguments).await;
        assert_eq!(code, 1, "{stderr}");
        assert!(stderr.contains(&detail), "{stderr}");
    }

    let (status, told) = app
        .rest("GET", &format!("{PATH}/graph?key=0&lag=5"), None)
        .await;
    assert_eq!(
        (status, &told["errors"][0]["pointer"]),
        (400, &json!("/lag"))
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_all_states_say_is_at_the_lag_that_is_asked_for() {
    let app = street().await;
    app.rest("POST", &format!("{PATH}/fit?lag=3"), None).await;
    for [order, more] in [
        ["visits desc", ""],
        ["p_dependent desc", ""],
        ["plug_in asc", "&min_visits=1"],
    ] {
        let page = app
            .get(&format!("{PATH}/states?lag=3&order_by={order}{more}"))
            .await;
        let states = page["states"].as_array().expect("a list");
        assert_eq!(states.len(), STATES);
        for state in states {
            let key = state["state"]["key"].as_str().expect("a key");
            let answer =
                app.get(&format!("{PATH}/influence?lag=3&key={key}")).await["answers"][0].clone();
            assert_eq!(state["visits"], answer["visits"], "{order}");
            assert_eq!(state["plug_in"], answer["mutual_information"]["plug_in"]);
            assert_eq!(state["probability"], answer["probability"]);
        }
    }

    // Discoveries are the near states, at that lag alone.
    let keys = |page: Value| -> Vec<String> {
        let states = page["states"].as_array().expect("a list").iter();
        let mut keys: Vec<String> = states
            .map(|one| one["state"]["key"].as_str().expect("a key").into())
            .collect();
        keys.sort_unstable();
        keys
    };
    for method in ["bayes", "bh"] {
        let found = |lag: usize| format!("{PATH}/states?lag={lag}&fdr=0.01&method={method}");
        assert_eq!(keys(app.get(&found(3)).await), ["0", "1"], "{method}");
        assert_eq!(keys(app.get(&found(2)).await), [""; 0], "{method}");
        let summary = app
            .get(&format!("{PATH}/summary?lag=3&fdr=0.01&method={method}"))
            .await;
        assert_eq!(summary["discoveries"]["states"], json!(NEAR));
        // Each track's last steps have no such outcome.
        let carried = played()
            .iter()
            .map(|track| track.len() - LAG)
            .sum::<usize>();
        assert_eq!(summary["transitions"], json!(carried));
    }

    let explored = |lag: usize| {
        format!("{PATH}/explore?lag={lag}&limit=3&rule.threshold=0.02&rule.confidence=0.999999")
    };
    let told = app.get(&explored(2)).await;
    let trial = &told["trials"][0];
    let key = trial["state"]["key"].as_str().expect("a key");
    let answer = app.get(&format!("{PATH}/influence?lag=2&key={key}")).await;
    assert_eq!(trial["visits"], answer["answers"][0]["visits"], "{told}");
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn graphs_have_arrows_at_a_lag() {
    let app = street().await;
    let over_rest = app.get(&format!("{PATH}/graph?key=0&lag=3")).await;
    let edges = over_rest["edges"].as_array().expect("a list");
    let told: Vec<_> = edges
        .iter()
        .map(|edge| [&edge["from"], &edge["to"], &edge["lag"], &edge["directed"]].map(Value::clone))
        .collect();
    let edge = |[from, to]: [&str; 2]| [json!(from), json!(to), json!(3), json!(true)];
    assert_eq!(told, BOTH.map(edge));
    assert_eq!(edges[0]["kind"], json!("direct"));
    assert_ne!(edges[1]["kind"], json!("direct"));
    let answer = app
        .get(&format!("{PATH}/influence?key=0&lag=3&view=figures"))
        .await;
    assert_eq!(edges[0]["answer"], answer["answers"][0]);

    let request = proto::GetGraphRequest {
        environment: "street".into(),
        state: Some(proto::get_graph_request::State::Key("0".into())),
        lag: 3,
        ..proto::GetGraphRequest::default()
    };
    let over_grpc = app.influence().await.get_graph(request).await;
    let over_grpc = over_grpc.expect("valid").into_inner();
    assert!(
        over_grpc.dot.starts_with("digraph \"0\" {"),
        "{}",
        over_grpc.dot
    );
    assert!(
        over_grpc
            .dot
            .contains("\"leader\" -> \"follower\" [style=solid"),
        "{}",
        over_grpc.dot
    );
    assert!(!over_grpc.dot.contains("--"), "{}", over_grpc.dot);
    assert_eq!(
        serde_json::to_value(dto::Graph::from(over_grpc)).expect("JSON"),
        over_rest
    );

    let asked = ["query", "street", "--key", "0", "--lag", "3", "--graph"];
    let (code, by_cli, stderr) = run(&app, &[&asked[..], &["--json"]].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(
        serde_json::from_str::<Value>(&by_cli).expect("JSON"),
        over_rest
    );
    let (_, text, _) = run(&app, &asked).await;
    assert!(
        text.starts_with("street: who depends on whom, 3 steps later"),
        "{text}"
    );
    assert!(text.contains("leader -> follower"), "{text}");
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_lag_and_each_direction_has_a_fit_of_its_own() {
    let app = street().await;
    let (status, told) = app.rest("POST", &format!("{PATH}/fit?lag=3"), None).await;
    assert_eq!(status, 200, "{told}");
    let fit = &told["fits"][0];
    assert_eq!(
        [&fit["earlier"], &fit["later"], &fit["lag"], &fit["states"]],
        [
            &json!("leader"),
            &json!("follower"),
            &json!(3),
            &json!(STATES)
        ]
    );
    let every = app.rest("POST", &format!("{PATH}/fit"), None).await.1;
    assert_eq!(every["fits"].as_array().map(Vec::len), Some(1));
    assert_eq!(every["fits"][0].get("lag"), None);

    let back = "ego=follower&other=leader&";
    let versions = [
        ("lag=3&", 1),
        ("", 1),
        ("lag=2&", 0),
        ("ego=follower&other=leader&lag=3&", 0),
    ];
    async fn version(app: &TestApp, pair: &str) -> Value {
        let told = app.get(&format!("{PATH}/influence?{pair}key=0")).await;
        told["answers"][0]["fit"]["version"].clone()
    }
    for (pair, expected) in versions {
        assert_eq!(version(&app, pair).await, json!(expected), "{pair}");
    }
    // At lag 0 one serves both directions. Each is kept beside the counts.
    assert_eq!(version(&app, back).await, json!(1));
    let app = app.restart().await;
    for (pair, expected) in versions {
        assert_eq!(version(&app, pair).await, json!(expected), "{pair}");
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lag_that_is_asked_for_is_kept_up_in_the_background() {
    let app = street().await;
    let environment = app.app.environments.find("street").expect("made");
    let registry = PriorRegistry::new(app.app.store.clone());
    let pair = Pair::new(0, 1, Vec::new());
    let [asked, other] = [3, 2].map(|lag| pair.at_lag(&environment.schema, lag).expect("declared"));
    registry.informed(&environment, &asked).await.expect("read");
    registry.keep_up_once(Instant::now()).await;
    for (pair, version) in [(asked, 1), (other, 0), (pair, 0)] {
        let fitted = registry.get(&environment, &pair).await.expect("read");
        assert_eq!(fitted.expect("small").id.version, version, "{pair:?}");
    }
    app.stop().await;
}

#[tokio::test]
async fn pages_by_visits_count_those_that_tell_of_the_pair() {
    let app = TestApp::start().await;
    let mut description = description();
    description["agents"][1]["may_be_absent"] = json!(true);
    description["lags"] = json!([1]);
    assert_eq!(app.rest("PUT", PATH, Some(&description)).await.0, 201);

    // State 0 is seen most, 1 by both agents most, and 2 alone has what the follower does next.
    let seen = |place: u64, follower: Value, next: Value, count: u64| {
        json!({"state": {"place": place}, "actions": {"leader": 1, "follower": follower},
            "outcomes": {"follower@1": next}, "count": count})
    };
    let transitions = [
        seen(0, json!(null), json!(null), 90),
        seen(0, json!(0), json!(null), 2),
        seen(1, json!(0), json!(null), 9),
        seen(2, json!(0), json!(3), 5),
        seen(3, json!(null), json!(null), 50),
    ];
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions});
    let (status, told) = app
        .rest("POST", &format!("{PATH}/transitions"), Some(&body))
        .await;
    assert_eq!((status, &told["accepted"]), (200, &json!(5)), "{told}");

    // A page after the other, as a ranking would have it, whether one was made or not.
    for (lag, expected) in [(0, vec![("1", 9), ("2", 5), ("0", 2)]), (1, vec![("2", 5)])] {
        let (mut listed, mut token) = (Vec::new(), String::new());
        loop {
            let page = format!("{PATH}/states?lag={lag}&page_size=1&page_token={token}");
            let page = app.get(&page).await;
            let states = page["states"].as_array().expect("a list").clone();
            listed.extend(states.into_iter().map(|one| {
                let key = one["state"]["key"].as_str().expect("a key").to_owned();
                (key, one["visits"].as_u64().expect("a number"))
            }));
            match page["next_page_token"].as_str() {
                Some(next) if !next.is_empty() => token = next.to_owned(),
                _ => break,
            }
        }
        let listed: Vec<(&str, u64)> = listed.iter().map(|(key, n)| (key.as_str(), *n)).collect();
        assert_eq!(listed, expected, "lag {lag}");
    }
    app.stop().await;
}

/// Returns numbers below a bound, always the same ones.
fn chance() -> impl FnMut(u64) -> u64 {
    let mut random = StdRng::seed_from_u64(3);
    move |below| random.random_range(0..below)
}

/// A singer whom a dancer joins at once, mostly, and the crowd one step later, mostly: the dancer
/// seems to move the crowd.
fn concert() -> Vec<[u64; 3]> {
    let mut next = chance();
    let mut sung = 0;
    let step = |_| {
        let singer = next(3);
        let dancer = if next(5) == 0 { next(3) } else { singer };
        let crowd = if next(5) == 0 { next(3) } else { sung };
        sung = singer;
        [singer, dancer, crowd]
    };
    (0..1_200).map(step).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn what_another_explains_at_a_lag_is_no_influence() {
    let app = TestApp::start().await;
    let feature = |name: &str| json!({"name": name, "integer": {"min": 0, "max": 2}});
    let agent = |name: &str| json!({"name": name, "action": [feature("act")]});
    let agents = ["singer", "dancer", "crowd"];
    let description =
        json!({"state": [feature("place")], "agents": agents.map(agent), "lags": [1]});
    assert_eq!(app.rest("PUT", PATH, Some(&description)).await.0, 201);

    let environment = app.app.environments.find("street").expect("made");
    let mut track = Track::of_rounds(&environment.schema);
    let step = |actions: &[u64; 3]| {
        let actions = actions.map(|action| action as f32).to_vec();
        tracks::Step::new(vec![0.0], actions)
    };
    let played = concert();
    let mut records: Vec<Record> = played
        .iter()
        .filter_map(|one| track.step(step(one)))
        .collect();
    records.extend(track.end());
    write(&app, &environment, 1, records).await;

    let graph = app.get(&format!("{PATH}/graph?key=0&lag=1")).await;
    let edges = graph["edges"].as_array().expect("a list");
    assert_eq!(edges.len(), 6, "in both directions");
    for edge in edges {
        let (from, to) = (edge["from"].as_str(), edge["to"].as_str());
        let expected = match (from, to) {
            (Some("singer"), Some("crowd")) => ("direct", json!([])),
            (Some("dancer"), Some("crowd")) => ("explained", json!(["singer"])),
            _ => ("absent", json!([])),
        };
        if expected.0 != "absent" {
            let told = (
                edge["kind"].as_str().expect("a word"),
                edge["explained_by"].clone(),
            );
            assert_eq!(told, expected, "{from:?} {to:?}");
        }
        assert_eq!(
            edge["kind"] == "direct",
            expected.0 == "direct",
            "{from:?} {to:?}"
        );
    }

    // Held fixed by hand: the same tables as the core's, beside what the crowd did before.
    let query = "ego=dancer&other=crowd&lag=1&key=0";
    for (given, names) in [("", vec!["crowd"]), ("singer", vec!["singer", "crowd"])] {
        let told = app
            .get(&format!("{PATH}/influence?{query}&given={given}"))
            .await;
        let fixed = told["labels"]["given"].as_array().expect("a list").iter();
        let fixed: Vec<&Value> = fixed.map(|one| &one["name"]).collect();
        assert_eq!(fixed, names);

        let mut strata: BTreeMap<[u64; 2], Vec<(u64, u64, u64)>> = BTreeMap::new();
        for pair in played.windows(2) {
            let [now, later] = [pair[0], pair[1]];
            let singer = if given.is_empty() { 0 } else { now[0] };
            let cells = strata.entry([singer, now[2]]).or_default();
            cells.push((now[1], later[2], 1));
        }
        let tables: Vec<Table> = strata.into_values().map(Table::from_counts).collect();
        let plug_in = information::conditional(&tables, information::plug_in);
        let answer = &told["answers"][0];
        near(
            figure(answer, "/mutual_information/plug_in"),
            plug_in,
            given,
        );
        let dependent = figure(answer, "/probability/dependent");
        assert_eq!(
            dependent > 0.95,
            given.is_empty(),
            "given {given:?}: {dependent}"
        );
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn odd_alphabets_are_asked_about_at_a_lag() {
    let app = TestApp::start().await;
    for letters in [[1, 2], [2, 1], [3, 25], [256, 3], [300, 2]] {
        let path = format!("/v1/environments/odd-{}-{}", letters[0], letters[1]);
        // Labels that read as other numbers than their index.
        let labels = |letters: u64| (0..letters).map(move |at| (letters - at).to_string());
        let agent = |name: &str, letters: u64| {
            let labels: Vec<String> = labels(letters).collect();
            json!({"name": name, "action": [{"name": "act", "categorical": {"labels": labels}}]})
        };
        let description = json!({
            "state": [{"name": "place", "integer": {"min": 0, "max": 1}}],
            "agents": [agent("a", letters[0]), agent("b", letters[1])],
            "outcomes": [{"agent": "b", "lag": 2}],
        });
        assert_eq!(app.rest("PUT", &path, Some(&description)).await.0, 201);

        let mut next = chance();
        let mut cells = Vec::new();
        let transition = |at: u64| {
            let [a, b, later] = [letters[0], letters[1], letters[1]].map(&mut next);
            let outcome = if at.is_multiple_of(3) {
                json!(null)
            } else {
                json!((letters[1] - later).to_string())
            };
            if !outcome.is_null() {
                cells.push((b, (a, later, 1)));
            }
            json!({"state": {"place": 0}, "actions": {"a": (letters[0] - a).to_string(), "b": letters[1] - b},
                "outcomes": {"b@2": outcome}})
        };
        let transitions: Vec<Value> = (0..90).map(transition).collect();
        let body = json!({"producer": "p", "sequence": 1, "transitions": transitions});
        let (status, told) = app
            .rest("POST", &format!("{path}/transitions"), Some(&body))
            .await;
        assert_eq!(
            (status, &told["rejected_count"]),
            (200, &json!(0)),
            "{told}"
        );

        let told = app.get(&format!("{path}/influence?lag=2&key=0")).await;
        let answer = &told["answers"][0];
        assert_eq!(
            (&answer["visits"], &answer["lag"]),
            (&json!(60), &json!(2)),
            "{path}"
        );
        // Its action at lag 1 is not declared: what it does now is held fixed instead.
        assert_eq!(told["labels"]["given"][0]["name"], json!("b"));
        let mut strata: BTreeMap<u64, Vec<(u64, u64, u64)>> = BTreeMap::new();
        cells
            .iter()
            .for_each(|(own, cell)| strata.entry(*own).or_default().push(*cell));
        let tables: Vec<Table> = strata.into_values().map(Table::from_counts).collect();
        let plug_in = information::conditional(&tables, information::plug_in);
        near(
            figure(answer, "/mutual_information/plug_in"),
            plug_in,
            &path,
        );

        let unseen = app.get(&format!("{path}/influence?lag=2&key=1")).await;
        assert_eq!(
            unseen["answers"][0]["basis"],
            json!({"kind": "prior"}),
            "{path}"
        );
        // Every pair of actions is looked at many times where something is to be tried: only small
        // alphabets are done with while a test waits.
        let explored = (letters[0] < 100).then_some("explore?lag=2");
        let others = ["states?lag=2", "summary?lag=2&fdr=0.1", "graph?lag=2&key=0"];
        for more in others.into_iter().chain(explored) {
            app.get(&format!("{path}/{more}")).await;
        }
    }
    app.stop().await;
}

/// Returns a file of the first games of the recording on one layout, and their lengths.
fn games(layout: &str, games: usize) -> (tempfile::NamedTempFile, Vec<usize>) {
    let (_, bytes) = overcooked::embedded()[1];
    let text = overcooked::decompressed(bytes).expect("it comes with the program");
    let text = std::str::from_utf8(&text).expect("text");
    let (header, rows) = text.split_once('\n').expect("lines");

    let mut lengths: Vec<(&str, usize)> = Vec::new();
    let mut kept = vec![header];
    for row in rows
        .lines()
        .filter(|row| row.starts_with(&format!("{layout},")))
    {
        let trial = row.split(',').nth(1).expect("a trial");
        let is_next = lengths.last().is_none_or(|(last, _)| *last != trial);
        if is_next && lengths.len() == games {
            break;
        }
        if is_next {
            lengths.push((trial, 0));
        }
        lengths.last_mut().expect("a game").1 += 1;
        kept.push(row);
    }
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), kept.join("\n") + "\n").expect("written");
    (file, lengths.into_iter().map(|(_, steps)| steps).collect())
}

#[tokio::test(flavor = "multi_thread")]
async fn recorded_play_is_sent_with_its_lags() {
    let app = TestApp::start().await;
    let (file, lengths) = games("cramped_room", 2);
    let path = file.path().to_str().expect("text");
    let ingest = ["ingest", "--format", "overcooked", path, "--json"];
    let steps: usize = lengths.iter().sum();

    for accepted in [steps, 0] {
        let (code, stdout, stderr) = run(&app, &ingest).await;
        assert_eq!(code, 0, "{stderr}");
        let report: Value = serde_json::from_str(&stdout).expect("JSON");
        assert_eq!(report["environments"][0]["accepted"], json!(accepted));
    }
    let room = app.get("/v1/environments/cramped_room").await;
    assert_eq!(room["state"][0]["name"], json!("player_0.x"));
    assert_eq!(room["outcomes"].as_array().map(Vec::len), Some(2 * 12 + 2));
    let [x, y] =
        ["x", "y"].map(|axis| json!([format!("player_1.{axis}"), format!("player_0.{axis}")]));
    let derived = json!([
        {"name": "dx", "difference": x},
        {"name": "dy", "difference": y},
        {"name": "distance", "manhattan": [x, y]},
    ]);
    assert_eq!(room["derived"], derived);
    // Whoever changed them is not overruled.
    let none = json!({"derived": []});
    let (status, changed) = app
        .rest("PATCH", "/v1/environments/cramped_room", Some(&none))
        .await;
    assert_eq!((status, changed.get("derived")), (200, None));
    let (code, _, stderr) = run(&app, &ingest).await;
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(app.get("/v1/environments/cramped_room").await, changed);
    for lag in [0, 1, 12] {
        let summary = app
            .get(&format!("/v1/environments/cramped_room/summary?lag={lag}"))
            .await;
        let carried: usize = lengths.iter().map(|steps| steps - lag).sum();
        assert_eq!(summary["transitions"], json!(carried), "lag {lag}");
    }

    // What the help says to try.
    let (_, help, _) = run(&app, &["--help"]).await;
    let line = help
        .lines()
        .find_map(|line| line.trim().strip_prefix("nudge query "));
    let query: Vec<&str> = line.expect("an example").split(' ').collect();
    let (code, stdout, stderr) = run(&app, &[&["query"], &query[..]].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    assert!(stdout.contains("3 steps later"), "{stdout}");

    // Where there are none, nothing is sent, and a line says what to do.
    let none = ["--lags", "none", "--name", "before"];
    let (code, _, stderr) = run(&app, &[&ingest[..], &none].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    let before = "before.cramped_room";
    let told = app.get(&format!("/v1/environments/{before}")).await;
    assert_eq!(told["state"][0]["name"], json!("player_0.position"));
    assert_eq!(told.get("derived"), None);
    let (code, _, stderr) = run(&app, &[&ingest[..], &["--name", "before"]].concat()).await;
    let line = format!(
        "error: `{before}` is there without outcomes, which are fixed with an environment: give --lags none to send it as it is, or --name NAME for another\n"
    );
    assert_eq!((code, stderr), (2, line));
    let again = run(&app, &[&ingest[..], &none].concat()).await;
    assert_eq!(again.0, 0, "{}", again.2);

    let (code, _, stderr) = run(&app, &[&ingest[..], &["--lags", "0"]].concat()).await;
    assert_eq!(code, 2);
    assert!(
        stderr.contains("expected none, or lags from 1 to 64"),
        "{stderr}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_hallway_is_sent_with_its_lags() {
    let app = TestApp::start().await;
    let simulate = [
        "simulate",
        "hallway",
        "--trials",
        "1",
        "--pedestrians",
        "4",
        "--lags",
        "1..2",
    ];
    let (code, _, stderr) = run(&app, &simulate).await;
    assert_eq!(code, 0, "{stderr}");

    // What is written to a file says the same.
    let (code, lines, stderr) = run(&app, &[&simulate[..], &["--out", "-"]].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    let mut description = app.get("/v1/environments/hallway").await;
    for member in ["name", "uid", "schema_hash"] {
        description
            .as_object_mut()
            .expect("an object")
            .remove(member);
    }
    let written = "/v1/environments/written";
    assert_eq!(app.rest("PUT", written, Some(&description)).await.0, 201);
    let transitions: Vec<Value> = lines
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions});
    let (status, told) = app
        .rest("POST", &format!("{written}/transitions"), Some(&body))
        .await;
    assert_eq!(
        (status, &told["rejected_count"]),
        (200, &json!(0)),
        "{told}"
    );

    for lag in 0..=2 {
        let visits = |environment: &str| {
            format!("/v1/environments/{environment}/states?lag={lag}&page_size=1000")
        };
        let (sent, written) = (
            app.get(&visits("hallway")).await,
            app.get(&visits("written")).await,
        );
        assert!(
            sent["states"]
                .as_array()
                .is_some_and(|states| states.len() > 10),
            "{sent}"
        );
        assert_eq!(sent["states"], written["states"], "lag {lag}");
    }

    let none = [
        "simulate",
        "hallway",
        "--trials",
        "1",
        "--pedestrians",
        "4",
        "--environment",
        "plain",
    ];
    assert_eq!(
        run(&app, &[&none[..], &["--lags", "none"]].concat())
            .await
            .0,
        0
    );
    let (code, _, stderr) = run(&app, &none).await;
    assert_eq!((code, stderr.lines().count()), (2, 1), "{stderr}");
    assert!(
        stderr.contains("--lags none") && stderr.contains("--environment NAME"),
        "{stderr}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn answers_repeat_what_was_asked() {
    let app = street().await;
    let nothing = json!([]);
    for (lag, other, given) in [
        (0, "follower", None),
        (1, "follower@1", Some("follower")),
        (3, "follower@3", Some("follower@2")),
    ] {
        let told = app.get(&format!("{PATH}/graph?key=0&lag={lag}")).await;
        assert_eq!(told["lag"], json!(lag));
        for path in [
            "influence?key=0",
            "influence?key=0&view=verdict",
            "states?page_size=1",
            "states?order_by=plug_in desc",
            "states?order_by=visits asc&min_visits=1",
            "states?fdr=0.1",
            "summary?",
            "summary?fdr=0.1",
            "explore?",
        ] {
            let told = app.get(&format!("{PATH}/{path}&lag={lag}")).await;
            assert_eq!(told["lag"], json!(lag), "{path}");
            let labels = &told["labels"];
            assert_eq!(labels["ego"]["name"], json!("leader"), "{path}");
            assert_eq!(labels["other"]["name"], json!(other), "{path}");
            let named = &labels["given"][0]["name"];
            assert_eq!(named, &json!(given), "{path}");
            // Labels of actions stand beside what has their indices.
            let is_told = labels["other"]["actions"] != nothing;
            assert_eq!(is_told, path.starts_with("influence"), "{path}");
        }
    }

    let scope = proto::Scope {
        environment: "street".into(),
        lag: 3,
        ..proto::Scope::default()
    };
    let mut client = app.influence().await;
    let request = proto::ListStatesRequest {
        scope: Some(scope.clone()),
        ..proto::ListStatesRequest::default()
    };
    let page = client.list_states(request).await.expect("valid");
    let page = serde_json::to_value(dto::StatePage::from(page.into_inner())).expect("JSON");
    assert_eq!(page, app.get(&format!("{PATH}/states?lag=3")).await);

    let request = proto::SummarizeRequest {
        scope: Some(scope.clone()),
        ..proto::SummarizeRequest::default()
    };
    let summary = client.summarize(request).await.expect("valid");
    let summary = serde_json::to_value(dto::Summary::from(summary.into_inner())).expect("JSON");
    assert_eq!(summary, app.get(&format!("{PATH}/summary?lag=3")).await);

    let request = proto::ExploreRequest {
        scope: Some(scope.clone()),
        ..proto::ExploreRequest::default()
    };
    let explored = client.explore(request).await.expect("valid");
    let explored = dto::Exploration::from(explored.into_inner());
    let explored = serde_json::to_value(explored).expect("JSON");
    assert_eq!(explored, app.get(&format!("{PATH}/explore?lag=3")).await);

    let request = proto::GetInfluenceRequest {
        scope: Some(scope),
        state: Some(proto::get_influence_request::State::Key("0".into())),
        view: proto::View::Verdict.into(),
        ..proto::GetInfluenceRequest::default()
    };
    let answer = client.get_influence(request).await.expect("valid");
    assert_eq!(answer.into_inner().lag, 3);
    app.stop().await;
}

/// Returns how many steps there are for each change of an agent's action, of those that begin so many
/// steps after one in a state and are told with it, as far as a lag.
fn held(agent: usize, state: usize, after: usize, lag: usize) -> f64 {
    let (mut steps, mut changes) = (0_u32, 0_u32);
    for track in played() {
        for (at, step) in track.iter().enumerate() {
            if step.state != state || at + lag >= track.len() {
                continue;
            }
            let [before, next] = [after, after + 1].map(|after| track[at + after].actions[agent]);
            steps += 1;
            changes += u32::from(before != next);
        }
    }
    f64::from(steps) / f64::from(changes)
}

#[tokio::test(flavor = "multi_thread")]
async fn full_answers_at_a_lag_tell_how_long_actions_are_held() {
    let app = street().await;
    for (at, [ego, other]) in BOTH.into_iter().enumerate() {
        for (lag, state) in [(1, 0), (3, 1), (4, 3)] {
            let query = format!("ego={ego}&other={other}&lag={lag}&key={state}");
            let told = app.get(&format!("{PATH}/influence?{query}")).await;
            let answer = &told["answers"][0];
            let egos = held(at, state, 0, 1);
            near(figure(answer, "/holds/ego"), egos, &query);
            let others = held(1 - at, state, lag - 1, lag);
            near(figure(answer, "/holds/other"), others, &query);
            assert!(egos > 1.0 && others > 1.0);
        }
    }
    for more in ["lag=0", "lag=3&view=figures", "lag=3&view=verdict"] {
        let told = app.get(&format!("{PATH}/influence?key=0&{more}")).await;
        assert_eq!(told["answers"][0].get("holds"), None, "{more}");
    }

    let asked = ["query", "street", "--key", "0", "--lag", "3"];
    let (_, text, _) = run(&app, &asked).await;
    let line = "steps that an action is held: the ego's ";
    assert!(text.lines().any(|one| one.starts_with(line)), "{text}");
    app.stop().await;
}
