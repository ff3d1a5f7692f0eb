//! A k-way merge of sorted cells: equal ones are added together.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::collections::binary_heap::PeekMut;

use super::cells::{Decoder, Place, Spoiled};
use crate::domain::Tally;

/// Cells of several sources in order of place, each place once.
pub struct Merge<'a> {
    sources: Vec<Decoder<'a>>,
    /// The next cell of each source that has one.
    heads: BinaryHeap<Head>,
    spoiled: bool,
}

/// The next cell of a source: the first is the greatest, as a heap wants it.
struct Head {
    place: Place,
    tally: Tally,
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

impl PartialEq for Head {
    #[inline]
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Head {}

impl<'a> Merge<'a> {
    /// Merges sources, each in order of place.
    pub fn new(sources: impl IntoIterator<Item = Decoder<'a>>) -> Self {
        let mut merge = Self {
            sources: sources.into_iter().collect(),
            heads: BinaryHeap::new(),
            spoiled: false,
        };
        for (source, cells) in merge.sources.iter_mut().enumerate() {
            match cells.next() {
                Some(Ok((place, tally))) => merge.heads.push(Head {
                    place,
                    tally,
                    source,
                }),
                Some(Err(Spoiled)) => merge.spoiled = true,
                None => {}
            }
        }
        merge
    }

    /// Takes the next cell of the source whose turn it is.
    #[inline]
    fn take(&mut self) -> Option<(Place, Tally)> {
        let mut head = self.heads.peek_mut()?;
        let taken = (head.place, head.tally);
        // The source keeps its place in the heap where it goes on: one sift instead of two.
        match self.sources[head.source].next() {
            Some(Ok((place, tally))) => (head.place, head.tally) = (place, tally),
            ended => {
                self.spoiled |= ended.is_some();
                PeekMut::pop(head);
            }
        }
        Some(taken)
    }

    fn is_next(&self, place: Place) -> bool {
        self.heads.peek().is_some_and(|head| head.place == place)
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
        let (place, mut sum) = self.take()?;
        while self.is_next(place) {
            let (_, tally) = self.take()?;
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
