//! A full scan of the states of an environment, by pages: keyset pagination, so that no read
//! transaction is long.

use crate::domain::EnvironmentId;
use crate::store::{Cursor, Scanned, Store, StoreError};

/// States read at a time, so that no read transaction is long.
const STEP: u32 = 1_000;

/// A scan over every state of an environment, a page at a time and in an order of the store's own.
pub struct Pages<'a> {
    store: &'a dyn Store,
    id: EnvironmentId,
    cursor: Cursor,
}

impl<'a> Pages<'a> {
    /// Begins before the first.
    pub fn new(store: &'a dyn Store, id: EnvironmentId) -> Self {
        Self {
            store,
            id,
            cursor: Cursor::default(),
        }
    }

    /// Returns the next page; `None` at the end.
    pub async fn next(&mut self) -> Result<Option<Vec<Scanned>>, StoreError> {
        // Between pages others have their turn.
        tokio::task::yield_now().await;
        let page = self.store.scan(self.id, self.cursor, STEP).await?;
        let Some(last) = page.last() else {
            return Ok(None);
        };
        self.cursor = last.cursor;
        Ok(Some(page))
    }
}
