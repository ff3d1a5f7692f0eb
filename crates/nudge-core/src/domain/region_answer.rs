//! Answers about regions: what the counts of many states say together.

use super::answer::{ActionFigures, Basis, Evidence, Independence, Labels, Segmentation, Verdict};
use super::{FitId, Region, RuleKind, Tally, Unit};
use crate::information::pooled::Pooled;

/// The answers to one question about regions.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionAnswers {
    /// What the numbers in the answers stand for.
    pub labels: Labels,
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// One a region, in the question's order.
    pub answers: Vec<RegionAnswer>,
}

/// The answer for one region.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionAnswer {
    /// The region.
    pub region: Region,
    /// How often its states were seen, and entered, in the segments asked for.
    pub tally: Tally,
    /// The verdict on mean mutual information over the region.
    pub verdict: Verdict,
    /// What the verdict rests on.
    pub basis: Basis,
    /// Absent in the `verdict` view.
    pub figures: Option<Box<RegionFigures>>,
    /// The ego's actions in index order; `full` view only.
    pub by_action: Option<Vec<ActionFigures>>,
}

/// The estimates of mutual information over the states of a region.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionFigures {
    /// How many steps the other is observed after the ego.
    pub lag: u32,
    /// The unit of every figure.
    pub unit: Unit,
    /// The threshold used, in that unit.
    pub threshold: f64,
    /// The same as a share of the largest mutual information of the pair; `None` where that is 0.
    pub share: Option<f64>,
    /// The kind of rule that decided.
    pub rule: RuleKind,
    /// What the strata show together: those of states, or of what the grain keeps of them.
    pub pooled: Pooled,
    /// What the grain leaves out, and what the strata of states show, with nothing left out; `None`
    /// where nothing is.
    pub grain: Option<AtGrain>,
    /// What was counted as independent draws.
    pub independence: Independence,
    /// What the counts say of mean mutual information by the fitted prior: `dependent` is the
    /// expected share of visits in dependent states. `None` where the alphabets are too large.
    pub evidence: Option<Evidence>,
    /// The segments that the counts come from.
    pub segmentation: Segmentation,
    /// What the reader should know before believing the figures: a sentence each.
    pub warnings: Vec<String>,
    /// The fit of the prior.
    pub fit: FitId,
    /// How many transitions the environment had when the pass over its states began.
    pub revision: u64,
}

/// What is told where a grain leaves something out.
#[derive(Debug, Clone, PartialEq)]
pub struct AtGrain {
    /// The features that it leaves out.
    pub left_out: Vec<String>,
    /// What the strata of states show, stratified by these too.
    pub stratified: Pooled,
}
