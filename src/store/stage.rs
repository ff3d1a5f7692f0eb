//! Progress of a store that is being opened, for those who wait.

use std::sync::{Arc, Mutex, PoisonError};

/// What the opening of a store does now, in words. Clones tell the same.
#[derive(Clone)]
pub struct Stage(Arc<Mutex<String>>);

impl Stage {
    /// Returns what is done now: "opening the database".
    pub fn in_words(&self) -> String {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    /// Says what is done from now on.
    pub fn begin_step(&self, what: impl Into<String>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = what.into();
    }
}

impl Default for Stage {
    fn default() -> Self {
        Self(Arc::new(Mutex::new("opening the database".to_owned())))
    }
}
