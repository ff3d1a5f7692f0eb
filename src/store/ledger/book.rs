//! The state of a group commit: what a database says of each environment and producer, and what is
//! accepted on top of it.

use std::collections::{BTreeMap, BTreeSet};

use super::account::Account;
use super::batch::{Numbered, Quotas, Refusal};
use super::books::{Books, Named, Opened, Opening, RowId};
use super::merge::{Merged, stored_label};
use crate::domain::EnvironmentId;
use crate::store::map::Map;

/// The ledgers of a commit, one an environment. In order of environment, so that the same commit
/// always writes in the same order.
pub(in crate::store) struct Ledgers<'a>(BTreeMap<EnvironmentId, Result<Ledger<'a>, Refusal>>);

/// One environment in a commit.
pub(in crate::store) struct Ledger<'a> {
    /// Whose it is.
    pub(in crate::store) environment: EnvironmentId,
    pub(super) quotas: Quotas,
    /// Its transitions before this commit.
    pub(super) transitions: u64,
    /// Its cells before this commit.
    pub(super) cells: u64,
    /// In order of name, so that writers beside each other take them in the same order, and none
    /// waits for one that waits for it.
    accounts: BTreeMap<&'a str, Account<'a>>,
    /// The segments of this commit that exist.
    segments: Map<&'a str, RowId>,
    /// What is accepted.
    pub(in crate::store) merged: Merged<'a>,
    /// How many cells of `merged` the database has not, once a quota was so near that they were
    /// looked up.
    pub(super) fresh_cells: Option<u64>,
}

impl<'a> Ledgers<'a> {
    /// Opens the ledger of every environment of these batches.
    pub(in crate::store) async fn open<B: Books>(
        books: &mut B,
        quotas: Quotas,
        batches: &'a [Numbered],
    ) -> Result<Self, B::Error> {
        let mut ledgers = BTreeMap::new();
        for (environment, parties) in parties(batches) {
            let ledger = match books.open(environment, &parties.named()).await? {
                Opening::Gone => Err(Refusal::Gone),
                Opening::ReadOnly => Err(Refusal::ReadOnly),
                Opening::Open(opened) => Ok(Ledger::new(environment, quotas, parties, opened)),
            };
            ledgers.insert(environment, ledger);
        }
        Ok(Self(ledgers))
    }

    /// Returns the ledger of an environment, or why it takes no batches.
    pub(super) fn ledger(
        &mut self,
        environment: EnvironmentId,
    ) -> Result<&mut Ledger<'a>, Refusal> {
        let ledger = self.0.get_mut(&environment);
        ledger
            .expect("every environment of a commit has a ledger")
            .as_mut()
            .map_err(|refusal| refusal.clone())
    }

    /// Returns the ledgers with something to write.
    pub(in crate::store) fn into_accepted(self) -> impl Iterator<Item = Ledger<'a>> {
        self.0
            .into_values()
            .flatten()
            .filter(|ledger| ledger.advanced().next().is_some())
    }
}

impl<'a> Ledger<'a> {
    fn new(
        environment: EnvironmentId,
        quotas: Quotas,
        parties: Parties<'a>,
        opened: Opened,
    ) -> Self {
        let mut stored: Map<String, _> = opened.producers.into_iter().collect();
        let account = |name: &'a str| {
            let stored = stored.remove(name);
            (name, stored.map_or_else(Account::default, Account::stored))
        };
        let accounts = parties.producers.iter().copied().map(account).collect();

        let existing = |(label, id): (String, RowId)| Some((*parties.segments.get(&*label)?, id));
        let segments = opened.segments.into_iter().filter_map(existing).collect();

        Self {
            environment,
            quotas,
            transitions: opened.transitions,
            cells: opened.cells,
            accounts,
            segments,
            merged: Merged::default(),
            fresh_cells: None,
        }
    }

    /// Returns the account of a batch's producer.
    pub(super) fn account(&self, batch: &Numbered) -> &Account<'a> {
        self.accounts
            .get(batch.producer.as_str())
            .expect("a ledger has every producer of its commit")
    }

    /// Returns the accounts of all producers of the commit.
    pub(super) fn accounts(&self) -> impl Iterator<Item = &Account<'a>> {
        self.accounts.values()
    }

    /// Returns the accounts that advance, with the names of their producers and in their order.
    pub(in crate::store) fn advanced(&self) -> impl Iterator<Item = (&'a str, &Account<'a>)> {
        let named = self.accounts.iter().map(|(name, account)| (*name, account));
        named.filter(|(_, account)| !account.accepted().is_empty())
    }

    /// Returns the row of a segment, where it exists.
    pub(in crate::store) fn segment(&self, label: &str) -> Option<RowId> {
        self.segments.get(label).copied()
    }

    /// Returns how many cells of what is accepted the environment has not, where a quota was so near
    /// that they were counted.
    pub(in crate::store) fn fresh_cells(&self) -> Option<u64> {
        self.fresh_cells
    }

    /// Returns the environment's transitions with what is accepted now.
    pub(in crate::store) fn revision(&self) -> u64 {
        self.transitions + self.merged.transitions()
    }

    /// Adds a batch that was decided to be counted.
    pub(super) fn accept(&mut self, batch: &'a Numbered) {
        let account = self.accounts.entry(batch.producer.as_str()).or_default();
        account.advance(batch);
        self.merged.add(&batch.increment);
    }
}

/// Whom and what a commit names in one environment.
#[derive(Default)]
struct Parties<'a> {
    producers: BTreeSet<&'a str>,
    segments: BTreeSet<&'a str>,
}

impl<'a> Parties<'a> {
    fn named(&self) -> Named<'a> {
        Named {
            producers: self.producers.iter().copied().collect(),
            segments: self.segments.iter().copied().collect(),
        }
    }
}

fn parties(batches: &[Numbered]) -> BTreeMap<EnvironmentId, Parties<'_>> {
    let mut all: BTreeMap<EnvironmentId, Parties<'_>> = BTreeMap::new();
    for batch in batches {
        let parties = all.entry(batch.environment).or_default();
        parties.producers.insert(batch.producer.as_str());
        let label = stored_label(batch.increment.segment.as_ref());
        parties.segments.insert(label);
    }
    all
}
