//! Where the counts of an environment are: its block of rows, and how its states are numbered.

use crate::domain::{EnvironmentId, MOST_RANKED, Schema, StateKey};
use crate::store::packed::row::{RowName, row_of};

/// Rows of a block are at most 2^44, so that 2^18 blocks fit.
const ROW_BITS: u32 = 44;
// Every rank has a place in a block: sixteen states a row.
const _: () = assert!(MOST_RANKED <= 1 << (ROW_BITS + 4));

/// The rows of one environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    environment: EnvironmentId,
    block: i64,
}

/// How the states of an environment are numbered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Numbering {
    /// By their ranks: every possible state has a number.
    Ranked,
    /// By their ids in the table of states, because there are too many possible ones.
    Listed,
}

impl Numbering {
    /// Returns how the states of a schema are numbered.
    pub(super) fn of(schema: &Schema) -> Self {
        if schema.is_ranked() {
            Self::Ranked
        } else {
            Self::Listed
        }
    }

    /// Returns the number of a state, where its key says it.
    pub(super) fn of_key(self, schema: &Schema, key: &StateKey) -> Option<u64> {
        (self == Self::Ranked).then(|| schema.rank(key))
    }
}

impl Layout {
    /// Makes that of an environment with a block.
    pub(super) fn new(environment: EnvironmentId, block: i64) -> Self {
        Self { environment, block }
    }

    /// Returns the id of a row.
    pub(super) fn id(self, row: u64) -> i64 {
        self.first() + row as i64
    }

    /// Returns the id of the row that has a state.
    pub(super) fn id_of_state(self, state: u64) -> i64 {
        self.id(row_of(state))
    }

    /// Returns the row of an id.
    pub(super) fn name(self, id: i64) -> RowName {
        RowName {
            environment: self.environment.0,
            row: (id - self.first()) as u64,
        }
    }

    /// Returns the id of the first row.
    pub(super) fn first(self) -> i64 {
        self.block << ROW_BITS
    }

    /// Returns the id of the last row that there may be.
    pub(super) fn last(self) -> i64 {
        self.first() + ((1 << ROW_BITS) - 1)
    }
}
