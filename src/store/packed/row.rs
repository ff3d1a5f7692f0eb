//! A row of the table of counts: the cells of sixteen neighbouring states.

use super::cells::{Before, Decoder, Encoder, Place, Spoiled};
use super::checked;
use crate::domain::Tally;

/// A row has 2^4 states.
const STATE_BITS: u32 = 4;

/// The name of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RowName {
    /// The environment.
    pub environment: i64,
    /// The number of its first state, divided by sixteen.
    pub row: u64,
}

/// Returns the row that a state is in.
pub fn row_of(state: u64) -> u64 {
    state >> STATE_BITS
}

/// Returns the first state of a row.
pub fn first_state(row: u64) -> u64 {
    row << STATE_BITS
}

impl RowName {
    fn checked(self) -> checked::Name {
        [self.environment, self.row as i64]
    }

    /// Begins a row.
    pub fn write(self) -> RowWriter {
        RowWriter {
            name: self,
            cells: Encoder::after(checked::begin(), first_state(self.row)),
        }
    }

    /// Returns the cells of a row, where its checksum holds.
    pub fn read(self, bytes: &[u8]) -> Result<Decoder<'_>, Spoiled> {
        let cells = checked::cells(self.checked(), bytes)?;
        Ok(Decoder::new(cells, Before::state(first_state(self.row))))
    }
}

/// Writes a row.
pub struct RowWriter {
    name: RowName,
    cells: Encoder,
}

impl RowWriter {
    /// Adds a cell of one of the row's states, in order of place.
    #[inline]
    pub fn push(&mut self, place: Place, tally: Tally) {
        debug_assert_eq!(row_of(place.state), self.name.row, "a cell of this row");
        self.cells.push(place, tally);
    }

    /// Adds cells that were packed behind the same cell, of which this is the last.
    pub fn copy(&mut self, packed: &[u8], last: Before) {
        self.cells.copy(packed, last);
    }

    /// Returns what comes before the next cell.
    pub fn before(&self) -> Before {
        self.cells.before()
    }

    /// Returns the bytes.
    pub fn finish(self) -> Vec<u8> {
        checked::end(self.name.checked(), self.cells.finish())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::cells::tests::{Model, model};
    use super::*;

    fn written(name: RowName, cells: &Model) -> Vec<u8> {
        let mut row = name.write();
        for (place, tally) in cells {
            let state = first_state(name.row) + place.state;
            row.push(Place { state, ..*place }, *tally);
        }
        row.finish()
    }

    proptest! {
        #[test]
        fn a_row_is_read_as_it_was_written(cells in model(1 << STATE_BITS), environment in 1i64.., row in 0u64..1 << 55) {
            let name = RowName { environment, row };
            let bytes = written(name, &cells);
            let found: Model = name.read(&bytes).expect("sound").map(|cell| {
                let (place, tally) = cell.expect("sound");
                let state = place.state - first_state(row);
                (Place { state, ..place }, tally)
            }).collect();
            prop_assert_eq!(found, cells);
        }

        #[test]
        fn a_flipped_bit_is_found(cells in model(1 << STATE_BITS), at in any::<proptest::sample::Index>(), bit in 0u8..8) {
            let name = RowName { environment: 7, row: 3 };
            let mut bytes = written(name, &cells);
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
            prop_assert!(name.read(&bytes).is_err());
        }

        #[test]
        fn a_row_in_anothers_place_is_found(cells in model(1 << STATE_BITS), environment in 1i64..9, row in 0u64..9) {
            let name = RowName { environment: 7, row: 3 };
            let bytes = written(name, &cells);
            let other = RowName { environment, row };
            prop_assert_eq!(other.read(&bytes).is_ok(), other == name);
        }
    }
}
