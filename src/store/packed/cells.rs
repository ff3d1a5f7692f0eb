//! Delta encoding of sorted cells: what rows, the journal and the runs in memory are made of.
//!
//! A cell is what differs from the one before it. Its first integer ends in a bit that says whether
//! it is of the same state, segment and family; the rest is then how many joint actions lie
//! between. Else a second bit says whether segment and family follow, and the rest is how many
//! states further it is; the joint action follows. Then comes the tally: two bits say what is known
//! of its entries, for a visit is mostly an entry, or none is known. So a cell beside its neighbour
//! takes two bytes, and one of a batch that hits anything about four.
//!
//! ```text
//! cell    joint - before - 1 << 1 | 0                                  tally
//!         state - before << 2 | strip << 1 | 1   [segment family]  joint  tally       strip: 1 where they follow
//! tally   n << 2 | kind   [entries]                     kind: 0 unknown, 1 as many as n, 2 none, 3 follow
//! ```

use std::cmp::Ordering;

use super::varint;
use crate::domain::Tally;

/// Where a cell is: the order of everything that is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Place {
    /// The state's rank among those of its environment, or its number there; below 2^59.
    pub state: u64,
    /// The segment.
    pub segment: u64,
    /// The family: 0 for the joint action alone.
    pub family: u64,
    /// The joint action, below 2^62.
    pub joint: u64,
}

impl Place {
    /// Where cells begin whose states are at or after this one.
    pub fn first_of(state: u64) -> Self {
        Self {
            state,
            ..Self::default()
        }
    }

    fn strip(&self) -> (u64, u64, u64) {
        (self.state, self.segment, self.family)
    }

    /// The four in two numbers: a merge compares little else.
    #[inline]
    fn order(&self) -> (u128, u128) {
        let both = |high: u64, low: u64| u128::from(high) << u64::BITS | u128::from(low);
        (
            both(self.state, self.segment),
            both(self.family, self.joint),
        )
    }
}

impl Ord for Place {
    #[inline]
    fn cmp(&self, other: &Self) -> Ordering {
        self.order().cmp(&other.order())
    }
}

impl PartialOrd for Place {
    #[inline]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The most visits of a cell: a sum of an environment's transitions.
pub const MOST: u64 = i64::MAX as u64;

/// Packed bytes that no [`Encoder`] wrote.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Spoiled;

/// Packs cells that come in order of place, each once.
#[derive(Debug, Default)]
pub struct Encoder {
    bytes: Vec<u8>,
    before: Before,
}

/// The cell before the next one: `None` at the beginning, where a state is given that no cell is
/// before.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Before {
    place: Place,
    is_cell: bool,
}

impl Before {
    /// Begins at a state.
    pub fn state(state: u64) -> Self {
        Self {
            place: Place::first_of(state),
            is_cell: false,
        }
    }

    /// Returns the place, of the cell or of where it begins.
    pub fn place(&self) -> Place {
        self.place
    }
}

impl Encoder {
    /// Begins at a state, after bytes of the caller's.
    pub fn after(bytes: Vec<u8>, state: u64) -> Self {
        Self {
            bytes,
            before: Before::state(state),
        }
    }

    /// Returns how many bytes there are.
    pub fn len(&self) -> usize {
        self.bytes.len()
    }

    /// Returns what comes before the next cell.
    pub fn before(&self) -> Before {
        self.before
    }

    /// Adds a cell that comes after all others.
    #[inline]
    pub fn push(&mut self, place: Place, tally: Tally) {
        let Before {
            place: before,
            is_cell,
        } = self.before;
        if is_cell && place.strip() == before.strip() {
            debug_assert!(place.joint > before.joint, "cells are in order");
            varint::put(&mut self.bytes, (place.joint - before.joint - 1) << 1);
        } else {
            debug_assert!(
                place.strip() > before.strip() || !is_cell,
                "cells are in order"
            );
            self.put_strip(before, place);
        }
        put_tally(&mut self.bytes, tally);
        self.before = Before {
            place,
            is_cell: true,
        };
    }

    /// Adds cells that were packed behind the same cell, of which this is the last.
    pub fn copy(&mut self, packed: &[u8], last: Before) {
        self.bytes.extend_from_slice(packed);
        self.before = last;
    }

    fn put_strip(&mut self, before: Place, place: Place) {
        let follows = (place.segment, place.family) != (before.segment, before.family);
        let further = place.state - before.state;
        varint::put(&mut self.bytes, further << 2 | u64::from(follows) << 1 | 1);
        if follows {
            varint::put(&mut self.bytes, place.segment);
            varint::put(&mut self.bytes, place.family);
        }
        varint::put(&mut self.bytes, place.joint);
    }

    /// Returns the bytes so far.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the bytes.
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

const UNKNOWN: u8 = 0;
const ALL: u8 = 1;
const NONE: u8 = 2;
const FOLLOW: u8 = 3;

/// The first byte has the kind, and five bits of n: so n may have all its bits.
#[inline]
fn put_tally(bytes: &mut Vec<u8>, tally: Tally) {
    let kind = match tally.entries {
        None => UNKNOWN,
        Some(entries) if entries == tally.n => ALL,
        Some(0) => NONE,
        Some(_) => FOLLOW,
    };
    let low = ((tally.n as u8) & 0x1f) << 2 | kind;
    match tally.n >> 5 {
        0 => bytes.push(low),
        high => {
            bytes.push(low | 0x80);
            varint::put(bytes, high);
        }
    }
    if let (FOLLOW, Some(entries)) = (kind, tally.entries) {
        varint::put(bytes, entries);
    }
}

#[inline]
fn take_tally(bytes: &mut &[u8]) -> Option<Tally> {
    let (first, rest) = bytes.split_first()?;
    *bytes = rest;
    let mut n = u64::from(first >> 2 & 0x1f);
    if *first >= 0x80 {
        let high = varint::take(bytes).filter(|high| (1..1 << 58).contains(high))?;
        n |= high << 5;
    }
    let entries = match first & 3 {
        UNKNOWN => None,
        ALL => Some(n),
        NONE => Some(0),
        _ => Some(varint::take(bytes).filter(|entries| (1..n).contains(entries))?),
    };
    (n > 0).then_some(Tally { n, entries })
}

/// Unpacks cells in order.
#[derive(Debug, Clone)]
pub struct Decoder<'a> {
    rest: &'a [u8],
    before: Before,
}

impl<'a> Decoder<'a> {
    /// Begins where an encoder was before it wrote these bytes.
    pub fn new(bytes: &'a [u8], before: Before) -> Self {
        Self {
            rest: bytes,
            before,
        }
    }

    /// Returns what is not unpacked yet.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// Returns the last cell that was unpacked.
    pub fn before(&self) -> Before {
        self.before
    }

    #[inline]
    fn take(&mut self) -> Option<(Place, Tally)> {
        let head = varint::take(&mut self.rest)?;
        let place = if head & 1 == 0 {
            self.neighbour(head >> 1)?
        } else {
            self.strip(head)?
        };
        let tally = take_tally(&mut self.rest)?;
        self.before = Before {
            place,
            is_cell: true,
        };
        Some((place, tally))
    }

    #[inline]
    fn neighbour(&self, between: u64) -> Option<Place> {
        let before = self.before.place;
        let joint = before.joint.checked_add(between)?.checked_add(1)?;
        self.before.is_cell.then_some(Place { joint, ..before })
    }

    fn strip(&mut self, head: u64) -> Option<Place> {
        let before = self.before.place;
        let state = before.state.checked_add(head >> 2)?;
        let (segment, family) = match head & 2 {
            0 => (before.segment, before.family),
            _ => (varint::take(&mut self.rest)?, varint::take(&mut self.rest)?),
        };
        let joint = varint::take(&mut self.rest)?;
        let place = Place {
            state,
            segment,
            family,
            joint,
        };
        let is_later = !self.before.is_cell || place.strip() > before.strip();
        is_later.then_some(place)
    }
}

impl Iterator for Decoder<'_> {
    type Item = Result<(Place, Tally), Spoiled>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let taken = self.take();
        if taken.is_none() {
            self.rest = &[];
        }
        Some(taken.ok_or(Spoiled))
    }
}

#[cfg(test)]
pub mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    pub type Model = BTreeMap<Place, Tally>;

    /// Any number, small ones more often than not.
    pub fn number(most: u64) -> impl Strategy<Value = u64> {
        prop_oneof![4 => 0..=most.min(3), 2 => 0..=most.min(200), 1 => 0..=most, 1 => Just(most)]
    }

    pub fn place(states: u64) -> impl Strategy<Value = Place> {
        let joint = number((1 << 62) - 1);
        (
            number(states - 1),
            number(i64::MAX as u64),
            number(3),
            joint,
        )
            .prop_map(|(state, segment, family, joint)| Place {
                state,
                segment,
                family,
                joint,
            })
    }

    pub fn tally(most: u64) -> impl Strategy<Value = Tally> {
        (number(most - 1), proptest::option::of(number(most))).prop_map(|(n, entries)| Tally {
            n: n + 1,
            entries: entries.map(|entries| entries.min(n + 1)),
        })
    }

    pub fn model(states: u64) -> impl Strategy<Value = Model> {
        proptest::collection::btree_map(place(states), tally(i64::MAX as u64), 0..60)
    }

    pub fn packed(cells: &Model) -> Vec<u8> {
        let mut encoder = Encoder::default();
        cells
            .iter()
            .for_each(|(place, tally)| encoder.push(*place, *tally));
        encoder.finish()
    }

    #[test]
    fn neighbours_take_two_bytes() {
        let mut cells = Model::new();
        for joint in 0..36 {
            let place = Place {
                joint,
                ..Place::default()
            };
            cells.insert(
                place,
                Tally {
                    n: 31,
                    entries: Some(31),
                },
            );
        }
        assert_eq!(packed(&cells).len(), 3 + 35 * 2);
    }

    #[test]
    fn what_no_encoder_writes_is_spoiled() {
        let first = |bytes: &[u8]| Decoder::new(bytes, Before::default()).last();
        // A neighbour of nothing; no visits; entries above n; as many entries as n, written out;
        // the state before; a joint action above all.
        let spoiled: [&[u8]; 7] = [
            &[0, 4],
            &[1, 0, 0],
            &[1, 0, 2 << 2 | 3, 3],
            &[1, 0, 2 << 2 | 3, 2],
            &[1, 0, 4, 1, 0, 4],
            &[1, 0x80, 4],
            &[
                1, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1, 4, 0, 4,
            ],
        ];
        for bytes in spoiled {
            assert_eq!(first(bytes), Some(Err(Spoiled)), "{bytes:?}");
        }
    }

    proptest! {
        #[test]
        fn what_is_packed_is_unpacked(cells in model(1 << 59)) {
            let bytes = packed(&cells);
            let found: Result<Model, _> = Decoder::new(&bytes, Before::default()).collect();
            prop_assert_eq!(found, Ok(cells));
        }

        #[test]
        fn any_bytes_are_read_in_order_or_spoiled(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let mut before = None;
            for cell in Decoder::new(&bytes, Before::default()) {
                let Ok((place, tally)) = cell else { break };
                prop_assert!(before.is_none_or(|before| before < place));
                prop_assert!(tally.n > 0 && tally.entries.is_none_or(|entries| entries <= tally.n));
                before = Some(place);
            }
        }
    }
}
