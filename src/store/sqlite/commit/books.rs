//! The ports of the exactly-once rule on SQLite: what it asks of a commit's environments,
//! producers, kept batches and cells, as SQL in the transaction of that commit.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use async_trait::async_trait;
use sqlx::Row;
use sqlx::sqlite::{SqliteConnection, SqliteRow};

use super::failed::Failed;
use crate::domain::{Digest, Environment, EnvironmentId, Sequence, StateKey};
use crate::store::StoreError;
use crate::store::ledger::{
    Books, CellAt, Kept, Named, Opened, Opening, RowId, StateName, StoredProducer,
};
use crate::store::packed::size::Size;
use crate::store::packed::unfolded::Outdated;
use crate::store::sqlite::checksums;
use crate::store::sqlite::columns::whole;
use crate::store::sqlite::directory::Directory;
use crate::store::sqlite::error::{aborted, spoiled};
use crate::store::sqlite::fresh;
use crate::store::sqlite::lookup::{self, Of};
use crate::store::sqlite::stored_forms;
use crate::store::sqlite::walk::Placed;
use crate::store::sqlite::writer::Transaction;

/// What a transaction answers.
pub(super) struct SqliteBooks<'t, 'w> {
    pub(super) transaction: &'t mut Transaction<'w>,
    pub(super) directory: &'t Directory,
    /// The most cells of an environment.
    pub(super) quota: u64,
    /// The most that this commit may add.
    pub(super) most_cells: u64,
}

#[async_trait]
impl Books for SqliteBooks<'_, '_> {
    type Error = Failed;

    async fn open(
        &mut self,
        environment: EnvironmentId,
        named: &Named<'_>,
    ) -> Result<Opening, Failed> {
        if self.directory.is_read_only(environment) {
            return Ok(Opening::ReadOnly);
        }

        let opened = open(self.transaction.connection(), environment, named).await;
        let opened = opened.map_err(|error| Failed::in_environment(environment, error))?;
        let Some(mut opened) = opened else {
            return Ok(Opening::Gone);
        };
        let fresh = self.fresh(environment, opened.cells).await;
        opened.cells += fresh.map_err(|error| Failed::in_environment(environment, error))?;
        Ok(Opening::Open(opened))
    }

    async fn count_producers(&mut self, environment: EnvironmentId) -> Result<u64, Failed> {
        let text = "select count(*) from producers where environment = ?";
        self.count(text, environment).await
    }

    async fn count_segments(&mut self, environment: EnvironmentId) -> Result<u64, Failed> {
        let text = "select count(*) from segments where environment = ?";
        self.count(text, environment).await
    }

    async fn count_cells(
        &mut self,
        environment: EnvironmentId,
        cells: &[CellAt<'_>],
    ) -> Result<u64, Failed> {
        let present = count_cells(self.transaction, environment, cells).await;
        present.map_err(|error| Failed::in_environment(environment, error))
    }

    async fn kept(
        &mut self,
        environment: EnvironmentId,
        producer: RowId,
        sequence: Sequence,
    ) -> Result<Kept, Failed> {
        let kept = kept(self.transaction.connection(), producer, sequence).await;
        kept.map_err(|error| Failed::in_environment(environment, error))
    }
}

impl SqliteBooks<'_, '_> {
    /// Returns how many cells of the journal are in no row: a bound of it, and exactly so many once
    /// the quota may be passed by this commit.
    async fn fresh(&mut self, environment: EnvironmentId, stored: u64) -> Result<u64, StoreError> {
        let Some(view) = self.transaction.memory().pending.view(environment) else {
            return Ok(0);
        };
        let most = view.most_fresh();
        if view.fresh.is_exact || stored + most + self.most_cells <= self.quota {
            return Ok(most);
        }

        let known = known(self.transaction, environment)?;
        let counted = fresh::count(self.transaction.connection(), &known, &view).await?;
        let Size { cells, .. } = counted.map_err(outdated)?;
        let last = view.unfolded.last();
        self.transaction
            .memory()
            .pending
            .counted(environment, cells, last);
        Ok(cells)
    }

    async fn count(
        &mut self,
        text: &'static str,
        environment: EnvironmentId,
    ) -> Result<u64, Failed> {
        let count = sqlx::query_scalar(text)
            .bind(environment.0)
            .fetch_one(self.transaction.connection())
            .await;
        let count: i64 = count.map_err(|error| failed(environment, error))?;
        Ok(count.unsigned_abs())
    }
}

fn failed(environment: EnvironmentId, error: sqlx::Error) -> Failed {
    Failed::in_environment(environment, aborted(error))
}

async fn open(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    named: &Named<'_>,
) -> Result<Option<Opened>, StoreError> {
    let row = sqlx::query("select transitions, cells from totals where environment = ?")
        .bind(environment.0)
        .fetch_optional(&mut *connection)
        .await
        .map_err(aborted)?;
    let Some(row) = row else { return Ok(None) };

    Ok(Some(Opened {
        transitions: whole(&row, 0).map_err(aborted)?,
        cells: whole(&row, 1).map_err(aborted)?,
        producers: producers(connection, environment, &named.producers).await?,
        segments: segments(connection, environment, &named.segments)
            .await
            .map_err(aborted)?,
    }))
}

async fn producers(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    names: &[&str],
) -> Result<Vec<(String, StoredProducer)>, StoreError> {
    let rows = sqlx::query(
        "select producers.*
         from json_each(?2) as wanted
         cross join producers on producers.environment = ?1 and producers.name = wanted.value",
    )
    .bind(environment.0)
    .bind(stored_forms::json_texts(names))
    .fetch_all(connection)
    .await
    .map_err(aborted)?;

    let mut found = Vec::with_capacity(rows.len());
    for row in &rows {
        let (name, producer) = producer(row).map_err(aborted)?;
        // Its checksum is written anew with its sequence, and would make damage good.
        if !checksums::is_sound_producer(row).map_err(aborted)? {
            return Err(spoiled(&format!("producer `{name}`")));
        }
        found.push((name, producer));
    }
    Ok(found)
}

fn producer(row: &SqliteRow) -> Result<(String, StoredProducer), sqlx::Error> {
    let producer = StoredProducer {
        id: RowId(row.try_get("id")?),
        sequence: Sequence::from_stored(row.try_get("sequence")?),
        owner: row.try_get("owner")?,
    };
    Ok((row.try_get("name")?, producer))
}

async fn segments(
    connection: &mut SqliteConnection,
    environment: EnvironmentId,
    labels: &[&str],
) -> Result<Vec<(String, RowId)>, sqlx::Error> {
    let rows = sqlx::query(
        "select segments.id, segments.label
         from json_each(?2) as wanted
         cross join segments on segments.environment = ?1 and segments.label = wanted.value",
    )
    .bind(environment.0)
    .bind(stored_forms::json_texts(labels))
    .fetch_all(connection)
    .await?;

    let mut found = Vec::with_capacity(rows.len());
    for row in rows {
        found.push((row.try_get(1)?, RowId(row.try_get(0)?)));
    }
    Ok(found)
}

async fn count_cells(
    transaction: &mut Transaction<'_>,
    id: EnvironmentId,
    cells: &[CellAt<'_>],
) -> Result<u64, StoreError> {
    let environment = known(transaction, id)?;
    let view = transaction.memory().pending.view(id);
    let view = view.ok_or(StoreError::UnknownEnvironment)?;
    let mut states: BTreeMap<StateName<'_>, Vec<(u64, u64, u64)>> = BTreeMap::new();
    for cell in cells {
        let cells = states.entry(cell.state).or_default();
        let family = u64::from(cell.family.number());
        cells.push((cell.segment.0.unsigned_abs(), family, cell.joint));
    }

    let key = |name: &StateName<'_>| match *name {
        StateName::Rank(rank) => environment.schema.state_of_rank(rank),
        StateName::Key(key) => key.clone(),
    };
    let keys: Vec<StateKey> = states.keys().map(key).collect();
    let keys: Vec<&StateKey> = keys.iter().collect();
    let connection = transaction.connection();
    let found = lookup::states(connection, &environment, &view, &keys, Of::All).await?;
    let found = found.map_err(outdated)?;
    let mut present = 0;
    for (wanted, found) in states.values().zip(&found) {
        let there: BTreeSet<(u64, u64, u64)> = found.iter().map(named).collect();
        present += wanted.iter().filter(|cell| there.contains(cell)).count() as u64;
    }
    Ok(present)
}

fn named((place, _): &Placed) -> (u64, u64, u64) {
    (place.segment, place.family, place.joint)
}

fn known(transaction: &Transaction<'_>, id: EnvironmentId) -> Result<Arc<Environment>, StoreError> {
    let environment = transaction.memory().directory.of_id(id);
    environment.ok_or(StoreError::UnknownEnvironment)
}

/// Nobody else writes while a transaction has the lock.
fn outdated(_: Outdated) -> StoreError {
    aborted("rows are of another fold than the journal in memory")
}

async fn kept(
    connection: &mut SqliteConnection,
    producer: RowId,
    sequence: Sequence,
) -> Result<Kept, StoreError> {
    let row =
        sqlx::query("select digest, receipt from batches where producer = ? and sequence = ?")
            .bind(producer.0)
            .bind(sequence.get() as i64)
            .fetch_one(connection)
            .await
            .map_err(aborted)?;

    let digest = row.try_get::<&[u8], _>(0).map_err(aborted)?.try_into();
    let digest = digest.map_err(|_| spoiled(&format!("the digest of batch {sequence}")))?;
    let receipt = stored_forms::read_receipt(row.try_get(1).map_err(aborted)?);
    if let Err(why) = &receipt {
        let (producer, sequence) = (producer.0, sequence.get());
        tracing::warn!(producer, sequence, %why, "a receipt cannot be read");
    }
    Ok(Kept {
        digest: Digest(digest),
        receipt: receipt.ok(),
    })
}
