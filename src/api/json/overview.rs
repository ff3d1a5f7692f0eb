//! A state's counts, pages of states, and all states together.

use serde::Serialize;
use utoipa::ToSchema;

use super::answer::verdict;
use super::{State, present};
use crate::api::proto;

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
    /// The states, in the order asked for.
    pub states: Vec<StateFigures>,
    /// Asks for the next page; null on the last.
    pub next_page_token: Option<String>,
    /// The revision the order was made from: how many transitions the environment had.
    pub as_of: u64,
    /// The unit of the figures, `nats` or `bits`.
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
    pub plug_in: f64,
    /// Its mean under independence, in the page's unit.
    pub expected_if_independent: f64,
    /// `influences`, `no_influence` or `undecided`.
    #[schema(example = "undecided")]
    pub verdict: &'static str,
}

/// What all states say together.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Summary {
    /// Transitions counted, in the segments asked for.
    pub transitions: u64,
    /// States seen, in the segments asked for.
    pub states: u64,
    /// Segments of the environment.
    pub segments: Vec<String>,
    /// Visits from which the rule calls data enough.
    pub min_visits: u64,
    /// Share of visits, 0 to 1, that fell in states with at least that many; 0 where nothing was seen.
    pub share_of_visits_with_enough_data: f64,
    /// States by verdict.
    pub verdicts: VerdictCounts,
    /// States by plug-in mutual information, beside the same under independence.
    pub histogram: Vec<HistogramBin>,
    /// The revision this was made from.
    pub as_of: u64,
    /// The unit of the figures, `nats` or `bits`.
    pub unit: String,
    /// The threshold used, in that unit.
    pub threshold: f64,
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
        let proto::Cell { segment, actions, labels, n, entries } = cell;
        Self { segment: present(segment), actions, labels, n, entries }
    }
}

impl From<proto::ListStatesResponse> for StatePage {
    fn from(page: proto::ListStatesResponse) -> Self {
        Self {
            states: page.states.into_iter().map(Into::into).collect(),
            next_page_token: present(page.next_page_token),
            as_of: page.as_of,
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
            verdict: verdict(figures.verdict),
        }
    }
}

impl From<proto::SummarizeResponse> for Summary {
    fn from(summary: proto::SummarizeResponse) -> Self {
        let verdicts = summary.verdicts.unwrap_or_default();
        Self {
            transitions: summary.transitions,
            states: summary.states,
            segments: summary.segments,
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
        }
    }
}

impl From<proto::HistogramBin> for HistogramBin {
    fn from(bin: proto::HistogramBin) -> Self {
        let proto::HistogramBin { from, to, plug_in, expected_if_independent } = bin;
        Self { from, to, plug_in, expected_if_independent }
    }
}
