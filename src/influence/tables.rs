//! From a state's cells to contingency tables: whole, and one for each joint action of the agents held fixed.

use std::collections::BTreeMap;

use crate::domain::{Cell, Pair, Schema};
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
    pub fn new<'a>(schema: &Schema, pair: &Pair, cells: impl Iterator<Item = &'a Cell>) -> Self {
        let counted = |cell: &Cell| {
            (schema.action_of(cell.joint, pair.ego), schema.action_of(cell.joint, pair.other), cell.tally.n)
        };
        if pair.given.is_empty() {
            return Self { whole: Table::from_counts(cells.map(counted)), slices: Vec::new() };
        }
        let mut slices: BTreeMap<Vec<u64>, Vec<(u64, u64, u64)>> = BTreeMap::new();
        for cell in cells {
            let fixed = pair.given.iter().map(|agent| schema.action_of(cell.joint, *agent)).collect();
            slices.entry(fixed).or_default().push(counted(cell));
        }
        let whole = Table::from_counts(slices.values().flatten().copied());
        Self { whole, slices: slices.into_values().map(Table::from_counts).collect() }
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
