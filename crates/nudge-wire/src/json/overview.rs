//! Contingency tables of one state, rankings of states, and summaries of all, with discoveries at a
//! false discovery rate.

use serde::Serialize;
use utoipa::ToSchema;

use super::answer::{basis, verdict};
use super::evidence::dependence;
use super::{Basis, Fit, Labels, Probability, ProfilePoint, Segmentation, State, words};
use crate::{present, proto};

/// The counts of one state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Counts {
    /// The state with its bins.
    pub state: State,
    /// How often it was seen.
    pub visits: u64,
    /// How often it was entered; absent unless every transition carried the flag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entries: Option<u64>,
    /// Its cells, in order of joint action and segment.
    pub cells: Vec<Cell>,
    /// How many transitions of the environment this stands on.
    pub revision: u64,
}

/// How often one joint action was seen under one segment.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Cell {
    /// The segment; null for transitions without one.
    pub segment: Option<String>,
    /// One action index an agent, in the environment's order.
    pub actions: Vec<u64>,
    /// One action label an agent, in the environment's order.
    pub labels: Vec<String>,
    /// Visits.
    pub n: u64,
    /// Entries; absent once a transition came without the flag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entries: Option<u64>,
}

/// A page of states.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct StatePage {
    /// Whose influence on whom: names alone, as nothing here has an index of the other's.
    pub labels: Labels,
    /// How many steps later the other is observed; 0 for the same tick.
    pub lag: u32,
    /// The states, in the order asked for.
    pub states: Vec<StateFigures>,
    /// Asks for the next page; null on the last.
    pub next_page_token: Option<String>,
    /// The revision the order was made from: how many transitions the environment had.
    pub as_of: u64,
    /// The fit of the prior that the order and the figures rest on; where a ranking takes long,
    /// that of the last one.
    pub fit: Fit,
    /// The unit of the figures, `nats` or `bits`.
    #[schema(value_type = words::Unit)]
    pub unit: String,
}

/// What one state of a page measures.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct StateFigures {
    /// The state.
    pub state: State,
    /// How often it was seen.
    pub visits: u64,
    /// Plug-in mutual information, in the page's unit.
    #[schema(minimum = 0)]
    pub plug_in: f64,
    /// Its mean under independence, in the page's unit.
    pub expected_if_independent: f64,
    /// The mean of mutual information given the counts, in the page's unit; absent where the
    /// alphabets are too large for evidence.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub posterior_mean: Option<f64>,
    /// `influences`, `no_influence` or `undecided`.
    #[schema(example = "undecided", value_type = words::Verdict)]
    pub verdict: &'static str,
    /// What the verdict rests on.
    pub basis: Basis,
    /// Whether there is any dependence at all: `established`, `excluded` or `open`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<words::Dependence>)]
    pub dependence: Option<&'static str>,
    /// Probabilities given the counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub probability: Option<Probability>,
    /// The p-value of the test of independence, where discoveries by `bh` were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub p_value: Option<f64>,
}

/// What all states say together.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Summary {
    /// Whose influence on whom: names alone, as nothing here has an index of the other's.
    pub labels: Labels,
    /// How many steps later the other is observed; 0 for the same tick.
    pub lag: u32,
    /// Transitions counted, in the segments asked for.
    pub transitions: u64,
    /// States seen, in the segments asked for.
    pub states: u64,
    /// Segments of the environment; empty where `omit_segments` is asked for.
    pub segments: Vec<String>,
    /// The segments that the counts come from; `differ` is the mean over states.
    pub segmentation: Segmentation,
    /// Visits from which the rule calls data enough.
    pub min_visits: u64,
    /// Share of visits, 0 to 1, that fell in states with at least that many; 0 where nothing was
    /// seen.
    #[schema(minimum = 0, maximum = 1)]
    pub share_of_visits_with_enough_data: f64,
    /// States by verdict.
    pub verdicts: VerdictCounts,
    /// States by plug-in mutual information, beside the same under independence.
    pub histogram: Vec<HistogramBin>,
    /// The revision this was made from.
    pub as_of: u64,
    /// The unit of the figures, `nats` or `bits`.
    #[schema(value_type = words::Unit)]
    pub unit: String,
    /// The threshold used, in that unit.
    pub threshold: f64,
    /// The same however it was given: in nats, in bits and as a share.
    pub thresholds: Thresholds,
    /// States by dependence.
    pub dependence: DependenceCounts,
    /// The share of states that depend, as fitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dependent_share: Option<f64>,
    /// The fit of the prior.
    pub fit: Fit,
    /// The discoveries, where a rate was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub discoveries: Option<Discoveries>,
    /// What all states say as one, at this lag: the same as a profile of all states has, in the
    /// summary's unit.
    pub pooled: ProfilePoint,
    /// How probable it is that habits differ by segment in the state of a visit: the mean of
    /// `differ` by visits, over states that were seen in several segments. Absent where none was, or
    /// nothing is told.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub habits_differ: Option<f64>,
    /// What the reader should know before believing the figures, a sentence each: where pooled and
    /// stratified tests of independence disagree, if discoveries by `bh` were asked for. Absent
    /// where there is nothing to warn of.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
}

/// One threshold, told in every way.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct Thresholds {
    /// In nats.
    pub nats: f64,
    /// In bits.
    pub bits: f64,
    /// As a share of ln min(R, K), the most that two agents with R and K actions can have; null
    /// where that is 0: then every verdict is `undecided`.
    pub share: Option<f64>,
}

impl From<proto::ThresholdFigures> for Thresholds {
    fn from(threshold: proto::ThresholdFigures) -> Self {
        let proto::ThresholdFigures { nats, bits, share } = threshold;
        Self { nats, bits, share }
    }
}

/// States by dependence: is there any at all, however weak?
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct DependenceCounts {
    /// States where it is established.
    pub established: u64,
    /// States where it is excluded.
    pub excluded: u64,
    /// States that the counts leave open.
    pub open: u64,
}

/// States that are called dependent at a false discovery rate.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Discoveries {
    /// The rate.
    pub fdr: f64,
    /// `bayes` or `bh`.
    #[schema(value_type = words::DiscoveryMethod)]
    pub method: &'static str,
    /// How many they are.
    pub states: u64,
    /// States among which they were looked for: with `bh` those whose smallest possible p-value can
    /// pass.
    pub testable: u64,
}

/// States by verdict.
#[derive(Debug, Clone, Default, PartialEq, Serialize, ToSchema)]
pub struct VerdictCounts {
    /// States where the ego's action influences the other's.
    pub influences: u64,
    /// States where it does not.
    pub no_influence: u64,
    /// States that the counts leave open.
    pub undecided: u64,
}

/// States whose mutual information lies between two bounds.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct HistogramBin {
    /// The lower bound, inclusive, in the summary's unit.
    pub from: f64,
    /// The upper bound, exclusive; null in the last bin.
    pub to: Option<f64>,
    /// States whose plug-in lies here.
    pub plug_in: u64,
    /// States whose mean under independence lies here.
    pub expected_if_independent: u64,
    /// States whose posterior mean lies here.
    pub posterior_mean: u64,
}

impl From<proto::GetStateResponse> for Counts {
    fn from(response: proto::GetStateResponse) -> Self {
        Self {
            state: response.state.map(Into::into).unwrap_or_default(),
            visits: response.visits,
            entries: response.entries,
            cells: response.cells.into_iter().map(Into::into).collect(),
            revision: response.revision,
        }
    }
}

impl From<proto::Cell> for Cell {
    fn from(cell: proto::Cell) -> Self {
        let proto::Cell {
            segment,
            actions,
            labels,
            n,
            entries,
        } = cell;
        Self {
            segment: present(segment),
            actions,
            labels,
            n,
            entries,
        }
    }
}

impl From<proto::ListStatesResponse> for StatePage {
    fn from(page: proto::ListStatesResponse) -> Self {
        Self {
            labels: page.labels.map(Into::into).unwrap_or_default(),
            lag: page.lag,
            states: page.states.into_iter().map(Into::into).collect(),
            next_page_token: present(page.next_page_token),
            as_of: page.as_of,
            fit: page.fit.map(Into::into).unwrap_or_default(),
            unit: page.unit,
        }
    }
}

impl From<proto::StateFigures> for StateFigures {
    fn from(figures: proto::StateFigures) -> Self {
        Self {
            state: figures.state.map(Into::into).unwrap_or_default(),
            visits: figures.visits,
            plug_in: figures.plug_in,
            expected_if_independent: figures.expected_if_independent,
            posterior_mean: figures.posterior_mean,
            verdict: verdict(figures.verdict),
            basis: basis(figures.basis, figures.basis_version, figures.visits),
            dependence: dependence(figures.dependence),
            probability: figures.probability.map(Into::into),
            p_value: figures.p_value,
        }
    }
}

impl From<proto::SummarizeResponse> for Summary {
    fn from(summary: proto::SummarizeResponse) -> Self {
        let verdicts = summary.verdicts.unwrap_or_default();
        let dependence = summary.dependence.unwrap_or_default();
        Self {
            labels: summary.labels.map(Into::into).unwrap_or_default(),
            lag: summary.lag,
            transitions: summary.transitions,
            states: summary.states,
            segments: summary.segments,
            segmentation: summary.segmentation.map(Into::into).unwrap_or_default(),
            min_visits: summary.min_visits,
            share_of_visits_with_enough_data: summary.share_of_visits_with_enough_data,
            verdicts: VerdictCounts {
                influences: verdicts.influences,
                no_influence: verdicts.no_influence,
                undecided: verdicts.undecided,
            },
            histogram: summary.histogram.into_iter().map(Into::into).collect(),
            as_of: summary.as_of,
            unit: summary.unit,
            threshold: summary.threshold,
            thresholds: summary.thresholds.unwrap_or_default().into(),
            dependence: DependenceCounts {
                established: dependence.established,
                excluded: dependence.excluded,
                open: dependence.open,
            },
            dependent_share: summary.dependent_share,
            fit: summary.fit.map(Into::into).unwrap_or_default(),
            discoveries: summary.discoveries.map(Into::into),
            pooled: summary.pooled.unwrap_or_default().into(),
            habits_differ: summary.habits_differ,
            warnings: summary.warnings,
        }
    }
}

impl From<proto::Discoveries> for Discoveries {
    fn from(found: proto::Discoveries) -> Self {
        let method = match found.method() {
            proto::DiscoveryMethod::Bh => "bh",
            proto::DiscoveryMethod::Bayes | proto::DiscoveryMethod::Unspecified => "bayes",
        };
        Self {
            fdr: found.fdr,
            method,
            states: found.states,
            testable: found.testable,
        }
    }
}

impl From<proto::HistogramBin> for HistogramBin {
    fn from(bin: proto::HistogramBin) -> Self {
        let proto::HistogramBin {
            from,
            to,
            plug_in,
            expected_if_independent,
            posterior_mean,
        } = bin;
        Self {
            from,
            to,
            plug_in,
            expected_if_independent,
            posterior_mean,
        }
    }
}
