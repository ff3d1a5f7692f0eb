//! Model cards: how a network was trained, how it scores on held-out data beside its baselines, and
//! how well it is calibrated.

use serde::Serialize;
use utoipa::ToSchema;

use super::Fit;
use super::words;
use crate::proto;

/// What a network says of itself.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Card {
    /// How it was trained.
    pub training: Training,
    /// Whether it was brought here by a file. Without `epochs` another tool trained it, and nobody
    /// knows which states it has seen.
    pub imported: bool,
    /// The schema it belongs to, in hexadecimal digits.
    pub schema_hash: String,
    /// The threshold that its probability is about, in nats.
    pub threshold: f64,
    /// How many transitions the environment had when its states were read.
    pub revision: u64,
    /// The fit of the prior that it was judged by.
    pub fit: Fit,
    /// States that it was trained or judged on.
    pub states: u64,
    /// How often they were seen.
    pub visits: u64,
    /// Numbers that a state is to it.
    pub inputs: u64,
    /// In a sentence: which states it learned from and which it was judged by.
    pub split: String,
    /// Passes over the states after which each member was best.
    pub epochs: Vec<u64>,
    /// The share of hidden units that was left out in each step: of two, the one that did better on
    /// states that were not learned from.
    pub dropout: f64,
    /// States that it was judged by.
    pub judged_states: u64,
    /// How much of them has influence by the evidence: the sum of their probabilities, by weight,
    /// as a share.
    pub positive_share: f64,
    /// From its mutual information to a probability.
    pub calibration: Calibration,
    /// What it says of a state on average: the mean of its probabilities over the states that it
    /// was judged on, each once. A verdict of it needs odds that are three times these, or a third.
    /// Absent from cards of earlier builds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_rate: Option<f64>,
    /// How it did.
    pub score: Score,
    /// How others did on the same states: `all_positive`, `majority`, `look_up`, `back_off` and
    /// `shuffled`; of an import, `shuffled` is as it was where the network was trained.
    pub baselines: Vec<Score>,
    /// Predicted probabilities beside what the evidence says, in tenths; tenths without a state are
    /// left out.
    pub reliability: Vec<Reliability>,
    /// Names of the baselines that it does not beat; it is made active by itself where there is
    /// none.
    pub not_better_than: Vec<String>,
}

/// How a network was trained.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Training {
    /// What it predicts: `joint` or `direct`.
    #[schema(example = "joint", value_type = words::ModelKind)]
    pub kind: &'static str,
    /// Units of the hidden layer.
    pub width: u64,
    /// Networks that were trained and averaged.
    pub members: u64,
    /// Parts that the states were cut into; each member was stopped and judged by one that it did
    /// not learn from.
    pub folds: u64,
    /// The most passes over the states.
    pub epochs: u64,
    /// How much a state counted: `visits` or `states`.
    #[schema(example = "visits", value_type = words::Weighting)]
    pub weighting: &'static str,
    /// Where all randomness came from.
    pub seed: u64,
}

/// P(MI > threshold) is the logistic function of intercept + slope ln(MI), MI being the network's
/// in nats.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, ToSchema)]
pub struct Calibration {
    /// Added to the rest.
    pub intercept: f64,
    /// Times ln(MI + 0.005), MI in nats.
    pub slope: f64,
}

/// How probabilities of influence did against the evidence of states that they were not made from.
///
/// A state counts as positive by its probability given its counts, and as negative by the rest.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Score {
    /// Whose they are: `network`, or a baseline's name.
    #[schema(example = "network")]
    pub name: String,
    /// Mean log-likelihood of the other's action given the ego's, in nats a visit; null for what
    /// predicts no actions.
    pub log_likelihood: Option<f64>,
    /// Area under the ROC curve; null where all have the same probability.
    pub auroc: Option<f64>,
    /// Share of influence in what is called at a probability of one half; null where nothing is
    /// called.
    pub precision: Option<f64>,
    /// Share called of what has influence; null where nothing has.
    pub recall: Option<f64>,
    /// Harmonic mean of both; 0 where nothing is called.
    pub f1: f64,
    /// Mean squared difference between probability and truth: less is better.
    pub brier: f64,
}

/// States whose predicted probability lies in one tenth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct Reliability {
    /// The lower bound of the tenth.
    pub from: f64,
    /// How many states.
    pub states: u64,
    /// The mean of what was predicted.
    pub predicted: f64,
    /// The mean of what the evidence says.
    pub observed: f64,
}

/// Returns the word for what a network predicts.
pub fn model_kind(number: i32) -> &'static str {
    match proto::ModelKind::try_from(number) {
        Ok(proto::ModelKind::Joint) => "joint",
        Ok(proto::ModelKind::Direct) => "direct",
        Ok(proto::ModelKind::Unspecified) | Err(_) => "unknown",
    }
}

/// Returns the word for how much a state counts.
pub fn weighting(number: i32) -> &'static str {
    match proto::Weighting::try_from(number) {
        Ok(proto::Weighting::Visits) => "visits",
        Ok(proto::Weighting::States) => "states",
        Ok(proto::Weighting::Unspecified) | Err(_) => "unknown",
    }
}

impl From<proto::Card> for Card {
    fn from(card: proto::Card) -> Self {
        let calibration = card.calibration.unwrap_or_default();
        Self {
            training: card.training.unwrap_or_default().into(),
            imported: card.imported,
            schema_hash: card.schema_hash,
            threshold: card.threshold,
            revision: card.revision,
            fit: card.fit.map(Into::into).unwrap_or_default(),
            states: card.states,
            visits: card.visits,
            inputs: card.inputs,
            split: card.split,
            epochs: card.epochs,
            dropout: card.dropout,
            judged_states: card.judged_states,
            positive_share: card.positive_share,
            calibration: Calibration {
                intercept: calibration.intercept,
                slope: calibration.slope,
            },
            base_rate: card.base_rate,
            score: card.score.map(Into::into).unwrap_or_default(),
            baselines: card.baselines.into_iter().map(Into::into).collect(),
            reliability: card.reliability.into_iter().map(Into::into).collect(),
            not_better_than: card.not_better_than,
        }
    }
}

impl From<proto::Training> for Training {
    fn from(training: proto::Training) -> Self {
        let proto::Training {
            width,
            members,
            folds,
            epochs,
            seed,
            ..
        } = training;
        let (kind, weighting) = (model_kind(training.kind), weighting(training.weighting));
        Self {
            kind,
            width,
            members,
            folds,
            epochs,
            weighting,
            seed,
        }
    }
}

impl From<proto::Score> for Score {
    fn from(score: proto::Score) -> Self {
        let proto::Score {
            name,
            log_likelihood,
            auroc,
            precision,
            recall,
            f1,
            brier,
        } = score;
        Self {
            name,
            log_likelihood,
            auroc,
            precision,
            recall,
            f1,
            brier,
        }
    }
}

impl From<proto::Reliability> for Reliability {
    fn from(tenth: proto::Reliability) -> Self {
        let proto::Reliability {
            from,
            states,
            predicted,
            observed,
        } = tenth;
        Self {
            from,
            states,
            predicted,
            observed,
        }
    }
}
