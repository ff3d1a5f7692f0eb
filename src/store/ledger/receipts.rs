//! The deduplication window: digests and receipts of each producer's last batches, by which a
//! duplicate gets its first answer and a number used with another content is found out.

use super::batch::{Numbered, Outcome, Refusal};
use crate::domain::{Acknowledged, Digest, Receipt, Rejection, Sequence};

/// How many of each producer's batches are kept, with digest and receipt.
const WINDOW: u64 = 1_024;

/// Returns the last number of which nothing is kept any more; [`Sequence::NONE`] where all are.
pub(in crate::store) fn last_dropped(watermark: Sequence) -> Sequence {
    Sequence::new(watermark.get().saturating_sub(WINDOW)).unwrap_or(Sequence::NONE)
}

/// Returns whether a batch is kept after which so many numbers were used.
pub(super) fn is_kept(after: u64) -> bool {
    after < WINDOW
}

/// What was kept of a batch.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::store) struct Kept {
    /// Of its content.
    pub(in crate::store) digest: Digest,
    /// What its sender was told; `None` where that cannot be read any more.
    pub(in crate::store) receipt: Option<Receipt>,
}

impl Kept {
    /// Answers a batch whose number the kept one used.
    pub(super) fn answer(self, batch: &Numbered) -> Outcome {
        let told = self
            .receipt
            .as_ref()
            .map_or(&[][..], |receipt| &receipt.rejected);
        if !is_same(batch, self.digest, told) {
            return Outcome::Refused(Refusal::Reused);
        }

        // Without a receipt it was counted all the same, and that is all that is known: an error
        // here would hold up whoever is in the same commit, for ever.
        let acknowledged = self
            .receipt
            .map_or(Acknowledged::Untold, Acknowledged::Duplicate);
        Outcome::Acknowledged(acknowledged)
    }
}

/// Returns whether a batch has the content that was digested first, by this build or by one that
/// digested what it told of rejected records too.
fn is_same(batch: &Numbered, first: Digest, told: &[Rejection]) -> bool {
    batch.digest == first
        || batch
            .worded
            .as_ref()
            .is_some_and(|worded| worded.digest(told) == first)
}

/// Returns what a receipt says that no receipt can, if it says such a thing.
pub(in crate::store) fn inconsistency(receipt: &Receipt) -> Option<&'static str> {
    let Receipt {
        accepted,
        rejected_count,
        rejected,
    } = receipt;
    let Some(records) = accepted.checked_add(*rejected_count) else {
        return Some("it has more records than there are numbers");
    };
    let told = (*rejected_count).min(Receipt::MOST_TOLD as u64);
    if rejected.len() as u64 != told {
        return Some("it tells of more or fewer rejected records than it counts");
    }

    let is_so = rejected.iter().all(|one| u64::from(one.index) < records)
        && rejected
            .windows(2)
            .all(|pair| pair[0].index <= pair[1].index);
    (!is_so).then_some("it tells of rejected records that the batch cannot have")
}
