//! Merging of a group commit: equal cells of all its batches are added together, so that each is
//! written once.

use crate::domain::{Increment, Label, StateKey, Tally};
use crate::store::map::Map;

/// The most cells that a commit makes room for at its first batch.
const USUAL_CELLS: usize = 8_192;

/// A cell by its names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct CellName<'k> {
    pub(super) state: &'k StateKey,
    /// As it is stored.
    pub(super) segment: &'k str,
    pub(super) joint: u64,
}

/// The sum of accepted increments of one environment. States and segments are numbered in order of
/// appearance.
#[derive(Default)]
pub(in crate::store) struct Merged<'a> {
    states: Vec<&'a StateKey>,
    positions: Map<&'a StateKey, u32>,
    segments: Vec<&'a str>,
    cells: Map<(u32, u32, u64), Tally>,
    transitions: u64,
}

impl<'a> Merged<'a> {
    /// Adds an increment.
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

        let states: Vec<u32> = increment
            .states
            .iter()
            .map(|key| self.number_of_state(key))
            .collect();
        for (state, joint, tally) in &increment.cells {
            self.cells
                .entry((states[*state as usize], segment, *joint))
                .or_insert(Tally::EMPTY)
                .add(*tally);
        }
    }

    fn number_of_state(&mut self, key: &'a StateKey) -> u32 {
        *self.positions.entry(key).or_insert_with(|| {
            self.states.push(key);
            self.states.len() as u32 - 1
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

    /// Returns the states, in order of their numbers.
    pub(in crate::store) fn states(&self) -> &[&'a StateKey] {
        &self.states
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
            state: self.states[*state as usize],
            segment: self.segments[*segment as usize],
            joint: *joint,
        })
    }

    /// Returns the cells of an increment that are not here, each once, by their names.
    pub(super) fn absent<'i>(&self, increment: &'i Increment) -> Vec<CellName<'i>> {
        let segment = stored_label(increment.segment.as_ref());
        let name = |(state, joint, _): &(u32, u64, Tally)| CellName {
            state: &increment.states[*state as usize],
            segment,
            joint: *joint,
        };

        let mut absent: Vec<_> = increment.cells.iter().map(name).collect();
        absent.retain(|cell| !self.has(cell));
        absent.sort_unstable();
        absent.dedup();
        absent
    }

    fn has(&self, cell: &CellName<'_>) -> bool {
        let state = self.positions.get(cell.state);
        let segment = self
            .segments
            .iter()
            .position(|label| *label == cell.segment);
        state.zip(segment).is_some_and(|(state, segment)| {
            self.cells
                .contains_key(&(*state, segment as u32, cell.joint))
        })
    }

    /// Returns the tallies by the numbers of state and segment, and the joint action; they are here
    /// no longer.
    pub(in crate::store) fn take_cells(
        &mut self,
    ) -> impl ExactSizeIterator<Item = ((u32, u32, u64), Tally)> + use<> {
        std::mem::take(&mut self.cells).into_iter()
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
                states: vec![StateKey::new(&[0])],
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
