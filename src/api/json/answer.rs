//! Answers about influence.

use std::collections::BTreeMap;

use serde::{Serialize, Serializer};
use utoipa::ToSchema;

use super::present;
use crate::api::proto;

/// The answers to one question, with what indices in them stand for.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Answers {
    /// What indices stand for.
    pub labels: Labels,
    /// One a state, in the order asked.
    pub answers: Vec<Answer>,
}

/// What indices in answers stand for.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Labels {
    /// The ego.
    pub ego: Variable,
    /// The other.
    pub other: Variable,
    /// The agents held fixed.
    pub given: Vec<Variable>,
}

/// A variable and the labels of its values.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Variable {
    /// Its name.
    #[schema(example = "robot")]
    pub name: String,
    /// A label an action, in index order; empty where there are more than 4,096.
    pub actions: Vec<String>,
}

/// The answer for one state. Fields from `unit` on are absent in the view `verdict`.
///
/// Every information figure is in `unit`. At lag 0 it states dependence given the state; that it runs from ego to other is the caller's assumption.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Answer {
    /// The state.
    pub state: State,
    /// How often it was seen, in the segments asked for.
    pub visits: u64,
    /// How often it was entered; absent unless every transition carried the flag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entries: Option<u64>,
    /// `influences`, `no_influence` or `undecided`.
    #[schema(example = "undecided")]
    pub verdict: &'static str,
    /// What the verdict rests on.
    pub basis: Basis,
    /// The unit of every information figure, `nats` or `bits`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// The threshold used, in that unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// The kind of rule that decided, `evidence` or `paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rule: Option<String>,
    /// Mutual information of ego action and other action in this state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mutual_information: Option<MutualInformation>,
    /// One an ego action, in index order; view `full` only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by_action: Option<Vec<ActionFigures>>,
    /// Steps between the two actions: 0, the same tick.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lag: Option<u32>,
    /// Whether the figures tell a direction: false at lag 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub directed: Option<bool>,
    /// How many transitions of the environment the answer stands on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub revision: Option<u64>,
}

/// A state by key and bins.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct State {
    /// Bin numbers joined by dots.
    #[schema(example = "3.0.7")]
    pub key: String,
    /// One a feature, in the environment's order; absent in the view `verdict`.
    #[serde(skip_serializing_if = "Vec::is_empty", serialize_with = "as_object")]
    #[schema(value_type = BTreeMap<String, Bin>, required = false)]
    pub bins: Vec<(String, Bin)>,
}

/// One bin of a state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Bin {
    /// The bin's number, from 0.
    #[schema(example = 3)]
    pub bin: u32,
    /// What people call it.
    #[schema(example = "[2, 3)")]
    pub label: String,
}

/// What a verdict rests on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Basis {
    /// `counts`, `model` (a network's prediction) or `prior` (nothing seen, and no model is active).
    #[schema(example = "counts")]
    pub kind: &'static str,
    /// The visits it rests on, where it is `counts`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visits: Option<u64>,
}

/// Mutual information of ego action and other action in a state, in the answer's unit.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MutualInformation {
    /// Plug-in, at least 0; 0 at no visits. At few visits most of it is bias: compare `expected_if_independent`.
    pub plug_in: f64,
    /// The mean of plug-in under independence at these margins.
    pub expected_if_independent: f64,
    /// `hypergeometric` (exact) or `asymptotic` (above 1,000 visits).
    pub expected_method: String,
    /// Further estimators that were asked for, by name; these may be negative.
    pub estimates: BTreeMap<String, f64>,
}

/// What one ego action was seen to do.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ActionFigures {
    /// Its label.
    pub action: String,
    /// Its index.
    pub index: u64,
    /// How often it was seen in this state.
    pub visits: u64,
    /// KL(p(other given this action) from p(other)) by relative frequencies, in the answer's unit; null when unvisited. Favours the rarest action.
    pub plug_in_divergence: Option<f64>,
    /// Relative frequency of each of the other's actions after it, in index order; null when unvisited.
    pub response: Option<Vec<f64>>,
}

/// Writes pairs as an object in their order, which a map type would lose.
fn as_object<S: Serializer>(bins: &[(String, Bin)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(bins.iter().map(|(feature, bin)| (feature, bin)))
}

/// Returns the word for a verdict.
pub(super) fn verdict(number: i32) -> &'static str {
    match proto::Verdict::try_from(number) {
        Ok(proto::Verdict::Influences) => "influences",
        Ok(proto::Verdict::NoInfluence) => "no_influence",
        Ok(proto::Verdict::Undecided) => "undecided",
        // A newer service may know a word that this client does not.
        Ok(proto::Verdict::Unspecified) | Err(_) => "unknown",
    }
}

fn basis(number: i32, visits: u64) -> Basis {
    match proto::Basis::try_from(number) {
        Ok(proto::Basis::Counts) => Basis { kind: "counts", visits: Some(visits) },
        Ok(proto::Basis::Model) => Basis { kind: "model", visits: None },
        Ok(proto::Basis::Prior) => Basis { kind: "prior", visits: None },
        Ok(proto::Basis::Unspecified) | Err(_) => Basis { kind: "unknown", visits: None },
    }
}

impl From<proto::BatchGetInfluenceResponse> for Answers {
    fn from(response: proto::BatchGetInfluenceResponse) -> Self {
        let labels = response.labels.map(Into::into).unwrap_or_default();
        Self { labels, answers: response.answers.into_iter().map(Into::into).collect() }
    }
}

impl From<proto::GetInfluenceResponse> for Answers {
    fn from(response: proto::GetInfluenceResponse) -> Self {
        let labels = response.labels.map(Into::into).unwrap_or_default();
        Self { labels, answers: response.answer.into_iter().map(Into::into).collect() }
    }
}

impl From<proto::Labels> for Labels {
    fn from(labels: proto::Labels) -> Self {
        Self {
            ego: labels.ego.map(Into::into).unwrap_or_default(),
            other: labels.other.map(Into::into).unwrap_or_default(),
            given: labels.given.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::Variable> for Variable {
    fn from(variable: proto::Variable) -> Self {
        Self { name: variable.name, actions: variable.actions }
    }
}

impl From<proto::Answer> for Answer {
    fn from(answer: proto::Answer) -> Self {
        let by_action: Vec<ActionFigures> = answer.by_action.into_iter().map(Into::into).collect();
        Self {
            state: answer.state.map(Into::into).unwrap_or_default(),
            visits: answer.visits,
            entries: answer.entries,
            verdict: verdict(answer.verdict),
            basis: basis(answer.basis, answer.visits),
            unit: present(answer.unit),
            threshold: answer.threshold,
            rule: present(answer.rule),
            mutual_information: answer.mutual_information.map(Into::into),
            // An agent has an action at least, so that nothing means "not asked for".
            by_action: Some(by_action).filter(|figures| !figures.is_empty()),
            lag: answer.lag,
            directed: answer.directed,
            revision: answer.revision,
        }
    }
}

impl From<proto::State> for State {
    fn from(state: proto::State) -> Self {
        let bin = |bin: proto::Bin| (bin.feature, Bin { bin: bin.bin, label: bin.label });
        Self { key: state.key, bins: state.bins.into_iter().map(bin).collect() }
    }
}

impl From<proto::MutualInformation> for MutualInformation {
    fn from(figures: proto::MutualInformation) -> Self {
        Self {
            plug_in: figures.plug_in,
            expected_if_independent: figures.expected_if_independent,
            expected_method: figures.expected_method,
            estimates: figures.estimates.into_iter().collect(),
        }
    }
}

impl From<proto::ActionFigures> for ActionFigures {
    fn from(figures: proto::ActionFigures) -> Self {
        let proto::ActionFigures { action, index, visits, plug_in_divergence, response } = figures;
        Self { action, index, visits, plug_in_divergence, response: Some(response).filter(|r| !r.is_empty()) }
    }
}
