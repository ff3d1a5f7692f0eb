//! The handle on an open database: its connections, what is remembered of it, and its lock.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use sqlx::SqlitePool;

use super::closing::Closing;
use super::lock::Lock;
use super::memory::Memory;
use super::writer::Writer;
use crate::store::Quotas;

/// A [`Store`](crate::store::Store) in one file.
pub struct SqliteStore {
    pub(super) path: PathBuf,
    pub(super) quotas: Quotas,
    pub(super) memory: Arc<Memory>,
    pub(super) writer: Writer,
    pub(super) readers: SqlitePool,
    pub(super) closing: Closing,
    /// Cells in the journal from which on it is folded.
    pub(super) fold_from: usize,
    /// Held by whoever changes rows.
    pub(super) compacting: tokio::sync::Mutex<()>,
    /// Held as long as the store lives. Last, so that it is let go after the connections.
    pub(super) lock: Mutex<Option<Lock>>,
}
