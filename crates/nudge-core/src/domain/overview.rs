//! Answers about more, or less, than influence in one state: a state's counts, pages of states, and
//! all states together.

use super::draft::DiscoveryDraft;
use super::{
    Answer, Basis, Bin, Evidence, FitId, Label, Labels, ProfilePoint, Segmentation, StateKey,
    Tally, Unit, Verdict,
};
use crate::error::{Fault, Problem};

/// Returns a page size within 1 to 1,000; 0 stands for 100.
pub fn page_size(asked: u64) -> Result<usize, Problem> {
    match asked {
        0 => Ok(100),
        1..=1_000 => Ok(asked as usize),
        _ => Err(Problem::invalid(
            "page",
            vec![Fault::new(
                "/page_size",
                format!("got {asked}, expected 1 to 1000"),
            )],
        )),
    }
}

/// The counts of one state.
#[derive(Debug, Clone, PartialEq)]
pub struct StateView {
    /// The state.
    pub key: StateKey,
    /// Its bins with their labels.
    pub bins: Vec<Bin>,
    /// The sum of its cells.
    pub total: Tally,
    /// Its cells, in order of joint action and segment.
    pub cells: Vec<LabelledCell>,
    /// How many transitions of the environment this stands on.
    pub revision: u64,
}

/// One cell with what its numbers stand for.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelledCell {
    /// Its segment, if it has one.
    pub segment: Option<Label>,
    /// One action index an agent.
    pub actions: Vec<u64>,
    /// One action label an agent.
    pub labels: Vec<String>,
    /// What was counted.
    pub tally: Tally,
}

/// A page of states.
#[derive(Debug, Clone, PartialEq)]
pub struct StatePage {
    /// Whose influence on whom, by names alone.
    pub labels: Labels,
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// In the order asked for.
    pub states: Vec<StateFigures>,
    /// Asks for the next page; `None` on the last.
    pub next_page_token: Option<String>,
    /// The revision the order was made from.
    pub as_of: u64,
    /// The fit that the order and the figures rest on.
    pub fit: FitId,
    /// The unit of the figures.
    pub unit: Unit,
}

/// What one state of a page measures.
#[derive(Debug, Clone, PartialEq)]
pub struct StateFigures {
    /// The state.
    pub key: StateKey,
    /// Its bins with their labels.
    pub bins: Vec<Bin>,
    /// How often it was seen.
    pub visits: u64,
    /// Plug-in mutual information, in the page's unit.
    pub plug_in: f64,
    /// Its mean under independence, in the page's unit.
    pub expected_if_independent: f64,
    /// The verdict.
    pub verdict: Verdict,
    /// What it rests on.
    pub basis: Basis,
    /// What the counts say by the fitted prior, in the page's unit; its interval is left out.
    pub evidence: Option<Evidence>,
    /// The p-value of the test of independence, where discoveries by it were asked for.
    pub p_value: Option<f64>,
}

/// A false discovery rate, and how it is kept: which states count as discoveries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discovery {
    /// The share of false ones that is accepted on average, above 0 and below 1.
    pub fdr: f64,
    /// How they are found.
    pub method: DiscoveryMethod,
}

/// How discoveries are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum DiscoveryMethod {
    /// The largest set whose mean probability of independence is within the rate.
    #[default]
    Bayes,
    /// Benjamini and Hochberg's procedure (1995) on the tests of independence.
    Bh,
}

impl DiscoveryMethod {
    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Bayes => "bayes",
            Self::Bh => "bh",
        }
    }
}

impl std::str::FromStr for DiscoveryMethod {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = [Self::Bayes, Self::Bh]
            .into_iter()
            .find(|method| method.as_str() == text);
        known.ok_or_else(|| format!("got {text:?}, expected bayes or bh"))
    }
}

impl Discovery {
    /// Checks which discoveries are asked for; `None` if none are.
    pub fn new(draft: &DiscoveryDraft) -> Result<Option<Self>, Vec<Fault>> {
        let mut faults = Vec::new();
        let method = draft.method.as_deref().map(str::parse).transpose();
        let method: Option<DiscoveryMethod> = method
            .map_err(|detail| faults.push(Fault::new("/method", detail)))
            .unwrap_or_default();

        match draft.fdr {
            Some(fdr) if !(fdr > 0.0 && fdr < 1.0) => {
                faults.push(Fault::new(
                    "/fdr",
                    format!("got {fdr}, expected a number above 0 and below 1"),
                ));
            }
            None if draft.method.is_some() => {
                faults.push(Fault::new("/fdr", "missing, and a method is given"));
            }
            _ => {}
        }

        if !faults.is_empty() {
            return Err(faults);
        }

        Ok(draft.fdr.map(|fdr| Self {
            fdr,
            method: method.unwrap_or_default(),
        }))
    }
}

/// States that are called dependent at a false discovery rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discoveries {
    /// The rate and the method.
    pub discovery: Discovery,
    /// How many they are.
    pub states: u64,
    /// States among which they were looked for.
    pub testable: u64,
}

/// What all states say together.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Whose influence on whom, by names alone.
    pub labels: Labels,
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// Transitions counted, in the segments asked for.
    pub transitions: u64,
    /// States seen, in the segments asked for.
    pub states: u64,
    /// Segments of the environment; none where they were left out.
    pub segments: Vec<Label>,
    /// Segments that the counts come from; the mean over states of the probability that habits
    /// differ there.
    pub segmentation: Segmentation,
    /// The same mean by visits; `None` where no state's evidence tells.
    pub habits_differ: Option<f64>,
    /// What all states say as one (a stratified test), at this lag; figures in the summary's unit.
    pub pooled: ProfilePoint,
    /// Visits from which the rule calls data enough.
    pub min_visits: u64,
    /// Share of visits that fell in states with at least that many; 0 where nothing was seen.
    pub share_of_visits_with_enough_data: f64,
    /// States by verdict, in the order of [`Verdict::ALL`].
    pub verdicts: [u64; 3],
    /// States by mutual information.
    pub histogram: Vec<HistogramBin>,
    /// The revision this was made from.
    pub as_of: u64,
    /// The unit of the figures.
    pub unit: Unit,
    /// The threshold used, in that unit.
    pub threshold: f64,
    /// The threshold in nats.
    pub threshold_nats: f64,
    /// The threshold as a share of the largest mutual information of the pair; `None` where that is
    /// 0.
    pub threshold_share: Option<f64>,
    /// States by dependence, in the order of [`Dependence::ALL`](super::Dependence::ALL).
    pub dependence: [u64; 3],
    /// The fit of the prior.
    pub fit: FitId,
    /// The share of states that depend, as fitted.
    pub dependent_share: Option<f64>,
    /// The discoveries, where a rate was given.
    pub discoveries: Option<Discoveries>,
    /// What the reader should know before believing the figures: a sentence each.
    pub warnings: Vec<String>,
}

/// States whose mutual information lies between two bounds.
#[derive(Debug, Clone, PartialEq)]
pub struct HistogramBin {
    /// Inclusive.
    pub from: f64,
    /// Exclusive; `None` in the last bin.
    pub to: Option<f64>,
    /// States whose plug-in lies here.
    pub plug_in: u64,
    /// States whose mean under independence lies here.
    pub expected_if_independent: u64,
    /// States whose posterior mean lies here.
    pub posterior_mean: u64,
}

/// The causal graph of one state.
#[derive(Debug, Clone, PartialEq)]
pub struct Graph {
    /// The state.
    pub key: StateKey,
    /// Its bins with their labels.
    pub bins: Vec<Bin>,
    /// The names of the agents, in the environment's order.
    pub nodes: Vec<String>,
    /// How many steps each edge's second agent is observed after the first.
    pub lag: u32,
    /// Every pair of agents, in their order; at a lag in both directions.
    pub edges: Vec<Edge>,
}

/// A pair of agents in a graph. At lag 0 the answer serves both directions; at a lag it is of the
/// first one's influence on the second.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// The position of the earlier agent; at a lag of the ego.
    pub from: usize,
    /// The position of the later agent; at a lag of the other.
    pub to: usize,
    /// The answer, with figures: of the pair by itself.
    pub answer: Answer,
    /// What it is, beside all other agents.
    pub kind: EdgeKind,
    /// The positions of the agents that explain it: with their actions held fixed no dependence is
    /// left.
    pub explained_by: Vec<usize>,
    /// The positions of the agents that open it: with their actions held fixed there is dependence
    /// that is not seen without.
    pub opened_by: Vec<usize>,
}

/// What a pair of agents is in a causal graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EdgeKind {
    /// The two depend on each other, and no few other agents explain it.
    Direct,
    /// They depend on each other by way of others.
    Explained,
    /// What was seen does not decide; or they depend on each other only while others are held
    /// fixed.
    Open,
    /// They do not depend on each other.
    Absent,
}

impl EdgeKind {
    /// Every kind, in the order in which they are told.
    pub const ALL: [Self; 4] = [Self::Direct, Self::Explained, Self::Open, Self::Absent];

    /// Returns the word on the wire.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            Self::Explained => "explained",
            Self::Open => "open",
            Self::Absent => "absent",
        }
    }
}

/// Where one more visit is worth most.
#[derive(Debug, Clone, PartialEq)]
pub struct Exploration {
    /// Whose influence on whom, by names alone.
    pub labels: Labels,
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// What to try, the most valuable first.
    pub trials: Vec<Suggestion>,
    /// How many states were looked at.
    pub considered: u64,
    /// The revision this was made from.
    pub as_of: u64,
    /// The fit that this was made by.
    pub fit: FitId,
}

/// An action to try in a state.
#[derive(Debug, Clone, PartialEq)]
pub struct Suggestion {
    /// The state.
    pub key: StateKey,
    /// Its bins with their labels.
    pub bins: Vec<Bin>,
    /// How often it was seen.
    pub visits: u64,
    /// The ego's action.
    pub index: u64,
    /// Its label.
    pub action: String,
    /// How often it was taken in this state.
    pub action_visits: u64,
    /// By how much one more visit is expected to lower the entropy of "MI is above the threshold",
    /// in nats.
    pub information_gain: f64,
    /// P(MI > threshold) as it is.
    pub above_threshold: f64,
}

/// The prior of one pair, as it was fitted.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedPrior {
    /// The name of the earlier agent; at a lag of the ego.
    pub earlier: String,
    /// The name of the later agent; at a lag of the other.
    pub later: String,
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// The names of the agents held fixed.
    pub given: Vec<String>,
    /// Its version and revision.
    pub fit: FitId,
    /// States that it was fitted to.
    pub states: u64,
    /// The share of states that depend.
    pub dependent_share: f64,
}
