//! What a journal has that rows have not yet: sorted runs in memory, merged in tiers as in a
//! log-structured merge tree, and folded into rows in slices.
//!
//! A fold takes all runs that there are: they are **frozen**, and those that come later are none of
//! its business. It goes on row by row, and the database knows how far ([`Mark`]), in the
//! transaction that wrote the rows. So a reader that has looked at memory first and at rows and
//! mark, by one statement, afterwards knows which runs are in the rows already: none is counted
//! twice, and none is missing.

use super::cells::{Decoder, Place, Spoiled};
use super::fold::RowDelta;
use super::merge::Merge;
use super::row::{first_state, row_of};
use super::run::Run;
use crate::domain::Tally;

/// Runs of a tier that are merged into one of the next.
const TIER: usize = 8;

/// How far the journal of an environment is folded, as the database says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Mark {
    /// The last entry of the journal that the last fold takes.
    pub upto: i64,
    /// The row at which that fold goes on; `None` once it has ended.
    pub next_row: Option<u64>,
}

/// The cells of one environment that are in its journal alone. Cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct Unfolded {
    /// The last entry of the fold before the one under way.
    base: i64,
    frozen: Option<Frozen>,
    /// The first have the youngest runs, which are the shortest.
    tiers: Vec<Vec<Run>>,
    /// The last entry of the journal.
    last: i64,
}

/// What a fold takes.
#[derive(Debug, Clone)]
struct Frozen {
    mark: Mark,
    runs: Vec<Run>,
}

/// Rows and memory are of different folds: memory was looked at too early.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outdated;

impl Unfolded {
    /// Begins with what the database says is folded.
    pub fn after(mark: Mark) -> Self {
        let frozen = mark.next_row.map(|_| Frozen {
            mark,
            runs: Vec::new(),
        });
        Self {
            // What a fold under way began after has no entry left, and nobody asks for it.
            base: if frozen.is_some() { 0 } else { mark.upto },
            frozen,
            tiers: Vec::new(),
            last: mark.upto,
        }
    }

    /// Adds an entry of the journal.
    pub fn push(&mut self, entry: i64, run: Run) {
        self.last = self.last.max(entry);
        match &mut self.frozen {
            Some(frozen) if entry <= frozen.mark.upto => frozen.runs.push(run),
            _ if self.tiers.is_empty() => self.tiers.push(vec![run]),
            _ => self.tiers[0].push(run),
        }
    }

    /// Returns how many cells are in no row yet, at most: equal ones of several runs each for
    /// itself, and of a fold that is under way what is left of it.
    pub fn len(&self) -> usize {
        let frozen = self.frozen.as_ref().map_or(0, Frozen::most_left);
        let recent = self.tiers.iter().flatten().map(Run::len);
        frozen + recent.sum::<usize>()
    }

    /// Returns whether there is nothing.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn runs(&self) -> impl Iterator<Item = &Run> {
        let frozen = self.frozen.iter().flat_map(|frozen| &frozen.runs);
        frozen.chain(self.tiers.iter().flatten())
    }

    /// Returns the last entry of the journal that is here, or was.
    pub fn last(&self) -> i64 {
        self.last
    }

    /// Returns whether a fold is under way.
    pub fn is_folding(&self) -> bool {
        self.frozen.is_some()
    }

    /// Returns where the fold under way stands.
    pub fn mark(&self) -> Option<Mark> {
        self.frozen.as_ref().map(|frozen| frozen.mark)
    }

    /// Returns the number of a tier that is full, and its runs.
    pub fn full_tier(&self) -> Option<(usize, Vec<Run>)> {
        let tier = self.tiers.iter().position(|runs| runs.len() >= TIER)?;
        Some((tier, self.tiers[tier].clone()))
    }

    /// Puts a merge of the first runs of a tier in their place, one tier up, if they are still
    /// there.
    pub fn merged(&mut self, tier: usize, runs: &[Run], merged: Run) {
        let there = self.tiers.get(tier).is_some_and(|all| {
            all.len() >= runs.len() && all.iter().zip(runs).all(|(a, b)| a.is(b))
        });
        if !there {
            return;
        }
        self.tiers[tier].drain(..runs.len());
        if self.tiers.len() == tier + 1 {
            self.tiers.push(Vec::new());
        }
        self.tiers[tier + 1].push(merged);
    }

    /// Begins a fold of all that there is, where none is under way, and returns where it stands.
    pub fn freeze(&mut self) -> Mark {
        let Self { tiers, last, .. } = self;
        let frozen = self.frozen.get_or_insert_with(|| Frozen {
            mark: Mark {
                upto: *last,
                next_row: Some(0),
            },
            runs: std::mem::take(tiers).into_iter().flatten().collect(),
        });
        frozen.mark
    }

    /// Notes how far the fold under way is, in the database.
    pub fn folded(&mut self, mark: Mark) {
        match &mut self.frozen {
            Some(frozen) if mark.next_row.is_some() => frozen.mark = mark,
            frozen => {
                *frozen = None;
                self.base = mark.upto;
            }
        }
    }

    /// Returns the state of every cell, those of frozen runs too that are in rows already; in no
    /// order, and some again and again.
    pub fn states(&self) -> impl Iterator<Item = u64> {
        let cells = self.runs().flat_map(|run| run.from(0));
        cells.flatten().map(|(place, _)| place.state)
    }

    /// Returns the cells of states at or after one that are not in rows, each once, where the
    /// database says by this mark what is in rows.
    pub fn from(&self, state: u64, mark: Mark) -> Result<Merge<'_>, Outdated> {
        let frozen = self.frozen_from(state, mark)?;
        let recent = self.tiers.iter().flatten().map(|run| run.from(state));
        Ok(Merge::new(frozen.into_iter().chain(recent)))
    }

    fn frozen_from(&self, state: u64, mark: Mark) -> Result<Vec<Decoder<'_>>, Outdated> {
        match &self.frozen {
            None if mark.upto == self.base => Ok(Vec::new()),
            Some(frozen) if mark.upto == frozen.mark.upto => Ok(match mark.next_row {
                Some(row) => frozen.from(state.max(first_state(row))),
                None => Vec::new(),
            }),
            // The fold has not written anything yet.
            Some(frozen) if mark.upto == self.base => Ok(frozen.from(state)),
            _ => Err(Outdated),
        }
    }

    /// Returns the next rows of the fold under way, as many at most.
    pub fn slice(&self, rows: usize) -> Result<Slice, Spoiled> {
        let Some((frozen, first)) = self.under_way() else {
            return Ok(Slice::default());
        };
        let mut cells = Merge::new(frozen.from(first_state(first))).peekable();
        let mut slice = Slice {
            mark: Mark {
                upto: frozen.mark.upto,
                next_row: None,
            },
            rows: Vec::new(),
        };
        while let Some(cell) = cells.next_if(|_| slice.rows.len() < rows) {
            let (place, tally) = cell?;
            let row = row_of(place.state);
            let mut delta = RowDelta::of(row);
            delta.push(place, tally);
            while let Some(cell) = cells.next_if(|cell| is_in(row, cell)) {
                let (place, tally) = cell?;
                delta.push(place, tally);
            }
            slice.rows.push(delta);
        }
        if let Some(cell) = cells.next() {
            slice.mark.next_row = Some(row_of(cell?.0.state));
        }
        Ok(slice)
    }

    fn under_way(&self) -> Option<(&Frozen, u64)> {
        let frozen = self.frozen.as_ref()?;
        Some((frozen, frozen.mark.next_row?))
    }
}

impl Frozen {
    fn most_left(&self) -> usize {
        let next = first_state(self.mark.next_row.unwrap_or_default());
        self.runs.iter().map(|run| run.most_from(next)).sum()
    }

    fn from(&self, state: u64) -> Vec<Decoder<'_>> {
        self.runs.iter().map(|run| run.from(state)).collect()
    }
}

fn is_in(row: u64, cell: &Result<(Place, Tally), Spoiled>) -> bool {
    cell.as_ref()
        .is_ok_and(|(place, _)| row_of(place.state) == row)
}

/// Some rows of a fold.
#[derive(Debug, Default)]
pub struct Slice {
    /// Where the fold stands once they are written.
    pub mark: Mark,
    /// What is added to each, in order.
    pub rows: Vec<RowDelta>,
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::super::cells::tests::Model;
    use super::super::merge::tests::{small, sum};
    use super::super::row::RowName;
    use super::super::size::Size;
    use super::*;

    /// A table of rows with its mark, as a database keeps them.
    #[derive(Default, Clone)]
    struct Table {
        mark: Mark,
        rows: BTreeMap<u64, Vec<u8>>,
        totals: Size,
        journal: BTreeMap<i64, Run>,
    }

    impl Table {
        fn fold(&mut self, slice: Slice) {
            for delta in &slice.rows {
                let old = self.rows.get(&delta.row).map(Vec::as_slice);
                let folded = delta.onto(7, old).expect("sound");
                self.totals += folded.new;
                self.rows.insert(delta.row, folded.bytes);
            }
            self.mark = slice.mark;
            if self.mark.next_row.is_none() {
                self.journal.retain(|entry, _| *entry > slice.mark.upto);
            }
        }

        fn cells(&self) -> Model {
            let cells = self.rows.iter().flat_map(|(row, bytes)| {
                let name = RowName {
                    environment: 7,
                    row: *row,
                };
                name.read(bytes)
                    .expect("sound")
                    .map(|cell| cell.expect("sound"))
            });
            cells.collect()
        }

        /// Begins again, as after a restart.
        fn opened(&self) -> Unfolded {
            let mut memory = Unfolded::after(self.mark);
            for (entry, run) in &self.journal {
                memory.push(*entry, run.clone());
            }
            memory
        }
    }

    #[derive(Debug, Clone)]
    enum Step {
        Commit(Model),
        Merge,
        Freeze,
        Fold(usize),
        Restart,
    }

    fn step() -> impl Strategy<Value = Step> {
        prop_oneof![
            6 => small().prop_map(Step::Commit),
            1 => Just(Step::Merge),
            1 => Just(Step::Freeze),
            4 => (1usize..4).prop_map(Step::Fold),
            1 => Just(Step::Restart),
        ]
    }

    proptest! {
        #[test]
        fn rows_and_memory_together_are_the_sum(steps in proptest::collection::vec(step(), 0..60)) {
            let (mut table, mut memory, mut all) = (Table::default(), Unfolded::default(), Vec::new());
            for (entry, step) in (1i64..).zip(steps) {
                // Somebody reads memory now, and the table after the step.
                let (seen, counted) = (memory.clone(), all.len());
                match step {
                    Step::Commit(cells) => {
                        let run = Run::of(cells.iter().map(|(place, tally)| (*place, *tally)));
                        table.journal.insert(entry, run.clone());
                        memory.push(entry, run);
                        all.push(cells);
                    }
                    Step::Merge => if let Some((tier, runs)) = memory.full_tier() {
                        memory.merged(tier, &runs, Run::merge(&runs).expect("sound"));
                    },
                    Step::Freeze => { memory.freeze(); }
                    Step::Fold(rows) => {
                        memory.freeze();
                        let slice = memory.slice(rows).expect("sound");
                        let mark = slice.mark;
                        table.fold(slice);
                        memory.folded(mark);
                    }
                    Step::Restart => memory = table.opened(),
                }
                for (memory, counted) in [(&seen, counted), (&memory, all.len())] {
                    let Ok(unfolded) = memory.from(0, table.mark) else { continue };
                    let unfolded: Result<Model, _> = unfolded.collect();
                    let found = sum(&[table.cells(), unfolded.expect("sound")]);
                    prop_assert_eq!(found, sum(&all[..counted]));
                }
                let left = memory.from(0, table.mark);
                prop_assert!(left.is_ok_and(|left| left.count() <= memory.len()));
            }
            let stored = table.cells();
            let stored: Vec<_> = stored.into_iter().collect();
            prop_assert_eq!(table.totals, Size::of(&stored));
        }
    }
}
