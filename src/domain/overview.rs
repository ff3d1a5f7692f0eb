//! Answers about more, or less, than influence in one state: a state's counts, pages of states, and all states together.

use super::{Bin, Label, StateKey, Tally, Unit, Verdict};
use crate::error::{Fault, Problem};

/// Returns a page size within 1 to 1,000; 0 stands for 100.
pub fn page_size(asked: u64) -> Result<usize, Problem> {
    match asked {
        0 => Ok(100),
        1..=1_000 => Ok(asked as usize),
        _ => Err(Problem::invalid("page", vec![Fault::new("/page_size", format!("got {asked}, expected 1 to 1000"))])),
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
    /// In the order asked for.
    pub states: Vec<StateFigures>,
    /// Asks for the next page; `None` on the last.
    pub next_page_token: Option<String>,
    /// The revision the order was made from.
    pub as_of: u64,
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
}

/// What all states say together.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// Transitions counted, in the segments asked for.
    pub transitions: u64,
    /// States seen, in the segments asked for.
    pub states: u64,
    /// Segments of the environment.
    pub segments: Vec<Label>,
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
}
