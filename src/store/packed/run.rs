//! A sorted run: the cells of one commit, or of several merged, packed in memory, where those of a
//! state are found by binary search.

use std::sync::Arc;

use super::cells::{Before, Decoder, Encoder, Place, Spoiled};
use super::merge::Merge;
use crate::domain::Tally;

/// Cells between two fences: as many are unpacked in vain, at most, before one is found.
const BETWEEN: usize = 16;

/// Sorted cells that do not change.
#[derive(Debug, Clone)]
pub struct Run {
    bytes: Arc<[u8]>,
    fences: Arc<[Fence]>,
    cells: usize,
}

/// A place to begin unpacking at.
#[derive(Debug, Clone, Copy)]
struct Fence {
    before: Before,
    at: u32,
}

/// Packs a run.
#[derive(Default)]
pub struct RunWriter {
    cells: Encoder,
    fences: Vec<Fence>,
    count: usize,
}

impl RunWriter {
    /// Adds a cell, in order of place.
    #[inline]
    pub fn push(&mut self, place: Place, tally: Tally) {
        if self.count.is_multiple_of(BETWEEN) {
            self.fences.push(Fence {
                before: self.cells.before(),
                at: self.cells.len() as u32,
            });
        }
        self.cells.push(place, tally);
        self.count += 1;
    }

    /// Returns the run.
    pub fn finish(self) -> Run {
        Run {
            bytes: self.cells.finish().into(),
            fences: self.fences.into(),
            cells: self.count,
        }
    }
}

impl Run {
    /// Packs cells that come in order of place, each once.
    pub fn of(cells: impl IntoIterator<Item = (Place, Tally)>) -> Self {
        let mut writer = RunWriter::default();
        cells
            .into_iter()
            .for_each(|(place, tally)| writer.push(place, tally));
        writer.finish()
    }

    /// Reads a run that was kept as bytes.
    pub fn read(bytes: &[u8]) -> Result<Self, Spoiled> {
        let mut writer = RunWriter::default();
        for cell in Decoder::new(bytes, Before::default()) {
            let (place, tally) = cell?;
            writer.push(place, tally);
        }
        Ok(writer.finish())
    }

    /// Merges runs into one.
    pub fn merge<'a>(runs: impl IntoIterator<Item = &'a Run>) -> Result<Self, Spoiled> {
        let mut writer = RunWriter::default();
        for cell in Merge::new(runs.into_iter().map(|run| run.from(0))) {
            let (place, tally) = cell?;
            writer.push(place, tally);
        }
        Ok(writer.finish())
    }

    /// Returns whether it is the very same run.
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.bytes, &other.bytes)
    }

    /// Returns the cells as bytes, to be kept.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns how many cells there are.
    pub fn len(&self) -> usize {
        self.cells
    }

    /// Returns how many cells there are of states at or after one: a few more at most.
    pub fn most_from(&self, state: u64) -> usize {
        self.cells - BETWEEN * self.last_fence_before(state)
    }

    /// Returns the last fence before all cells of states at or after one, or the first.
    fn last_fence_before(&self, state: u64) -> usize {
        let is_before = |fence: &Fence| fence.before.place().state < state;
        self.fences.partition_point(is_before).saturating_sub(1)
    }

    /// Returns the cells of states at or after one.
    pub fn from(&self, state: u64) -> Decoder<'_> {
        let Some(fence) = self.fences.get(self.last_fence_before(state)) else {
            return Decoder::new(&[], Before::default());
        };
        let mut cells = Decoder::new(&self.bytes[fence.at as usize..], fence.before);
        loop {
            let mut ahead = cells.clone();
            match ahead.next() {
                Some(Ok((place, _))) if place.state < state => cells = ahead,
                _ => return cells,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::cells::tests::{Model, model, place, tally};
    use super::super::merge::tests::{small, sum};
    use super::*;

    fn run(cells: &Model) -> Run {
        Run::of(cells.iter().map(|(place, tally)| (*place, *tally)))
    }

    proptest! {
        #[test]
        fn cells_of_a_state_and_after_are_found(
            cells in proptest::collection::btree_map(place(300), tally(9), 0..400),
            state in 0u64..310,
        ) {
            let found: Result<Model, _> = run(&cells).from(state).collect();
            let expected: Model = cells.range(Place::first_of(state)..).map(|(p, t)| (*p, *t)).collect();
            let more = run(&cells).most_from(state) - expected.len();
            prop_assert!(more <= BETWEEN, "{} more", more);
            prop_assert_eq!(found, Ok(expected));
        }

        #[test]
        fn what_is_kept_is_read(cells in model(1 << 59)) {
            let again = Run::read(run(&cells).bytes()).expect("sound");
            let found: Result<Model, _> = again.from(0).collect();
            prop_assert_eq!(found, Ok(cells));
        }

        #[test]
        fn merged_runs_are_their_sum(models in proptest::collection::vec(small(), 0..9)) {
            let runs: Vec<Run> = models.iter().map(run).collect();
            let merged = Run::merge(&runs).expect("sound");
            let expected = sum(&models);
            prop_assert_eq!(merged.len(), expected.len());
            let found: Result<Model, _> = merged.from(0).collect();
            prop_assert_eq!(found, Ok(expected));
        }
    }
}
