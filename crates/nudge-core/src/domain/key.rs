//! State keys: a discretised state by its bin numbers.

use std::borrow::Borrow;
use std::fmt::{self, Write};
use std::sync::Arc;

/// A state by its bin numbers, written joined by dots: `3.0.7`. Ordered by bins, first feature
/// first. Cloning is cheap.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StateKey(Arc<[u32]>);

impl StateKey {
    /// Makes the key of these bins, which the caller took from a schema.
    pub fn new(bins: &[u32]) -> Self {
        Self(bins.into())
    }

    /// Reads a key as [`fmt::Display`] wrote it, without asking whether a schema has such bins: for
    /// text that was checked before it was stored.
    pub fn from_stored(text: &str) -> Option<Self> {
        text.split('.')
            .map(|part| part.parse().ok())
            .collect::<Option<Arc<[u32]>>>()
            .map(Self)
    }

    /// Returns a number that follows from the key alone, for choices at random that must be the
    /// same again.
    pub fn seed(&self) -> u64 {
        let digest = blake3::hash(bytemuck::cast_slice(&self.0));
        let [first, ..] = bytemuck::cast::<[u8; 32], [u64; 4]>(*digest.as_bytes());
        first
    }

    /// Returns the bin of each feature.
    pub fn bins(&self) -> &[u32] {
        &self.0
    }
}

/// A key hashes and compares as its bins, so a map can be asked without making a key.
impl Borrow<[u32]> for StateKey {
    fn borrow(&self) -> &[u32] {
        &self.0
    }
}

impl fmt::Display for StateKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, bin) in self.0.iter().enumerate() {
            if i > 0 {
                f.write_str(".")?;
            }
            // Most features have fewer than ten bins, and keys are written by the ten thousand.
            match char::from_digit(*bin, 10) {
                Some(digit) => f.write_char(digit)?,
                None => write!(f, "{bin}")?,
            }
        }
        Ok(())
    }
}
