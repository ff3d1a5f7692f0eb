//! Write-through cache of the row ids of states and of the cells that exist, so that writing to hot
//! ones needs no look-up. It belongs to the writer, and a transaction that fails empties it.

use super::recent::Recent;
use crate::domain::{EnvironmentId, StateKey};

/// A cell as the database names it: state, segment and joint action.
pub(super) type CellKey = (i64, i64, i64);

/// States and cells a generation: about 100 bytes a state and 30 a cell.
const GENERATION: usize = 65_536;

/// A bounded cache of rows that exist.
pub(super) struct RowIdCache {
    states: Recent<(EnvironmentId, StateKey), i64>,
    cells: Recent<CellKey, ()>,
}

impl Default for RowIdCache {
    fn default() -> Self {
        Self {
            states: Recent::new(GENERATION),
            cells: Recent::new(GENERATION),
        }
    }
}

impl RowIdCache {
    /// Returns the id of a state, where it is remembered.
    pub(super) fn state_id(&mut self, environment: EnvironmentId, key: &StateKey) -> Option<i64> {
        self.states.get(&(environment, key.clone()))
    }

    /// Remembers the id of a state.
    pub(super) fn add_state(&mut self, environment: EnvironmentId, key: &StateKey, id: i64) {
        self.states.insert((environment, key.clone()), id);
    }

    /// Returns whether a cell is remembered.
    pub(super) fn has_cell(&mut self, cell: &CellKey) -> bool {
        self.cells.get(cell).is_some()
    }

    /// Remembers a cell.
    pub(super) fn add_cell(&mut self, cell: CellKey) {
        self.cells.insert(cell, ());
    }

    /// Forgets the states of an environment. Its cells may stay: states that come after may get the
    /// same ids, but never its segments' ids.
    pub(super) fn forget(&mut self, environment: EnvironmentId) {
        self.states.retain(|(of, _)| *of != environment);
    }
}
