//! Cooperative cancellation: the token by which a computation learns that nobody waits for it any
//! more.

use tokio_util::sync::CancellationToken;

/// A cancellation token, which loops look at once for each state, round or step. Cloning shares it.
#[derive(Debug, Clone, Default)]
pub struct Stop(CancellationToken);

/// Nobody waits any more: the caller has left, its deadline has passed, or the service stops.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stopped;

impl Stop {
    /// Makes a token that is cancelled with its parent.
    pub fn under(parent: &CancellationToken) -> Self {
        Self(parent.child_token())
    }

    /// Cancels what looks at this token.
    pub fn stop(&self) {
        self.0.cancel();
    }

    /// Returns whether the computation is to go on.
    pub fn goes_on(&self) -> bool {
        !self.0.is_cancelled()
    }

    /// Ends a computation by `?` where nobody waits for it any more.
    pub fn check(&self) -> Result<(), Stopped> {
        if self.goes_on() { Ok(()) } else { Err(Stopped) }
    }
}
