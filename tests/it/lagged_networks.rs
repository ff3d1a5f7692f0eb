//! Networks at a lag: a follower that answers some steps later is found in states that nobody saw,
//! at its lag and in its direction and nowhere else, by every face in the same words.

use std::time::Duration;

use nudge::api::inference_proto::grpc_inference_service_client::GrpcInferenceServiceClient;
use nudge::api::inference_proto::model_infer_request::InferInputTensor;
use nudge::api::inference_proto::{ModelInferRequest, ModelReadyRequest};
use nudge::api::{json as dto, proto};
use nudge::domain::draft::TrainingDraft;
use nudge::domain::{Job, JobState, Model, StateKey};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use safetensors::SafeTensors;
use serde_json::{Value, json};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::TestApp;

const WORLD: &str = "/v1/environments/street";

const LANES: u64 = 12;
const SIGNS: u64 = 5;

/// The lag at which the follower answers.
const LAG: usize = 3;

/// How often the follower does what the leader did, where it answers.
const COPIES: f64 = 0.9;

/// Transitions of a body.
const TOGETHER: usize = 4_000;

/// A street in which steps are taken.
struct World {
    /// Actions of the leader and of the follower.
    actions: [u64; 2],
    /// How often the follower keeps its own action where it does not answer.
    keeps: f64,
    /// Whether the leader that is recorded is another one, of another hour.
    is_shuffled: bool,
    /// How often each state is seen.
    visits: u64,
    /// Whether the follower adds what the leader did to its own last action, in place of copying.
    adds: bool,
    /// How often the follower is absent.
    rests: f64,
}

const USUAL: World = World {
    actions: [4, 4],
    keeps: 0.0,
    is_shuffled: false,
    visits: 40,
    adds: false,
    rests: 0.0,
};

/// What the follower does while it is absent.
const ABSENT: u64 = u64::MAX;

/// One step: near, lane and sign, and what both do.
#[derive(Clone, Copy)]
struct Step {
    state: [u64; 3],
    actions: [u64; 2],
}

/// An action as it is sent: null of who is absent.
fn acted(action: u64) -> Value {
    match action {
        ABSENT => Value::Null,
        action => json!(action),
    }
}

/// Whether a state is left for the network alone: half of all are.
fn is_hidden([_, lane, sign]: [u64; 3]) -> bool {
    (lane + sign).is_multiple_of(2)
}

/// Every state.
fn states() -> impl Iterator<Item = [u64; 3]> {
    let all = (0..2).flat_map(|near| (0..LANES).map(move |lane| (near, lane)));
    all.flat_map(|(near, lane)| (0..SIGNS).map(move |sign| [near, lane, sign]))
}

/// The keys of the states that were never seen, and whether the follower answers there.
fn hidden() -> impl Iterator<Item = (String, bool)> {
    let hidden = states().filter(|state| is_hidden(*state));
    hidden.map(|[near, lane, sign]| (format!("{near}.{lane}.{sign}"), near == 1))
}

impl World {
    fn description(&self) -> Value {
        let agent = |name: &str, actions: u64| json!({"name": name, "action": [{"name": "move", "integer": {"min": 0, "max": actions - 1}}]});
        let mut agents = [("leader", 0), ("follower", 1)]
            .map(|(name, at): (&str, usize)| agent(name, self.actions[at]));
        if self.rests > 0.0 {
            agents[1]["may_be_absent"] = json!(true);
        }
        json!({
            "state": [
                {"name": "near", "categorical": {"labels": ["no", "yes"]}},
                {"name": "lane", "integer": {"min": 0, "max": LANES - 1}},
                {"name": "sign", "categorical": {"labels": ["a", "b", "c", "d", "e"]}},
            ],
            "agents": agents,
            "lags": [1, 2, 3],
        })
    }

    /// The steps that were taken: each in a state that is seen, whatever the one before.
    fn steps(&self) -> Vec<Step> {
        let mut random = StdRng::seed_from_u64(4);
        let seen: Vec<[u64; 3]> = states().filter(|state| !is_hidden(*state)).collect();
        let mut steps: Vec<Step> = Vec::new();
        for at in 0..seen.len() * self.visits as usize {
            let state = seen[random.random_range(0..seen.len())];
            let leads = random.random_range(0..self.actions[0]);
            let answered = at.checked_sub(LAG).map(|before| steps[before]);
            let answered = answered.filter(|step| step.state[0] == 1 && random.random_bool(COPIES));
            let follows = match (answered, steps.last()) {
                _ if self.rests > 0.0 && random.random_bool(self.rests) => ABSENT,
                (Some(step), Some(last)) if self.adds => {
                    (step.actions[0] + last.actions[1]) % self.actions[1]
                }
                (Some(step), _) => step.actions[0] % self.actions[1],
                (None, Some(last)) if random.random_bool(self.keeps) => last.actions[1],
                _ => random.random_range(0..self.actions[1]),
            };
            steps.push(Step {
                state,
                actions: [leads, follows],
            });
        }
        steps
    }

    /// The same as they are sent, each with what both do one to three steps later.
    fn transitions(&self) -> Vec<Value> {
        let steps = self.steps();
        let leader = |at: usize| {
            let hours = if self.is_shuffled { steps.len() / 2 } else { 0 };
            steps[(at + hours) % steps.len()].actions[0]
        };
        let transition = |at: usize| {
            let [near, lane, sign] = steps[at].state;
            let mut outcomes = json!({});
            for lag in 1..=LAG {
                outcomes[format!("leader@{lag}")] = json!(leader(at + lag));
                outcomes[format!("follower@{lag}")] = acted(steps[at + lag].actions[1]);
            }
            json!({
                "state": {"near": near, "lane": lane, "sign": sign},
                "actions": {"leader": leader(at), "follower": acted(steps[at].actions[1])},
                "outcomes": outcomes,
                "entry": true,
            })
        };
        (0..steps.len() - LAG).map(transition).collect()
    }

    /// Returns a service that counted every step.
    async fn counted(&self) -> TestApp {
        let app = TestApp::start().await;
        let made = app.rest("PUT", WORLD, Some(&self.description())).await;
        assert_eq!(made.0, 201, "{}", made.1);
        count(&app, "p", &self.transitions()).await;
        app
    }
}

async fn count(app: &TestApp, producer: &str, transitions: &[Value]) {
    for (sequence, transitions) in (1..).zip(transitions.chunks(TOGETHER)) {
        let body = json!({"producer": producer, "sequence": sequence, "transitions": transitions});
        let to = format!("{WORLD}/transitions");
        let (status, receipt) = app.rest("POST", &to, Some(&body)).await;
        assert_eq!(
            (status, &receipt["rejected_count"]),
            (200, &json!(0)),
            "{receipt}"
        );
    }
}

fn draft(lag: i64) -> TrainingDraft {
    TrainingDraft {
        lag,
        members: Some(2),
        width: Some(32),
        ..TrainingDraft::default()
    }
}

/// A training that takes no time, of a network that answers whatever it has found.
fn small(lag: i64) -> TrainingDraft {
    TrainingDraft {
        width: Some(4),
        folds: Some(2),
        epochs: Some(5),
        activate: true,
        ..draft(lag)
    }
}

async fn trained(app: &TestApp, draft: &TrainingDraft) -> Model {
    let environment = app.app.environments.find("street").expect("made");
    let networks = &app.app.networks;
    let job = networks.train(&environment, draft).await.expect("valid");
    let job = networks.finished(&environment, job.id).await;
    let job = job.expect("known");
    assert_eq!(job.state, JobState::Done, "{}", job.message);
    assert_eq!(i64::from(job.lag), draft.lag);
    let version = job.version.expect("a version");
    networks.get(&environment, version).await.expect("kept")
}

/// Returns the answer about a state, of what a query says.
async fn answer(app: &TestApp, query: &str) -> Value {
    app.get(&format!("{WORLD}/influence?{query}")).await["answers"][0].clone()
}

/// How often upkeep looks at what has grown.
const OFTEN: Duration = Duration::from_millis(10);

/// Awaits so many jobs in all, which upkeep asks for, and returns them, in order of lag and number.
async fn ended_jobs(app: &TestApp, many: usize) -> Vec<Job> {
    let environment = app.app.environments.find("street").expect("made");
    let networks = &app.app.networks;
    loop {
        let mut jobs = networks.list(&environment).await.expect("listed").jobs;
        if jobs.len() == many && jobs.iter().all(|job| job.state == JobState::Done) {
            jobs.sort_by_key(|job| (job.lag, job.id));
            return jobs;
        }
        assert!(jobs.len() <= many, "{jobs:?}");
        tokio::time::sleep(OFTEN).await;
    }
}

/// Returns how many of the states that nobody saw are said to have influence and how many to have
/// none, where that is right and where it is wrong.
async fn decided(app: &TestApp, query: &str) -> [[usize; 2]; 2] {
    let keys: Vec<String> = hidden().map(|(key, _)| key).collect();
    let mut body = json!({"keys": keys, "view": "figures"});
    for part in query.split('&') {
        let (name, value) = part.split_once('=').expect("a name and a value");
        body[name] = value.parse::<i64>().map_or(json!(value), |lag| json!(lag));
    }
    let to = format!("{WORLD}/influence");
    let (status, told) = app.rest("POST", &to, Some(&body)).await;
    assert_eq!(status, 200, "{told}");

    let mut found = [[0; 2]; 2];
    let answers = told["answers"].as_array().expect("a list");
    for (answer, (_, answers_there)) in answers.iter().zip(hidden()) {
        assert_eq!(answer["visits"], json!(0));
        match answer["verdict"].as_str().expect("a word") {
            "influences" => found[0][usize::from(!answers_there)] += 1,
            "no_influence" => found[1][usize::from(answers_there)] += 1,
            _ => {}
        }
    }
    found
}

#[tokio::test(flavor = "multi_thread")]
async fn a_follower_is_found_in_states_that_nobody_saw() {
    let app = USUAL.counted().await;
    let model = trained(&app, &draft(3)).await;
    let card = model.card.as_ref().expect("readable");
    assert!(model.active, "it beats its baselines: {card:?}");
    assert_eq!((model.lag, card.lag), (3, 3));

    let far = hidden().filter(|(_, answers)| !answers).count();
    let near = hidden().count() - far;
    let [influences, none] = decided(&app, "lag=3").await;
    assert_eq!((influences[1], none[1]), (0, 0), "nothing wrong");
    assert!(
        10 * influences[0] >= 9 * near && 10 * none[0] >= 8 * far,
        "{influences:?} {none:?} of {near} and {far}"
    );

    let told = answer(&app, "lag=3&key=1.1.1").await;
    assert_eq!(
        (&told["verdict"], &told["basis"]),
        (
            &json!("influences"),
            &json!({"kind": "model", "version": model.version})
        ),
        "{told}"
    );
    let actions = told["model"]["by_action"].as_array().expect("a list");
    let number = |of: &Value, name: &str| of[name].as_f64().expect("a number");
    let mean: f64 = actions
        .iter()
        .map(|action| number(action, "probability") * number(action, "divergence"))
        .sum();
    let information = number(&told["model"], "mutual_information");
    assert!(
        actions.len() == 4 && (mean - information).abs() < 0.05 && information > 0.6,
        "members differ a little: {mean} {information}"
    );
    for (at, action) in actions.iter().enumerate() {
        let response: Vec<f64> =
            serde_json::from_value(action["response"].clone()).expect("numbers");
        assert!((response.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        assert!(response[at] > 0.7, "the follower copies: {response:?}");
    }

    // At every other lag, and in the other direction, nothing is asked of it.
    for query in ["lag=0", "lag=1", "lag=2", "lag=3&ego=follower&other=leader"] {
        let told = answer(&app, &format!("{query}&key=1.1.1")).await;
        assert_eq!(
            (&told["verdict"], &told["model"]),
            (&json!("undecided"), &Value::Null),
            "{query}"
        );
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_found_where_nothing_is() {
    let app = USUAL.counted().await;
    let reverse = TrainingDraft {
        ego: Some("follower".into()),
        other: Some("leader".into()),
        activate: true,
        ..draft(3)
    };
    let model = trained(&app, &reverse).await;
    let card = model.card.expect("readable");
    assert!(!card.found_something(), "{card:?}");
    let [influences, _] = decided(&app, "lag=3&ego=follower&other=leader").await;
    assert_eq!(influences, [0, 0]);

    // A lag at which nobody answers: by then the follower has done something else.
    let model = trained(
        &app,
        &TrainingDraft {
            activate: true,
            ..draft(1)
        },
    )
    .await;
    assert!(!model.card.expect("readable").found_something());
    assert_eq!(decided(&app, "lag=1").await[0], [0, 0]);
    app.stop().await;

    let shuffled = World {
        is_shuffled: true,
        ..USUAL
    };
    let app = shuffled.counted().await;
    let model = trained(
        &app,
        &TrainingDraft {
            activate: true,
            ..draft(3)
        },
    )
    .await;
    let card = model.card.expect("readable");
    assert!(!card.found_something(), "{card:?}");
    assert_eq!(decided(&app, "lag=3").await[0], [0, 0]);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_other_did_itself_is_no_influence() {
    // The follower keeps what it does, and so what it did a step before tells nearly all.
    let world = World {
        keeps: 0.8,
        ..USUAL
    };
    let app = world.counted().await;
    let model = trained(&app, &draft(3)).await;
    assert!(model.active, "{:?}", model.card);
    let [influences, none] = decided(&app, "lag=3").await;
    assert_eq!((influences[1], none[1]), (0, 0), "{influences:?} {none:?}");
    assert!(influences[0] >= 20, "{influences:?} {none:?}");
    app.stop().await;

    let shuffled = World {
        is_shuffled: true,
        ..world
    };
    let app = shuffled.counted().await;
    let model = trained(
        &app,
        &TrainingDraft {
            activate: true,
            ..draft(3)
        },
    )
    .await;
    let card = model.card.expect("readable");
    assert!(!card.found_something(), "{card:?}");
    assert_eq!(decided(&app, "lag=3").await[0], [0, 0]);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_answer_that_turns_on_what_the_other_did_itself_is_found() {
    // Summed over what the follower did a step before, nothing depends on the leader: what is the
    // same in all strata tells nothing.
    let world = World {
        actions: [3, 3],
        adds: true,
        visits: 60,
        ..USUAL
    };
    let app = world.counted().await;
    let model = trained(&app, &draft(3)).await;
    assert!(model.active, "{:?}", model.card);
    let [influences, none] = decided(&app, "lag=3").await;
    assert_eq!((influences[1], none[1]), (0, 0), "{influences:?} {none:?}");
    assert!(influences[0] >= 20, "{influences:?} {none:?}");
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_held_fixed_may_be_an_absence() {
    let world = World {
        rests: 0.3,
        visits: 60,
        ..USUAL
    };
    let app = world.counted().await;
    let model = trained(&app, &draft(3)).await;
    assert!(model.active, "{:?}", model.card);
    let [influences, none] = decided(&app, "lag=3").await;
    assert_eq!((influences[1], none[1]), (0, 0), "{influences:?} {none:?}");
    assert!(influences[0] >= 20, "{influences:?} {none:?}");

    let environment = app.app.environments.find("street").expect("made");
    let file = app.app.networks.export(&environment, model.version).await;
    let file = file.expect("kept");
    let tensors = SafeTensors::deserialize(&file).expect("a file");
    let own = tensors.tensor("members.0.own.bias").expect("strata");
    assert_eq!(own.shape(), [5], "four actions and the absence");
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_has_grown_is_trained_again_at_its_lag() {
    let app = USUAL.counted().await;
    let mut first = Vec::new();
    for draft in [small(0), small(1), draft(3)] {
        first.push(trained(&app, &draft).await);
    }
    assert!(first.iter().all(|model| model.active), "{first:?}");

    let upkeep = tokio::spawn(app.app.networks.clone().keep_up(OFTEN));
    count(&app, "another", &USUAL.transitions()).await;
    let jobs = ended_jobs(&app, 6).await;
    upkeep.abort();

    let environment = app.app.environments.find("street").expect("made");
    for (jobs, first) in jobs.chunks(2).zip(&first) {
        let version = jobs[1].version.expect("a version");
        let again = app.app.networks.get(&environment, version).await;
        let again = again.expect("kept");
        assert_eq!((jobs[1].lag, again.lag), (first.lag, first.lag));

        let [before, after] = [first, &again].map(|model| model.card.as_ref().expect("readable"));
        assert_eq!(after.training, before.training, "as it was trained then");
        assert!(2 * after.revision >= 3 * before.revision, "{after:?}");
        // Where nobody answers none is better than its baselines, and the first one answers on.
        assert_eq!(again.active, first.lag == 3, "{after:?}");
        let active = if again.active { version } else { first.version };
        assert_eq!(told_at(&app, first.lag).await, json!(active));
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pair_that_no_network_fits_keeps_no_other_from_being_trained_again() {
    let app = TestApp::start().await;
    // Upkeep asks for the first two agents whether anybody did or not: these two have too many actions.
    let mut description = USUAL.description();
    let agents = description["agents"].as_array_mut().expect("a list");
    let large = |name: &str| json!({"name": name, "action": [{"name": "move", "integer": {"min": 0, "max": 255}}]});
    agents.splice(0..0, ["crowd", "choir"].map(large));
    assert_eq!(app.rest("PUT", WORLD, Some(&description)).await.0, 201);

    let beside = |mut transition: Value| {
        for name in ["crowd", "choir"] {
            transition["actions"][name] = json!(0);
            for lag in 1..=LAG {
                transition["outcomes"][format!("{name}@{lag}")] = json!(0);
            }
        }
        transition
    };
    let transitions: Vec<Value> = USUAL.transitions().into_iter().map(beside).collect();
    count(&app, "p", &transitions).await;
    let of_pair = TrainingDraft {
        ego: Some("leader".into()),
        other: Some("follower".into()),
        ..small(3)
    };
    trained(&app, &of_pair).await;

    let upkeep = tokio::spawn(app.app.networks.clone().keep_up(OFTEN));
    count(&app, "another", &transitions).await;
    let jobs = ended_jobs(&app, 2).await;
    upkeep.abort();
    assert_eq!([jobs[0].lag, jobs[1].lag], [3, 3]);
    app.stop().await;
}

/// Returns the version that the answer at a lag tells of.
async fn told_at(app: &TestApp, lag: u32) -> Value {
    answer(app, &format!("lag={lag}&key=1.1.1&view=figures")).await["model"]["version"].clone()
}

#[tokio::test(flavor = "multi_thread")]
async fn networks_of_one_pair_at_several_lags_live_side_by_side() {
    let app = USUAL.counted().await;
    for (version, lag) in (1..).zip([0, 1, 3, 3, 1]) {
        assert_eq!(trained(&app, &small(lag)).await.version, version);
    }
    let lags = |models: &Value, active: bool| -> Vec<(u64, u64)> {
        let models = models["models"].as_array().expect("a list").iter();
        let number = |model: &Value, name: &str| model[name].as_u64().expect("a number");
        models
            .filter(|model| model["active"] == json!(active))
            .map(|model| (number(model, "version"), number(model, "lag")))
            .collect()
    };
    let listed = app.get(&format!("{WORLD}/models")).await;
    assert_eq!(lags(&listed, true), [(1, 0), (4, 3), (5, 1)]);
    assert_eq!(lags(&listed, false), [(2, 1), (3, 3)]);
    let asked = |lags: [u32; 3]| {
        let app = &app;
        async move {
            let mut told = Vec::new();
            for lag in lags {
                told.push(told_at(app, lag).await);
            }
            json!(told)
        }
    };
    assert_eq!(asked([0, 1, 3]).await, json!([1, 5, 4]));
    assert_eq!(told_at(&app, 2).await, Value::Null);

    // One is taken back: the one of its lag that was active before answers again, or none.
    let taken = |version: u64| {
        let app = &app;
        let path = format!("{WORLD}/models/{version}/active");
        async move { app.rest("DELETE", &path, None).await }
    };
    let (status, told) = taken(4).await;
    assert_eq!(
        (status, &told["active"]["version"]),
        (200, &json!(3)),
        "{told}"
    );
    assert_eq!(told["active"]["lag"], json!(3));
    assert_eq!(asked([0, 1, 3]).await, json!([1, 5, 3]));
    assert_eq!(taken(3).await, (200, json!({"active": null})));
    assert_eq!(asked([0, 1, 3]).await, json!([1, 5, null]));

    // One is deleted, and another made active.
    let path = format!("{WORLD}/models/3");
    assert_eq!(app.rest("DELETE", &path, None).await.0, 204);
    let refused = app.rest("DELETE", &format!("{WORLD}/models/5"), None).await;
    assert_eq!(refused.0, 409, "it is active");
    let path = format!("{WORLD}/models/2/active");
    let (status, told) = app.rest("PUT", &path, None).await;
    assert_eq!((status, &told["lag"]), (200, &json!(1)), "{told}");
    assert_eq!(asked([0, 1, 3]).await, json!([1, 2, null]));

    let app = app.restart().await;
    let kept = [
        told_at(&app, 0).await,
        told_at(&app, 1).await,
        told_at(&app, 3).await,
    ];
    assert_eq!(json!(kept), json!([1, 2, null]), "after a restart too");
    app.stop().await;
}

/// Returns figures of the protocol over REST: probabilities and mutual information, or the error.
async fn infer(app: &TestApp, model: &str, rows: &[f32]) -> Result<[Vec<f32>; 2], (u16, String)> {
    let shape = [rows.len() / 3, 3];
    let input = json!({"name": "state", "datatype": "FP32", "shape": shape, "data": rows});
    let path = format!("/v2/models/{model}/infer");
    let body = json!({"inputs": [input]});
    let (status, told) = app.rest("POST", &path, Some(&body)).await;
    if status != 200 {
        let error = told["error"].as_str().expect("text").to_owned();
        return Err((status, error));
    }
    assert_eq!(told["model_name"], json!(model));
    let data = |at: usize| told["outputs"][at]["data"].clone();
    Ok([0, 1].map(|at| serde_json::from_value(data(at)).expect("numbers")))
}

#[tokio::test(flavor = "multi_thread")]
async fn the_inference_protocol_names_the_lag_behind_the_other() {
    let app = USUAL.counted().await;
    let same_tick = trained(&app, &small(0)).await.version;
    let later = trained(
        &app,
        &TrainingDraft {
            activate: true,
            ..draft(3)
        },
    )
    .await
    .version;

    let rows = [[1.0, 1.0, 1.0], [0.0, 1.0, 1.0], [1.0, 2.0, 4.0]];
    let model = "street~leader~follower@3";
    let [probabilities, information] = infer(&app, model, &rows.concat()).await.expect("active");
    for ((row, p), mi) in rows.iter().zip(probabilities).zip(information) {
        let key: Vec<String> = row.iter().map(ToString::to_string).collect();
        let told = answer(&app, &format!("lag=3&key={}&unit=nats", key.join("."))).await;
        let figure = |name: &str| told["model"][name].as_f64().expect("told") as f32;
        assert_eq!(
            (p, mi),
            (figure("probability"), figure("mutual_information")),
            "{told}"
        );
    }

    let unknown = |name: &str| infer_error(&app, name.to_owned());
    for (name, says) in [
        ("street~leader~follower@2", "no version of model"),
        ("street~follower~leader@3", "no version of model"),
        (
            "street~leader~follower@9",
            "got 9, expected 0 or a lag that is declared for follower: 1, 2, 3",
        ),
        (
            "street~leader~follower@0",
            "got \"follower@0\", expected a whole number above 0 behind the @",
        ),
        (
            "street~leader~follower@x",
            "expected a whole number above 0",
        ),
        ("street~leader~dog@3", "unknown agent \"dog\""),
    ] {
        let (status, error) = unknown(name).await;
        assert_eq!(status, 404, "{name}: {error}");
        assert!(error.contains(says), "{name}: {error}");
    }

    // A version is one of its own lag's model, and of no other's.
    let metadata = app.get(&format!("/v2/models/{model}")).await;
    assert_eq!(metadata["versions"], json!([later.to_string()]));
    let (status, told) = app
        .rest(
            "GET",
            &format!("/v2/models/{model}/versions/{same_tick}"),
            None,
        )
        .await;
    assert_eq!(status, 404);
    let says = format!("version {same_tick} is not one of model `{model}`; known: {later}");
    assert!(
        told["error"].as_str().expect("text").contains(&says),
        "{told}"
    );
    let path = format!("/v2/models/street/versions/{later}");
    assert_eq!(app.rest("GET", &path, None).await.0, 404);

    let mut client = GrpcInferenceServiceClient::new(app.channel().await);
    let ready = |name: &str| ModelReadyRequest {
        name: name.into(),
        version: String::new(),
    };
    let told = client.model_ready(ready(model)).await.expect("told");
    assert!(told.into_inner().ready);
    let told = client.model_ready(ready("street~leader~follower@2")).await;
    assert!(!told.expect("told").into_inner().ready);
    let message = ModelInferRequest {
        model_name: model.into(),
        inputs: vec![InferInputTensor {
            name: "state".into(),
            datatype: "FP32".into(),
            shape: vec![3, 3],
            ..Default::default()
        }],
        raw_input_contents: vec![
            rows.concat()
                .iter()
                .flat_map(|x: &f32| x.to_le_bytes())
                .collect(),
        ],
        ..Default::default()
    };
    let over_grpc = client.model_infer(message).await.expect("active");
    let over_grpc = over_grpc.into_inner().raw_output_contents.concat();
    let over_rest = infer(&app, model, &rows.concat()).await.expect("active");
    let over_rest: Vec<u8> = over_rest
        .concat()
        .iter()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    assert_eq!(over_grpc, over_rest);
    app.stop().await;
}

async fn infer_error(app: &TestApp, model: String) -> (u16, String) {
    infer(app, &model, &[1.0, 1.0, 1.0])
        .await
        .expect_err("no network")
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lag_that_is_not_declared_is_refused_in_the_same_words() {
    let app = USUAL.counted().await;
    let declared = "expected 0 or a lag that is declared for follower: 1, 2, 3";
    let before = "leader would be observed after follower";
    for (other, lag, pointer, detail) in [
        ("follower", 4, "/lag", format!("got 4, {declared}")),
        ("follower", -1, "/lag", before.to_owned()),
        (
            "follower@3",
            0,
            "/other",
            "got \"follower@3\", expected \"follower\" with the lag 3 beside it".to_owned(),
        ),
    ] {
        let body = json!({"other": other, "lag": lag});
        let to = format!("{WORLD}/models");
        let (status, told) = app.rest("POST", &to, Some(&body)).await;
        let fault = &told["errors"][0];
        assert_eq!(
            (status, &fault["pointer"]),
            (400, &json!(pointer)),
            "{told}"
        );
        assert!(
            fault["detail"].as_str().expect("text").contains(&detail),
            "{told}"
        );

        let request = proto::TrainModelRequest {
            environment: "street".into(),
            other: other.into(),
            lag,
            ..Default::default()
        };
        let refused = app.models().await.train_model(request).await;
        let refused = refused.expect_err("refused");
        assert_eq!(refused.code(), tonic::Code::InvalidArgument);
        assert!(refused.message().contains(&detail), "{}", refused.message());

        let lag = lag.to_string();
        let arguments = ["train", "street", "--other", other, "--lag", &lag];
        let told = output(nudge(&app.address.to_string(), &arguments)).await;
        let (code, _, stderr) = exit_and_texts(&told);
        assert!(code == 1 && stderr.contains(&detail), "{stderr}");
    }
    for wrong in [json!(1.5), json!("3")] {
        let to = format!("{WORLD}/models");
        let (status, told) = app.rest("POST", &to, Some(&json!({"lag": wrong}))).await;
        assert_eq!(
            (status, &told["errors"][0]["pointer"]),
            (400, &json!("/lag"))
        );
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_face_trains_and_tells_the_same() {
    let app = USUAL.counted().await;
    let small = [
        "--width",
        "4",
        "--members",
        "1",
        "--folds",
        "2",
        "--epochs",
        "5",
    ];
    let train = ["train", "street", "--lag", "3", "--activate", "--json"];
    let address = app.address.to_string();
    let told = output(nudge(&address, &[&train[..], &small].concat())).await;
    let (code, by_cli, stderr) = exit_and_texts(&told);
    assert_eq!(code, 0, "{stderr}");
    let by_cli: Value = serde_json::from_str(&by_cli).expect("JSON");
    assert_eq!(
        (&by_cli["lag"], &by_cli["active"]),
        (&json!(3), &json!(true))
    );
    assert_eq!(app.get(&format!("{WORLD}/models/1")).await, by_cli);

    let request = proto::GetModelRequest {
        environment: "street".into(),
        version: 1,
    };
    let over_grpc = app.models().await.get_model(request).await.expect("kept");
    let over_grpc = over_grpc.into_inner().model.expect("told");
    assert_eq!(json!(dto::Model::from(over_grpc)), by_cli);

    // The same training over REST gives the same network.
    let body = json!({"lag": 3, "width": 4, "members": 1, "folds": 2, "epochs": 5});
    let to = format!("{WORLD}/models");
    let (status, job) = app.rest("POST", &to, Some(&body)).await;
    assert_eq!((status, &job["lag"]), (202, &json!(3)), "{job}");
    let environment = app.app.environments.find("street").expect("made");
    let id: u64 = job["id"].as_str().expect("a name")[4..]
        .parse()
        .expect("a number");
    let done = app.app.networks.finished(&environment, id).await;
    assert_eq!(done.expect("known").version, Some(2));
    let again = app.get(&format!("{WORLD}/models/2")).await;
    for part in ["training", "epochs", "calibration", "score", "baselines"] {
        assert_eq!(again["card"][part], by_cli["card"][part], "{part}");
    }

    let told = output(nudge(&address, &["model", "list", "street"])).await;
    let (_, listed, _) = exit_and_texts(&told);
    assert!(listed.contains("follower@3"), "{listed}");
    app.stop().await;
}

async fn import(app: &TestApp, file: Vec<u8>) -> (u16, Value) {
    let sent = reqwest::Client::new()
        .post(app.url(&format!("{WORLD}/models/import")))
        .header("content-type", "application/octet-stream")
        .body(file)
        .send()
        .await
        .expect("answered");
    (sent.status().as_u16(), sent.json().await.expect("JSON"))
}

/// Replaces a text of a file's header by another of the same length.
fn replaced(file: &[u8], from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let at = file
        .windows(from.len())
        .position(|part| part == from.as_bytes());
    let at = at.unwrap_or_else(|| panic!("{from} is in the file"));
    [&file[..at], to.as_bytes(), &file[at + from.len()..]].concat()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_says_its_lag_and_brings_the_same_answers_along() {
    let app = USUAL.counted().await;
    for kind in ["joint", "direct"] {
        let draft = TrainingDraft {
            kind: Some(kind.into()),
            ..small(3)
        };
        let version = trained(&app, &draft).await.version;
        let environment = app.app.environments.find("street").expect("made");
        let networks = &app.app.networks;
        let file = networks.export(&environment, version).await.expect("kept");
        let (_, header) = SafeTensors::read_metadata(&file).expect("a file");
        let metadata = header.metadata().clone().expect("texts");
        assert_eq!(
            [&metadata["format"], &metadata["lag"], &metadata["other"]],
            ["nudge/2", "3", "follower"]
        );

        let (status, imported) = import(&app, file.clone()).await;
        assert_eq!((status, &imported["lag"]), (201, &json!(3)), "{imported}");
        let bins = |state: [u64; 3]| StateKey::new(&state.map(|bin| bin as u32));
        let keys: Vec<StateKey> = states().map(bins).collect();
        let mut said = Vec::new();
        for version in [version, imported["version"].as_u64().expect("a number")] {
            let network = networks.network(&environment, version).await.expect("kept");
            said.push(network.predict(&keys, network.threshold));
        }
        assert_eq!(said[0], said[1], "{kind}");

        for (from, to, pointer, detail) in [
            (
                "\"lag\":\"3\"",
                "\"lag\":\"9\"",
                "/metadata/lag",
                "got \"9\", expected a lag above 0 that is declared for follower",
            ),
            (
                "\"lag\":\"3\"",
                "\"lag\":\"0\"",
                "/metadata/lag",
                "got \"0\", expected a lag above 0 that is declared for follower",
            ),
            (
                "\"lag\":\"3\"",
                "\"gal\":\"3\"",
                "/metadata/lag",
                "got none, expected a lag above 0 that is declared for follower",
            ),
            (
                "\"lag\":\"3\"",
                "\"lag\":\"1\"",
                "/metadata/card",
                "is of lag 3, expected 1",
            ),
            (
                "nudge/2",
                "nudge/1",
                "/metadata/lag",
                "got \"3\", expected none in format \"nudge/1\"",
            ),
            (
                "nudge/2",
                "nudge/3",
                "/metadata/format",
                "got \"nudge/3\", expected \"nudge/1\", or at a lag \"nudge/2\"",
            ),
        ] {
            let (status, told) = import(&app, replaced(&file, from, to)).await;
            assert_eq!(status, 400, "{from} {to}: {told}");
            let faults = told["errors"].as_array().expect("a list");
            let names = |fault: &&Value| fault["pointer"] == json!(pointer);
            let fault = faults.iter().find(names);
            let fault = fault.unwrap_or_else(|| panic!("{from} {to}: {told}"));
            assert!(
                fault["detail"].as_str().expect("text").contains(detail),
                "{told}"
            );
        }
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn odd_alphabets_have_networks_and_too_large_ones_are_refused() {
    for actions in [[1, 1], [3, 1], [1, 3], [2, 3], [3, 2], [25, 3]] {
        let world = World {
            actions,
            visits: 12,
            ..USUAL
        };
        let app = world.counted().await;
        for kind in ["joint", "direct"] {
            let draft = TrainingDraft {
                kind: Some(kind.into()),
                ..small(3)
            };
            let model = trained(&app, &draft).await;
            assert!(model.card.is_ok(), "{actions:?} {kind}: {model:?}");
            let told = answer(&app, "lag=3&key=1.1.1").await;
            assert_eq!(
                told["model"]["version"],
                json!(model.version),
                "{actions:?}"
            );
            if actions.contains(&1) {
                assert_eq!(told["verdict"], json!("undecided"), "{actions:?}");
            }
        }
        app.stop().await;
    }

    let app = TestApp::start().await;
    for actions in [[41, 41], [256, 256]] {
        let world = World { actions, ..USUAL };
        let made = app.rest("PUT", WORLD, Some(&world.description())).await;
        assert_eq!(made.0, 201, "{}", made.1);
        let body = json!({"lag": 3});
        let (status, told) = app
            .rest("POST", &format!("{WORLD}/models"), Some(&body))
            .await;
        assert_eq!(
            (status, &told["reason"]),
            (413, &json!("NETWORK_TOO_LARGE")),
            "{told}"
        );
        assert_eq!(app.rest("DELETE", WORLD, None).await.0, 204);
    }
    app.stop().await;
}
