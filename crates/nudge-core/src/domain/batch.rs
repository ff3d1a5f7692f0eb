//! Idempotent batches and their receipts: what a producer sends under a sequence number, and what
//! it is told.

use std::fmt;

use super::{Label, Records, Rejection};

/// The sequence number of a batch, which makes it idempotent: 1, 2, 3, ... to 2^63 - 1, per
/// environment and producer. 0 stands for "none yet".
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Sequence(u64);

impl Sequence {
    /// Before the first batch.
    pub const NONE: Self = Self(0);

    /// Returns the number of a batch, or what is wrong with it.
    pub fn new(number: u64) -> Result<Self, String> {
        let fits = number >= 1 && i64::try_from(number).is_ok();
        fits.then_some(Self(number))
            .ok_or_else(|| format!("got {number}, expected 1 to 2^63 - 1"))
    }

    /// Returns a number as the store kept it.
    pub fn from_stored(number: i64) -> Self {
        Self(number.unsigned_abs())
    }

    /// Returns the number.
    pub fn get(self) -> u64 {
        self.0
    }

    /// Returns the number that follows.
    pub fn next(self) -> Self {
        Self(self.0 + 1)
    }
}

impl fmt::Display for Sequence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// One numbered batch, decoded and not yet validated.
#[derive(Debug, Clone, PartialEq)]
pub struct Batch {
    /// Its number.
    pub sequence: Sequence,
    /// Where its transitions come from.
    pub segment: Option<Label>,
    /// Its content.
    pub records: Records,
}

/// What became of a batch's records. The same for the batch and for every duplicate of it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Receipt {
    /// Records that were counted.
    pub accepted: u64,
    /// Records that were not.
    pub rejected_count: u64,
    /// The first [`Receipt::MOST_TOLD`] of those.
    pub rejected: Vec<Rejection>,
}

impl Receipt {
    /// How many rejections a receipt tells one by one.
    pub const MOST_TOLD: usize = 100;

    /// Returns whether there were records and none of them was counted.
    pub fn is_all_rejected(&self) -> bool {
        self.accepted == 0 && self.rejected_count > 0
    }
}

/// What a producer is told about a batch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Acknowledged {
    /// Counted now.
    Applied(Receipt),
    /// Every one of its records was rejected, so that nothing of it counts. Its number is used all
    /// the same: later ones may be on their way.
    Rejected(Receipt),
    /// Counted before; this is its first receipt.
    Duplicate(Receipt),
    /// Counted before, for its content is the same; its first receipt cannot be read.
    Untold,
    /// Numbered so far back that its content and receipt are no longer kept. It is a duplicate if
    /// its producer numbers as it should, and is lost if the producer began anew: nobody can tell
    /// which.
    Unverified,
}

impl Acknowledged {
    /// Tells a batch whose number is used now.
    pub fn now(receipt: Receipt) -> Self {
        if receipt.is_all_rejected() {
            Self::Rejected(receipt)
        } else {
            Self::Applied(receipt)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn acknowledged(accepted: u64, rejected_count: u64) -> Acknowledged {
        Acknowledged::now(Receipt {
            accepted,
            rejected_count,
            rejected: Vec::new(),
        })
    }

    #[test]
    fn a_batch_is_rejected_where_it_has_records_and_all_of_them_are() {
        assert!(matches!(acknowledged(0, 1), Acknowledged::Rejected(_)));
        assert!(matches!(acknowledged(0, 10_000), Acknowledged::Rejected(_)));
        for (accepted, rejected) in [(0, 0), (1, 0), (1, 9_999)] {
            assert!(
                matches!(acknowledged(accepted, rejected), Acknowledged::Applied(_)),
                "{accepted}, {rejected}"
            );
        }
    }
}
