//! Policies: whose habits weigh the ego's actions. An explorer who tries what is rarely done changes
//! its habits, and with them mutual information; asked about by the habits from before, it does not.

use nudge::api::{json as dto, proto};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde_json::{Value, json};

use crate::lags::run;
use crate::support::TestApp;

const PATH: &str = "/v1/environments/crossing";

/// A robot that waits 19 times in 20, and a human who steps aside whenever it goes: .17 nats by these
/// habits, .69 by those of an explorer who goes half the time.
async fn crossing() -> TestApp {
    let app = TestApp::start().await;
    let agent = |name: &str, labels: [&str; 2]| json!({"name": name, "action": [{"name": "move", "categorical": {"labels": labels}}]});
    let description = json!({
        "state": [{"name": "place", "integer": {"min": 0, "max": 1}}],
        "agents": [agent("robot", ["wait", "go"]), agent("human", ["stay", "aside"])],
    });
    let made = app.rest("PUT", PATH, Some(&description)).await;
    assert_eq!(made.0, 201, "{}", made.1);

    for (sequence, segment, waits, goes) in [(1, "before", 380, 20), (2, "explored", 200, 200)] {
        let did = |robot: &str, human: &str, count: u64| {
            json!({"state": {"place": 0}, "entry": true, "count": count,
                   "actions": {"robot": robot, "human": human}})
        };
        let transitions = [did("wait", "stay", waits), did("go", "aside", goes)];
        let batch = json!({"producer": "test", "sequence": sequence, "segment": segment,
                           "transitions": transitions});
        let sent = app
            .rest("POST", &format!("{PATH}/transitions"), Some(&batch))
            .await;
        assert_eq!(sent.0, 200, "{}", sent.1);
    }
    app
}

/// Returns the answer under a policy, at a threshold between the two.
async fn asked(app: &TestApp, policy: Value) -> Value {
    let question = json!({
        "keys": ["0"],
        "policy": policy,
        "rule": {"threshold": 0.4, "unit": "nats"},
        "within": "pooled",
    });
    let path = format!("{PATH}/influence");
    let (status, answers) = app.rest("POST", &path, Some(&question)).await;
    assert_eq!(status, 200, "{answers}");
    answers["answers"][0].clone()
}

fn information(answer: &Value, name: &str) -> f64 {
    let figure = answer["mutual_information"][name].as_f64();
    figure.unwrap_or_else(|| panic!("no {name} in {answer}"))
}

#[tokio::test]
async fn an_explorer_is_weighed_by_the_habits_from_before() {
    let app = crossing().await;
    let entropy = |p: f64| -p * p.ln() - (1.0 - p) * (1.0 - p).ln();
    for (policy, goes, verdict) in [
        (json!("observed"), 220.0 / 800.0, "influences"),
        (json!("uniform"), 0.5, "influences"),
        (json!({"segments": ["before"]}), 0.05, "no_influence"),
        (json!({"segments": ["explored"]}), 0.5, "influences"),
        (
            json!({"segments": ["explored", "before"]}),
            220.0 / 800.0,
            "influences",
        ),
    ] {
        let told = asked(&app, policy.clone()).await;
        let truth = entropy(goes);
        assert!(
            (information(&told, "plug_in") - truth).abs() < 1e-9,
            "{policy}: {told}"
        );
        let mean = information(&told, "posterior_mean");
        assert!(
            (mean - truth).abs() < 0.1,
            "{policy}: {mean} beside {truth}"
        );
        assert!(
            information(&told, "expected_if_independent") < 0.02,
            "{told}"
        );
        assert_eq!(told["verdict"], json!(verdict), "{policy}: {told}");
        assert_eq!(told["dependence"], json!("established"));
        assert_eq!(told["visits"], json!(800), "responses are by all visits");
    }
}

#[tokio::test]
async fn faces_ask_by_the_same_policy() {
    let app = crossing().await;
    let question = json!({"keys": ["0"], "policy": {"segments": ["before"]}, "view": "figures"});
    let path = format!("{PATH}/influence");
    let (status, over_rest) = app.rest("POST", &path, Some(&question)).await;
    assert_eq!(status, 200, "{over_rest}");
    let query = "?key=0&policy.segments=before&view=figures";
    assert_eq!(app.get(&format!("{path}{query}")).await, over_rest);

    let segments = vec!["before".to_owned()];
    let habits = proto::policy::Habits::Segments(proto::PolicySegments { segments });
    let request = proto::BatchGetInfluenceRequest {
        scope: Some(proto::Scope {
            environment: "crossing".into(),
            policy: Some(proto::Policy {
                habits: Some(habits),
            }),
            ..proto::Scope::default()
        }),
        keys: vec!["0".into()],
        view: proto::View::Figures.into(),
        ..proto::BatchGetInfluenceRequest::default()
    };
    let over_grpc = app.influence().await.batch_get_influence(request).await;
    let over_grpc = dto::Answers::from(over_grpc.expect("valid").into_inner());
    assert_eq!(serde_json::to_value(over_grpc).expect("JSON"), over_rest);

    let asked = [
        "query", "crossing", "--key", "0", "--view", "figures", "--json",
    ];
    let policy = ["--policy-segments", "before"];
    let (code, told, stderr) = run(&app, &[&asked[..], &policy].concat()).await;
    assert_eq!(code, 0, "{stderr}");
    let by_command: Value = serde_json::from_str(&told).expect("JSON");
    assert_eq!(by_command, over_rest);

    // A ranking decides as the answer does.
    let listed = app
        .get(&format!(
            "{PATH}/states?policy.segments=before&rule.threshold=0.4"
        ))
        .await;
    let alone = app
        .get(&format!(
            "{path}?key=0&policy.segments=before&rule.threshold=0.4"
        ))
        .await;
    assert_eq!(
        listed["states"][0]["verdict"], alone["answers"][0]["verdict"],
        "{listed}"
    );
}

#[tokio::test]
async fn a_policy_of_nobody_is_refused() {
    let app = crossing().await;
    let path = format!("{PATH}/influence");
    for (policy, pointer) in [
        (json!("random"), "/policy"),
        (json!({"segments": []}), "/policy/segments"),
        (json!({"segments": ["a", ""]}), "/policy/segments/1"),
        (json!({"segments": ["befor"]}), "/policy/segments"),
        (json!(7), "/policy"),
        (json!({"segment": ["before"]}), "/policy"),
    ] {
        let question = json!({"keys": ["0"], "policy": policy});
        let (status, problem) = app.rest("POST", &path, Some(&question)).await;
        assert_eq!(status, 400, "{policy}: {problem}");
        assert_eq!(problem["errors"][0]["pointer"], json!(pointer), "{problem}");
    }
    let (status, problem) = app
        .rest(
            "POST",
            &format!("{PATH}/profile"),
            Some(&json!({"policy": "uniform"})),
        )
        .await;
    assert_eq!(status, 400, "{problem}");
}

/// States of the learner's world; in every other one the other copies the ego three times in four.
const PLACES: u64 = 40;
/// Visits of a round.
const ROUND: usize = 40;
const ROUNDS: usize = 30;

/// Someone who learns whether the robot influences the human, place by place.
struct Learner {
    app: TestApp,
    random: Pcg64,
    sequence: u64,
}

/// Right and wrong verdicts.
#[derive(Debug, Default, Clone, Copy)]
struct Verdicts {
    right: u64,
    wrong: u64,
}

impl Learner {
    /// Begins with five visits to each place, acting naturally.
    async fn new(seed: u64) -> Self {
        let app = TestApp::start().await;
        let action = json!([{"name": "move", "integer": {"min": 0, "max": 2}}]);
        let description = json!({
            "state": [{"name": "place", "integer": {"min": 0, "max": PLACES - 1}}],
            "agents": [{"name": "robot", "action": action}, {"name": "human", "action": action}],
            "rule": {"threshold": 0.1, "unit": "nats", "exploration": ["tried"]},
        });
        let made = app.rest("PUT", PATH, Some(&description)).await;
        assert_eq!(made.0, 201, "{}", made.1);

        let random = Pcg64::seed_from_u64(seed);
        let mut learner = Self {
            app,
            random,
            sequence: 0,
        };
        let visits: Vec<(u64, u64)> = (0..5 * PLACES)
            .map(|at| (at % PLACES, learner.natural()))
            .collect();
        learner.visit(None, &visits).await;
        learner
    }

    /// Returns an action as the robot is used to act: mostly 0.
    fn natural(&mut self) -> u64 {
        match self.random.random_range(0..10) {
            0 => 1,
            1 => 2,
            _ => 0,
        }
    }

    /// Takes actions in places, and counts what the human does.
    async fn visit(&mut self, segment: Option<&str>, visits: &[(u64, u64)]) {
        self.sequence += 1;
        let transitions: Vec<Value> = visits
            .iter()
            .map(|(place, robot)| {
                let copies = place % 2 == 0 && self.random.random_range(0..4) > 0;
                let human = if copies { *robot } else { self.random.random_range(0..3) };
                json!({"state": {"place": place}, "actions": {"robot": robot, "human": human}, "entry": true})
            })
            .collect();
        let batch = json!({"producer": "learner", "sequence": self.sequence,
                           "segment": segment, "transitions": transitions});
        let path = format!("{PATH}/transitions");
        let (status, receipt) = self.app.rest("POST", &path, Some(&batch)).await;
        assert_eq!(
            (status, &receipt["rejected_count"]),
            (200, &json!(0)),
            "{receipt}"
        );
    }

    /// Acts naturally, wherever it comes.
    async fn act(&mut self) {
        let visits: Vec<(u64, u64)> = (0..ROUND)
            .map(|_| (self.random.random_range(0..PLACES), self.natural()))
            .collect();
        self.visit(None, &visits).await;
    }

    /// Tries what is suggested, in a segment of its own.
    async fn explore(&mut self) {
        self.fit().await;
        let told = self.app.get(&format!("{PATH}/explore?limit={ROUND}")).await;
        let trials = told["trials"].as_array().expect("trials").iter();
        let visits: Vec<(u64, u64)> = trials
            .map(|trial| {
                let place = trial["state"]["key"].as_str().expect("a key").parse();
                (
                    place.expect("a number"),
                    trial["index"].as_u64().expect("an index"),
                )
            })
            .collect();
        if !visits.is_empty() {
            self.visit(Some("tried"), &visits).await;
        }
    }

    /// Fits the prior to what was counted, rather than some time in the background.
    async fn fit(&self) {
        let (status, fitted) = self.app.rest("POST", &format!("{PATH}/fit"), None).await;
        assert_eq!(status, 200, "{fitted}");
    }

    async fn verdicts(&self) -> Verdicts {
        self.fit().await;
        let keys: Vec<String> = (0..PLACES).map(|place| place.to_string()).collect();
        let question = json!({"keys": keys, "view": "figures"});
        let path = format!("{PATH}/influence");
        let (status, told) = self.app.rest("POST", &path, Some(&question)).await;
        assert_eq!(status, 200, "{told}");

        let answers = told["answers"].as_array().expect("answers").iter();
        let mut verdicts = Verdicts::default();
        for (place, answer) in answers.enumerate() {
            let is_copied = place % 2 == 0;
            match answer["verdict"].as_str().expect("a verdict") {
                "undecided" => {}
                verdict if (verdict == "influences") == is_copied => verdicts.right += 1,
                _ => verdicts.wrong += 1,
            }
        }
        verdicts
    }
}

#[tokio::test]
async fn a_learner_who_follows_advice_is_right_sooner_and_no_more_often_wrong() {
    let (mut decided, mut wrong) = (0, 0);
    for seed in [1, 2] {
        let [mut natural, mut explorer] = [Learner::new(seed).await, Learner::new(seed).await];
        for _ in 0..ROUNDS {
            natural.act().await;
        }
        let acted = natural.verdicts().await;

        // As many right ones as acting naturally has, with at most .7 x the visits.
        let begun = 5 * PLACES as usize;
        let most = (begun + ROUNDS * ROUND) * 7 / 10;
        let rounds = (most - begun) / ROUND;
        for _ in 0..rounds {
            explorer.explore().await;
        }
        let explored = explorer.verdicts().await;
        assert!(
            explored.right >= acted.right,
            "{explored:?} beside {acted:?}"
        );
        decided += explored.right + explored.wrong;
        wrong += explored.wrong;
    }
    // The rule's confidence lets one in five be wrong; marked by no segment, half of them are.
    assert!(wrong * 10 <= decided, "{wrong} of {decided}");
}
