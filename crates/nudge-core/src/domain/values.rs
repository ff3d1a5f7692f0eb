//! Columns of values in the form of the wire: little-endian IEEE 754 floats, read in place without
//! a copy (zero-copy), wherever in memory they begin.

use bytes::Bytes;

/// The size of a value in bytes.
const SIZE: usize = size_of::<f32>();

/// Values in a row. Cloning is cheap.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Values(Bytes);

impl Values {
    /// Takes little-endian floats as they are; `None` where the last one is not whole.
    pub fn from_le(bytes: Bytes) -> Option<Self> {
        bytes.len().is_multiple_of(SIZE).then_some(Self(bytes))
    }

    /// Returns how many there are.
    pub fn len(&self) -> usize {
        self.0.len() / SIZE
    }

    /// Returns whether there are none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns them as little-endian floats.
    pub fn le_bytes(&self) -> &[u8] {
        &self.0
    }

    /// Returns them as little-endian floats, to be sent.
    pub fn into_le_bytes(self) -> Bytes {
        self.0
    }

    /// Returns a number of them from a place on.
    #[inline]
    pub fn at(&self, first: usize, len: usize) -> impl ExactSizeIterator<Item = f32> + Clone {
        self.raw()[first..][..len]
            .iter()
            .map(|value| f32::from_le_bytes(*value))
    }

    /// Returns a number of them from a place on, each so far behind the one before.
    #[inline]
    pub fn column(&self, first: usize, stride: usize, len: usize) -> impl Iterator<Item = f32> {
        let raw = self.raw();
        (0..len).map(move |row| f32::from_le_bytes(raw[first + row * stride]))
    }

    /// Returns all of them.
    #[inline]
    pub fn iter(&self) -> impl ExactSizeIterator<Item = f32> + Clone {
        self.at(0, self.len())
    }

    /// Returns them in the one form that equal content has: -0.0 is 0.0, and a NaN is a quiet one,
    /// which is what adding 0.0 makes of it. Copies only where there is such a value.
    pub fn normalised(self) -> Self {
        // Without a way out in the middle, which keeps it from being vectorised.
        let bits = self.raw().iter().map(|value| u32::from_le_bytes(*value));
        let all_normal = bits.clone().fold(true, |all, bits| all & is_normal(bits));
        if all_normal {
            return self;
        }
        let bits = bits.map(|bits| if is_normal(bits) { bits } else { normal(bits) });
        Self(bits.flat_map(u32::to_le_bytes).collect())
    }

    fn raw(&self) -> &[[u8; SIZE]] {
        bytemuck::cast_slice(&self.0)
    }
}

const MINUS_ZERO: u32 = (-0.0_f32).to_bits();
const INFINITY: u32 = f32::INFINITY.to_bits();
/// The bit by which a quiet NaN differs from a signalling one.
const QUIET: u32 = 1 << 22;

#[inline]
fn is_normal(bits: u32) -> bool {
    let is_nan = (bits & !MINUS_ZERO) > INFINITY;
    (bits != MINUS_ZERO) & !(is_nan & (bits & QUIET == 0))
}

/// Returns what a value that is not normal is in the normal form.
fn normal(bits: u32) -> u32 {
    if bits == MINUS_ZERO { 0 } else { bits | QUIET }
}

impl From<Vec<f32>> for Values {
    fn from(values: Vec<f32>) -> Self {
        if cfg!(target_endian = "little") {
            Self(Bytes::from_owner(Owned(values)))
        } else {
            Self(values.into_iter().flat_map(f32::to_le_bytes).collect())
        }
    }
}

/// Floats that are little-endian bytes already.
struct Owned(Vec<f32>);

impl AsRef<[u8]> for Owned {
    fn as_ref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }
}

impl std::fmt::Debug for Values {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_last_value_is_whole() {
        for (bytes, len) in [(0, Some(0)), (3, None), (4, Some(1)), (9, None)] {
            let values = Values::from_le(Bytes::from(vec![0; bytes]));
            assert_eq!(values.map(|values| values.len()), len, "{bytes}");
        }
    }

    #[test]
    fn equal_content_has_one_form() {
        let bits = |values: &Values| values.iter().map(f32::to_bits).collect::<Vec<_>>();
        let odd = [0x8000_0000, 0xff80_0001, 0x7fa0_0000].map(f32::from_bits);
        let normal = Values::from(odd.to_vec()).normalised();
        assert_eq!(bits(&normal), [0, 0xffc0_0001, 0x7fe0_0000]);

        let even = [0, 1, 0x8000_0001, 0x7f80_0000, 0xff80_0000, 0x7fc0_0000].map(f32::from_bits);
        let values = Values::from(even.to_vec());
        let place = values.le_bytes().as_ptr();
        let normal = values.normalised();
        assert_eq!(bits(&normal), even.map(f32::to_bits));
        assert_eq!(normal.le_bytes().as_ptr(), place, "not copied");
    }

    proptest! {
        #[test]
        fn floats_are_read_wherever_they_begin(
            values in proptest::collection::vec(any::<f32>(), 0..50),
            offset in 0usize..4,
        ) {
            let mut bytes = vec![7; offset];
            bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
            let read = Values::from_le(Bytes::from(bytes).slice(offset..)).expect("whole");
            prop_assert_eq!(&read, &Values::from(values.clone()));
            let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(&read.iter().collect::<Vec<_>>()), bits(&values));
        }

        /// The form of builds that added 0.0 to each value, by which the digests of kept batches were made.
        #[test]
        fn the_form_is_the_one_that_kept_digests_were_made_of(bits in proptest::collection::vec(any::<u32>(), 0..50)) {
            let values: Vec<f32> = bits.into_iter().map(f32::from_bits).collect();
            let added: Vec<f32> = values.iter().map(|value| std::hint::black_box(*value) + 0.0).collect();
            prop_assert_eq!(Values::from(values).normalised(), Values::from(added));
        }
    }
}
