//! What the database says of each environment and producer of a commit, and what is accepted on top
//! of it.

use std::collections::{BTreeMap, BTreeSet};

use sqlx::Row;
use sqlx::sqlite::SqliteConnection;

use super::failed::Failed;
use super::merge::{Merged, stored_label};
use crate::domain::{EnvironmentId, Name, Sequence};
use crate::store::sqlite::directory::Directory;
use crate::store::sqlite::error::aborted;
use crate::store::sqlite::map::Map;
use crate::store::sqlite::text;
use crate::store::{Numbered, Quotas};

/// The ledgers of a commit: one an environment that exists. In order of environment, so that the
/// same commit always writes in the same order.
pub(super) struct Ledgers<'a> {
    readable: BTreeMap<EnvironmentId, Ledger<'a>>,
    /// Environments that are damaged: nothing of them is read.
    read_only: BTreeSet<EnvironmentId>,
}

/// One environment in a commit.
pub(super) struct Ledger<'a> {
    pub(super) environment: EnvironmentId,
    pub(super) quotas: Quotas,
    /// Totals before this commit.
    pub(super) transitions: u64,
    pub(super) cells: u64,
    /// The producers of this commit by name.
    pub(super) accounts: Map<&'a str, Account<'a>>,
    /// The segments of this commit that exist.
    pub(super) segments: Map<&'a str, i64>,
    /// What is accepted.
    pub(super) merged: Merged<'a>,
    /// How many cells of `merged` the database has not, once a quota was so near that they were
    /// looked up.
    pub(super) fresh_cells: Option<u64>,
}

/// One producer in a commit.
#[derive(Default)]
pub(super) struct Account<'a> {
    /// Its id and last sequence, where the database knows it.
    pub(super) stored: Option<(i64, Sequence)>,
    /// The name of the key that it belongs to: the one that first speaks for it, maybe in this
    /// commit.
    pub(super) owner: Option<String>,
    /// The batches accepted now, which follow each other.
    pub(super) accepted: Vec<&'a Numbered>,
}

impl Account<'_> {
    /// Returns whether somebody speaks for a producer that is another's. Where nobody needs a key,
    /// nobody is asked.
    pub(super) fn is_anothers(&self, speaker: Option<&Name>) -> bool {
        matches!((&self.owner, speaker), (Some(owner), Some(speaker)) if owner != speaker.as_str())
    }

    /// Returns the last sequence before this commit.
    pub(super) fn before(&self) -> Sequence {
        self.stored.map_or(Sequence::NONE, |(_, sequence)| sequence)
    }

    /// Returns the last sequence with what is accepted now.
    pub(super) fn last(&self) -> Sequence {
        self.accepted
            .last()
            .map_or(self.before(), |batch| batch.sequence)
    }
}

impl<'a> Ledgers<'a> {
    /// Reads what the database says of every environment and producer of these batches.
    pub(super) async fn read(
        connection: &mut SqliteConnection,
        directory: &Directory,
        quotas: Quotas,
        batches: &'a [Numbered],
    ) -> Result<Self, Failed> {
        let mut ledgers = Self {
            readable: BTreeMap::new(),
            read_only: BTreeSet::new(),
        };
        for (environment, parties) in parties(batches) {
            if directory.is_read_only(environment) {
                ledgers.read_only.insert(environment);
                continue;
            }
            let ledger = Ledger::read(connection, quotas, environment, parties).await;
            let ledger =
                ledger.map_err(|error| Failed::in_environment(environment, aborted(error)))?;
            ledgers
                .readable
                .extend(ledger.map(|ledger| (environment, ledger)));
        }
        Ok(ledgers)
    }

    /// Returns whether an environment takes no batches.
    pub(super) fn is_read_only(&self, environment: EnvironmentId) -> bool {
        self.read_only.contains(&environment)
    }

    /// Returns the ledger of an environment; `None` where it is gone.
    pub(super) fn of(&mut self, environment: EnvironmentId) -> Option<&mut Ledger<'a>> {
        self.readable.get_mut(&environment)
    }

    /// Returns whether there is nothing to write.
    pub(super) fn accepted_nothing(&self) -> bool {
        self.readable.values().all(Ledger::accepted_nothing)
    }

    /// Returns the ledgers with something to write.
    pub(super) fn into_accepted(self) -> impl Iterator<Item = Ledger<'a>> {
        self.readable
            .into_values()
            .filter(|ledger| !ledger.accepted_nothing())
    }
}

impl<'a> Ledger<'a> {
    /// Reads the ledger of an environment; `None` where it is gone.
    async fn read(
        connection: &mut SqliteConnection,
        quotas: Quotas,
        environment: EnvironmentId,
        parties: Parties<'a>,
    ) -> Result<Option<Self>, sqlx::Error> {
        let Some([transitions, cells]) = totals(connection, environment).await? else {
            return Ok(None);
        };
        Ok(Some(Self {
            environment,
            quotas,
            transitions,
            cells,
            accounts: accounts(connection, environment, parties.producers).await?,
            segments: segments(connection, environment, &parties.labels).await?,
            merged: Merged::default(),
            fresh_cells: None,
        }))
    }

    /// Adds a batch that was decided to be counted.
    pub(super) fn accept(&mut self, batch: &'a Numbered) {
        let account = self.accounts.entry(batch.producer.as_str()).or_default();
        if account.owner.is_none() {
            account.owner = batch.owner.as_ref().map(|owner| owner.as_str().to_owned());
        }
        account.accepted.push(batch);
        self.merged.add(&batch.increment);
    }

    fn accepted_nothing(&self) -> bool {
        self.accounts
            .values()
            .all(|account| account.accepted.is_empty())
    }
}

/// Who and what a commit names in one environment.
#[derive(Default)]
struct Parties<'a> {
    producers: Map<&'a str, Account<'a>>,
    labels: Map<&'a str, ()>,
}

fn parties(batches: &[Numbered]) -> BTreeMap<EnvironmentId, Parties<'_>> {
    let mut all: BTreeMap<EnvironmentId, Parties<'_>> = BTreeMap::new();
    for batch in batches {
        let parties = all.entry(batch.environment).or_default();
        parties
            .producers
            .entry(batch.producer.as_str())
            .or_default();
        parties
            .labels
            .insert(stored_label(batch.increment.segment.as_ref()), ());
    }
    all
}

async fn totals(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
) -> Result<Option<[u64; 2]>, sqlx::Error> {
    let row = sqlx::query("select transitions, cells from totals where environment = ?")
        .bind(id.0)
        .fetch_optional(connection)
        .await?;
    let Some(row) = row else { return Ok(None) };
    Ok(Some([
        row.try_get::<i64, _>(0)?.unsigned_abs(),
        row.try_get::<i64, _>(1)?.unsigned_abs(),
    ]))
}

async fn accounts<'a>(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    mut accounts: Map<&'a str, Account<'a>>,
) -> Result<Map<&'a str, Account<'a>>, sqlx::Error> {
    let rows = sqlx::query(
        "select producers.id, producers.name, producers.sequence, producers.owner
         from json_each(?2) as wanted
         cross join producers on producers.environment = ?1 and producers.name = wanted.value",
    )
    .bind(id.0)
    .bind(text::of_list(accounts.keys()))
    .fetch_all(connection)
    .await?;
    for row in rows {
        if let Some(account) = accounts.get_mut(row.try_get::<&str, _>(1)?) {
            account.stored = Some((row.try_get(0)?, Sequence::from_stored(row.try_get(2)?)));
            account.owner = row.try_get(3)?;
        }
    }
    Ok(accounts)
}

async fn segments<'a>(
    connection: &mut SqliteConnection,
    id: EnvironmentId,
    labels: &Map<&'a str, ()>,
) -> Result<Map<&'a str, i64>, sqlx::Error> {
    let rows = sqlx::query(
        "select segments.id, segments.label
         from json_each(?2) as wanted
         cross join segments on segments.environment = ?1 and segments.label = wanted.value",
    )
    .bind(id.0)
    .bind(text::of_list(labels.keys()))
    .fetch_all(connection)
    .await?;
    let mut found = Map::default();
    for row in rows {
        if let Some((label, ())) = labels.get_key_value(row.try_get::<&str, _>(1)?) {
            found.insert(*label, row.try_get(0)?);
        }
    }
    Ok(found)
}
