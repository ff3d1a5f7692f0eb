//! Consistency check of the deduplication window: looks whether the numbers and receipts of batches
//! can be what was written: they follow from each other in part, and each batch has a checksum.

use futures::TryStreamExt;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqlitePool};

use super::checksums;
use super::error::unreadable;
use super::stored_forms;
use crate::domain::{EnvironmentId, ProducerId, Sequence};
use crate::store::StoreError;
use crate::store::ledger::{inconsistency, last_dropped};

/// The most faults that are told.
const MOST_TOLD: usize = 100;

/// Returns what is wrong with the producers of an environment and their last batches.
pub(super) async fn faults(
    readers: &SqlitePool,
    id: EnvironmentId,
) -> Result<Vec<String>, StoreError> {
    let text = "select producers.id, producers.name, producers.sequence as last, batches.*
         from producers left join batches on batches.producer = producers.id
         where producers.environment = ? order by producers.id, batches.sequence";
    let mut rows = sqlx::query(text).bind(id.0).fetch(readers);
    let (mut faults, mut looking) = (Vec::new(), None::<Looking>);
    while let Some(row) = rows.try_next().await.map_err(unreadable)? {
        let producer: i64 = row.try_get(0).map_err(unreadable)?;
        if looking
            .as_ref()
            .is_none_or(|looking| looking.id != producer)
        {
            faults.extend(looking.take().and_then(Looking::ended));
            looking = Some(Looking::begin(&row).map_err(unreadable)?);
        }

        let looking = looking.as_mut().expect("there is one now");
        if let Some(sequence) = row.try_get("sequence").map_err(unreadable)? {
            faults.extend(looking.batch(sequence, &row).map_err(unreadable)?);
        }
    }

    faults.extend(looking.and_then(Looking::ended));
    faults.truncate(MOST_TOLD);
    Ok(faults)
}

/// A producer whose batches are looked at, one after the other.
struct Looking {
    id: i64,
    name: String,
    last: i64,
    /// The number that the next batch has, if all is well.
    next: i64,
    is_in_order: bool,
}

impl Looking {
    fn begin(row: &SqliteRow) -> Result<Self, sqlx::Error> {
        let (id, name, last) = (row.try_get(0)?, row.try_get(1)?, row.try_get::<i64, _>(2)?);
        let next = last_dropped(Sequence::from_stored(last)).next().get() as i64;
        Ok(Self {
            id,
            name,
            last,
            next,
            is_in_order: true,
        })
    }

    fn batch(&mut self, sequence: i64, row: &SqliteRow) -> Result<Option<String>, sqlx::Error> {
        self.is_in_order &= sequence == self.next;
        self.next = sequence.saturating_add(1);

        let receipt: &str = row.try_get("receipt")?;
        let is_sound = checksums::is_sound(row, |row| {
            let digest = row.try_get("digest")?;
            Ok(checksums::batch(self.id, sequence, digest, receipt))
        })?;
        let why = match stored_forms::read_receipt(receipt) {
            Ok(receipt) => inconsistency(&receipt).map(str::to_owned),
            Err(why) => Some(why.to_string()),
        };
        let why = why.or_else(|| (!is_sound).then(|| "its checksum is another".to_owned()));
        let told = |why| {
            format!(
                "producer `{}`: the receipt of batch {sequence}: {why}",
                self.name
            )
        };
        Ok(why.map(told))
    }

    fn ended(self) -> Option<String> {
        let Self {
            name,
            last,
            next,
            is_in_order,
            ..
        } = self;
        if name.parse::<ProducerId>().is_err() {
            return Some(format!("producer {name:?}: nobody can have this name"));
        }
        let is_whole = is_in_order && next == last.saturating_add(1);
        (!is_whole).then(|| {
            format!(
                "producer `{name}`: its last number is {last}, and its batches do not lead up to it"
            )
        })
    }
}
