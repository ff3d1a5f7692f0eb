//! Contingency tables of a state and their transposes, as each side reads them; and cut by segment.

use std::borrow::Cow;

use super::counted::Counted;
use super::likelihood::by_part;
use crate::information::Table;

/// A table, and the same with rows and columns exchanged: as each side reads it.
pub(super) type Reading<'a> = [Cow<'a, Table>; 2];

/// The tables of a state as each side reads them.
pub(super) struct Readings<'a> {
    /// Those that were visited, or one that was not.
    pub wholes: Vec<Reading<'a>>,
    /// Their parts by segment, if there are several segments.
    pub parts: Parts<'a>,
}

impl<'a> Readings<'a> {
    pub fn new(Counted { slices, parts }: Counted<'a>) -> Self {
        let visited: Vec<Reading<'_>> = slices
            .iter()
            .filter(|slice| slice.total() > 0)
            .map(reading)
            .collect();

        let wholes = if visited.is_empty() {
            vec![Reading::default()]
        } else {
            visited
        };

        Self {
            wholes,
            parts: Parts::new(parts),
        }
    }
}

pub(super) fn reading(slice: &Table) -> Reading<'_> {
    [Cow::Borrowed(slice), Cow::Owned(slice.transposed())]
}

/// The parts of a state as each side reads them.
pub(super) struct Parts<'a> {
    /// Those that were visited more than once.
    pub several: Vec<Reading<'a>>,
    pub single: Single<'a>,
}

/// The parts of one visit, of which there can be many: all that matters is which letter it was.
pub(super) struct Single<'a> {
    /// How many.
    pub number: usize,
    pub first: Option<Reading<'a>>,
    /// By letter of the rows, and of the columns.
    letters: [Vec<u64>; 2],
}

impl<'a> Parts<'a> {
    /// Looks at the parts that were visited.
    pub fn new(parts: &'a [Table]) -> Self {
        Self {
            several: parts
                .iter()
                .filter(|part| part.total() > 1)
                .map(reading)
                .collect(),
            single: Single::new(parts.iter().filter(|part| part.total() == 1)),
        }
    }

    /// Returns how many there are.
    pub fn number(&self) -> usize {
        self.several.len() + self.single.number
    }

    /// Returns the sum of their visits.
    pub fn visits(&self) -> f64 {
        self.several
            .iter()
            .map(|part| part[0].total() as f64)
            .sum::<f64>()
            + self.single.number as f64
    }

    /// Returns the cells of the table of parts and the responder's letters.
    pub fn by_part(&self, side: usize) -> impl Iterator<Item = (u64, u64, u64)> {
        let single = self.single.letters[1 - side]
            .iter()
            .map(|letter| (*letter, 1));
        let single = (self.several.len() as u64..)
            .zip(single)
            .map(|(part, (letter, n))| (part, letter, n));
        by_part(self.several.iter().map(move |part| &*part[side])).chain(single)
    }
}

impl<'a> Single<'a> {
    fn new(parts: impl Iterator<Item = &'a Table> + Clone) -> Self {
        let first = parts.clone().next().map(reading);
        let mut letters = [Vec::new(), Vec::new()];

        for part in parts {
            letters[0].push(part.row_labels()[0]);
            letters[1].push(part.column_labels()[0]);
        }

        letters
            .iter_mut()
            .for_each(|letters| letters.sort_unstable());

        Self {
            number: letters[0].len(),
            first,
            letters,
        }
    }

    /// Returns the driver's letters, and how many parts are of each.
    pub fn drivers(&self, side: usize) -> impl Iterator<Item = (usize, f64)> {
        counted(&self.letters[side])
    }

    /// Returns the responder's letters, and how many parts are of each.
    pub fn responses(&self, side: usize) -> impl Iterator<Item = (usize, f64)> {
        counted(&self.letters[1 - side])
    }
}

/// Returns each letter with how often it is there, given letters in order.
fn counted(letters: &[u64]) -> impl Iterator<Item = (usize, f64)> {
    letters
        .chunk_by(|a, b| a == b)
        .map(|equal| (equal[0] as usize, equal.len() as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::information::samples::grid;

    #[test]
    fn slices_without_visits_are_left_out_but_for_one() {
        let visited = grid(&[&[1, 2], &[0, 4]]);
        let slices = [Table::default(), visited.clone()];
        let readings = Readings::new((&slices).into());
        assert_eq!(readings.wholes.len(), 1);
        assert_eq!(*readings.wholes[0][0], visited);
        assert_eq!(*readings.wholes[0][1], visited.transposed());

        let nothing = [Table::default(), Table::default()];
        let readings = Readings::new((&nothing).into());
        assert_eq!(readings.wholes.len(), 1);
        assert_eq!(readings.wholes[0][0].total(), 0);
    }

    #[test]
    fn parts_of_one_visit_are_counted_by_letter() {
        let several = grid(&[&[0, 2], &[3, 0]]);
        let one = |row, column| Table::from_counts([(row, column, 1)]);
        let parts = [one(1, 2), several, Table::default(), one(0, 2), one(1, 0)];

        let parts = Parts::new(&parts);

        assert_eq!((parts.several.len(), parts.single.number), (1, 3));
        assert_eq!((parts.number(), parts.visits()), (4, 8.0));
        let first = parts.single.first.as_ref().expect("there are three");
        assert_eq!(first[0].row_labels(), [1]);

        let letters = |found: &mut dyn Iterator<Item = (usize, f64)>| found.collect::<Vec<_>>();
        assert_eq!(letters(&mut parts.single.drivers(0)), [(0, 1.0), (1, 2.0)]);
        assert_eq!(
            letters(&mut parts.single.responses(0)),
            [(0, 1.0), (2, 2.0)]
        );
        assert_eq!(letters(&mut parts.single.drivers(1)), [(0, 1.0), (2, 2.0)]);
        assert_eq!(
            letters(&mut parts.single.responses(1)),
            [(0, 1.0), (1, 2.0)]
        );

        // By the responder's letters: those of several visits first, then each single one.
        let cells: Vec<_> = parts.by_part(0).collect();
        assert_eq!(
            cells,
            [(0, 0, 3), (0, 1, 2), (1, 0, 1), (2, 2, 1), (3, 2, 1)]
        );
        let cells: Vec<_> = parts.by_part(1).collect();
        assert_eq!(
            cells,
            [(0, 0, 2), (0, 1, 3), (1, 0, 1), (2, 1, 1), (3, 1, 1)]
        );
    }
}
