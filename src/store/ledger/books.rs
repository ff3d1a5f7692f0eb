//! Ports of the rule: the few questions that it asks a database, all within the transaction of one
//! commit.

use async_trait::async_trait;

use super::merge::StateName;
use super::receipts::Kept;
use crate::domain::{EnvironmentId, Family, Sequence};

/// The number that a database gave a row. Opaque here: the rule hands it back as it came.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(in crate::store) struct RowId(pub(in crate::store) i64);

/// What a database answers. It sees its own transaction, and nobody else writes meanwhile.
#[async_trait]
pub(in crate::store) trait Books: Send {
    /// How asking fails. The commit then ends, and nothing of it is counted.
    type Error: Send;

    /// Returns what an environment has of what a commit names.
    async fn open(
        &mut self,
        environment: EnvironmentId,
        named: &Named<'_>,
    ) -> Result<Opening, Self::Error>;

    /// Returns how many producers an environment has.
    async fn count_producers(&mut self, environment: EnvironmentId) -> Result<u64, Self::Error>;

    /// Returns how many segments an environment has.
    async fn count_segments(&mut self, environment: EnvironmentId) -> Result<u64, Self::Error>;

    /// Returns how many of these cells an environment has; each is given once.
    async fn count_cells(
        &mut self,
        environment: EnvironmentId,
        cells: &[CellAt<'_>],
    ) -> Result<u64, Self::Error>;

    /// Returns what was kept of a batch whose number is among the last that are kept.
    async fn kept(
        &mut self,
        environment: EnvironmentId,
        producer: RowId,
        sequence: Sequence,
    ) -> Result<Kept, Self::Error>;
}

/// Whom and what a commit names in one environment, each once and in order.
#[derive(Debug, Default)]
pub(in crate::store) struct Named<'a> {
    /// Producers.
    pub(in crate::store) producers: Vec<&'a str>,
    /// Segments, as they are stored.
    pub(in crate::store) segments: Vec<&'a str>,
}

/// How an environment stands at the beginning of a commit.
#[derive(Debug)]
pub(in crate::store) enum Opening {
    /// It was deleted.
    Gone,
    /// It is damaged, and takes no batches.
    ReadOnly,
    /// It takes batches.
    Open(Opened),
}

/// What an environment has of what a commit names.
#[derive(Debug, Default)]
pub(in crate::store) struct Opened {
    /// All its transitions.
    pub(in crate::store) transitions: u64,
    /// All its cells.
    pub(in crate::store) cells: u64,
    /// Those of the producers that it knows.
    pub(in crate::store) producers: Vec<(String, StoredProducer)>,
    /// Those of the segments that it has.
    pub(in crate::store) segments: Vec<(String, RowId)>,
}

/// A producer as it is stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::store) struct StoredProducer {
    /// Its row.
    pub(in crate::store) id: RowId,
    /// Its watermark: the last committed sequence.
    pub(in crate::store) sequence: Sequence,
    /// The name of the key that it belongs to, if it belongs to one.
    pub(in crate::store) owner: Option<String>,
}

/// A cell of a segment that exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::store) struct CellAt<'k> {
    /// Its state, which may be new.
    pub(in crate::store) state: StateName<'k>,
    /// Its segment.
    pub(in crate::store) segment: RowId,
    /// Its family.
    pub(in crate::store) family: Family,
    /// Its joint action, or another cell of the family.
    pub(in crate::store) joint: u64,
}
