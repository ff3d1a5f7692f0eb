//! Cancellation of reads when a store closes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use sqlx::sqlite::SqliteConnection;

/// Steps of SQLite's machine after which a reader looks whether the store closes: some
/// milliseconds.
const INTERRUPT_STEPS: i32 = 100_000;

/// Ends the reads that go on when a store closes: one may look at every cell, and nobody waits for
/// its answer any more.
#[derive(Clone, Default)]
pub(super) struct Closing(Arc<AtomicBool>);

impl Closing {
    /// Interrupts every read, also those to come.
    pub(super) fn interrupt(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Lets a connection be interrupted.
    pub(super) async fn watch(self, connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
        let goes_on = move || !self.0.load(Ordering::Relaxed);
        connection
            .lock_handle()
            .await?
            .set_progress_handler(INTERRUPT_STEPS, goes_on);
        Ok(())
    }
}
