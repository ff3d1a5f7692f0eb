//! Who asks in one request, at each moment of it: a key may be withdrawn or narrowed while its
//! request is under way.

use std::fmt;
use std::sync::{Arc, OnceLock};

use super::Principal;
use crate::error::Problem;

/// A principal as it was when its request was let in, and as it is now. Cloning shares what is
/// found out.
#[derive(Clone)]
pub struct Asker(Arc<Asking>);

struct Asking {
    first: Arc<Principal>,
    now: Box<dyn Fn() -> Arc<Principal> + Send + Sync>,
    environment: OnceLock<String>,
}

impl Asker {
    /// Makes one who stays who it is.
    pub fn always(principal: Principal) -> Self {
        let principal = Arc::new(principal);
        let now = principal.clone();
        Self::changing(principal, move || now.clone())
    }

    /// Makes one who may be somebody else, or nobody, whenever it is looked at.
    pub fn changing(
        first: Arc<Principal>,
        now: impl Fn() -> Arc<Principal> + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(Asking {
            first,
            now: Box::new(now),
            environment: OnceLock::new(),
        }))
    }

    /// Returns who was let in.
    pub fn first(&self) -> &Arc<Principal> {
        &self.0.first
    }

    /// Returns who it is now.
    pub fn now(&self) -> Arc<Principal> {
        (self.0.now)()
    }

    /// Refuses an environment that is not theirs now, whether it exists or not; takes note of one
    /// that is.
    pub fn admit_to(&self, environment: &str) -> Result<(), Problem> {
        self.now().admit_to(environment)?;
        // A request is about one.
        let _ = self.0.environment.set(environment.to_owned());
        Ok(())
    }

    /// Returns the environment that the request was found to be about.
    pub fn environment(&self) -> Option<&str> {
        self.0.environment.get().map(String::as_str)
    }
}

impl fmt::Debug for Asker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Asker").field(&self.0.first).finish()
    }
}
