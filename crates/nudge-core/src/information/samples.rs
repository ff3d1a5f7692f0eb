//! Tables for tests.

use super::table::Table;
use proptest::prelude::*;

/// Returns the table of a grid of counts, rows first.
pub(crate) fn grid(counts: &[&[u64]]) -> Table {
    let cells = counts
        .iter()
        .zip(0..)
        .flat_map(|(row, i)| row.iter().zip(0..).map(move |(&n, j)| (i, j, n)));
    Table::from_counts(cells)
}

/// Returns the table with every count multiplied.
pub(super) fn scaled(table: &Table, by: u64) -> Table {
    Table::from_counts(triples(table).map(|(row, column, n)| (row, column, n * by)))
}

fn triples(table: &Table) -> impl Iterator<Item = (u64, u64, u64)> {
    table
        .cells()
        .iter()
        .map(|cell| (u64::from(cell.row), u64::from(cell.column), cell.n))
}

/// Generates counts as they arrive: in any order, with repeated cells and zeros.
pub(super) fn counts() -> impl Strategy<Value = Vec<(u64, u64, u64)>> {
    let n = prop_oneof![4 => 0..4_u64, 1 => 0..60_u64];
    prop::collection::vec((0..7_u64, 0..7_u64, n), 0..50)
}

/// Generates small tables, empty and degenerate ones among them.
pub(super) fn tables() -> impl Strategy<Value = Table> {
    counts().prop_map(Table::from_counts)
}
