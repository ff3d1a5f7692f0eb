//! Merging of a group commit: equal cells of all its batches are added together, so that each is
//! written once. They are gathered as they come, and sorted now and then.

use super::order::{Part, Sorted, side_by_side, sorted};
use crate::domain::{Family, Increment, Label, StateKey, States, Tally};
use crate::store::map::Map;

/// Cells that are gathered before they are sorted: few enough that sorting them takes some 32 MB.
const UNSORTED: usize = 1 << 20;

/// A state by its names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::store) enum StateName<'k> {
    /// Its rank, where the states of the environment have ranks.
    Rank(u64),
    /// Its key.
    Key(&'k StateKey),
}

/// A cell by its names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct CellName<'k> {
    pub(super) state: StateName<'k>,
    /// As it is stored.
    pub(super) segment: &'k str,
    pub(super) family: Family,
    /// The joint action, or another cell of the family.
    pub(super) joint: u64,
}

/// The sum of accepted increments of one environment. States that are listed, and segments, are
/// numbered in order of appearance; the number of a state that has a rank is the rank.
#[derive(Default)]
pub(in crate::store) struct Merged<'a> {
    listed: Vec<&'a StateKey>,
    positions: Map<&'a StateKey, u64>,
    segments: Vec<&'a str>,
    /// By the numbers of families.
    cells: Vec<Sorted>,
    /// What is not in `cells` yet.
    parts: Vec<Part<'a>>,
    /// How many cells that is, at most.
    unsorted: usize,
    transitions: u64,
}

impl<'a> Merged<'a> {
    /// Adds an increment. All those of an environment name their states in the same way, for its
    /// schema says which.
    pub(super) fn add(&mut self, increment: &'a Increment) {
        if increment.is_empty() {
            return;
        }

        self.transitions += increment.transitions;
        let segment = self.number_of_segment(stored_label(increment.segment.as_ref()));
        let numbers: Option<Box<[u64]>> = match &increment.states {
            States::Ranked => None,
            States::Listed(keys) => {
                Some(keys.iter().map(|key| self.number_of_state(key)).collect())
            }
        };
        self.unsorted += increment.most_cells();
        self.parts.push(Part {
            increment,
            segment,
            numbers,
        });

        // As many as there are, so that those that are different are not merged again and again.
        if self.unsorted >= UNSORTED.max(self.len()) {
            self.settle();
        }
    }

    /// Adds equal cells together.
    fn settle(&mut self) {
        let parts = std::mem::take(&mut self.parts);
        self.unsorted = 0;
        for (family, more) in sorted(&parts, self.transitions).into_iter().enumerate() {
            match self.cells.get_mut(family) {
                Some(cells) => *cells = std::mem::take(cells).merged(more),
                None => self.cells.push(more),
            }
        }
    }

    /// Returns how many cells are sorted.
    fn len(&self) -> usize {
        self.cells.iter().map(Sorted::len).sum()
    }

    fn number_of_state(&mut self, key: &'a StateKey) -> u64 {
        *self.positions.entry(key).or_insert_with(|| {
            self.listed.push(key);
            self.listed.len() as u64 - 1
        })
    }

    /// A commit has few segments, and mostly one.
    fn number_of_segment(&mut self, label: &'a str) -> u32 {
        let at = self.segments.iter().position(|known| *known == label);
        at.unwrap_or_else(|| {
            self.segments.push(label);
            self.segments.len() - 1
        }) as u32
    }

    /// Returns the states that are listed, in order of their numbers; none where numbers are ranks.
    pub(in crate::store) fn listed(&self) -> &[&'a StateKey] {
        &self.listed
    }

    /// Returns the labels of segments, in order of their numbers.
    pub(in crate::store) fn segments(&self) -> &[&'a str] {
        &self.segments
    }

    /// Returns whether there are none.
    pub(in crate::store) fn is_empty(&self) -> bool {
        self.most_cells() == 0
    }

    /// Returns a bound of the number of cells, which costs nothing.
    pub(super) fn most_cells(&self) -> usize {
        self.len() + self.unsorted
    }

    /// Returns how many cells there are.
    pub(super) fn count_cells(&mut self) -> usize {
        self.settle();
        self.len()
    }

    /// Returns the sum of all visits.
    pub(in crate::store) fn transitions(&self) -> u64 {
        self.transitions
    }

    /// Returns every cell by its names, each once.
    pub(super) fn cells(&mut self) -> impl Iterator<Item = CellName<'a>> {
        self.settle();
        let cells = side_by_side(&self.cells);
        cells.map(|(family, (state, segment, joint), _)| CellName {
            state: name(&self.listed, state),
            segment: self.segments[segment as usize],
            family: Family::from_number(family),
            joint,
        })
    }

    /// Returns the cells of an increment that are not here, each once, by their names.
    pub(super) fn absent<'i>(&mut self, increment: &'i Increment) -> Vec<CellName<'i>> {
        self.settle();
        let segment = stored_label(increment.segment.as_ref());
        let listed: Vec<&StateKey> = increment.states.listed().iter().collect();
        let named = |family, (state, joint, _): (u64, u64, Tally)| CellName {
            state: name(&listed, state),
            segment,
            family,
            joint,
        };

        let mut absent = Vec::with_capacity(increment.most_cells());
        for family in increment.families() {
            let cells = increment.of_family(family);
            absent.extend(cells.map(|cell| named(family, cell)));
        }
        absent.retain(|cell| !self.has(cell));
        absent.sort_unstable();
        absent.dedup();
        absent
    }

    fn has(&self, cell: &CellName<'_>) -> bool {
        let state = match cell.state {
            StateName::Rank(rank) => Some(rank),
            StateName::Key(key) => self.positions.get(key).copied(),
        };
        let segment = self
            .segments
            .iter()
            .position(|label| *label == cell.segment);
        state.zip(segment).is_some_and(|(state, segment)| {
            let cells = self.cells.get(cell.family.number() as usize);
            cells.is_some_and(|cells| cells.has((state, segment as u32, cell.joint)))
        })
    }

    /// Returns the tallies by the numbers of state, segment and family, and the family's cell, each
    /// once and in this order.
    pub(in crate::store) fn tallies(
        &mut self,
    ) -> impl Iterator<Item = ((u64, u32, u32, u64), Tally)> {
        self.settle();
        let cells = side_by_side(&self.cells);
        cells.map(|(family, (state, segment, joint), tally)| {
            ((state, segment, family, joint), tally)
        })
    }
}

/// Returns the name of a state by its number, which is its rank where no states are listed.
fn name<'k>(listed: &[&'k StateKey], number: u64) -> StateName<'k> {
    if listed.is_empty() {
        StateName::Rank(number)
    } else {
        StateName::Key(listed[number as usize])
    }
}

/// Returns how a segment's label is stored: transitions without one have the empty label, which no
/// label can be.
pub(super) fn stored_label(label: Option<&Label>) -> &str {
    label.map_or("", Label::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_cells_are_one_however_many_come() {
        let one = Tally {
            n: 1,
            entries: Some(1),
        };
        let increment = |first: u64| Increment {
            cells: (first..first + 1_000)
                .map(|i| (i % 3_000, i % 2, one))
                .collect(),
            transitions: 1_000,
            ..Increment::default()
        };
        let increments: Vec<Increment> = (0..1_200).map(|i| increment(i * 1_000)).collect();

        let mut merged = Merged::default();
        increments
            .iter()
            .for_each(|increment| merged.add(increment));

        assert!(merged.most_cells() < UNSORTED, "added together on the way");
        assert!(merged.absent(&increments[7]).is_empty());
        let cells: Vec<_> = merged.tallies().collect();
        let expected = |i: u64| {
            (
                (i, 0, 0, i % 2),
                Tally {
                    n: 400,
                    entries: Some(400),
                },
            )
        };
        assert_eq!(cells, (0..3_000).map(expected).collect::<Vec<_>>());
        assert_eq!(merged.transitions(), 1_200_000);
    }
}
