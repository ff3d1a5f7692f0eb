//! The alphabets of a network's variables, and contingency tables stacked by stratum.
//!
//! At a lag a network predicts what the ego does now and the other later, in each stratum: given the
//! other's own action one step before it is observed. Its counts of a state are one table whose rows
//! are the ego's actions of the first stratum, then those of the second, and so on: with R actions
//! of the ego, row h R + i is action i in stratum h. In the same tick there is one stratum, and the
//! table is that of the pair.

use std::borrow::Cow;

use crate::domain::{Pair, Schema};
use crate::information::{Alphabet, Table};

/// How many letters each variable of a network has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Letters {
    /// Actions of both; rows for the ego.
    pub actions: Alphabet,
    /// Letters of what is held fixed; 1 where nothing is.
    pub strata: u64,
}

impl Letters {
    /// Returns those of a pair, of which nobody's action is given.
    pub fn of_pair(schema: &Schema, pair: &Pair) -> Self {
        let own = pair.later.map(|_| schema.agents()[pair.other].letters());
        Self {
            actions: pair.alphabet(schema),
            strata: own.unwrap_or(1),
        }
    }

    /// Returns how many rows a stacked table has.
    pub fn rows(self) -> u64 {
        self.strata.saturating_mul(self.actions.rows)
    }

    /// Returns how many cells a stacked table has.
    pub fn cells(self) -> u64 {
        self.rows().saturating_mul(self.actions.columns)
    }

    /// Returns the stratum of a row of a stacked table.
    pub fn stratum(self, row: usize) -> usize {
        row / self.actions.rows as usize
    }

    /// Returns the strata of a stacked table that have counts, in order: each with its number, and
    /// its table with the ego's actions as rows.
    pub fn strata_of(self, table: &Table) -> Vec<(u64, Cow<'_, Table>)> {
        if self.strata == 1 {
            return vec![(0, Cow::Borrowed(table))];
        }
        let rows = self.actions.rows;
        let cells: Vec<(u64, u64, u64)> = table.triples().collect();
        let of_stratum = |cells: &[(u64, u64, u64)]| {
            let own = cells
                .iter()
                .map(|(row, column, n)| (row % rows, *column, *n));
            (cells[0].0 / rows, Cow::Owned(Table::from_counts(own)))
        };
        cells
            .chunk_by(|a, b| a.0 / rows == b.0 / rows)
            .map(of_stratum)
            .collect()
    }

    /// Stacks the tables of strata.
    pub fn stacked(self, strata: impl IntoIterator<Item = (u64, Table)>) -> Table {
        let rows = self.actions.rows;
        let cells = |(stratum, table): (u64, Table)| -> Vec<(u64, u64, u64)> {
            let row = |(row, column, n)| (stratum * rows + row, column, n);
            table.triples().map(row).collect()
        };
        Table::from_counts(strata.into_iter().flat_map(cells))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strata_are_taken_apart_as_they_were_stacked() {
        let letters = Letters {
            actions: Alphabet {
                rows: 2,
                columns: 3,
            },
            strata: 4,
        };
        assert_eq!((letters.rows(), letters.cells()), (8, 24));

        let tables = [
            (1, Table::from_counts([(1, 0, 3), (0, 2, 1)])),
            (3, Table::from_counts([(1, 1, 5)])),
        ];
        let stacked = letters.stacked(tables.clone());
        assert_eq!(stacked.row_labels(), [2, 3, 7]);
        let apart = letters.strata_of(&stacked);
        let apart: Vec<(u64, Table)> = apart
            .into_iter()
            .map(|(stratum, table)| (stratum, table.into_owned()))
            .collect();
        assert_eq!(apart, tables);
        assert!(letters.strata_of(&Table::default()).is_empty());
    }

    #[test]
    fn in_the_same_tick_a_table_is_what_it_was() {
        let letters = Letters {
            actions: Alphabet {
                rows: 2,
                columns: 2,
            },
            strata: 1,
        };
        let table = Table::from_counts([(0, 1, 2), (1, 1, 1)]);
        assert_eq!(letters.strata_of(&table), [(0, Cow::Borrowed(&table))]);
        assert_eq!(letters.stacked([(0, table.clone())]), table);
    }
}
