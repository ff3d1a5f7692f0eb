//! Outcomes with values (Seitzer et al. 2021): an action's influence on a factor of the next state is
//! asked about as that on another agent is, on every face, by the same figures as the core has of the
//! same tables.

use nudge::api::proto;
use nudge::evidence::{Counted, Fit, Habits, Prior};
use nudge::information::{self, Alphabet, Table};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::lags::assert_same_by_grpc_and_command;
use crate::support::TestApp;

const PATH: &str = "/v1/environments/kitchen";

/// How close figures are that are sums in another order.
const TOLERANCE: f64 = 1e-12;

/// What the pot holds, two steps after the actions: labels that read as other numbers than their
/// index.
const HOLDS: [&str; 3] = ["7", "2", "0"];

/// One step: where, what the cook and the helper did, and what the pot then held, if that was seen.
type Step = (u64, u64, u64, Option<u64>);

/// What the cook does mostly decides what the pot holds at place 0, and nothing decides it at place 1;
/// the helper follows the cook at both.
fn played() -> Vec<Step> {
    let mut random = StdRng::seed_from_u64(5);
    let mut next = |below: u64| random.random_range(0..below);
    let step = |at: u64| {
        let (place, cook) = (at % 2, next(4));
        let helper = if next(4) == 0 { next(2) } else { cook % 2 };
        let pot = match place {
            0 if next(5) > 0 => (cook % 3 + 1) % 3,
            _ => next(3),
        };
        (place, cook, helper, (!at.is_multiple_of(7)).then_some(pot))
    };
    (0..420).map(step).collect()
}

fn description() -> Value {
    let integer = |name: &str, most: u64| json!({"name": name, "integer": {"min": 0, "max": most}});
    let agent = |name: &str, most| json!({"name": name, "action": [integer("act", most)]});
    let holds = json!({"name": "holds", "categorical": {"labels": HOLDS}});
    json!({
        "state": [integer("place", 2)],
        "agents": [agent("cook", 3), agent("helper", 1)],
        "outcomes": [
            {"agent": "helper", "lag": 1},
            {"name": "pot", "lag": 2, "value": [holds]},
            {"name": "score", "lag": 1, "value": [integer("sign", 0)]},
        ],
    })
}

async fn kitchen() -> TestApp {
    let app = TestApp::start().await;
    let made = app.rest("PUT", PATH, Some(&description())).await;
    assert_eq!(made.0, 201, "{}", made.1);

    let transition = |(place, cook, helper, pot): &Step| {
        let pot = pot.map(|pot| HOLDS[pot as usize]);
        json!({"state": {"place": place}, "actions": {"cook": cook, "helper": helper},
            "outcomes": {"pot": pot}, "entry": true})
    };
    let transitions: Vec<Value> = played().iter().map(transition).collect();
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions});
    let (status, told) = app
        .rest("POST", &format!("{PATH}/transitions"), Some(&body))
        .await;
    assert_eq!(
        (status, &told["rejected_count"]),
        (200, &json!(0)),
        "{told}"
    );
    app
}

/// Returns the table of an ego and the pot at a place: cook 0, helper 1.
fn table(ego: usize, place: u64) -> Table {
    Table::from_counts(cells(|step| step.0 == place, ego))
}

fn cells(wanted: impl Fn(&Step) -> bool, ego: usize) -> Vec<(u64, u64, u64)> {
    let steps = played().into_iter().filter(wanted);
    let cell = |(_, cook, helper, pot): Step| pot.map(|pot| ([cook, helper][ego], pot, 1));
    steps.filter_map(cell).collect()
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

async fn run(app: &TestApp, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
}

/// How often each was drawn: actions in all entries, values in those that carried one.
fn draws(variable: impl Fn(&Step) -> Option<u64>, letters: u64) -> Vec<u64> {
    let drawn: Vec<u64> = played().iter().filter_map(variable).collect();
    let count = |letter| drawn.iter().filter(|one| **one == letter).count() as u64;
    (0..letters).map(count).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn figures_of_a_value_are_those_of_the_core_on_the_same_table() {
    let app = kitchen().await;
    let pots = draws(|step| step.3, 3);
    let egos = [
        ("cook", draws(|step| Some(step.1), 4)),
        ("helper", draws(|step| Some(step.2), 2)),
    ];
    for (at, (ego, drawn)) in egos.iter().enumerate() {
        for place in [0, 1] {
            let what = format!("ego={ego}&other=pot&key={place}");
            let told = app
                .get(&format!("{PATH}/influence?{what}&estimators=nsb"))
                .await;
            let (answer, table) = (&told["answers"][0], table(at, place));
            assert_eq!(answer["visits"], json!(table.total()), "{what}");

            let plug_in = information::plug_in(&table);
            near(
                figure(answer, "/mutual_information/plug_in"),
                plug_in,
                &what,
            );
            let (expected, _) = information::expected_if_independent(&table);
            let said = figure(answer, "/mutual_information/expected_if_independent");
            near(said, expected, &what);

            let alphabet = Alphabet {
                rows: drawn.len() as u64,
                columns: 3,
            };
            let prior = Prior::new(&Fit::cold(alphabet));
            let counted = Counted {
                slices: &[table],
                parts: &[],
            };
            let posterior = prior.posterior(&Habits::new(drawn, &pots), counted);
            let mean = figure(answer, "/mutual_information/posterior_mean");
            near(mean, posterior.mean(), &what);
            let dependent = figure(answer, "/probability/dependent");
            near(dependent, posterior.beliefs(0.5).dependent, &what);

            assert_eq!(
                [&answer["lag"], &answer["directed"]],
                [&json!(2), &json!(true)]
            );
            let labels = json!({"name": "pot", "actions": HOLDS});
            assert_eq!(told["labels"]["other"], labels);
            assert_eq!(
                told["labels"]["given"],
                json!([]),
                "it has no action before"
            );

            // No next action was sent, and a value holds nothing.
            let holds = &answer["holds"];
            assert_eq!(
                [&holds["ego"], &holds["other"]],
                [&json!(null); 2],
                "{what}"
            );
        }
    }

    // What follows most each of the cook's actions goes by the value's labels.
    let told = app.get(&format!("{PATH}/influence?other=pot&key=0")).await;
    for action in told["answers"][0]["by_action"].as_array().expect("a list") {
        let response = action["response"].as_array().expect("a list");
        let response: Vec<f64> = response.iter().filter_map(Value::as_f64).collect();
        let likeliest = (0..3).max_by(|a, b| response[*a].total_cmp(&response[*b]));
        let cook = action["index"].as_u64().expect("an index");
        assert_eq!(likeliest, Some(((cook % 3 + 1) % 3) as usize), "{action}");
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_helper_that_follows_the_cook_moves_nothing_by_itself() {
    let app = kitchen().await;
    let dependent = |given: &'static str, place: u64| {
        let path = format!("{PATH}/influence?ego=helper&other=pot&key={place}&given={given}");
        let app = &app;
        async move { app.get(&path).await }
    };
    let told = dependent("cook", 0).await;
    assert_eq!(told["labels"]["given"][0]["name"], json!("cook"));
    assert_eq!(told["labels"]["given"].as_array().map(Vec::len), Some(1));
    let strata: Vec<Table> = (0..4)
        .map(|cook| Table::from_counts(cells(|step| step.0 == 0 && step.1 == cook, 1)))
        .collect();
    let plug_in = information::conditional(&strata, information::plug_in);
    let answer = &told["answers"][0];
    near(
        figure(answer, "/mutual_information/plug_in"),
        plug_in,
        "given",
    );
    assert!(figure(answer, "/probability/dependent") < 0.5, "{answer}");

    let alone = dependent("", 0).await;
    assert!(figure(&alone["answers"][0], "/probability/dependent") > 0.95);
    let elsewhere = dependent("", 1).await;
    assert!(figure(&elsewhere["answers"][0], "/probability/dependent") < 0.5);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_face_tells_the_same_of_a_value() {
    let app = kitchen().await;
    let more = "significance=auto&visits_to_decide=true&estimators=nsb";
    let over_rest = app
        .get(&format!("{PATH}/influence?other=pot&key=0&{more}"))
        .await;
    let at_its_lag = format!("{PATH}/influence?ego=cook&other=pot&lag=2&key=0&{more}");
    assert_eq!(app.get(&at_its_lag).await, over_rest);
    for lag in [json!(null), json!(0), json!(2)] {
        let body = json!({"other": "pot", "lag": lag, "keys": ["0"], "significance": "auto",
            "visits_to_decide": true, "estimators": ["nsb"]});
        let posted = app
            .rest("POST", &format!("{PATH}/influence"), Some(&body))
            .await;
        assert_eq!(posted, (200, over_rest.clone()));
    }

    let scope = proto::Scope {
        environment: "kitchen".into(),
        other: "pot".into(),
        ..proto::Scope::default()
    };
    let asked = ["query", "kitchen", "--key", "0", "--other", "pot"];
    assert_same_by_grpc_and_command(&app, scope, &asked, &over_rest).await;

    let heading = "kitchen: cook on pot, 2 steps later";
    for view in ["full", "figures", "verdict"] {
        let (code, text, stderr) = run(&app, &[&asked[..], &["--view", view]].concat()).await;
        assert_eq!(code, 0, "{stderr}");
        assert_eq!(text.lines().next(), Some(heading), "{view}");
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_all_states_say_is_of_the_value() {
    let app = kitchen().await;
    let pair = "ego=cook&other=pot";
    let (status, fitted) = app.rest("POST", &format!("{PATH}/fit?{pair}"), None).await;
    assert_eq!(status, 200, "{fitted}");
    let fit = &fitted["fits"][0];
    assert_eq!(
        [&fit["earlier"], &fit["later"], &fit["lag"]],
        [&json!("cook"), &json!("pot"), &json!(2)]
    );

    for order in ["visits desc", "p_dependent desc", "plug_in asc"] {
        let page = app
            .get(&format!("{PATH}/states?{pair}&order_by={order}"))
            .await;
        let states = page["states"].as_array().expect("a list");
        assert_eq!(states.len(), 2, "{order}");
        for state in states {
            let key = state["state"]["key"].as_str().expect("a key");
            let told = app.get(&format!("{PATH}/influence?{pair}&key={key}")).await;
            let answer = &told["answers"][0];
            assert_eq!(answer["fit"]["version"], json!(1));
            assert_eq!(state["visits"], answer["visits"], "{order}");
            assert_eq!(state["plug_in"], answer["mutual_information"]["plug_in"]);
            assert_eq!(state["probability"], answer["probability"]);
        }
    }

    let carried = played().iter().filter(|step| step.3.is_some()).count();
    for method in ["bayes", "bh"] {
        let fdr = format!("{pair}&fdr=0.01&method={method}");
        let page = app.get(&format!("{PATH}/states?{fdr}")).await;
        let states = page["states"].as_array().expect("a list");
        let keys: Vec<&Value> = states.iter().map(|one| &one["state"]["key"]).collect();
        assert_eq!(keys, [&json!("0")], "{method}");
        assert_eq!(
            [&page["lag"], &page["labels"]["other"]["name"]],
            [&json!(2), &json!("pot")]
        );
        let summary = app.get(&format!("{PATH}/summary?{fdr}")).await;
        assert_eq!(summary["discoveries"]["states"], json!(1), "{method}");
        assert_eq!(summary["transitions"], json!(carried), "{method}");
    }

    let explore = format!("{PATH}/explore?{pair}&rule.threshold=0.01&rule.confidence=0.999999");
    let told = app.get(&explore).await;
    assert_eq!(
        told["trials"][0]["visits"],
        json!(table(0, 1).total()),
        "{told}"
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn values_that_tell_nothing_are_answered_all_the_same() {
    let app = kitchen().await;
    // Nobody saw the score, which has one value; nobody was at place 2.
    for (other, key, basis) in [
        ("score", 0, "prior"),
        ("score", 2, "prior"),
        ("pot", 2, "prior"),
    ] {
        let told = app
            .get(&format!("{PATH}/influence?other={other}&key={key}"))
            .await;
        let answer = &told["answers"][0];
        assert_eq!(answer["basis"]["kind"], json!(basis), "{other} {key}");
        assert_eq!(answer["mutual_information"]["plug_in"], json!(0.0));
        assert_eq!(answer["verdict"], json!("undecided"));
    }
    for more in ["states?", "summary?fdr=0.1&", "explore?"] {
        app.get(&format!("{PATH}/{more}other=score")).await;
    }
    let fitted = app
        .rest("POST", &format!("{PATH}/fit?other=score"), None)
        .await;
    assert_eq!(fitted.0, 200, "{}", fitted.1);

    // An agent is told beside it as ever.
    let told = app.get(&format!("{PATH}/influence?lag=1&key=0")).await;
    assert_eq!(told["labels"]["other"]["name"], json!("helper@1"));
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_value_is_refused_where_nothing_can_be_said_of_it() {
    let app = kitchen().await;
    let later = "which is observed 2 steps after the actions: what comes later influences nothing before it";
    let agents = "expected one of cook, helper";
    let cases = [
        (
            "other=pot&lag=1",
            "/lag",
            "got 1, expected 2, at which pot is observed, or none".to_owned(),
        ),
        (
            "other=pot&lag=-2",
            "/lag",
            "got -2, expected 2, at which pot is observed, or none".to_owned(),
        ),
        (
            "ego=pot&other=cook",
            "/ego",
            format!("got \"pot\", {later}, {agents}"),
        ),
        (
            "other=pot&given=pot",
            "/given/0",
            format!("got \"pot\", which is an outcome and no agent, {agents}"),
        ),
        (
            "other=pan",
            "/other",
            format!("unknown agent \"pan\", {agents}, pot, score"),
        ),
        (
            "other=helper@1",
            "/other",
            "got \"helper@1\", expected \"helper\" with the lag 1 beside it".to_owned(),
        ),
    ];
    for (pair, pointer, detail) in cases {
        let expected = json!([{"pointer": pointer, "detail": detail}]);
        for path in ["influence?key=0&", "states?", "summary?", "explore?"] {
            let (status, told) = app.rest("GET", &format!("{PATH}/{path}{pair}"), None).await;
            assert_eq!((status, &told["errors"]), (400, &expected), "{path}{pair}");
        }
        let (status, told) = app.rest("POST", &format!("{PATH}/fit?{pair}"), None).await;
        assert_eq!((status, &told["errors"]), (400, &expected), "{pair}");
    }

    let scope = proto::Scope {
        environment: "kitchen".into(),
        other: "pot".into(),
        lag: 1,
        ..proto::Scope::default()
    };
    let request = proto::SummarizeRequest {
        scope: Some(scope),
        ..proto::SummarizeRequest::default()
    };
    let refused = app.influence().await.summarize(request).await;
    let refused = refused.expect_err("another lag");
    assert_eq!(refused.code(), tonic::Code::InvalidArgument);
    assert!(refused.message().contains("expected 2"), "{refused}");
    let arguments = [
        "query", "kitchen", "--key", "0", "--other", "pot", "--lag", "1",
    ];
    let (code, _, stderr) = run(&app, &arguments).await;
    assert_eq!(code, 1);
    assert!(stderr.contains("expected 2, at which pot"), "{stderr}");
    app.stop().await;
}
