//! Adding equal cells together across all batches of a commit, so that each is written once.

use crate::domain::{Increment, Label, StateKey, Tally};
use crate::store::sqlite::map::Map;

/// The most cells that a commit makes room for at its first batch.
const USUAL_CELLS: usize = 8_192;

/// The sum of accepted increments of one environment. States and segments are numbered in order of
/// appearance.
#[derive(Default)]
pub(super) struct Merged<'a> {
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
        let segment = self.segment(stored_label(increment.segment.as_ref()));
        if self.cells.is_empty() {
            self.cells
                .reserve((8 * increment.cells.len()).min(USUAL_CELLS));
        }
        let states: Vec<u32> = increment.states.iter().map(|key| self.state(key)).collect();
        for (state, joint, tally) in &increment.cells {
            self.cells
                .entry((states[*state as usize], segment, *joint))
                .or_insert(Tally::EMPTY)
                .add(*tally);
        }
    }

    fn state(&mut self, key: &'a StateKey) -> u32 {
        *self.positions.entry(key).or_insert_with(|| {
            self.states.push(key);
            self.states.len() as u32 - 1
        })
    }

    /// A commit has few segments, and mostly one.
    fn segment(&mut self, label: &'a str) -> u32 {
        let at = self.segments.iter().position(|known| *known == label);
        at.unwrap_or_else(|| {
            self.segments.push(label);
            self.segments.len() - 1
        }) as u32
    }

    /// Returns the states, in order of their numbers.
    pub(super) fn states(&self) -> &[&'a StateKey] {
        &self.states
    }

    /// Returns the labels of segments, in order of their numbers.
    pub(super) fn segments(&self) -> &[&'a str] {
        &self.segments
    }

    /// Returns the number of cells.
    pub(super) fn len(&self) -> usize {
        self.cells.len()
    }

    /// Returns the sum of all visits.
    pub(super) fn transitions(&self) -> u64 {
        self.transitions
    }

    /// Returns every cell by its names.
    pub(super) fn cells(&self) -> impl Iterator<Item = (&'a StateKey, &'a str, u64)> {
        let name = |(state, segment, joint): &(u32, u32, u64)| {
            (
                self.states[*state as usize],
                self.segments[*segment as usize],
                *joint,
            )
        };
        self.cells.keys().map(name)
    }

    /// Returns the cells of an increment that are not here, each once, by their names.
    pub(super) fn absent<'i>(&self, increment: &'i Increment) -> Vec<(&'i StateKey, &'i str, u64)> {
        let label = stored_label(increment.segment.as_ref());
        let segment = self
            .segments
            .iter()
            .position(|known| *known == label)
            .map(|at| at as u32);
        let name = |(state, joint, _): &(u32, u64, Tally)| {
            let key = &increment.states[*state as usize];
            let known = self.positions.get(key).zip(segment);
            let present = known.is_some_and(|(state, segment)| {
                self.cells.contains_key(&(*state, segment, *joint))
            });
            (!present).then_some((key, label, *joint))
        };
        let mut absent: Vec<_> = increment.cells.iter().filter_map(name).collect();
        absent.sort_unstable();
        absent.dedup();
        absent
    }

    /// Returns the tallies by the numbers of state and segment, and the joint action; they are here
    /// no longer.
    pub(super) fn take_cells(
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
