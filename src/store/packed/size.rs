//! How many states and cells there are.

use std::ops::AddAssign;

use super::cells::Place;
use crate::domain::Tally;

/// How many states and cells there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Size {
    /// States with a cell.
    pub states: u64,
    /// Cells.
    pub cells: u64,
}

impl Size {
    /// Returns the size of cells in order of place, each place once.
    pub fn of(cells: &[(Place, Tally)]) -> Self {
        let states = cells.chunk_by(|(a, _), (b, _)| a.state == b.state);
        Self {
            states: states.count() as u64,
            cells: cells.len() as u64,
        }
    }

    /// Returns what this has beyond some of it.
    pub fn less(self, some: Self) -> Self {
        Self {
            states: self.states - some.states,
            cells: self.cells - some.cells,
        }
    }

    /// Returns the larger number of each.
    pub fn max(self, other: Self) -> Self {
        Self {
            states: self.states.max(other.states),
            cells: self.cells.max(other.cells),
        }
    }
}

impl AddAssign for Size {
    fn add_assign(&mut self, more: Self) {
        self.states += more.states;
        self.cells += more.cells;
    }
}
