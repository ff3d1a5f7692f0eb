//! Merging of a group commit: equal cells of all its batches are added together, so that each is
//! written once.

use crate::domain::{Increment, Label, StateKey, States, Tally};
use crate::store::map::Map;

/// The most cells that a commit makes room for at its first batch.
const USUAL_CELLS: usize = 8_192;

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
    pub(super) joint: u64,
}

/// A state's number, a segment's and a joint action.
type At = (u64, u32, u64);

/// The sum of accepted increments of one environment. States that are listed, and segments, are
/// numbered in order of appearance; the number of a state that has a rank is the rank.
#[derive(Default)]
pub(in crate::store) struct Merged<'a> {
    listed: Vec<&'a StateKey>,
    positions: Map<&'a StateKey, u64>,
    segments: Vec<&'a str>,
    cells: Map<At, Tally>,
    transitions: u64,
}

impl<'a> Merged<'a> {
    /// Adds an increment. All those of an environment name their states in the same way, for its
    /// schema says which.
    pub(super) fn add(&mut self, increment: &'a Increment) {
        if increment.cells.is_empty() {
            return;
        }

        self.transitions += increment.transitions;
        let segment = self.number_of_segment(stored_label(increment.segment.as_ref()));
        if self.cells.is_empty() {
            self.cells
                .reserve((8 * increment.cells.len()).min(USUAL_CELLS));
        }

        match &increment.states {
            States::Ranked => self.add_cells(increment, segment, |rank| rank),
            States::Listed(keys) => {
                let numbers: Vec<u64> = keys.iter().map(|key| self.number_of_state(key)).collect();
                self.add_cells(increment, segment, |at| numbers[at as usize]);
            }
        }
    }

    fn add_cells(&mut self, increment: &Increment, segment: u32, number: impl Fn(u64) -> u64) {
        for (state, joint, tally) in &increment.cells {
            self.cells
                .entry((number(*state), segment, *joint))
                .or_insert(Tally::EMPTY)
                .add(*tally);
        }
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

    /// Returns the number of cells.
    pub(in crate::store) fn len(&self) -> usize {
        self.cells.len()
    }

    /// Returns the sum of all visits.
    pub(in crate::store) fn transitions(&self) -> u64 {
        self.transitions
    }

    /// Returns every cell by its names.
    pub(super) fn cells(&self) -> impl Iterator<Item = CellName<'a>> {
        self.cells.keys().map(|(state, segment, joint)| CellName {
            state: name(&self.listed, *state),
            segment: self.segments[*segment as usize],
            joint: *joint,
        })
    }

    /// Returns the cells of an increment that are not here, each once, by their names.
    pub(super) fn absent<'i>(&self, increment: &'i Increment) -> Vec<CellName<'i>> {
        let segment = stored_label(increment.segment.as_ref());
        let listed: Vec<&StateKey> = increment.states.listed().iter().collect();
        let named = |(state, joint, _): &(u64, u64, Tally)| CellName {
            state: name(&listed, *state),
            segment,
            joint: *joint,
        };

        let mut absent: Vec<_> = increment.cells.iter().map(named).collect();
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
            self.cells
                .contains_key(&(state, segment as u32, cell.joint))
        })
    }

    /// Returns the tallies by the numbers of state and segment, and the joint action; they are here
    /// no longer.
    pub(in crate::store) fn take_cells(
        &mut self,
    ) -> impl ExactSizeIterator<Item = (At, Tally)> + use<> {
        std::mem::take(&mut self.cells).into_iter()
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
    fn the_first_batch_of_a_commit_makes_room_for_more_like_it_within_bounds() {
        let capacity = |cells: u64| {
            let increment = Increment {
                cells: (0..cells).map(|joint| (0, joint, Tally::EMPTY)).collect(),
                ..Increment::default()
            };
            let mut merged = Merged::default();
            merged.add(&increment);
            merged.cells.capacity()
        };
        assert!(capacity(100) >= 800);
        assert!(capacity(2_000) < 16_000, "eight of these are not usual");
    }
}
