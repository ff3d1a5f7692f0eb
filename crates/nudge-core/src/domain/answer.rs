//! Answers: what the counts of a state say about influence. Every figure is in the answer's unit.

use super::{FitId, ModelFigures, RuleKind, StateKey, Tally, Unit};

/// The verdict on a state: whether the ego's action influences the other's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Verdict {
    /// It does, by the rule.
    Influences,
    /// It does not, by the rule.
    NoInfluence,
    /// What was seen does not decide.
    Undecided,
}

impl Verdict {
    /// Every verdict, in the order in which they are told.
    pub const ALL: [Self; 3] = [Self::Influences, Self::NoInfluence, Self::Undecided];

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Influences => "influences",
            Self::NoInfluence => "no_influence",
            Self::Undecided => "undecided",
        }
    }
}

impl std::str::FromStr for Verdict {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("got {text:?}, expected influences, no_influence or undecided");
        Self::ALL
            .into_iter()
            .find(|verdict| verdict.as_str() == text)
            .ok_or_else(wrong)
    }
}

/// Whether there is any dependence at all, however weak: another question than whether it is strong
/// enough to count as influence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Dependence {
    /// There is.
    Established,
    /// There is none.
    Excluded,
    /// What was seen does not decide.
    Open,
}

impl Dependence {
    /// Every value, in the order in which they are told.
    pub const ALL: [Self; 3] = [Self::Established, Self::Excluded, Self::Open];

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Established => "established",
            Self::Excluded => "excluded",
            Self::Open => "open",
        }
    }
}

/// What the evidence of a state counts as independent draws.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Independence {
    /// Entries: every transition said whether it entered its state.
    Entries,
    /// Visits, of which some may only be steps of one stay.
    Assumed,
}

impl From<Tally> for Independence {
    /// Entries are independent draws where every transition said whether it entered its state.
    fn from(tally: Tally) -> Self {
        if tally.entries.is_some() {
            Self::Entries
        } else {
            Self::Assumed
        }
    }
}

impl Independence {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Entries => "entries",
            Self::Assumed => "assumed",
        }
    }
}

/// What a verdict rests on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    /// This many visits.
    Counts(u64),
    /// The active network of this version, where the counts do not decide.
    Model(u64),
    /// Nothing was seen, and no model is active.
    Prior,
}

impl Basis {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Counts(_) => "counts",
            Self::Model(_) => "model",
            Self::Prior => "prior",
        }
    }
}

/// The answers to one question.
#[derive(Debug, Clone, PartialEq)]
pub struct Answers {
    /// What the numbers in the answers stand for.
    pub labels: Labels,
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// One a state, in the question's order.
    pub answers: Vec<Answer>,
}

/// What the action indices in answers stand for.
#[derive(Debug, Clone, PartialEq)]
pub struct Labels {
    /// The ego's actions.
    pub ego: Variable,
    /// The other's actions, or values.
    pub other: Variable,
    /// What is held fixed: the agents named, and at a lag an agent's own action before.
    pub given: Vec<Variable>,
}

/// A variable and the labels of its values.
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Its name.
    pub name: String,
    /// A label a value, in index order; empty where there are more than [`Variable::MOST_LABELS`],
    /// and beside what has no indices.
    pub actions: Vec<String>,
}

impl Variable {
    /// The largest alphabet whose labels are told.
    pub const MOST_LABELS: u64 = 4_096;
}

/// The answer for one state.
#[derive(Debug, Clone, PartialEq)]
pub struct Answer {
    /// The state.
    pub key: StateKey,
    /// How often it was seen, in the segments asked for.
    pub visits: u64,
    /// The verdict.
    pub verdict: Verdict,
    /// What the verdict rests on.
    pub basis: Basis,
    /// Absent in the `verdict` view, which is asked for by the ten thousand.
    pub figures: Option<Box<Figures>>,
    /// The ego's actions in index order; `full` view only.
    pub by_action: Option<Vec<ActionFigures>>,
}

/// The estimates of mutual information in one state: what its counts measure.
#[derive(Debug, Clone, PartialEq)]
pub struct Figures {
    /// The state's bins with their labels: feature, bin, label.
    pub bins: Vec<Bin>,
    /// How many steps the other is observed after the ego. From 1 on figures have a direction: what
    /// comes later influences nothing before it.
    pub lag: u32,
    /// How often the state was entered, where every transition carried the flag.
    pub entries: Option<u64>,
    /// The unit of every figure.
    pub unit: Unit,
    /// The threshold used, in that unit.
    pub threshold: f64,
    /// The same as a share of the largest mutual information of the pair; `None` where that is 0.
    pub share: Option<f64>,
    /// The kind of rule that decided.
    pub rule: RuleKind,
    /// Plug-in mutual information, at least 0; 0 at no visits.
    pub plug_in: f64,
    /// Its mean under independence at these margins.
    pub expected_if_independent: f64,
    /// How that mean was computed.
    pub expected_method: &'static str,
    /// Further estimators that were asked for, by name.
    pub estimates: Vec<(&'static str, f64)>,
    /// What the evidence counts as independent draws.
    pub independence: Independence,
    /// What the counts say by the fitted prior; `None` where the alphabets are too large for it.
    pub evidence: Option<Evidence>,
    /// The segments that the counts come from.
    pub segmentation: Segmentation,
    /// The test of independence, where it was asked for.
    pub significance: Option<Significance>,
    /// What the reader should know before believing the figures: a sentence each.
    pub warnings: Vec<String>,
    /// Where it was asked for: how many more visits a verdict would take, `None` if no number of
    /// them is likely to bring one.
    pub visits_to_decide: Option<Option<u64>>,
    /// What the active network says of the state, where there is one.
    pub model: Option<ModelFigures>,
    /// For how many steps both go on with an action; at a lag, in the `full` view only.
    pub holds: Option<Holds>,
    /// The fit of the prior.
    pub fit: FitId,
    /// How many transitions of the environment the answer stands on.
    pub revision: u64,
}

/// Mean holds: for how many steps on average two agents go on with an action in a state. `None`
/// where the counts do not tell, because the step after is not declared or no change was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Holds {
    /// The ego's.
    pub ego: Option<f64>,
    /// The other's.
    pub other: Option<f64>,
}

/// The posterior of a state: what its counts say by the fitted prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Whether there is any dependence at all.
    pub dependence: Dependence,
    /// The probabilities behind it and behind the verdict.
    pub probability: Probability,
    /// The mean of mutual information, at least 0.
    pub posterior_mean: f64,
    /// Where it lies with a probability of 90 %.
    pub interval: Interval,
    /// P(habits differ by segment here); `None` where the evidence does not tell.
    pub differ: Option<f64>,
    /// P(MI > 0) of the pooled table, where the evidence tells segments apart.
    pub pooled: Option<f64>,
}

impl Evidence {
    /// Returns evidence in nats, told in a unit.
    pub fn in_unit(self, unit: Unit) -> Self {
        let posterior_mean = unit.from_nats(self.posterior_mean);
        Self {
            posterior_mean,
            interval: self.interval.map(|nats| unit.from_nats(nats)),
            ..self
        }
    }
}

/// Posterior probabilities, given the counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Probability {
    /// P(MI > 0).
    pub dependent: f64,
    /// P(MI > threshold).
    pub above_threshold: f64,
}

/// A 90 % credible interval: its lower and its upper end.
pub type Interval = [f64; 2];

/// The outcome of a test of independence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Significance {
    /// The probability of a plug-in at least as large under independence.
    pub p_value: f64,
    /// How it was computed.
    pub method: &'static str,
}

/// How counts are divided into segments. Transitions without a segment count as one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segmentation {
    /// How many segments have visits, of those asked for.
    pub count: u64,
    /// P(habits differ by segment); `None` where the evidence does not tell.
    pub differ: Option<f64>,
}

/// One bin of a state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bin {
    /// The feature.
    pub feature: String,
    /// The bin's number.
    pub bin: u32,
    /// What people call it.
    pub label: String,
}

/// What one ego action was seen to do.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ActionFigures {
    /// Its index.
    pub index: u64,
    /// Its label.
    pub action: String,
    /// How often it was seen in this state.
    pub visits: u64,
    /// Posterior mean of KL(p(other given this action) from p(other)), and its interval: what
    /// actions are ranked by.
    pub divergence: Option<(f64, Interval)>,
    /// The same by relative frequencies; `None` when unvisited. It favours the rarest action.
    pub plug_in_divergence: Option<f64>,
    /// Probability of each of the other's actions after it, in index order: given the counts, or
    /// without evidence the relative frequency. `None` where neither is known.
    pub response: Option<Vec<f64>>,
    /// Where each of these probabilities lies with a probability of 90 %; empty without evidence.
    pub response_intervals: Vec<Interval>,
    /// The mean of `response` were actions independent within each stratum; of regions alone.
    pub response_if_independent: Vec<f64>,
    /// The mean of `plug_in_divergence` then; of regions alone.
    pub expected_divergence: Option<f64>,
}

impl ActionFigures {
    /// Returns the same with figures, which are in nats, in a unit.
    pub fn in_unit(self, unit: Unit) -> Self {
        let of = |nats: f64| unit.from_nats(nats);
        Self {
            divergence: self.divergence.map(|(mean, ends)| (of(mean), ends.map(of))),
            plug_in_divergence: self.plug_in_divergence.map(of),
            expected_divergence: self.expected_divergence.map(of),
            ..self
        }
    }
}
