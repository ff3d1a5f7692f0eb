//! The idempotency key of one producer in a commit: its watermark, whom it belongs to, and the
//! batches that advance it.

use std::cmp::Ordering;

use super::batch::Numbered;
use super::books::{RowId, StoredProducer};
use crate::domain::{Name, Sequence};

/// One producer in a commit.
#[derive(Default)]
pub(in crate::store) struct Account<'a> {
    /// Its row and watermark before this commit, where the database knows it.
    stored: Option<(RowId, Sequence)>,
    /// The name of the key that it belongs to: the one that first speaks for it, maybe in this
    /// commit.
    owner: Option<String>,
    /// The batches accepted now, which follow each other.
    accepted: Vec<&'a Numbered>,
}

/// How the number of a batch stands to the watermark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// It comes next.
    Next,
    /// It leaves a gap before it, or is no number at all.
    Gap,
    /// It was used; so many numbers were used after it.
    Used(u64),
}

impl<'a> Account<'a> {
    /// Makes the account of a producer as it is stored.
    pub(super) fn stored(producer: StoredProducer) -> Self {
        Self {
            stored: Some((producer.id, producer.sequence)),
            owner: producer.owner,
            accepted: Vec::new(),
        }
    }

    /// Returns its row, where the database knows it.
    pub(in crate::store) fn id(&self) -> Option<RowId> {
        self.stored.map(|(id, _)| id)
    }

    /// Returns the name of the key that it belongs to, if it belongs to one.
    pub(in crate::store) fn owner(&self) -> Option<&str> {
        self.owner.as_deref()
    }

    /// Returns the batches accepted now, in order.
    pub(in crate::store) fn accepted(&self) -> &[&'a Numbered] {
        &self.accepted
    }

    /// Returns the watermark before this commit.
    pub(in crate::store) fn before(&self) -> Sequence {
        self.stored.map_or(Sequence::NONE, |(_, sequence)| sequence)
    }

    /// Returns the watermark with what is accepted now.
    pub(in crate::store) fn last(&self) -> Sequence {
        self.accepted
            .last()
            .map_or(self.before(), |batch| batch.sequence)
    }

    /// Returns whether this commit makes it.
    pub(super) fn is_new(&self) -> bool {
        self.stored.is_none() && !self.accepted.is_empty()
    }

    /// Returns whether the database knows it, or will with this commit.
    pub(super) fn is_known(&self) -> bool {
        self.stored.is_some() || !self.accepted.is_empty()
    }

    /// Returns whether somebody speaks for a producer that is another's. Where nobody needs a key,
    /// nobody is asked.
    pub(super) fn is_anothers(&self, speaker: Option<&Name>) -> bool {
        matches!((self.owner(), speaker), (Some(owner), Some(speaker)) if owner != speaker.as_str())
    }

    /// Returns how a number stands to the watermark.
    pub(super) fn standing(&self, sequence: Sequence) -> Standing {
        if sequence == Sequence::NONE {
            return Standing::Gap;
        }

        match sequence.cmp(&self.last().next()) {
            Ordering::Greater => Standing::Gap,
            Ordering::Equal => Standing::Next,
            Ordering::Less => Standing::Used(self.last().get() - sequence.get()),
        }
    }

    /// Returns the batch of this commit after which so many numbers were used.
    pub(super) fn accepted_before(&self, after: u64) -> Option<&'a Numbered> {
        let from_end = usize::try_from(after).ok()?;
        self.accepted.iter().rev().nth(from_end).copied()
    }

    /// Advances the watermark to a batch that comes next.
    pub(super) fn advance(&mut self, batch: &'a Numbered) {
        if self.owner.is_none() {
            self.owner = batch.owner.as_ref().map(|owner| owner.as_str().to_owned());
        }
        self.accepted.push(batch);
    }
}
