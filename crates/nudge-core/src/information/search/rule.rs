//! Rules: what must be so of the bins of some coordinates.

use std::ops::Range;

use super::sum::Sum;

/// The bins that one coordinate may have.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Condition {
    /// Which coordinate, in the order of the axes.
    pub axis: usize,
    /// From the first to before the last.
    pub bins: Range<u32>,
}

/// A rule that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct FoundRule {
    /// What must be so, in the order of the axes; without any, it is every state.
    pub conditions: Vec<Condition>,
    /// What the search half of its states says, but for those of earlier rules.
    pub sum: Sum,
}
