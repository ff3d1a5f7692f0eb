//! The contingency tables of one state, by stratum and by segment, as the evidence takes them.

use std::borrow::Cow;

use crate::information::Table;

/// The contingency tables of a state: one, or a stratum for each joint action of the agents held
/// fixed; and the same cut by segment, where any of them was seen in two or more.
#[derive(Debug, Clone, Copy)]
pub struct Counted<'a> {
    /// Over all segments.
    pub slices: &'a [Table],
    /// The parts of all slices, one for each segment; none where segments are of no concern.
    pub parts: &'a [Table],
}

impl<'a> From<&'a [Table]> for Counted<'a> {
    fn from(slices: &'a [Table]) -> Self {
        Self { slices, parts: &[] }
    }
}

impl<'a> From<&'a Vec<Table>> for Counted<'a> {
    fn from(slices: &'a Vec<Table>) -> Self {
        slices.as_slice().into()
    }
}

impl<'a> From<&'a Cow<'_, [Table]>> for Counted<'a> {
    fn from(slices: &'a Cow<'_, [Table]>) -> Self {
        slices.as_ref().into()
    }
}

impl<'a, const N: usize> From<&'a [Table; N]> for Counted<'a> {
    fn from(slices: &'a [Table; N]) -> Self {
        slices.as_slice().into()
    }
}

/// Where the ego stands in a table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ego {
    /// Its actions are the rows: it is the earlier variable.
    Rows,
    /// Its actions are the columns.
    Columns,
}

impl Ego {
    /// Returns the side of a prior on which the ego drives.
    pub(super) fn side(self) -> usize {
        usize::from(self == Self::Columns)
    }
}
