//! Random seeds that an experiment runs over.

use std::fmt;

/// Seeds that follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seeds {
    /// How many.
    pub number: u32,
    /// The first of them.
    pub first: u32,
}

impl Seeds {
    /// Returns each of them.
    pub fn iter(self) -> impl Iterator<Item = u64> {
        let first = u64::from(self.first);
        first..first + u64::from(self.number)
    }
}

impl fmt::Display for Seeds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { number, first } = self;
        if *number == 1 {
            write!(f, "seed {first}")
        } else {
            write!(f, "{number} seeds from {first}")
        }
    }
}
