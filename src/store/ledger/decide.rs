//! The table of [`crate::store::Store`], row by row: whether a batch is applied, a duplicate, ahead
//! of a gap, or refused.

use super::account::Standing;
use super::batch::{Numbered, Outcome, Refusal};
use super::book::{Ledger, Ledgers};
use super::books::Books;
use super::quota;
use super::receipts::{Kept, is_kept};
use crate::domain::Acknowledged;

impl<'a> Ledgers<'a> {
    /// Decides one batch after those before it, and merges it where it is accepted.
    pub(in crate::store) async fn decide<B: Books>(
        &mut self,
        books: &mut B,
        batch: &'a Numbered,
    ) -> Result<Outcome, B::Error> {
        match self.ledger(batch.environment) {
            Err(refusal) => Ok(Outcome::Refused(refusal)),
            Ok(ledger) => ledger.decide(books, batch).await,
        }
    }
}

impl<'a> Ledger<'a> {
    async fn decide<B: Books>(
        &mut self,
        books: &mut B,
        batch: &'a Numbered,
    ) -> Result<Outcome, B::Error> {
        let account = self.account(batch);
        if account.is_anothers(batch.owner.as_ref()) {
            return Ok(Outcome::Refused(Refusal::Foreign));
        }

        match account.standing(batch.sequence) {
            Standing::Gap => Ok(Outcome::Refused(Refusal::OutOfOrder {
                expected: account.last().next(),
            })),
            Standing::Used(after) => self.answer_again(books, batch, after).await,
            Standing::Next => self.admit(books, batch).await,
        }
    }

    /// Answers a batch by the one that used its number: earlier in this commit, or in the database.
    async fn answer_again<B: Books>(
        &self,
        books: &mut B,
        batch: &Numbered,
        after: u64,
    ) -> Result<Outcome, B::Error> {
        let account = self.account(batch);
        if !is_kept(after) {
            return Ok(Outcome::Acknowledged(Acknowledged::Unverified));
        }
        if let Some(first) = account.accepted_before(after) {
            let kept = Kept {
                digest: first.digest,
                receipt: Some(first.receipt.clone()),
            };
            return Ok(kept.answer(batch));
        }

        let producer = account
            .id()
            .expect("numbers used before this commit are of a producer that is stored");
        let kept = books
            .kept(self.environment, producer, batch.sequence)
            .await?;
        Ok(kept.answer(batch))
    }

    /// Accepts a batch that comes next, if there is room for it.
    async fn admit<B: Books>(
        &mut self,
        books: &mut B,
        batch: &'a Numbered,
    ) -> Result<Outcome, B::Error> {
        if let Some(refusal) = quota::refusal(books, self, batch).await? {
            return Ok(Outcome::Refused(refusal));
        }

        self.accept(batch);
        let acknowledged = Acknowledged::now(batch.receipt.clone());
        Ok(Outcome::Acknowledged(acknowledged))
    }
}
