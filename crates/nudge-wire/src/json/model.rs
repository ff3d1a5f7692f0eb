//! Networks: requests for a training, the names of versions and jobs, and the lists of both.

use nudge_core::domain::ModelId;
use nudge_core::domain::draft::TrainingDraft;
use nudge_core::error::{Fault, Problem};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::decode::or_default;
use super::whole::perhaps_whole;
use super::{Card, words};
use crate::{present, proto};

/// How a network is to be trained. What is absent has its default.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of ego, other, kind and more"
)]
pub struct TrainingRequest {
    /// The agent whose influence is learned; absent for the first.
    #[schema(example = "robot")]
    pub ego: Option<String>,
    /// The agent that may be influenced; absent for the second.
    #[schema(example = "human")]
    pub other: Option<String>,
    /// How many steps later the other's action is observed, one of the lags that are declared for
    /// it; 0, or absent, for the same tick. Each lag has versions of its own. The other's own action
    /// one step before is held fixed, as in questions.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(minimum = 0, maximum = 64, example = 3)]
    pub lag: Option<i64>,
    /// `joint` (the default): what both agents do, from which mutual information and responses
    /// come; or `direct`, the paper's classifier: whether mutual information is above one
    /// threshold, and nothing else.
    #[schema(example = "joint", value_type = Option<words::ModelKind>)]
    pub kind: Option<String>,
    /// Units of the hidden layer; 64 by default.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(example = 64, minimum = 1, maximum = 1_024)]
    pub width: Option<u64>,
    /// Networks that are trained and averaged, at most `folds`; 3 by default.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(example = 3, minimum = 1, maximum = 16)]
    pub members: Option<u64>,
    /// Parts that the states are cut into; each member is stopped and judged by one that it does
    /// not learn from. 5 by default.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(example = 5, minimum = 2, maximum = 20)]
    pub folds: Option<u64>,
    /// The most passes over the states; 140 by default.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(example = 140, minimum = 1, maximum = 10_000)]
    pub epochs: Option<u64>,
    /// How much a state counts: `visits` (the default), as often as it was seen, or `states`, once.
    #[schema(example = "visits", value_type = Option<words::Weighting>)]
    pub weighting: Option<String>,
    /// Where all randomness comes from; 0 by default.
    #[serde(default, deserialize_with = "perhaps_whole")]
    pub seed: Option<u64>,
    /// Whether the version is made active even where it does not beat its baselines.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub activate: bool,
}

impl From<TrainingRequest> for TrainingDraft {
    fn from(request: TrainingRequest) -> Self {
        let TrainingRequest {
            ego,
            other,
            lag,
            kind,
            width,
            members,
            folds,
            epochs,
            weighting,
            seed,
            activate,
        } = request;
        Self {
            ego,
            other,
            lag: lag.unwrap_or_default(),
            kind,
            width,
            members,
            folds,
            epochs,
            weighting,
            seed,
            activate,
        }
    }
}

/// Reads the name of a version or a job from a path.
pub fn model_id(text: &str) -> Result<ModelId, Problem> {
    text.parse()
        .map_err(|detail: String| Problem::invalid("model", vec![Fault::new("/model", detail)]))
}

/// Reads the number of a version from a path.
pub fn model_version(text: &str) -> Result<u64, Problem> {
    match model_id(text)? {
        ModelId::Version(version) => Ok(version),
        ModelId::Job(_) => {
            let detail = format!("got {text:?}, expected the number of a version");
            Err(Problem::invalid(
                "model",
                vec![Fault::new("/model", detail)],
            ))
        }
    }
}

/// Every version of an environment, and the jobs that were asked for since the service started.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Models {
    /// In order of version.
    pub models: Vec<Model>,
    /// In order of number; all of them on the first page.
    pub jobs: Vec<Job>,
    /// Asks for the next page; null on the last.
    pub next_page_token: Option<String>,
}

/// A version or a job.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum ModelOrJob {
    /// A version.
    Model(Box<Model>),
    /// A job.
    Job(Job),
}

/// What answers for a pair after a version was taken back.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RolledBack {
    /// The version that answers now; null where none does.
    pub active: Option<Model>,
}

/// A trained network.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Model {
    /// Its number in its environment, never used twice.
    pub version: u64,
    /// The agent whose influence it tells.
    pub ego: String,
    /// The agent that may be influenced.
    pub other: String,
    /// How many steps after the ego the other is observed; 0 in the same tick. It answers at this
    /// lag and at no other.
    #[schema(example = 0)]
    pub lag: u32,
    /// Whether it answers where counts do not decide.
    pub active: bool,
    /// Whether it cannot answer by the environment's rule any more: its threshold is not the
    /// rule's.
    pub stale: bool,
    /// What it says of itself; null where it cannot be read.
    pub card: Option<Card>,
    /// In a sentence: why this build cannot read it; absent where it can. It answers nothing then,
    /// and cannot be made active; it can be exported, taken back and deleted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unreadable: Option<String>,
}

/// A training that was asked for.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Job {
    /// Its name: `job-` and its number, which no job of another start of the service has.
    #[schema(example = "job-3", pattern = "^job-[0-9]+$")]
    pub id: String,
    /// The agent whose influence is learned.
    pub ego: String,
    /// The agent that may be influenced.
    pub other: String,
    /// How many steps after the ego the other is observed; 0 in the same tick.
    #[schema(example = 0)]
    pub lag: u32,
    /// `queued` (others are trained first), `running`, `done` (there is a version), `failed` (the
    /// message says why) or `cancelled`.
    #[schema(example = "running", value_type = words::JobState)]
    pub state: &'static str,
    /// The share that is done, 0 to 1.
    #[schema(minimum = 0, maximum = 1)]
    pub progress: f64,
    /// In a sentence: what it does, what came out, or why not.
    pub message: String,
    /// The version that came out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<u64>,
    /// Trainings that go before it, of whatever environment; 0 once it has begun.
    pub ahead: u64,
    /// In how many seconds it will be done, at its pace so far; absent before that can be told, and
    /// when it is over.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0)]
    pub seconds_left: Option<f64>,
}

/// Returns the word for how far a job is.
pub fn job_state(number: i32) -> &'static str {
    match proto::JobState::try_from(number) {
        Ok(proto::JobState::Queued) => "queued",
        Ok(proto::JobState::Running) => "running",
        Ok(proto::JobState::Done) => "done",
        Ok(proto::JobState::Failed) => "failed",
        Ok(proto::JobState::Cancelled) => "cancelled",
        Ok(proto::JobState::Unspecified) | Err(_) => "unknown",
    }
}

impl From<proto::ListModelsResponse> for Models {
    fn from(response: proto::ListModelsResponse) -> Self {
        Self {
            models: response.models.into_iter().map(Into::into).collect(),
            jobs: response.jobs.into_iter().map(Into::into).collect(),
            next_page_token: present(response.next_page_token),
        }
    }
}

impl From<proto::Model> for Model {
    fn from(model: proto::Model) -> Self {
        let proto::Model {
            version,
            ego,
            other,
            lag,
            active,
            stale,
            card,
            unreadable,
        } = model;
        Self {
            version,
            ego,
            other,
            lag,
            active,
            stale,
            card: card.map(Into::into),
            unreadable,
        }
    }
}

impl From<proto::RollBackModelResponse> for RolledBack {
    fn from(response: proto::RollBackModelResponse) -> Self {
        Self {
            active: response.active.map(Into::into),
        }
    }
}

impl From<proto::Job> for Job {
    fn from(job: proto::Job) -> Self {
        let proto::Job {
            id,
            ego,
            other,
            lag,
            state,
            progress,
            message,
            version,
            ahead,
            seconds_left,
        } = job;
        let (id, state) = (ModelId::Job(id).to_string(), job_state(state));
        Self {
            id,
            ego,
            other,
            lag,
            state,
            progress,
            message,
            version,
            ahead,
            seconds_left,
        }
    }
}

#[cfg(test)]
mod tests {
    use nudge_core::domain;
    use serde_json::json;

    use super::*;
    use crate::grpc;
    use crate::json::{decode, model_kind, weighting};

    fn draft(text: &str) -> Result<TrainingDraft, Problem> {
        decode::<TrainingRequest>("body", text.as_bytes()).map(Into::into)
    }

    #[test]
    fn everything_can_be_asked_over_both_faces_and_nothing_must_be() {
        assert_eq!(draft("{}"), Ok(TrainingDraft::default()));
        let text = r#"{"ego": "a", "other": "b", "lag": 3, "kind": "direct", "width": 0, "members": 1, "folds": 2, "epochs": 3,
            "weighting": "states", "seed": 18446744073709551615, "activate": true}"#;
        let expected = TrainingDraft {
            ego: Some("a".into()),
            other: Some("b".into()),
            lag: 3,
            kind: Some("direct".into()),
            width: Some(0),
            members: Some(1),
            folds: Some(2),
            epochs: Some(3),
            weighting: Some("states".into()),
            seed: Some(u64::MAX),
            activate: true,
        };
        assert_eq!(draft(text), Ok(expected.clone()));
        let request = proto::TrainModelRequest {
            environment: "hallway".into(),
            ego: "a".into(),
            other: "b".into(),
            lag: 3,
            kind: proto::ModelKind::Direct.into(),
            weighting: proto::Weighting::States.into(),
            width: expected.width,
            members: expected.members,
            folds: expected.folds,
            epochs: expected.epochs,
            seed: expected.seed,
            activate: expected.activate,
        };
        assert_eq!(grpc::training(request), ("hallway".into(), expected));
    }

    #[test]
    fn faults_name_their_place() {
        let pointer = |text: &str| draft(text).expect_err("wrong").faults.remove(0).pointer;
        assert_eq!(pointer(r#"{"widht": 64}"#), "/widht");
        assert_eq!(pointer(r#"{"epochs": -1}"#), "/epochs");
        assert_eq!(pointer(r#"{"lag": 1.5}"#), "/lag");
        assert_eq!(pointer(r#"{"activate": "yes"}"#), "/activate");
        assert_eq!(pointer("[]"), "");
    }

    #[test]
    fn paths_name_versions_and_jobs() {
        assert_eq!(
            (model_id("3"), model_id("job-12")),
            (Ok(ModelId::Version(3)), Ok(ModelId::Job(12)))
        );
        assert_eq!(model_version("3"), Ok(3));
        for wrong in ["job-3", "three", "03", "", "-1"] {
            assert_eq!(
                model_version(wrong).expect_err(wrong).faults[0].pointer,
                "/model"
            );
        }
        assert!(model_id("job-x").is_err());
    }

    fn score(name: &str, log_likelihood: Option<f64>) -> domain::Score {
        domain::Score {
            name: name.into(),
            log_likelihood,
            f1: 0.5,
            brier: 0.125,
            ..domain::Score::default()
        }
    }

    fn model() -> domain::Model {
        let card = domain::Card {
            training: domain::Training {
                kind: domain::ModelKind::Direct,
                seed: u64::MAX,
                ..Default::default()
            },
            lag: 3,
            imported: true,
            schema_hash: "ab12".into(),
            threshold: 0.5,
            revision: 900,
            fit: domain::FitId {
                version: 2,
                revision: 850,
            },
            states: 60,
            visits: 900,
            inputs: 7,
            split: "by states".into(),
            epochs: vec![41, 38],
            dropout: 0.5,
            judged_states: 12,
            positive_share: 0.25,
            base_rate: Some(0.2),
            calibration: domain::Calibration {
                intercept: 1.5,
                slope: 0.75,
            },
            score: domain::Score {
                auroc: Some(0.9),
                precision: Some(0.8),
                recall: Some(0.7),
                ..score("network", Some(-1.25))
            },
            baselines: vec![score("all_positive", None), score("majority", Some(-1.5))],
            reliability: vec![domain::Reliability {
                from: 0.1,
                states: 4,
                predicted: 0.15,
                observed: 0.2,
            }],
            not_better_than: vec!["majority".into()],
        };
        let (ego, other, card) = ("robot".into(), "human".into(), Ok(card));
        domain::Model {
            version: 3,
            ego,
            other,
            lag: 3,
            active: false,
            stale: true,
            card,
        }
    }

    fn job_as_json(job: domain::Job) -> serde_json::Value {
        serde_json::to_value(Job::from(proto::Job::from(job))).expect("JSON")
    }

    fn as_json(model: domain::Model) -> serde_json::Value {
        serde_json::to_value(Model::from(proto::Model::from(model))).expect("JSON")
    }

    #[test]
    fn a_card_is_told_whole() {
        let network = json!({
            "name": "network", "log_likelihood": -1.25, "auroc": 0.9, "precision": 0.8, "recall": 0.7, "f1": 0.5, "brier": 0.125,
        });
        let plain = |name: &str, log_likelihood: Option<f64>| {
            json!({
                "name": name, "log_likelihood": log_likelihood, "auroc": null, "precision": null, "recall": null,
                "f1": 0.5, "brier": 0.125,
            })
        };
        let card = json!({
            "training": {
                "kind": "direct", "width": 64, "members": 3, "folds": 5, "epochs": 140, "weighting": "visits", "seed": u64::MAX,
            },
            "imported": true, "schema_hash": "ab12", "threshold": 0.5, "revision": 900,
            "fit": {"version": 2, "revision": 850}, "states": 60, "visits": 900, "inputs": 7, "split": "by states",
            "epochs": [41, 38], "dropout": 0.5, "judged_states": 12, "positive_share": 0.25,
            "calibration": {"intercept": 1.5, "slope": 0.75}, "base_rate": 0.2, "score": network,
            "baselines": [plain("all_positive", None), plain("majority", Some(-1.5))],
            "reliability": [{"from": 0.1, "states": 4, "predicted": 0.15, "observed": 0.2}],
            "not_better_than": ["majority"],
        });
        let expected = json!({"version": 3, "ego": "robot", "other": "human", "lag": 3, "active": false, "stale": true, "card": card});
        assert_eq!(as_json(model()), expected);
    }

    #[test]
    fn cards_of_earlier_builds_lack_a_base_rate() {
        let mut expected = as_json(model());
        expected["card"]
            .as_object_mut()
            .map(|card| card.remove("base_rate"));
        let card = model().card.map(|card| domain::Card {
            base_rate: None,
            ..card
        });
        assert_eq!(as_json(domain::Model { card, ..model() }), expected);
    }

    #[test]
    fn a_version_that_cannot_be_read_says_why_instead_of_its_card() {
        let expected = json!({
            "version": 3, "ego": "robot", "other": "human", "lag": 3, "active": false, "stale": true, "card": null, "unreadable": "why",
        });
        assert_eq!(
            as_json(domain::Model {
                card: Err("why".into()),
                ..model()
            }),
            expected
        );
    }

    #[test]
    fn jobs_are_told_by_name() {
        let job = domain::Job {
            id: 3,
            ego: "robot".into(),
            other: "human".into(),
            lag: 1,
            state: domain::JobState::Running,
            progress: 0.25,
            message: "training".into(),
            version: None,
            ahead: 0,
            seconds_left: None,
        };
        let running = json!({
            "id": "job-3", "ego": "robot", "other": "human", "lag": 1, "state": "running", "progress": 0.25, "message": "training",
            "ahead": 0,
        });
        assert_eq!(job_as_json(job.clone()), running);
        let waits = job_as_json(domain::Job {
            ahead: 2,
            seconds_left: Some(1.5),
            ..job.clone()
        });
        assert_eq!(
            (&waits["ahead"], &waits["seconds_left"]),
            (&json!(2), &json!(1.5))
        );
        let done = job_as_json(domain::Job {
            state: domain::JobState::Done,
            version: Some(7),
            ..job
        });
        assert_eq!(
            (&done["state"], &done["version"]),
            (&json!("done"), &json!(7))
        );
    }

    #[test]
    fn words_are_those_of_the_domain() {
        use domain::JobState::*;
        for state in [Queued, Running, Done, Failed, Cancelled] {
            assert_eq!(
                job_state(proto::JobState::from(state).into()),
                state.as_str()
            );
        }
        for one in [domain::ModelKind::Joint, domain::ModelKind::Direct] {
            assert_eq!(model_kind(proto::ModelKind::from(one).into()), one.as_str());
        }
        for one in [domain::Weighting::Visits, domain::Weighting::States] {
            assert_eq!(weighting(proto::Weighting::from(one).into()), one.as_str());
        }
    }
}
