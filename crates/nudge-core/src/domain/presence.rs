//! Presence bitmaps: which slots of some records have a value, in the form of the wire.

use bytes::Bytes;

/// A bit a slot, record after record, least significant bit first; the empty one says that all are
/// there. Cloning is cheap.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Presence(Bytes);

impl Presence {
    /// Returns how many bytes so many slots take.
    pub fn bytes_of(slots: usize) -> usize {
        slots.div_ceil(8)
    }

    /// Takes the bits of so many slots, in the one form that equal content has; `None` where there
    /// are more or fewer bytes, unless there are none at all.
    pub fn from_bits(bits: Bytes, slots: usize) -> Option<Self> {
        if bits.is_empty() {
            return Some(Self::default());
        }
        (bits.len() == Self::bytes_of(slots)).then(|| Self::of((0..slots).map(|at| bit(&bits, at))))
    }

    /// Packs a flag a slot.
    pub fn of(flags: impl IntoIterator<Item = bool>) -> Self {
        let (mut bits, mut all, mut len) = (Vec::new(), true, 0);
        for flag in flags {
            if len % 8 == 0 {
                bits.push(0);
            }
            bits[len / 8] |= u8::from(flag) << (len % 8);
            all &= flag;
            len += 1;
        }
        Self(if all { Bytes::new() } else { bits.into() })
    }

    /// Returns whether all are there.
    pub fn is_all(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns whether none is there.
    pub fn is_none(&self) -> bool {
        !self.is_all() && self.0.iter().all(|byte| *byte == 0)
    }

    /// Returns whether a slot has a value.
    #[inline]
    pub fn has(&self, at: usize) -> bool {
        self.is_all() || bit(&self.0, at)
    }

    /// Returns the bits.
    pub fn bits(&self) -> &Bytes {
        &self.0
    }
}

#[inline]
fn bit(bits: &[u8], at: usize) -> bool {
    bits[at / 8] >> (at % 8) & 1 == 1
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn bits_behind_the_last_slot_are_no_content() {
        let read = |bits: &[u8], slots| Presence::from_bits(Bytes::copy_from_slice(bits), slots);
        assert_eq!(read(&[0b1111_0101], 3), read(&[0b101], 3));
        assert_eq!(read(&[0xff, 0x01], 9), Some(Presence::default()));
        assert_eq!(read(&[], 9), Some(Presence::default()), "all are there");
        assert_eq!(read(&[], 0), Some(Presence::default()));
        for (bits, slots) in [(1, 9), (2, 8), (1, 0), (3, 9)] {
            assert_eq!(read(&vec![1; bits], slots), None, "{bits} {slots}");
        }
    }

    proptest! {
        #[test]
        fn a_slot_has_its_flag(flags in proptest::collection::vec(any::<bool>(), 0..70)) {
            let packed = Presence::of(flags.iter().copied());
            for (at, flag) in flags.iter().enumerate() {
                prop_assert_eq!(packed.has(at), *flag);
            }
            let again = Presence::from_bits(packed.bits().clone(), flags.len());
            prop_assert_eq!(again.as_ref(), Some(&packed));
            prop_assert_eq!(packed.is_none(), !flags.is_empty() && flags.iter().all(|flag| !flag));
        }
    }
}
