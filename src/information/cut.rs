//! Stratification: a table beside the same cut by segment.

use super::table::Table;

/// The table of a state, or of one of its slices, whole and cut by segment.
///
/// Segments may differ in their habits, and then the whole table shows a dependence that no part has (Simpson 1951).
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Cut {
    /// Over all segments.
    pub whole: Table,
    /// One for each segment with counts, in order of segment: a single one, equal to the whole, where only one has any, and none where nothing was
    /// counted. Their sum is the whole.
    pub parts: Vec<Table>,
}
