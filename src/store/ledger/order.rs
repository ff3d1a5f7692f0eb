//! Radix sort of the cells of several batches by where they are, with equal ones added together:
//! each family for itself.
//!
//! A place and a tally mostly fit into sixteen bytes, and those of one family of a commit into the
//! processor's cache, where all of them together do not. Families are in the same order of states
//! and segments, so that reading them side by side gives the order of everything.

use std::iter::Peekable;

use crate::domain::{Family, Increment, Tally};

/// Where a cell of a family is: a state's number, a segment's and the family's cell.
pub(super) type At = (u64, u32, u64);

/// Below so many records a comparison sort is faster.
const FEW: usize = 256;

/// Bits that one pass sorts by, at most.
const DIGIT: u32 = 11;

/// What one batch adds.
pub(super) struct Part<'a> {
    pub(super) increment: &'a Increment,
    pub(super) segment: u32,
    /// The numbers of the states that the batch lists; `None` where cells have them themselves.
    pub(super) numbers: Option<Box<[u64]>>,
}

impl Part<'_> {
    #[inline]
    fn number(&self, state: u64) -> u64 {
        let numbers = self.numbers.as_ref();
        numbers.map_or(state, |numbers| numbers[state as usize])
    }

    /// Returns the cells of a family.
    pub(super) fn cells(&self, family: Family) -> impl Iterator<Item = (At, Tally)> {
        let cells = self.increment.of_family(family);
        cells.map(|(state, cell, tally)| ((self.number(state), self.segment, cell), tally))
    }
}

/// Sorts the cells of batches and returns those of each family. The sum of their visits is at most
/// `visits`, and that of all that they are ever merged with.
pub(super) fn sorted(parts: &[Part<'_>], visits: u64) -> Vec<Sorted> {
    let families = parts.iter().map(|part| part.increment.families());
    let families = families.max_by_key(ExactSizeIterator::len);
    let families = families.into_iter().flatten();
    match Strips::of(parts, visits) {
        Some(strips) => families.map(|family| strips.sorted(family)).collect(),
        None => families.map(|family| Sorted::wide(parts, family)).collect(),
    }
}

/// Cells of one family in order of place, each once.
pub(super) enum Sorted {
    /// In few bytes.
    Packed(Packing, Vec<Packed>),
    /// Where a place or a tally needs more.
    Wide(Vec<(At, Tally)>),
}

impl Default for Sorted {
    fn default() -> Self {
        Self::Wide(Vec::new())
    }
}

impl Sorted {
    fn wide(parts: &[Part<'_>], family: Family) -> Self {
        let cells = parts.iter().flat_map(|part| part.cells(family));
        let mut cells: Vec<(At, Tally)> = cells.collect();
        cells.sort_unstable_by_key(|(at, _)| *at);
        Self::Wide(summed(cells.into_iter()))
    }

    /// Adds both together.
    pub(super) fn merged(self, other: Self) -> Self {
        match (self, other) {
            (one, none) | (none, one) if none.len() == 0 => one,
            (Self::Packed(packing, a), Self::Packed(other, b)) if packing == other => {
                let both = InOrder::new(a.into_iter(), b.into_iter(), |cell| cell.place);
                Self::Packed(packing, packed_sums(both.collect()))
            }
            (a, b) => Self::Wide(summed(InOrder::new(a.iter(), b.iter(), |cell| cell.0))),
        }
    }

    /// Returns how many there are.
    pub(super) fn len(&self) -> usize {
        match self {
            Self::Packed(_, cells) => cells.len(),
            Self::Wide(cells) => cells.len(),
        }
    }

    #[inline]
    fn get(&self, index: usize) -> Option<(At, Tally)> {
        match self {
            Self::Packed(packing, cells) => Some(packing.unpack(*cells.get(index)?)),
            Self::Wide(cells) => cells.get(index).copied(),
        }
    }

    /// Returns whether there is a cell at a place.
    pub(super) fn has(&self, at: At) -> bool {
        match self {
            Self::Packed(packing, cells) => packing.pack_any(at).is_some_and(|place| {
                cells
                    .binary_search_by_key(&place, |cell| cell.place)
                    .is_ok()
            }),
            Self::Wide(cells) => cells.binary_search_by_key(&at, |(at, _)| *at).is_ok(),
        }
    }

    /// Returns all of them.
    pub(super) fn iter(&self) -> impl Iterator<Item = (At, Tally)> {
        (0..self.len()).map_while(|index| self.get(index))
    }
}

/// Returns the cells of families that were sorted together, each with the family's number, in order
/// of state, segment, family and cell.
pub(super) fn side_by_side(families: &[Sorted]) -> impl Iterator<Item = (u32, At, Tally)> {
    let mut next = vec![0; families.len()];
    let (mut family, mut strip) = (0, None);
    std::iter::from_fn(move || {
        loop {
            // What is observed is observed with a joint action: they have every state and segment.
            let cells = families.get(family)?;
            let cell = cells.get(next[family]);
            let cell = cell.filter(|((state, segment, _), _)| {
                *strip.get_or_insert((*state, *segment)) == (*state, *segment)
            });
            if let Some((at, tally)) = cell {
                next[family] += 1;
                return Some((family as u32, at, tally));
            }

            strip?;
            family += 1;
            if family == families.len() {
                (family, strip) = (0, None);
            }
        }
    })
}

/// The items of two iterators that are in order, in order.
struct InOrder<I: Iterator, F> {
    a: Peekable<I>,
    b: Peekable<I>,
    place: F,
}

impl<I: Iterator, P: Ord, F: Fn(&I::Item) -> P> InOrder<I, F> {
    fn new(a: I, b: I, place: F) -> Self {
        let (a, b) = (a.peekable(), b.peekable());
        Self { a, b, place }
    }
}

impl<I: Iterator, P: Ord, F: Fn(&I::Item) -> P> Iterator for InOrder<I, F> {
    type Item = I::Item;

    #[inline]
    fn next(&mut self) -> Option<I::Item> {
        match (self.a.peek(), self.b.peek()) {
            (Some(a), Some(b)) if (self.place)(a) <= (self.place)(b) => self.a.next(),
            (Some(_), None) => self.a.next(),
            _ => self.b.next(),
        }
    }
}

/// Adds neighbours together that are the same.
fn summed(cells: impl Iterator<Item = (At, Tally)>) -> Vec<(At, Tally)> {
    let mut sums: Vec<(At, Tally)> = Vec::with_capacity(cells.size_hint().0);
    for (at, tally) in cells {
        match sums.last_mut() {
            Some((last, sum)) if *last == at => sum.add(tally),
            _ => sums.push((at, tally)),
        }
    }
    sums
}

/// Does the same with packed ones.
fn packed_sums(mut cells: Vec<Packed>) -> Vec<Packed> {
    cells.dedup_by(|cell, sum| {
        let is_same = cell.place == sum.place;
        if is_same {
            sum.add(*cell);
        }
        is_same
    });
    cells
}

/// A cell in sixteen bytes.
#[derive(Clone, Copy, Default)]
pub(super) struct Packed {
    place: u64,
    n: u32,
    /// Or [`UNKNOWN`].
    entries: u32,
}

/// Whether it was entered is not known.
const UNKNOWN: u32 = u32::MAX;

impl Packed {
    #[inline]
    fn of(place: u64, tally: Tally) -> Self {
        Self {
            place,
            n: tally.n as u32,
            entries: tally.entries.map_or(UNKNOWN, |entries| entries as u32),
        }
    }

    #[inline]
    fn add(&mut self, other: Self) {
        self.n += other.n;
        self.entries = match (self.entries, other.entries) {
            (UNKNOWN, _) | (_, UNKNOWN) => UNKNOWN,
            (a, b) => a + b,
        };
    }
}

/// How the three numbers of a place go into one of 64 bits, which is in the same order: how many
/// bits a segment and a cell take.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) struct Packing {
    segment: u32,
    cell: u32,
}

impl Packing {
    #[inline]
    fn pack(&self, (state, segment, cell): At) -> u64 {
        (state << (self.segment + self.cell)) | (u64::from(segment) << self.cell) | cell
    }

    /// Packs a place that none of the cells may have.
    fn pack_any(&self, at: At) -> Option<u64> {
        let place = self.pack(at);
        (self.place(place) == at).then_some(place)
    }

    #[inline]
    fn place(&self, packed: u64) -> At {
        let low = |shift: u32, bits: u32| (packed >> shift) & ((1 << bits) - 1);
        (
            packed >> (self.segment + self.cell),
            low(self.cell, self.segment) as u32,
            low(0, self.cell),
        )
    }

    #[inline]
    fn unpack(&self, cell: Packed) -> (At, Tally) {
        let tally = Tally {
            n: cell.n.into(),
            entries: (cell.entries != UNKNOWN).then_some(cell.entries.into()),
        };
        (self.place(cell.place), tally)
    }
}

/// The records of batches, each in sixteen bytes: their states and segments, in which each family
/// has a cell of them.
struct Strips<'p, 'a> {
    parts: &'p [Part<'a>],
    /// In their order, with a place of no bits for a cell.
    records: Vec<Packed>,
    /// How many bits a segment takes, and how many that and a state.
    segment: u32,
    bits: u32,
}

impl<'p, 'a> Strips<'p, 'a> {
    /// Returns those of many records; `None` where they need more bytes.
    fn of(parts: &'p [Part<'a>], visits: u64) -> Option<Self> {
        let many = parts.iter().map(|part| part.increment.cells.len()).sum();
        let segments = parts.iter().fold(0, |used, part| used | part.segment);
        let packing = Packing {
            segment: bits(segments.into()),
            cell: 0,
        };

        let (mut records, mut states) = (Vec::with_capacity(many), 0);
        for part in parts {
            records.extend(part.increment.cells.iter().map(|(state, _, tally)| {
                let state = part.number(*state);
                states |= state;
                Packed::of(packing.pack((state, part.segment, 0)), *tally)
            }));
        }

        let bits = bits(states) + packing.segment;
        let fits = many >= FEW && bits <= u64::BITS && visits < UNKNOWN.into();
        fits.then_some(Self {
            parts,
            records,
            segment: packing.segment,
            bits,
        })
    }

    /// Sorts the cells of a family.
    fn sorted(&self, family: Family) -> Sorted {
        let cell = self.bits_of_cells(family);
        let all = self.bits + cell;
        // A shift by 64 is none.
        if all > u64::BITS || cell == u64::BITS {
            return Sorted::wide(self.parts, family);
        }

        let packing = Packing {
            segment: self.segment,
            cell,
        };
        let cells = radix_sorted(self.cells(family, cell), all);
        Sorted::Packed(packing, packed_sums(cells))
    }

    fn bits_of_cells(&self, family: Family) -> u32 {
        let mut used = 0;
        for part in self.parts {
            let cells = part.increment.column(family);
            cells.for_each(|cell| used |= if cell == Increment::MISSING { 0 } else { cell });
        }
        bits(used)
    }

    /// Returns the cells of a family, of so many bits, in the order of records.
    fn cells(&self, family: Family, bits: u32) -> Vec<Packed> {
        let mut all = Vec::with_capacity(self.records.len());
        let mut records = &self.records[..];
        for part in self.parts {
            let (of_part, rest) = records.split_at(part.increment.cells.len());
            records = rest;

            let cells = of_part.iter().zip(part.increment.column(family));
            let observed = cells.filter(|(_, cell)| *cell != Increment::MISSING);
            all.extend(observed.map(|(record, cell)| Packed {
                place: record.place << bits | cell,
                ..*record
            }));
        }
        all
    }
}

/// Returns how many bits a number takes.
fn bits(number: u64) -> u32 {
    u64::BITS - number.leading_zeros()
}

/// Sorts cells by their places, which have so many bits, least significant digit first.
fn radix_sorted(mut cells: Vec<Packed>, bits: u32) -> Vec<Packed> {
    const DIGITS: usize = 1 << DIGIT;
    // As many passes, and none with more digits than it needs.
    let digits = bits.div_ceil(bits.div_ceil(DIGIT).max(1)).max(1);
    let mut sorted = vec![Packed::default(); cells.len()];
    for shift in (0..bits).step_by(digits as usize) {
        let digit = |cell: &Packed| (cell.place >> shift) as usize & ((1 << digits) - 1);

        let mut next = [0_u32; DIGITS];
        for cell in &cells {
            next[digit(cell)] += 1;
        }
        let mut first = 0;
        for count in &mut next[..1 << digits] {
            first += std::mem::replace(count, first);
        }

        for cell in &cells {
            let at = &mut next[digit(cell)];
            sorted[*at as usize] = *cell;
            *at += 1;
        }
        std::mem::swap(&mut cells, &mut sorted);
    }
    cells
}
