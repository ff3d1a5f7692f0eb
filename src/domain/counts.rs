//! Counts: what a batch adds, and what a state holds.

use super::{Label, StateKey};

/// The store's number of a segment; never used twice. Transitions without a segment have one too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SegmentId(pub i64);

/// How often something was seen, and how often its state was entered with it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Visits, at least 1 in a cell.
    pub n: u64,
    /// Entries, at most `n`; `None` once a transition came without the flag.
    pub entries: Option<u64>,
}

impl Tally {
    /// Nothing seen: the sum of no tallies.
    pub const EMPTY: Self = Self { n: 0, entries: Some(0) };

    /// Returns the sum of cells.
    pub fn of<'a>(cells: impl Iterator<Item = &'a Cell>) -> Self {
        cells.fold(Self::EMPTY, |mut sum, cell| {
            sum.add(cell.tally);
            sum
        })
    }

    /// Adds another tally. The store bounds all sums by an environment's total, which fits.
    #[inline]
    pub fn add(&mut self, other: Self) {
        self.n += other.n;
        self.entries = self.entries.zip(other.entries).map(|(a, b)| a + b);
    }
}

/// What a validated batch adds to one environment under one segment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Increment {
    /// Where its transitions come from.
    pub segment: Option<Label>,
    /// Each state once.
    pub states: Vec<StateKey>,
    /// By the state's position above and the joint action, in any order; the same cell may stand here more than once.
    pub cells: Vec<(u32, u64, Tally)>,
    /// The sum of all `n`.
    pub transitions: u64,
}

/// One cell of a state: a joint action under a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cell {
    /// The joint action.
    pub joint: u64,
    /// The segment.
    pub segment: SegmentId,
    /// What was counted.
    pub tally: Tally,
}

/// Every cell of one state, in order of joint action and segment.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Counts {
    cells: Vec<Cell>,
}

impl Counts {
    /// Makes counts of cells in any order, each given once.
    pub fn new(mut cells: Vec<Cell>) -> Self {
        cells.sort_unstable_by_key(|cell| (cell.joint, cell.segment));
        Self { cells }
    }

    /// Returns the cells in order.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Returns the cells of the segments named, or of all.
    pub fn of_segments<'a>(&'a self, segments: Option<&'a [SegmentId]>) -> impl Iterator<Item = &'a Cell> + Clone {
        self.cells.iter().filter(move |cell| segments.is_none_or(|named| named.contains(&cell.segment)))
    }

    /// Adds a tally to a cell.
    pub fn add(&mut self, joint: u64, segment: SegmentId, tally: Tally) {
        match self.cells.binary_search_by_key(&(joint, segment), |cell| (cell.joint, cell.segment)) {
            Ok(at) => self.cells[at].tally.add(tally),
            Err(at) => self.cells.insert(at, Cell { joint, segment, tally }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_are_unknown_once_one_was() {
        let mut sum = Tally::EMPTY;
        sum.add(Tally { n: 2, entries: Some(1) });
        assert_eq!(sum, Tally { n: 2, entries: Some(1) });
        sum.add(Tally { n: 1, entries: None });
        sum.add(Tally { n: 1, entries: Some(1) });
        assert_eq!(sum, Tally { n: 4, entries: None });
    }

    #[test]
    fn order_of_adding_does_not_matter() {
        let one = Tally { n: 1, entries: Some(1) };
        let steps = [(3, 1), (1, 2), (3, 0), (1, 2), (0, 9)];
        let add = |order: &mut dyn Iterator<Item = &(u64, i64)>| {
            let mut counts = Counts::default();
            order.for_each(|&(joint, segment)| counts.add(joint, SegmentId(segment), one));
            counts
        };
        let forward = add(&mut steps.iter());
        assert_eq!(forward, add(&mut steps.iter().rev()));
        assert_eq!(
            forward.cells().iter().map(|c| (c.joint, c.segment.0, c.tally.n)).collect::<Vec<_>>(),
            [(0, 9, 1), (1, 2, 2), (3, 0, 1), (3, 1, 1)]
        );
    }
}
