//! Durable, idempotent storage of counts and of what was made of them: the [`Store`] trait with its
//! promise, the pure exactly-once rule (`ledger`), SQLite behind both, and the schema versions of
//! what is kept as text ([`form`]).
//!
//! Absent on purpose: nothing here validates (it takes [`Increment`](crate::domain::Increment)s),
//! waits in a queue, or knows a wire format.

use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;

use crate::domain::{
    ActionTotals, Change, Counts, Environment, EnvironmentId, FitId, Label, Name, ProducerId,
    Schema, SegmentId, Sequence, StateKey, UnreadableEnvironment,
};

mod error;
pub mod form;
mod ledger;
mod map;
mod packed;
mod sqlite;
mod stage;

pub use error::{Cause, ENVIRONMENT_NOT_FOUND, StorageFault, StoreError};
pub use ledger::{Numbered, Outcome, Quotas, Refusal};
pub use sqlite::{Options, SqliteStore};
pub use stage::Stage;

/// Keeps environments and counts each batch exactly once: an idempotent, transactional store.
///
/// **The promise.** When [`Store::commit`] returns `Ok`, every batch it calls `Applied` or
/// `Rejected` is on stable storage with its counts, its receipt and its number, all in one
/// transaction; what follows holds for ever, through kill -9 and power loss on a disk that honours
/// flush:
///
/// | a batch's number is | its content is | outcome |
/// |---|---|---|
/// | last + 1 | any | `Applied`, or `Rejected` where every record of it was; last advances |
/// | above last + 1 | any | `Refused(OutOfOrder)`, nothing changes |
/// | at or below last, among the last 1,024 | the same | `Duplicate` with the first receipt |
/// | at or below last, among the last 1,024 | another | `Refused(Reused)`, nothing changes |
/// | at or below last, its receipt cannot be read | the same | `Untold` |
/// | at or below last, older | not compared | `Unverified` |
/// | any | of an environment that is gone | `Refused(Gone)` |
/// | last + 1 | would pass a quota, or 2^63 - 1 transitions | `Refused(Quota)`, `Refused(Overflow)`; the number is not used |
///
/// One refused batch changes nothing for the others of its commit; a later batch of the same
/// producer is then `OutOfOrder`.
///
/// When `commit` returns an error, no batch of it may be acknowledged: [`StoreError::Aborted`] says
/// that none was counted, [`StoreError::OutcomeUnknown`] that each may have been. In both cases the
/// next [`Store::watermark`] tells which.
///
/// A read that starts after `commit` returned sees what it counted.
#[async_trait]
pub trait Store: Send + Sync {
    /// Returns every environment, in order of name. From memory.
    fn environments(&self) -> Vec<Arc<Environment>>;

    /// Returns the environment of that name. From memory.
    fn environment(&self, name: &str) -> Option<Arc<Environment>>;

    /// Returns every environment that cannot be read, in order of name. Their names are taken, and
    /// they can be deleted. From memory.
    fn unreadable(&self) -> Vec<Arc<UnreadableEnvironment>>;

    /// Makes an environment with a new uid; `AlreadyExists` where the name is taken, `Quota` where
    /// there are as many as there may be. What `change` leaves out has its default.
    async fn create(
        &self,
        name: &Name,
        schema: &Schema,
        change: &Change,
    ) -> Result<Arc<Environment>, StoreError>;

    /// Changes an environment, all that is given or nothing.
    async fn change(
        &self,
        id: EnvironmentId,
        change: &Change,
    ) -> Result<Arc<Environment>, StoreError>;

    /// Removes an environment with its counts, receipts, watermarks and models: when this returns,
    /// no commit finds it, every read of it fails with `UnknownEnvironment`, one that began before
    /// too, and its name is free. Its rows are left for [`Store::sweep`].
    async fn delete(&self, id: EnvironmentId) -> Result<(), StoreError>;

    /// Waits until a deleted environment has left rows, and removes some of them: so few that a
    /// commit hardly waits. To be called again and again, by one at a time. Interrupted anywhere,
    /// by an error, by being dropped or by kill -9, the next call goes on, after a restart too.
    async fn sweep(&self) -> Result<(), StoreError>;

    /// Waits until the journal of counts is long, or something that an earlier build counted is in
    /// its old place, and puts some of it into rows: so little that a commit hardly waits. To be
    /// called again and again. Interrupted anywhere, the next call goes on, after a restart too.
    async fn compact(&self) -> Result<(), StoreError>;

    /// Returns what deleted environments have left. From memory.
    fn leftovers(&self) -> Leftovers;

    /// Returns the watermark of a producer: its last committed sequence, as the next commit would
    /// find it.
    async fn watermark(
        &self,
        id: EnvironmentId,
        producer: &ProducerId,
    ) -> Result<Sequence, StoreError>;

    /// Returns whose a producer is: the name of the key that first sent a batch of it that was
    /// counted. `None` where there is none.
    async fn owner(
        &self,
        id: EnvironmentId,
        producer: &ProducerId,
    ) -> Result<Option<Name>, StoreError>;

    /// Commits batches in their order, in one transaction (group commit), and returns an outcome
    /// each.
    async fn commit(&self, batches: &[Numbered]) -> Result<Vec<Outcome>, StoreError>;

    /// Returns the counts of states, in the order asked; a state never seen has none.
    async fn counts(
        &self,
        id: EnvironmentId,
        keys: &[StateKey],
    ) -> Result<Vec<StateCounts>, StoreError>;

    /// Returns the next states after a cursor, in an order of the store's own, without filling the
    /// cache. Empty at the end.
    async fn scan(
        &self,
        id: EnvironmentId,
        after: Cursor,
        states: u32,
    ) -> Result<Vec<Scanned>, StoreError>;

    /// Returns the first states in an order of their visits, with all their cells, and how many
    /// transitions the environment had: all of one moment, and without filling the cache. Looks at
    /// every cell of the environment.
    async fn by_visits(
        &self,
        id: EnvironmentId,
        wanted: &ByVisits,
    ) -> Result<(Vec<Scanned>, u64), StoreError>;

    /// Returns the segments of an environment in order of label; transitions without a segment have
    /// the label `None`.
    async fn segments(
        &self,
        id: EnvironmentId,
    ) -> Result<Vec<(SegmentId, Option<Label>)>, StoreError>;

    /// Returns the totals of an environment.
    async fn totals(&self, id: EnvironmentId) -> Result<Totals, StoreError>;

    /// Returns how often each agent took each of its actions, over all states and segments, at one
    /// revision. A call that starts after `commit` returned sees what it counted. From memory, but
    /// for the first call, which reads every state once; no commit waits for it.
    async fn actions(&self, environment: &Environment) -> Result<Arc<ActionTotals>, StoreError>;

    /// Returns the fits of an environment, in order of pair.
    async fn fits(&self, id: EnvironmentId) -> Result<Vec<FitRecord>, StoreError>;

    /// Keeps a fit in place of the one of its pair.
    async fn keep_fit(&self, id: EnvironmentId, fit: &FitRecord) -> Result<(), StoreError>;

    /// Returns the most that may be held. From memory.
    fn quotas(&self) -> Quotas;

    /// Returns the models of an environment, in order of version, without their weights.
    async fn models(&self, id: EnvironmentId) -> Result<Vec<ModelRecord>, StoreError>;

    /// Returns a model with its weights, which are empty where they are missing; `None` where there
    /// is no such version.
    async fn model(
        &self,
        id: EnvironmentId,
        version: u64,
    ) -> Result<Option<(ModelRecord, Vec<u8>)>, StoreError>;

    /// Keeps a model and returns its version: 1, 2, 3, ... in each environment, never used again,
    /// even after it is deleted. It is not active yet. `Quota` where there are as many as there may
    /// be.
    async fn keep_model(&self, id: EnvironmentId, model: &NewModel) -> Result<u64, StoreError>;

    /// Makes a version the active one of its pair; `UnknownModel` where there is no such version.
    async fn activate_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError>;

    /// Rolls a version back, so that it is as if never activated: if it was active, the one of its
    /// pair activated before it is active again, or none. `UnknownModel` where there is no such
    /// version.
    async fn deactivate_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError>;

    /// Deletes a version; if it was active, the one of its pair activated before it is active
    /// again, or none. `UnknownModel` where there is no such version.
    async fn delete_model(&self, id: EnvironmentId, version: u64) -> Result<(), StoreError>;

    /// Compares the totals of every environment with the sums of its cells. Where they differ or
    /// cannot be read, the environment becomes read-only.
    async fn audit(&self) -> Result<Vec<Audit>, StoreError>;

    /// Waits until an environment that takes no batches because it seemed damaged is to be looked at
    /// again, and reads everything of it: where all is as it was written, it takes batches again. To
    /// be called again and again, by one at a time.
    async fn look_again(&self);

    /// Returns the environments that take no batches because they are damaged, in order of name,
    /// with what is wrong with each. Damage that any call meets twice makes its environment one of
    /// them, until [`Store::look_again`] finds it sound. From memory.
    fn read_only(&self) -> Vec<(Name, String)>;

    /// Returns whether a commit would succeed: `Ok`, or why not, by the last commit or proof. From
    /// memory.
    async fn ready(&self) -> Result<(), Cause>;

    /// Proves by a small write that changes nothing that a commit would succeed, unless a write
    /// ended within the time given. To be called again and again.
    async fn prove(&self, oldest: Duration) -> Result<(), StoreError>;

    /// Returns the size of the database on disk in bytes, journal included.
    async fn bytes(&self) -> Result<u64, StoreError>;

    /// Returns what is free on the disk of the database, in bytes, and the size of the disk.
    async fn disk(&self) -> Result<[u64; 2], StoreError>;

    /// Returns what each environment holds, in order of id; of one that was deleted something may be
    /// left. Cheap however much was counted a moment ago: states and cells may then be those of a
    /// little earlier, but never fewer than were told before.
    async fn held(&self) -> Result<Vec<(EnvironmentId, Held)>, StoreError>;

    /// Moves the journal into the database and closes it. No call may follow.
    async fn close(&self);
}

/// The counts of one state, and what they stand on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateCounts {
    /// The cells.
    pub counts: Arc<Counts>,
    /// How many transitions the environment had when this was read.
    pub revision: u64,
}

/// A place in a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Cursor(pub i64);

/// One state of a scan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Scanned {
    /// Where the scan goes on after it.
    pub cursor: Cursor,
    /// The state.
    pub key: StateKey,
    /// Its cells.
    pub counts: Counts,
}

/// Which states are wanted in an order of their visits: what [`Store::by_visits`] takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ByVisits {
    /// Whose visits count; those of all segments if `None`. A state without any is left out.
    pub segments: Option<Vec<SegmentId>>,
    /// Leaves out states with fewer visits.
    pub min_visits: u64,
    /// The most visits first. Equally many are in order of key.
    pub descending: bool,
    /// Begins after a state with so many visits.
    pub after: Option<(u64, StateKey)>,
    /// The most states to return.
    pub states: u32,
}

/// What was fitted to the counts of one pair of agents. What it says is for those who made it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FitRecord {
    /// The pair.
    pub pair: String,
    /// Its version and revision.
    pub id: FitId,
    /// The fit itself, as text.
    pub body: String,
    /// Whether all of this is as it was kept, by its checksum; of one that is to be kept it is.
    pub is_sound: bool,
}

/// A trained network of one pair of agents, without its weights. What it says is for those who made
/// it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelRecord {
    /// Its number in its environment.
    pub version: u64,
    /// The ego agent's position.
    pub ego: usize,
    /// The other agent's position.
    pub other: usize,
    /// `direct` or `joint`.
    pub kind: String,
    /// When it was last activated, in the order of its environment's activations; `None` if never,
    /// or rolled back.
    pub activated: Option<u64>,
    /// Whether it is the active one of its pair: the last activated.
    pub active: bool,
    /// What is told of it, as text.
    pub card: String,
    /// Whether all of this is as it was kept, by its checksum; and its weights, where they were
    /// read.
    pub is_sound: bool,
}

/// A trained network that has no version yet: what [`Store::keep_model`] takes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewModel {
    /// The ego agent's position.
    pub ego: usize,
    /// The other agent's position.
    pub other: usize,
    /// `direct` or `joint`.
    pub kind: String,
    /// What is told of it, as text.
    pub card: String,
    /// The weights, in their maker's form. The store has no limit of its own for them.
    pub weights: Vec<u8>,
}

/// How much an environment holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Totals {
    /// Transitions: the sum of all visits. Grows with every commit that counts something, so it is
    /// the revision too.
    pub transitions: u64,
    /// Distinct states.
    pub states: u64,
    /// Cells.
    pub cells: u64,
    /// Segments.
    pub segments: u64,
    /// Producers.
    pub producers: u64,
}

/// How much an environment holds, networks included.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Held {
    /// What was counted.
    pub totals: Totals,
    /// Versions of networks.
    pub models: u64,
    /// Pairs of agents with an active one.
    pub active: u64,
}

/// What deleted environments have left in the database, for garbage collection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Leftovers {
    /// Deleted environments with rows left.
    pub environments: u64,
    /// Their states that are left, as far as they are counted.
    pub states: u64,
}

/// Totals beside what the cells add up to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Audit {
    /// The environment.
    pub environment: Name,
    /// As kept with every commit: transitions, states, cells.
    pub kept: [u64; 3],
    /// As summed over states and cells.
    pub found: [u64; 3],
    /// Why they cannot be compared, where the figures are 0, or what else is wrong with the cells.
    pub unreadable: Option<String>,
}

impl Audit {
    /// Returns whether the totals match.
    pub fn is_sound(&self) -> bool {
        self.unreadable.is_none() && self.kept == self.found
    }

    /// Says what is wrong, if anything is.
    pub fn fault(&self) -> Option<String> {
        match &self.unreadable {
            Some(why) => Some(format!("its counts cannot be read: {why}")),
            None if self.is_sound() => None,
            None => Some(format!(
                "its totals do not match its cells: kept {}, found {}",
                totals_in_words(self.kept),
                totals_in_words(self.found)
            )),
        }
    }
}

fn totals_in_words([transitions, states, cells]: [u64; 3]) -> String {
    format!("{transitions} transitions, {states} states, {cells} cells")
}
