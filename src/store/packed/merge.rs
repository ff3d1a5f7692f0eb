//! A k-way merge of sorted cells: equal ones are added together.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::collections::binary_heap::PeekMut;
use std::iter::Peekable;

use super::cells::{Decoder, Place, Spoiled};
use crate::domain::Tally;

/// Cells of several sources in order of place, each place once.
pub struct Merge<'a> {
    sources: Vec<Peekable<Decoder<'a>>>,
    /// The next place of each source that has one.
    heads: BinaryHeap<Head>,
    spoiled: bool,
}

/// The next place of a source: the first is the greatest, as a heap wants it.
#[derive(PartialEq, Eq)]
struct Head {
    place: Place,
    source: usize,
}

impl Ord for Head {
    #[inline]
    fn cmp(&self, other: &Self) -> Ordering {
        let place = other.place.cmp(&self.place);
        place.then(other.source.cmp(&self.source))
    }
}

impl PartialOrd for Head {
    #[inline]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<'a> Merge<'a> {
    /// Merges sources, each in order of place.
    pub fn new(sources: impl IntoIterator<Item = Decoder<'a>>) -> Self {
        let mut merge = Self {
            sources: sources.into_iter().map(Iterator::peekable).collect(),
            heads: BinaryHeap::new(),
            spoiled: false,
        };
        (0..merge.sources.len()).for_each(|source| merge.look(source));
        merge
    }

    /// Notes the next place of a source.
    #[inline]
    fn look(&mut self, source: usize) {
        match self.sources[source].peek() {
            Some(Ok((place, _))) => self.heads.push(Head {
                place: *place,
                source,
            }),
            Some(Err(Spoiled)) => self.spoiled = true,
            None => {}
        }
    }

    /// Takes the next cell of the source whose turn it is, if it is at this place or none is asked
    /// for.
    #[inline]
    fn take(&mut self, place: Option<Place>) -> Option<(Place, Tally)> {
        let mut head = self.heads.peek_mut()?;
        let Head {
            place: first,
            source,
        } = *head;
        if place.is_some_and(|place| place != first) {
            return None;
        }
        let (_, tally) = self.sources[source].next()?.ok()?;
        // The source keeps its place in the heap where it goes on: one sift instead of two.
        match self.sources[source].peek() {
            Some(Ok((next, _))) => head.place = *next,
            Some(Err(Spoiled)) => {
                self.spoiled = true;
                PeekMut::pop(head);
            }
            None => {
                PeekMut::pop(head);
            }
        }
        Some((first, tally))
    }
}

impl Iterator for Merge<'_> {
    type Item = Result<(Place, Tally), Spoiled>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        if self.spoiled {
            self.heads.clear();
            self.spoiled = false;
            return Some(Err(Spoiled));
        }
        let (place, mut sum) = self.take(None)?;
        while let Some((_, tally)) = self.take(Some(place)) {
            sum.add(tally);
        }
        Some(Ok((place, sum)))
    }
}

#[cfg(test)]
pub mod tests {
    use proptest::prelude::*;

    use super::super::cells::Before;
    use super::super::cells::tests::{Model, packed, place, tally};
    use super::*;

    /// Few places and small tallies, so that sums fit.
    pub fn small() -> impl Strategy<Value = Model> {
        proptest::collection::btree_map(place(40), tally(1 << 40), 0..40)
    }

    pub fn sum(models: &[Model]) -> Model {
        let mut sum = Model::new();
        for (place, tally) in models.iter().flatten() {
            sum.entry(*place).or_insert(Tally::EMPTY).add(*tally);
        }
        sum
    }

    proptest! {
        #[test]
        fn a_merge_is_the_sum(models in proptest::collection::vec(small(), 0..9)) {
            let all: Vec<Vec<u8>> = models.iter().map(packed).collect();
            let sources = all.iter().map(|bytes| Decoder::new(bytes, Before::default()));
            let merged: Result<Vec<_>, _> = Merge::new(sources).collect();
            let expected: Vec<_> = sum(&models).into_iter().collect();
            prop_assert_eq!(merged, Ok(expected));
        }

        #[test]
        fn a_spoiled_source_spoils_the_merge(models in proptest::collection::vec(small(), 1..5), at in 0usize..5) {
            let mut all: Vec<Vec<u8>> = models.iter().map(packed).collect();
            let at = at % all.len();
            // A strip without a joint action.
            all[at].push(1);
            let sources = all.iter().map(|bytes| Decoder::new(bytes, Before::default()));
            let merged: Result<Vec<_>, _> = Merge::new(sources).collect();
            prop_assert_eq!(merged, Err(Spoiled));
        }
    }
}
