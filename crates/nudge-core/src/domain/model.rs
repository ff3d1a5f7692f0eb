//! Networks that answer for states with few visits or none: how they are trained, what they say of
//! themselves, and what they answer.

use std::fmt;

use super::{FitId, Pair, Schema};

/// What a network predicts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum ModelKind {
    /// What both agents do: mutual information, divergences and responses come from its output.
    #[default]
    Joint,
    /// The paper's classifier: whether mutual information is above one threshold, and nothing else.
    Direct,
}

impl ModelKind {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Joint => "joint",
            Self::Direct => "direct",
        }
    }
}

impl std::str::FromStr for ModelKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "joint" => Ok(Self::Joint),
            "direct" => Ok(Self::Direct),
            _ => Err(format!("got {text:?}, expected joint or direct")),
        }
    }
}

/// How much a state counts in training and in scores.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Weighting {
    /// As often as it was seen.
    #[default]
    Visits,
    /// Once.
    States,
}

impl Weighting {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Visits => "visits",
            Self::States => "states",
        }
    }
}

impl std::str::FromStr for Weighting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "visits" => Ok(Self::Visits),
            "states" => Ok(Self::States),
            _ => Err(format!("got {text:?}, expected visits or states")),
        }
    }
}

/// The hyperparameters of a training. Made only by [`Training::new`], so every number is within its
/// limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Training {
    /// What it predicts.
    pub kind: ModelKind,
    /// Units of the hidden layer.
    pub width: usize,
    /// The size of the ensemble: networks that are trained and averaged.
    pub members: usize,
    /// Folds of the cross-validation: parts that the states are cut into. Each member is stopped
    /// early and judged by one that it does not learn from.
    pub folds: usize,
    /// The most epochs, passes over the states; early stopping may end before.
    pub epochs: usize,
    /// How much a state counts: for what a direct network learns, and for the scores of both.
    pub weighting: Weighting,
    /// Where all randomness comes from.
    pub seed: u64,
}

impl Default for Training {
    fn default() -> Self {
        Self {
            kind: ModelKind::Joint,
            width: 64,
            members: 3,
            folds: 5,
            epochs: 140,
            weighting: Weighting::Visits,
            seed: 0,
        }
    }
}

/// A trained network as the registry lists it.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// Its number in its environment, never used twice.
    pub version: u64,
    /// The agent whose influence it tells.
    pub ego: String,
    /// The agent that may be influenced.
    pub other: String,
    /// How many steps after the ego the other is observed; 0 in the same tick.
    pub lag: u32,
    /// Whether it answers where counts do not decide.
    pub active: bool,
    /// Whether it cannot answer by the environment's rule any more: its threshold is not the
    /// rule's.
    pub stale: bool,
    /// What it says of itself, or why it cannot be read: then it answers nothing, and can only be
    /// taken along, taken back or deleted.
    pub card: Result<Card, String>,
}

impl Model {
    /// Returns whose influence on whom it tells; `None` where that is no pair of a schema.
    pub fn pair(&self, schema: &Schema) -> Option<Pair> {
        let [ego, other] = [&self.ego, &self.other].map(|name| schema.agent(name));
        Pair::new(ego?, other?, Vec::new()).at_lag(schema, self.lag)
    }

    /// Returns whether another tells of the same pair.
    pub fn is_of_pair_of(&self, other: &Self) -> bool {
        (&self.ego, &self.other, self.lag) == (&other.ego, &other.other, other.lag)
    }
}

/// What a network says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Card {
    /// How it was trained.
    pub training: Training,
    /// How many steps after the ego the other is observed; 0 in the same tick.
    pub lag: u32,
    /// Whether it was brought here by a file.
    pub imported: bool,
    /// The schema it belongs to, in hexadecimal digits.
    pub schema_hash: String,
    /// The threshold that its probability is about, in nats.
    pub threshold: f64,
    /// How many transitions the environment had when its states were read.
    pub revision: u64,
    /// The fit of the prior that it was judged by.
    pub fit: FitId,
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
    /// States that it was judged by: of those that it did not learn from, those with at least 8
    /// draws.
    pub judged_states: u64,
    /// How much of them has influence by the evidence: the sum of their probabilities, by weight,
    /// as a share.
    pub positive_share: f64,
    /// P(MI > threshold) is the logistic function of intercept + slope ln(MI + 0.005), MI being
    /// what a member of a joint network says in nats.
    pub calibration: Calibration,
    /// What it says of a state on average: the mean of its probabilities over the states that it
    /// was judged on, each once, rarely seen ones included. Absent from cards of earlier builds.
    pub base_rate: Option<f64>,
    /// How it did.
    pub score: Score,
    /// How others did on the same states: see [`Baseline`].
    pub baselines: Vec<Score>,
    /// Predicted probabilities beside what the evidence says, in tenths; tenths without a state are
    /// left out.
    pub reliability: Vec<Reliability>,
    /// Names of the baselines that it does not beat, by log-likelihood where both have one, else by
    /// the Brier score; it is made active by itself where there is none.
    pub not_better_than: Vec<String>,
}

impl Card {
    /// Returns whether it found more in the counts that it learned from than the same network does
    /// in shuffled ones.
    pub fn found_something(&self) -> bool {
        !self
            .not_better_than
            .iter()
            .any(|name| name == Baseline::Shuffled.as_str())
    }

    /// Returns whether it is known which states each member did not learn from: not of a network
    /// that another tool trained.
    pub fn is_split_known(&self) -> bool {
        !self.epochs.is_empty()
    }
}

/// Returns whether two thresholds in nats are the same but for rounding: one may have been told in
/// bits, or as a share of what is possible.
pub fn is_same_threshold(one: f64, other: f64) -> bool {
    const ROUNDING: f64 = 1e-9;
    (one - other).abs() <= ROUNDING * one.abs().max(other.abs())
}

/// What a network has to beat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Baseline {
    /// Every state has influence.
    AllPositive,
    /// Every state has it with the probability that all have on average.
    Majority,
    /// What was seen in the same state; in a state that was not seen, the average.
    LookUp,
    /// What was seen in the states that share its most telling features.
    BackOff,
    /// The same network, trained on counts in which the other's actions are shuffled within each
    /// state.
    Shuffled,
}

impl Baseline {
    /// Every baseline, in the order in which they are told.
    pub const ALL: [Self; 5] = [
        Self::AllPositive,
        Self::Majority,
        Self::LookUp,
        Self::BackOff,
        Self::Shuffled,
    ];

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::AllPositive => "all_positive",
            Self::Majority => "majority",
            Self::LookUp => "look_up",
            Self::BackOff => "back_off",
            Self::Shuffled => "shuffled",
        }
    }
}

/// A calibration (Platt scaling): from a network's mutual information to a probability.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Added to the rest.
    pub intercept: f64,
    /// Times ln(MI + 0.005), MI in nats.
    pub slope: f64,
}

/// Scores on held-out states: how probabilities of influence did against the evidence of states
/// that they were not made from. A state counts as positive by its probability given its counts,
/// and as negative by the rest.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Score {
    /// Whose they are: `network`, or a baseline's name.
    pub name: String,
    /// Mean log-likelihood of the other's action given the ego's, in nats a visit; absent for what
    /// predicts no actions.
    pub log_likelihood: Option<f64>,
    /// Area under the ROC curve; absent where all have the same probability.
    pub auroc: Option<f64>,
    /// Share of influence in what is called at a probability of one half; absent where nothing is
    /// called.
    pub precision: Option<f64>,
    /// Share called of what has influence; absent where nothing has.
    pub recall: Option<f64>,
    /// Harmonic mean of both; 0 where nothing is called.
    pub f1: f64,
    /// Brier score, the mean squared difference between probability and truth: less is better.
    pub brier: f64,
}

/// One bin of a reliability diagram: states whose predicted probability lies in one tenth.
#[derive(Debug, Clone, Copy, PartialEq)]
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

/// A training that was asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct Job {
    /// Its number, which no job of another start of the service has.
    pub id: u64,
    /// The agent whose influence is learned.
    pub ego: String,
    /// The agent that may be influenced.
    pub other: String,
    /// How many steps after the ego the other is observed; 0 in the same tick.
    pub lag: u32,
    /// How far it is.
    pub state: JobState,
    /// The share that is done, 0 to 1.
    pub progress: f64,
    /// In a sentence: what it does, what came out, or why not.
    pub message: String,
    /// The version that came out.
    pub version: Option<u64>,
    /// Trainings that go before it, of whatever environment; 0 once it has begun.
    pub ahead: u64,
    /// In how many seconds it will be done, at its pace so far; `None` before that can be told, and
    /// when it is over.
    pub seconds_left: Option<f64>,
}

/// How far a job is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JobState {
    /// Others are trained first.
    Queued,
    /// It is trained.
    Running,
    /// There is a version.
    Done,
    /// There is none; the message says why.
    Failed,
    /// Somebody ended it.
    Cancelled,
}

impl JobState {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Queued => "queued",
            Self::Running => "running",
            Self::Done => "done",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Returns whether it is over.
    pub fn is_over(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}

/// Versions of an environment, and the jobs that were asked for since the service started.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Models {
    /// In order of version.
    pub models: Vec<Model>,
    /// In order of number; all of them on the first page.
    pub jobs: Vec<Job>,
    /// Asks for the next page; `None` on the last.
    pub next_page_token: Option<String>,
}

/// Names a version or a job: `3` or `job-3`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModelId {
    /// A version.
    Version(u64),
    /// A job.
    Job(u64),
}

impl fmt::Display for ModelId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Version(version) => write!(f, "{version}"),
            Self::Job(job) => write!(f, "job-{job}"),
        }
    }
}

impl std::str::FromStr for ModelId {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            text.parse()
                .ok()
                .filter(|number: &u64| number.to_string() == text)
        };

        let found = match text.strip_prefix("job-") {
            Some(job) => number(job).map(Self::Job),
            None => number(text).map(Self::Version),
        };

        found.ok_or_else(|| {
            format!(
                "got {text:?}, expected the number of a version, or job- and the number of a job"
            )
        })
    }
}

/// What the active network says of a state.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelFigures {
    /// Its version.
    pub version: u64,
    /// What it predicts.
    pub kind: ModelKind,
    /// P(MI > threshold), the mean of its members; absent at another threshold than the one that it
    /// was trained for.
    pub probability: Option<f64>,
    /// Mutual information, the mean of its members; absent for a direct network.
    pub mutual_information: Option<f64>,
    /// Whether its members say the same at their own threshold, each on its own side of one half.
    pub agrees: bool,
    /// Names of the features whose bin in this state no state of its training had: where there is
    /// one, it gives no verdict.
    pub out_of_range: Vec<String>,
    /// The ego's actions in index order; a joint network in the view `full` only.
    pub by_action: Vec<ModelAction>,
}

/// What a network says of one of the ego's actions.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelAction {
    /// Its index.
    pub index: u64,
    /// Its label.
    pub action: String,
    /// How probable it is.
    pub probability: f64,
    /// KL(p(other given this action) from p(other)).
    pub divergence: f64,
    /// Probability of each of the other's actions after it, in index order.
    pub response: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_are_compared_up_to_rounding() {
        let half = 0.5 / std::f64::consts::LN_2 * std::f64::consts::LN_2;
        assert!(is_same_threshold(0.5, half) && is_same_threshold(0.0, 0.0));
        assert!(!is_same_threshold(0.5, 0.5 + 1e-6) && !is_same_threshold(0.0, 1e-12));
    }
}
