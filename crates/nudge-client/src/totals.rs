//! Delivery counts: what became of everything a producer sent.

use nudge_wire::proto;

/// How many rejected transitions are told one by one.
const MOST_TOLD: usize = 100;

/// What became of the transitions of a producer since it was opened. Once all is acknowledged,
/// `sent = accepted + rejected + resumed + unverified`; of the steps of its tracks, so many more are
/// `held_back` or were `dropped`.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Totals {
    /// Transitions that were handed over and are part of a batch.
    pub sent: u64,
    /// Steps that were given to tracks and wait in them for what follows: what a crash now would
    /// lose beside what is not acknowledged, and what was lost of tracks that were never ended.
    pub held_back: u64,
    /// Steps of tracks that found no room within the time that a step may take, and were not sent.
    pub dropped: u64,
    /// Transitions whose receipt says that they were counted.
    pub accepted: u64,
    /// Transitions whose receipt says that they were not.
    pub rejected: u64,
    /// Transitions of batches that the service had committed before this producer got a receipt: of
    /// an earlier run, or of a stream that broke.
    pub resumed: u64,
    /// Transitions of batches under numbers that were used so long ago that nobody can tell whether
    /// they were counted: lost, if this producer began anew under an id that was used before.
    pub unverified: u64,
    /// Batches of which every transition was rejected. They are part of the figures above.
    pub rejected_batches: u64,
    /// Batches that were answered as counted before; their first receipts are part of the figures
    /// above.
    pub duplicates: u64,
    /// The sequence of the last batch.
    pub last_sequence: u64,
    /// The first hundred of the rejected transitions.
    pub rejections: Vec<Rejected>,
}

/// A transition that was not counted, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejected {
    /// Its position among everything this producer sent, from 0.
    pub position: u64,
    /// The batch it was in.
    pub sequence: u64,
    /// The field at fault, as a JSON pointer into the transition: `/state/distance`.
    pub field: String,
    /// The value that was found and what was expected.
    pub reason: String,
}

impl Totals {
    /// Counts a batch of `len` transitions, the first of them at `position`, by its receipt.
    pub(crate) fn receive(&mut self, receipt: proto::Receipt, position: u64, len: u64) {
        match receipt.status() {
            proto::BatchStatus::Unverified => {
                self.unverified += len;
                return;
            }
            proto::BatchStatus::Duplicate => self.duplicates += 1,
            proto::BatchStatus::Rejected => self.rejected_batches += 1,
            proto::BatchStatus::Applied | proto::BatchStatus::Unspecified => {}
        }

        if receipt.unverified {
            self.resumed += len;
            return;
        }

        self.accepted += receipt.accepted;
        self.rejected += receipt.rejected_count;
        let sequence = receipt.sequence;
        let room = MOST_TOLD - self.rejections.len();

        self.rejections.extend(
            receipt
                .rejected
                .into_iter()
                .take(room)
                .map(|rejection| Rejected {
                    position: position + u64::from(rejection.index),
                    sequence,
                    field: rejection.field,
                    reason: rejection.reason,
                }),
        );
    }
}
