//! Networks that answer where counts do not decide: a world in which it is known which states have
//! influence, seen and unseen.

use std::sync::Arc;
use std::time::Duration;

use nudge::api::proto;
use nudge::app::{App, Upkeep};
use nudge::domain::draft::ChangeDraft;
use nudge::domain::draft::TrainingDraft;
use nudge::domain::{Card, Environment, Job, JobState, Model, RuleDraft, StateKey};
use nudge::model::Prediction;
use nudge::serve::{Settings, Starting};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use safetensors::SafeTensors;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::{TestApp, open};

const WORLD: &str = "/v1/environments/street";

const LANES: u64 = 12;
const SIGNS: u64 = 5;

/// How often the human does what the robot does, where it answers: .95 nats.
const COPIES: f64 = 0.9;

/// A street: the human answers the robot where they are near, whatever the lane and the sign.
fn description() -> Value {
    let agent = |name: &str| json!({"name": name, "action": [{"name": "move", "integer": {"min": 0, "max": 3}}]});
    json!({
        "state": [
            {"name": "near", "categorical": {"labels": ["no", "yes"]}},
            {"name": "lane", "integer": {"min": 0, "max": LANES - 1}},
            {"name": "sign", "categorical": {"labels": ["a", "b", "c", "d", "e"]}},
        ],
        "agents": [agent("robot"), agent("human")],
    })
}

/// Whether a state is left for the network alone.
fn is_hidden(lane: u64, sign: u64) -> bool {
    (lane + 2 * sign).is_multiple_of(4)
}

fn transition(near: u64, lane: u64, sign: u64, copies: f64, random: &mut StdRng) -> Value {
    let robot = random.random_range(0..4);
    let copies = near == 1 && random.random_bool(copies);
    let human = if copies {
        robot
    } else {
        random.random_range(0..4)
    };
    json!({"state": {"near": near, "lane": lane, "sign": sign}, "actions": {"robot": robot, "human": human}})
}

/// What was seen of the street: every state that is not hidden, so many times.
fn seen(times: u64, copies: f64) -> Vec<Value> {
    seen_by(|_, _| times, copies)
}

/// What was seen of the street, so many times by lane and sign.
fn seen_by(times: impl Fn(u64, u64) -> u64, copies: f64) -> Vec<Value> {
    let mut random = StdRng::seed_from_u64(4);
    let mut transitions = Vec::new();
    for near in 0..2 {
        for (lane, sign) in (0..LANES).flat_map(|lane| (0..SIGNS).map(move |sign| (lane, sign))) {
            if !is_hidden(lane, sign) {
                transitions.extend(
                    (0..times(lane, sign))
                        .map(|_| transition(near, lane, sign, copies, &mut random)),
                );
            }
        }
    }
    transitions
}

async fn street(transitions: Vec<Value>) -> TestApp {
    let app = TestApp::start().await;
    assert_eq!(app.rest("PUT", WORLD, Some(&description())).await.0, 201);
    count(&app, 1, transitions).await;
    app
}

async fn count(app: &TestApp, sequence: u64, transitions: Vec<Value>) {
    let body = json!({"producer": "p", "sequence": sequence, "transitions": transitions});
    let (status, receipt) = app
        .rest("POST", &format!("{WORLD}/transitions"), Some(&body))
        .await;
    assert_eq!(
        (status, &receipt["rejected_count"]),
        (200, &json!(0)),
        "{receipt}"
    );
}

fn environment(app: &App) -> Arc<Environment> {
    app.environments.find("street").expect("made")
}

fn draft() -> TrainingDraft {
    TrainingDraft {
        members: Some(2),
        width: Some(32),
        ..TrainingDraft::default()
    }
}

async fn finished(app: &App, draft: &TrainingDraft) -> Job {
    let environment = environment(app);
    let job = app
        .networks
        .train(&environment, draft)
        .await
        .expect("valid");
    app.networks
        .finished(&environment, job.id)
        .await
        .expect("known")
}

async fn trained(app: &App, draft: &TrainingDraft) -> Model {
    let job = finished(app, draft).await;
    assert_eq!(job.state, JobState::Done, "{}", job.message);
    app.networks
        .get(&environment(app), job.version.expect("a version"))
        .await
        .expect("kept")
}

async fn answer(app: &TestApp, key: &str) -> Value {
    let (status, told) = app
        .rest("GET", &format!("{WORLD}/influence?key={key}"), None)
        .await;
    assert_eq!(status, 200, "{told}");
    told["answers"][0].clone()
}

async fn told_by_cli(app: &TestApp, arguments: &[&str]) -> (i32, String, String) {
    exit_and_texts(&output(nudge(&app.address.to_string(), arguments)).await)
}

/// Keys of the states that were never seen, and whether there is influence.
fn hidden() -> impl Iterator<Item = (String, bool)> {
    let all = (0..2).flat_map(|near| {
        (0..LANES).flat_map(move |lane| (0..SIGNS).map(move |sign| (near, lane, sign)))
    });
    all.filter(|(_, lane, sign)| is_hidden(*lane, *sign))
        .map(|(near, lane, sign)| (format!("{near}.{lane}.{sign}"), near == 1))
}

#[tokio::test]
async fn states_that_were_never_seen_get_a_verdict_that_names_its_version() {
    let app = street(seen(20, COPIES)).await;
    let before = answer(&app, "1.0.0").await;
    assert_eq!(
        (&before["verdict"], &before["model"]),
        (&json!("undecided"), &Value::Null)
    );
    let model = trained(&app.app, &draft()).await;
    assert!(model.active, "it beats its baselines: {:?}", model.card);
    let mut decided = 0;
    for (key, influences) in hidden() {
        let told = answer(&app, &key).await;
        let wrong = if influences {
            "no_influence"
        } else {
            "influences"
        };
        assert!(told["verdict"] != wrong && told["visits"] == 0, "{told}");
        decided += usize::from(told["verdict"] != "undecided");
        assert_eq!(
            told["basis"],
            json!({"kind": "model", "version": model.version})
        );
        assert_eq!(
            told["mutual_information"]["plug_in"], 0.0,
            "the counts' figures stay beside it"
        );
        assert_eq!(
            told["model"]["by_action"].as_array().expect("a list").len(),
            4
        );
    }
    assert!(
        10 * decided >= 8 * hidden().count(),
        "{decided} of {} are decided",
        hidden().count()
    );
    let often = answer(&app, "1.1.0").await;
    assert_eq!(
        often["model"]["version"], 1,
        "its figures are told beside counts too: {often}"
    );
}

#[tokio::test]
async fn counts_that_decide_are_not_overruled() {
    let app = street(seen(20, COPIES)).await;
    trained(
        &app.app,
        &TrainingDraft {
            activate: true,
            ..draft()
        },
    )
    .await;
    // In this one state the human does not care, as is seen often later on.
    let mut random = StdRng::seed_from_u64(9);
    count(
        &app,
        2,
        (0..600)
            .map(|_| transition(1, 1, 0, 0.0, &mut random))
            .collect(),
    )
    .await;
    let told = answer(&app, "1.1.0").await;
    assert_eq!(
        (&told["verdict"], &told["basis"]["kind"]),
        (&json!("no_influence"), &json!("counts")),
        "{told}"
    );
    assert_eq!(
        told["model"]["version"], 1,
        "what the network says is told beside them"
    );
    // By the paper's rule the counts need not decide; what they exclude stays excluded, whichever
    // view is asked for.
    for view in ["verdict", "figures", "full"] {
        let rule = json!({"kind": "paper", "min_visits": 1_000});
        let body = json!({"keys": ["1.1.0", "1.0.0"], "view": view, "rule": rule});
        let (_, told) = app
            .rest("POST", &format!("{WORLD}/influence"), Some(&body))
            .await;
        let [excluded, unseen] = [&told["answers"][0], &told["answers"][1]];
        assert_eq!(
            (&excluded["verdict"], &excluded["basis"]["kind"]),
            (&json!("undecided"), &json!("counts")),
            "{told}"
        );
        assert_eq!(
            (&unseen["verdict"], &unseen["basis"]["kind"]),
            (&json!("influences"), &json!("model")),
            "{told}"
        );
    }
}

#[tokio::test]
async fn what_counts_have_settled_no_rule_lets_a_network_overrule() {
    let app = street(seen(20, COPIES)).await;
    trained(
        &app.app,
        &TrainingDraft {
            activate: true,
            ..draft()
        },
    )
    .await;
    // The human does not care in a state that the network knows from its neighbours. By the paper's
    // rule so few visits decide nothing.
    let mut random = StdRng::seed_from_u64(9);
    let mut verdicts = Vec::new();
    for sequence in 2..12 {
        count(
            &app,
            sequence,
            (0..4)
                .map(|_| transition(1, 0, 0, 0.0, &mut random))
                .collect(),
        )
        .await;
        let body = json!({"keys": ["1.0.0"], "rule": {"kind": "paper", "min_visits": 1_000}});
        let (_, told) = app
            .rest("POST", &format!("{WORLD}/influence"), Some(&body))
            .await;
        let by_paper = &told["answers"][0];
        let by_evidence = answer(&app, "1.0.0").await;
        if by_evidence["basis"]["kind"] == "counts" && by_evidence["verdict"] == "no_influence" {
            let verdict = (&by_paper["verdict"], &by_paper["basis"]["kind"]);
            assert_eq!(
                verdict,
                (&json!("undecided"), &json!("counts")),
                "{by_paper} {by_evidence}"
            );
        }
        verdicts.push((by_paper["verdict"].clone(), by_evidence["verdict"].clone()));
    }
    let [first, last] = [verdicts.first(), verdicts.last()];
    assert_eq!(
        first.map(|(by_paper, _)| by_paper),
        Some(&json!("influences")),
        "the network is asked: {verdicts:?}"
    );
    assert_eq!(
        last,
        Some(&(json!("undecided"), json!("no_influence"))),
        "until counts have settled it"
    );
}

/// A world in which no state reaches half a nat, however it is seen.
struct Weak {
    /// How often the robot does what it always does in a lane.
    habit: f64,
    /// How often the human does what the robot does, where it answers.
    copies: f64,
    /// Whether it answers everywhere.
    everywhere: bool,
}

/// Weak copying has .20 nats; who nearly always does the same has no more to tell than .24, however
/// closely it is followed.
const WEAK: [Weak; 4] = [
    Weak {
        habit: 0.0,
        copies: 0.4,
        everywhere: false,
    },
    Weak {
        habit: 0.0,
        copies: 0.4,
        everywhere: true,
    },
    Weak {
        habit: 0.95,
        copies: 0.98,
        everywhere: false,
    },
    Weak {
        habit: 0.95,
        copies: 0.98,
        everywhere: true,
    },
];

impl Weak {
    fn seen(&self, times: u64) -> Vec<Value> {
        let mut random = StdRng::seed_from_u64(4);
        let states = (0..2).flat_map(|near| {
            (0..LANES).flat_map(move |lane| (0..SIGNS).map(move |sign| (near, lane, sign)))
        });
        let seen = states.filter(|(_, lane, sign)| !is_hidden(*lane, *sign));
        seen.flat_map(|state| std::iter::repeat_n(state, times as usize))
            .map(|(near, lane, sign)| {
                let robot = if random.random_bool(self.habit) { lane % 4 } else { random.random_range(0..4) };
                let copies = (self.everywhere || near == 1) && random.random_bool(self.copies);
                let human = if copies { robot } else { random.random_range(0..4) };
                json!({"state": {"near": near, "lane": lane, "sign": sign}, "actions": {"robot": robot, "human": human}})
            })
            .collect()
    }
}

#[tokio::test]
async fn a_world_that_cannot_pass_the_threshold_is_not_told_that_it_does() {
    for (world, times) in WEAK
        .iter()
        .flat_map(|world| [9, 20, 60].map(|times| (world, times)))
    {
        let app = street(world.seen(times)).await;
        let model = trained(
            &app.app,
            &TrainingDraft {
                activate: true,
                ..draft()
            },
        )
        .await;
        let mut told = Vec::new();
        for (key, _) in hidden() {
            let answer = answer(&app, &key).await;
            assert_ne!(answer["verdict"], "influences", "{times}: {answer}");
            told.push(
                answer["model"]["probability"]
                    .as_f64()
                    .expect("at its own threshold"),
            );
        }
        let mean = told.iter().sum::<f64>() / told.len() as f64;
        assert!(mean < 0.3, "{times} visits: {mean}");
        let card = model.card.expect("it can be read");
        assert!(
            card.base_rate.expect("it is judged") < 0.35,
            "{times}: {card:?}"
        );
        let (_, page) = app
            .rest(
                "GET",
                &format!("{WORLD}/states?verdict=influences&page_size=1000"),
                None,
            )
            .await;
        let called = page["states"]
            .as_array()
            .expect("a list")
            .iter()
            .filter(|state| state["basis"]["kind"] == "model");
        assert_eq!(called.count(), 0, "{times}: {page}");
        app.stop().await;
    }
}

#[tokio::test]
async fn no_verdict_outside_what_it_was_trained_on() {
    // Nothing was seen in the last two lanes, nor under the last sign.
    let times = |lane: u64, sign: u64| {
        if lane < LANES - 2 && sign < SIGNS - 1 {
            20
        } else {
            0
        }
    };
    let app = street(seen_by(times, COPIES)).await;
    let version = trained(
        &app.app,
        &TrainingDraft {
            activate: true,
            ..draft()
        },
    )
    .await
    .version;
    let inside = answer(&app, "1.0.0").await;
    assert_eq!(
        (&inside["verdict"], &inside["model"]["out_of_range"]),
        (&json!("influences"), &Value::Null),
        "{inside}"
    );
    let cases = [
        ("1.10.0", json!(["lane"])),
        ("1.0.4", json!(["sign"])),
        ("1.11.4", json!(["lane", "sign"])),
    ];
    for (key, names) in &cases {
        let told = answer(&app, key).await;
        assert_eq!(
            (&told["verdict"], &told["basis"]["kind"]),
            (&json!("undecided"), &json!("prior")),
            "{told}"
        );
        assert_eq!(&told["model"]["out_of_range"], names, "{told}");
        assert!(
            told["model"]["probability"].is_number(),
            "its figures stay: {told}"
        );
        let (_, graph) = app
            .rest("GET", &format!("{WORLD}/graph?key={key}"), None)
            .await;
        assert_eq!(
            graph["edges"][0]["answer"]["verdict"], "undecided",
            "{graph}"
        );
        let (code, text, stderr) = told_by_cli(&app, &["query", "street", "--key", key]).await;
        let expected = names
            .as_array()
            .expect("names")
            .iter()
            .filter_map(Value::as_str)
            .collect::<Vec<_>>()
            .join(", ");
        assert_eq!(code, 0, "{stderr}");
        assert!(
            text.contains(&format!(
                "no verdict, for it was trained without such {expected}\n"
            )),
            "{text}"
        );
    }
    let scope = proto::Scope {
        environment: "street".into(),
        ..Default::default()
    };
    let request = proto::BatchGetInfluenceRequest {
        scope: Some(scope),
        keys: vec!["1.11.4".into(), "1.0.0".into()],
        ..Default::default()
    };
    let answers = app
        .influence()
        .await
        .batch_get_influence(request)
        .await
        .expect("valid")
        .into_inner()
        .answers;
    let outside: Vec<Vec<String>> = answers
        .into_iter()
        .map(|one| one.model.expect("told").out_of_range)
        .collect();
    assert_eq!(
        outside,
        [vec!["lane".to_owned(), "sign".to_owned()], Vec::new()]
    );

    // Weights that are brought elsewhere know what they were trained on, whatever is counted there.
    let environment = environment(&app.app);
    let file = app
        .app
        .networks
        .export(&environment, version)
        .await
        .expect("a file");
    count(
        &app,
        2,
        (0..20)
            .map(|_| transition(1, 11, 4, COPIES, &mut StdRng::seed_from_u64(5)))
            .collect(),
    )
    .await;
    let brought = app
        .app
        .networks
        .import(&environment, file)
        .await
        .expect("its own file")
        .version;
    app.app
        .networks
        .activate(&environment, brought)
        .await
        .expect("not stale");
    assert_eq!(
        answer(&app, "1.10.4").await["model"]["out_of_range"],
        json!(["lane", "sign"])
    );
}

#[tokio::test]
async fn every_face_tells_the_verdict_of_the_network() {
    // What was seen often calibrates it; three visits decide nothing.
    let app = street(seen_by(
        |lane, _| if lane < LANES / 2 { 20 } else { 3 },
        COPIES,
    ))
    .await;
    let version = trained(
        &app.app,
        &TrainingDraft {
            activate: true,
            ..draft()
        },
    )
    .await
    .version;
    let (_, page) = app
        .rest(
            "GET",
            &format!("{WORLD}/states?verdict=influences&page_size=1000"),
            None,
        )
        .await;
    let states = page["states"].as_array().expect("a list");
    let by_network = states
        .iter()
        .filter(|state| state["basis"] == json!({"kind": "model", "version": version}))
        .count();
    assert!(by_network >= 10, "{by_network} of {}", states.len());
    let (_, summary) = app.rest("GET", &format!("{WORLD}/summary"), None).await;
    assert_eq!(summary["verdicts"]["influences"], states.len());
    let (_, graph) = app
        .rest("GET", &format!("{WORLD}/graph?key=1.0.0"), None)
        .await;
    assert_eq!(graph["edges"][0]["answer"]["basis"]["kind"], "model");
    let body = json!({"keys": ["1.0.0", "0.0.0"], "view": "verdict"});
    let (_, told) = app
        .rest("POST", &format!("{WORLD}/influence"), Some(&body))
        .await;
    assert_eq!(told["answers"][0]["verdict"], "influences", "{told}");
    // Not at any other threshold, however near; the same in bits or as a share is the same.
    for rule in [
        json!({"threshold": 0.0}),
        json!({"threshold": 0.4999}),
        json!({"threshold": 0.6}),
        json!({"share": 0.9}),
    ] {
        let given = json!({"keys": ["1.0.0"], "rule": rule});
        let (_, told) = app
            .rest("POST", &format!("{WORLD}/influence"), Some(&given))
            .await;
        let told = &told["answers"][0];
        assert_eq!(
            (&told["basis"]["kind"], &told["model"]["probability"]),
            (&json!("prior"), &Value::Null),
            "{told}"
        );
        assert!(
            told["model"]["mutual_information"]
                .as_f64()
                .expect("a number")
                > 0.3,
            "{told}"
        );
    }
    let (bits, share) = (0.5 / std::f64::consts::LN_2, 0.5 / 4_f64.ln());
    for rule in [
        json!({"threshold": bits, "unit": "bits"}),
        json!({"share": share}),
    ] {
        let given = json!({"keys": ["1.0.0"], "rule": rule});
        let (_, told) = app
            .rest("POST", &format!("{WORLD}/influence"), Some(&given))
            .await;
        assert_eq!(told["answers"][0]["basis"]["kind"], "model", "{told}");
    }
}

#[tokio::test]
async fn where_there_is_nothing_to_find_nothing_is_called() {
    let app = street(seen(9, 0.0)).await;
    let model = trained(&app.app, &draft()).await;
    let card = model.card.expect("it can be read");
    assert!(
        !model.active && card.not_better_than.iter().any(|name| name == "shuffled"),
        "{card:?}"
    );
    app.app
        .networks
        .activate(&environment(&app.app), model.version)
        .await
        .expect("as was asked for");
    for (key, _) in hidden() {
        let told = answer(&app, &key).await;
        assert_eq!(
            (&told["verdict"], &told["basis"]["kind"]),
            (&json!("undecided"), &json!("prior")),
            "{told}"
        );
        assert!(
            told["model"]["probability"].as_f64().expect("a number") < 0.5,
            "{told}"
        );
    }
}

#[tokio::test]
async fn a_network_answers_at_its_own_threshold_only() {
    for kind in ["joint", "direct"] {
        at_its_own_threshold_only(kind).await;
    }
}

async fn at_its_own_threshold_only(kind: &str) {
    let app = street(seen(30, COPIES)).await;
    let draft = TrainingDraft {
        kind: Some(kind.into()),
        activate: true,
        ..draft()
    };
    let version = trained(&app.app, &draft).await.version;
    let told = answer(&app, "1.0.0").await;
    assert_eq!(
        (&told["verdict"], &told["basis"]["version"]),
        (&json!("influences"), &json!(version)),
        "{told}"
    );
    assert_eq!(
        (
            told["model"]["mutual_information"].is_number(),
            &told["model"]["kind"]
        ),
        (kind == "joint", &json!(kind))
    );
    let (status, _) = app
        .rest("PATCH", WORLD, Some(&json!({"rule": {"threshold": 0.3}})))
        .await;
    assert_eq!(status, 200);
    let environment = environment(&app.app);
    assert!(
        app.app
            .networks
            .get(&environment, version)
            .await
            .expect("kept")
            .stale
    );
    let told = answer(&app, "1.0.0").await;
    assert_eq!(
        (&told["verdict"], &told["basis"]["kind"]),
        (&json!("undecided"), &json!("prior")),
        "{told}"
    );
    assert_eq!(told["model"]["probability"], Value::Null, "{told}");
    // An inference server has no rule: it tells the probability that the network was trained for,
    // and of which threshold it is.
    let rows = json!({"inputs": [{"name": "state", "datatype": "FP32", "shape": [1, 3], "data": [1, 0, 0]}]});
    let (status, inferred) = app
        .rest("POST", "/v2/models/street/infer", Some(&rows))
        .await;
    assert_eq!(
        (
            status,
            &inferred["outputs"][0]["parameters"]["threshold_nats"]
        ),
        (200, &json!(0.5)),
        "{inferred}"
    );
    let refused = app
        .app
        .networks
        .activate(&environment, version)
        .await
        .expect_err("it cannot answer by this rule");
    assert_eq!(refused.reason, "MODEL_STALE");
}

#[tokio::test]
async fn the_same_counts_and_seed_give_the_same_network() {
    let app = street(seen(4, COPIES)).await;
    let environment = environment(&app.app);
    let file = async |seed: u64| {
        let model = trained(
            &app.app,
            &TrainingDraft {
                seed: Some(seed),
                ..draft()
            },
        )
        .await;
        let file = app
            .app
            .networks
            .export(&environment, model.version)
            .await
            .expect("a file");
        safetensors::SafeTensors::deserialize(&file)
            .expect("safetensors")
            .tensor("members.1.ego.weight")
            .expect("there")
            .data()
            .to_vec()
    };
    let first = file(7).await;
    assert_eq!(first, file(7).await);
    assert_ne!(first, file(8).await);
}

#[tokio::test]
async fn too_little_to_learn_from_is_said() {
    let app = street(seen(1, COPIES).into_iter().take(30).collect()).await;
    let job = finished(&app.app, &draft()).await;
    assert_eq!((job.state, job.version), (JobState::Failed, None));
    assert_eq!(
        job.message,
        "no network is made: too few data: got 30 states with 30 independent draws, expected at least 20 states and 200 draws"
    );
}

#[tokio::test]
async fn no_request_notices_a_switch() {
    let app = street(seen(6, COPIES)).await;
    let environment = environment(&app.app);
    let draft = draft();
    let versions = [
        trained(&app.app, &draft).await.version,
        trained(
            &app.app,
            &TrainingDraft {
                seed: Some(1),
                ..draft
            },
        )
        .await
        .version,
    ];
    let networks = app.app.networks.clone();
    let switching = tokio::spawn(async move {
        for turn in 0..40 {
            networks
                .activate(&environment, versions[turn % 2])
                .await
                .expect("switched");
        }
    });
    let mut told = std::collections::BTreeSet::new();
    while !switching.is_finished() {
        let answer = answer(&app, "1.0.0").await;
        told.insert(answer["basis"]["version"].as_u64().unwrap_or_default());
    }
    switching.await.expect("no switch failed");
    assert!(
        told.iter().all(|version| versions.contains(version)) || told.len() > 1,
        "{told:?}"
    );
}

#[tokio::test]
async fn the_active_version_outlives_a_restart() {
    let app = street(seen(6, COPIES)).await;
    let version = trained(
        &app.app,
        &TrainingDraft {
            activate: true,
            ..draft()
        },
    )
    .await
    .version;
    let before = answer(&app, "1.0.0").await;
    let app = app.restart().await;
    let after = answer(&app, "1.0.0").await;
    assert_eq!(before["basis"]["version"], version);
    assert_eq!(before["model"], after["model"]);
}

#[tokio::test]
async fn what_has_grown_is_trained_again_by_itself_if_asked() {
    let directory = Arc::new(TempDir::new().expect("a directory"));
    let app = street_on(directory.clone()).await;
    count(&app, 1, seen(15, COPIES)).await;
    app.stop().await;
    let store = open(directory.path(), Default::default()).await;
    let upkeep = Upkeep {
        train_every: Duration::from_millis(10),
        ..Upkeep::default()
    };
    let running = Starting::new(Settings::default()).open(store, upkeep);
    let running = running.await.expect("it starts");
    let app = &running.app;
    let environment = environment(app);
    let job = ended(app, &environment, 0).await;
    assert_eq!(
        (job.state, job.version),
        (JobState::Done, Some(1)),
        "{}",
        job.message
    );
    // Another threshold makes it stale, which is mended once, and not again by itself.
    let threshold = RuleDraft {
        threshold: Some(0.3),
        ..RuleDraft::default()
    };
    let change = ChangeDraft {
        rule: Some(threshold),
        ..ChangeDraft::default()
    };
    app.environments
        .update("street", &change)
        .await
        .expect("valid");
    let job = ended(app, &environment, 1).await;
    assert_eq!(
        (job.state, job.version),
        (JobState::Done, Some(2)),
        "{}",
        job.message
    );
    let models = app
        .networks
        .list(&app.environments.find("street").expect("made"))
        .await
        .expect("listed")
        .models;
    assert_eq!(
        models.iter().map(|model| model.stale).collect::<Vec<_>>(),
        [true, false]
    );
    tokio::time::sleep(Duration::from_millis(100)).await;
    let jobs = app.networks.list(&environment).await.expect("listed").jobs;
    assert_eq!(jobs.len(), 2, "nothing has changed since");
    running.shutdown().await.expect("it ends");
}

/// Awaits the end of an environment's nth job, which somebody asks for sooner or later.
async fn ended(app: &App, environment: &Environment, nth: usize) -> Job {
    loop {
        let jobs = app.networks.list(environment).await.expect("listed").jobs;
        if let Some(job) = jobs.get(nth) {
            return app
                .networks
                .finished(environment, job.id)
                .await
                .expect("known");
        }
        tokio::task::yield_now().await;
    }
}

async fn street_on(directory: Arc<TempDir>) -> TestApp {
    let app = TestApp::on(directory).await;
    assert_eq!(app.rest("PUT", WORLD, Some(&description())).await.0, 201);
    app
}

/// Takes a version to a file and back, and returns the number that it has then.
async fn there_and_back(app: &App, version: u64) -> u64 {
    let environment = environment(app);
    let file = app
        .networks
        .export(&environment, version)
        .await
        .expect("a file");
    app.networks
        .import(&environment, file)
        .await
        .expect("its own file")
        .version
}

/// What a version says of every state, bit by bit: probabilities, information, and what each action
/// does.
async fn said(app: &App, version: u64) -> Vec<String> {
    let environment = environment(app);
    let network = app
        .networks
        .network(&environment, version)
        .await
        .expect("kept");
    let all = (0..2).flat_map(|near| {
        (0..LANES).flat_map(move |lane| (0..SIGNS).map(move |sign| (near, lane, sign)))
    });
    let keys: Vec<StateKey> = all
        .map(|(near, lane, sign)| StateKey::new(&[near, lane, sign].map(|bin| bin as u32)))
        .collect();
    let bits = |number: Option<f64>| number.map(f64::to_bits);
    let predictions = network.predict(&keys, network.threshold);
    let said = |(key, told): (&StateKey, Prediction)| {
        let actions = network.by_action(&environment, key);
        let verdict = network.decide(&told, 0.8, 0.1);
        let numbers = [bits(told.probability), bits(told.mutual_information)];
        format!(
            "{key} {numbers:?} {} {} {verdict:?} {actions:?}",
            told.agrees, told.in_range
        )
    };
    keys.iter().zip(predictions).map(said).collect()
}

#[tokio::test]
async fn a_network_that_leaves_and_comes_back_says_what_it_said() {
    // Worlds with influence, with little, and with none, in which a calibration to states that were
    // learned from would see much.
    let worlds = [seen(20, COPIES), seen(9, 0.4), seen(9, 0.0)];
    let kinds = ["joint", "direct"];
    for (world, kind) in worlds
        .iter()
        .flat_map(|world| kinds.map(|kind| (world, kind)))
    {
        let app = street(world.clone()).await;
        let draft = TrainingDraft {
            kind: Some(kind.into()),
            ..draft()
        };
        let own = trained(&app.app, &draft).await;
        let before = said(&app.app, own.version).await;
        let brought = there_and_back(&app.app, own.version).await;
        let again = there_and_back(&app.app, brought).await;
        // What is counted meanwhile changes how it is judged, and not what it says.
        count(&app, 2, seen(3, 1.0)).await;
        let later = there_and_back(&app.app, own.version).await;
        let own = own.card.expect("it can be read");
        for version in [brought, again, later] {
            assert!(
                said(&app.app, version).await == before,
                "{kind}: version {version} says something else"
            );
            let card = app
                .app
                .networks
                .get(&environment(&app.app), version)
                .await
                .expect("kept")
                .card
                .expect("read");
            assert_eq!(
                (card.calibration, card.base_rate, card.imported),
                (own.calibration, own.base_rate, true)
            );
            assert_eq!(
                (&card.epochs, card.training),
                (&own.epochs, own.training),
                "it is known how it was trained"
            );
            assert_eq!(card.found_something(), own.found_something());
            let shuffled = |card: &Card| {
                card.baselines
                    .iter()
                    .find(|score| score.name == "shuffled")
                    .cloned()
            };
            assert!(shuffled(&own).is_some(), "{own:?}");
            assert_eq!(shuffled(&card), shuffled(&own), "it is told as it was");
        }
        let card = app
            .app
            .networks
            .get(&environment(&app.app), brought)
            .await
            .expect("kept")
            .card
            .expect("read");
        assert_eq!(
            (&card.score, &card.reliability),
            (&own.score, &own.reliability),
            "judged by what it had not learned"
        );
        app.stop().await;
    }
}

#[tokio::test]
async fn brought_to_a_rule_with_another_threshold_it_is_calibrated_by_what_it_had_not_learned() {
    let app = street(seen(9, 0.0)).await;
    let own = trained(&app.app, &draft()).await;
    app.rest("PATCH", WORLD, Some(&json!({"rule": {"threshold": 0.3}})))
        .await;
    let brought = there_and_back(&app.app, own.version).await;
    let card = app
        .app
        .networks
        .get(&environment(&app.app), brought)
        .await
        .expect("kept")
        .card
        .expect("read");
    assert_eq!(
        (card.threshold, card.imported, card.found_something()),
        (0.3, true, false)
    );
    assert!(
        card.base_rate.expect("judged") < 0.3,
        "there is no influence in this world: {card:?}"
    );
    app.stop().await;
}

/// A file of weights with another card, or none.
fn with_card(file: &[u8], card: Option<&str>) -> Vec<u8> {
    let (_, header) = SafeTensors::read_metadata(file).expect("a header");
    let mut metadata = header.metadata().clone().expect("metadata");
    metadata.remove("card").expect("an export has one");
    metadata.extend(card.map(|card| ("card".to_owned(), card.to_owned())));
    let tensors = SafeTensors::deserialize(file).expect("safetensors");
    safetensors::serialize(tensors.tensors(), Some(metadata)).expect("names differ")
}

#[tokio::test]
async fn files_without_a_card_are_judged_here_and_wrong_cards_are_faulted() {
    let app = street(seen(9, COPIES)).await;
    let environment = environment(&app.app);
    let version = trained(&app.app, &draft()).await.version;
    let file = app
        .app
        .networks
        .export(&environment, version)
        .await
        .expect("a file");
    for card in [None, Some(""), Some("{}"), Some(" {} ")] {
        let brought = app
            .app
            .networks
            .import(&environment, with_card(&file, card))
            .await
            .expect("as other tools write");
        let card = brought.card.expect("it can be read");
        assert!(
            card.imported && card.epochs.is_empty() && card.split.starts_with("trained elsewhere"),
            "{card:?}"
        );
    }
    let (_, header) = SafeTensors::read_metadata(&file).expect("a header");
    let text = header.metadata().as_ref().expect("metadata")["card"].clone();
    let edit = |edit: &dyn Fn(&mut Value)| {
        let mut card: Value = serde_json::from_str(&text).expect("JSON");
        edit(&mut card);
        card.to_string()
    };
    let wrong = [
        ("no card".to_owned(), "it is not as it was written"),
        ("[]".to_owned(), "it is not as it was written"),
        (
            edit(&|card| card["form"] = json!(9)),
            "form 9 of a newer build",
        ),
        (
            edit(&|card| card["training"]["members"] = json!(3)),
            "expected (\"joint\", 2, 32)",
        ),
        (
            edit(&|card| card["training"]["kind"] = json!("direct")),
            "is of a network (\"direct\", 2, 32)",
        ),
        (
            edit(&|card| card["training"]["folds"] = json!(1)),
            "got 1 folds, expected 2 to 20",
        ),
        (
            edit(&|card| card["training"]["folds"] = json!(1_000_000_000)),
            "expected 2 to 20",
        ),
        (
            edit(&|card| card["threshold"] = json!(0.4)),
            "is of a threshold of 0.4 nats, expected 0.5",
        ),
        (
            edit(&|card| card["base_rate"] = json!(2)),
            "base_rate 2, expected 0 to 1",
        ),
        (
            edit(&|card| card["calibration"]["slope"] = json!("x")),
            "invalid type",
        ),
    ];
    for (card, why) in wrong {
        let refused = app
            .app
            .networks
            .import(&environment, with_card(&file, Some(&card)))
            .await
            .expect_err(&card);
        assert_eq!(
            refused
                .faults
                .iter()
                .map(|fault| fault.pointer.as_str())
                .collect::<Vec<_>>(),
            ["/metadata/card"]
        );
        assert!(refused.message.contains(why), "{why}: {refused}");
    }
    // As builds wrote it before cards had forms.
    let first = edit(&|card| drop(card.as_object_mut().expect("an object").remove("form")));
    let brought = app
        .app
        .networks
        .import(&environment, with_card(&file, Some(&first)))
        .await
        .expect("an older file");
    assert!(said(&app.app, brought.version).await == said(&app.app, version).await);
    app.stop().await;
}
