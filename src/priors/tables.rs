//! From a state's cells to contingency tables: whole, and one for each joint action of the agents held fixed.

use std::borrow::Cow;
use std::collections::BTreeMap;

use crate::domain::{Cell, Independence, Pair, Schema, SegmentId, Tally};
use crate::information::{self, ExpectedMethod, Table};

/// The tables of one state for one pair.
pub struct Tables {
    /// Over all cells; rows are the ego's actions.
    pub whole: Table,
    /// One for each joint action of the agents held fixed, in their order; empty where none is.
    slices: Vec<Table>,
}

impl Tables {
    /// Builds the tables of these cells.
    pub fn new<'a>(schema: &Schema, pair: &Pair, cells: impl Iterator<Item = &'a Cell> + Clone) -> Self {
        let visits = |cell: &Cell| cell.tally.n;
        let whole = Table::from_counts(cells.clone().map(|cell| counted(schema, pair, cell, visits)));
        let slices = if pair.given.is_empty() { Vec::new() } else { slices(schema, pair, cells, visits, no_more) };
        Self { whole, slices }
    }

    /// Returns what the evidence rests on: the tables of what counts as independent draws, rows for the earlier agent, a slice for each joint action
    /// of the agents held fixed. These are entries where every transition carried the flag, else visits.
    pub fn draws<'a>(
        &self,
        schema: &Schema,
        pair: &Pair,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Cow<'_, [Table]> {
        let undirected = pair.undirected();
        let independence = Independence::from(Tally::of(cells.clone()));
        match (independence, undirected == *pair, self.slices.is_empty()) {
            (Independence::Assumed, true, true) => std::slice::from_ref(&self.whole).into(),
            (Independence::Assumed, true, false) => self.slices.as_slice().into(),
            _ => slices(schema, &undirected, cells, drawn(independence), no_more).into(),
        }
    }

    /// Returns the same cut further, by segment.
    pub fn draws_by_segment<'a>(
        schema: &Schema,
        pair: &Pair,
        cells: impl Iterator<Item = &'a Cell> + Clone,
    ) -> Vec<Table> {
        let drawn = drawn(Independence::from(Tally::of(cells.clone())));
        slices(schema, &pair.undirected(), cells, drawn, |cell| Some(cell.segment))
    }

    /// Returns a figure of the table, or its mean over the slices where agents are held fixed.
    pub fn figure(&self, figure: impl Fn(&Table) -> f64) -> f64 {
        if self.slices.is_empty() { figure(&self.whole) } else { information::conditional(&self.slices, figure) }
    }

    /// Returns the mean of plug-in mutual information under independence, in nats, and how it was computed.
    pub fn expected_if_independent(&self) -> (f64, ExpectedMethod) {
        if self.slices.is_empty() {
            return information::expected_if_independent(&self.whole);
        }
        let mut method = ExpectedMethod::Hypergeometric;
        let mean = information::conditional(&self.slices, |slice| {
            let (expected, of_slice) = information::expected_if_independent(slice);
            if of_slice == ExpectedMethod::Asymptotic {
                method = of_slice;
            }
            expected
        });
        (mean, method)
    }

    /// Returns the plug-in divergence of the ego's action at a row of the whole table, in nats: its mean over the slices, weighted by how often the
    /// action was seen in each, so that plug-in mutual information is its mean over the ego's actions.
    pub fn divergence(&self, row: usize) -> f64 {
        if self.slices.is_empty() {
            return information::divergence(&self.whole, row);
        }
        let label = self.whole.row_labels()[row];
        let parts = self.slices.iter().filter_map(|slice| {
            let at = slice.row_labels().binary_search(&label).ok()?;
            Some(slice.rows()[at] as f64 * information::divergence(slice, at))
        });
        parts.sum::<f64>() / self.whole.rows()[row] as f64
    }
}

/// The row, the column and the count of a cell of a table.
type Counted = (u64, u64, u64);

/// What a slice is of: the joint action of the agents held fixed, and what it is cut by further.
type Stratum = (Vec<u64>, Option<SegmentId>);

fn drawn(independence: Independence) -> impl Fn(&Cell) -> u64 + Copy {
    move |cell| match independence {
        Independence::Entries => cell.tally.entries.unwrap_or(0),
        Independence::Assumed => cell.tally.n,
    }
}

/// Returns a table for each joint action of the agents held fixed and each value of `further`, in their order.
fn slices<'a>(
    schema: &Schema,
    pair: &Pair,
    cells: impl Iterator<Item = &'a Cell>,
    count: impl Fn(&Cell) -> u64 + Copy,
    further: impl Fn(&Cell) -> Option<SegmentId>,
) -> Vec<Table> {
    let mut slices: BTreeMap<Stratum, Vec<Counted>> = BTreeMap::new();
    for cell in cells {
        let fixed = pair.given.iter().map(|agent| schema.action_of(cell.joint, *agent)).collect();
        slices.entry((fixed, further(cell))).or_default().push(counted(schema, pair, cell, count));
    }
    slices.into_values().map(Table::from_counts).collect()
}

fn no_more(_: &Cell) -> Option<SegmentId> {
    None
}

fn counted(schema: &Schema, pair: &Pair, cell: &Cell, count: impl Fn(&Cell) -> u64) -> Counted {
    (schema.action_of(cell.joint, pair.ego), schema.action_of(cell.joint, pair.other), count(cell))
}
