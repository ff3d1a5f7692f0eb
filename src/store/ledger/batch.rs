//! Numbered batches, the outcomes of a commit and the quotas that bound it: the words in which the
//! rule takes its questions and gives its answers.

use crate::domain::{
    Acknowledged, Digest, EnvironmentId, Increment, Name, ProducerId, Receipt, Sequence, Worded,
};

/// A validated batch with its number: what a commit takes.
#[derive(Debug, Clone)]
pub struct Numbered {
    /// Whom it is for.
    pub environment: EnvironmentId,
    /// Who sent it.
    pub producer: ProducerId,
    /// The name of the key that spoke for the producer; `None` where nobody needs one.
    pub owner: Option<Name>,
    /// Its number.
    pub sequence: Sequence,
    /// Of its decoded content.
    pub digest: Digest,
    /// For what earlier builds kept instead, if they did. In a box, because it is large and rare.
    pub worded: Option<Box<Worded>>,
    /// What it adds.
    pub increment: Increment,
    /// What its sender is told, now and whenever it is sent again.
    pub receipt: Receipt,
}

/// What became of one batch of a commit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// It is counted, once.
    Acknowledged(Acknowledged),
    /// It counts nothing, and its number is not used.
    Refused(Refusal),
}

/// Why a whole batch was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refusal {
    /// The environment was deleted.
    Gone,
    /// The environment is damaged: its totals do not match its cells, or something of it cannot be
    /// read.
    ReadOnly,
    /// The producer belongs to another key's name.
    Foreign,
    /// The number is ahead of the one expected.
    OutOfOrder {
        /// The number that would be applied.
        expected: Sequence,
    },
    /// The number was used with another content.
    Reused,
    /// A quota of the environment would be passed.
    Quota {
        /// `cells`, `segments` or `producers`.
        what: &'static str,
        /// The most there may be.
        limit: u64,
    },
    /// The environment's transitions would pass 2^63 - 1.
    Overflow,
}

/// The most that may be held. What is stored already stays where a quota is lower.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quotas {
    /// Cells of an environment.
    pub cells: u64,
    /// Segments of an environment.
    pub segments: u64,
    /// Producers of an environment.
    pub producers: u64,
    /// Models of an environment.
    pub models: u64,
    /// Environments.
    pub environments: u64,
}

impl Default for Quotas {
    fn default() -> Self {
        Self {
            cells: 5_000_000,
            segments: 4_096,
            producers: 10_000,
            models: 256,
            environments: 1_000,
        }
    }
}
