//! The identity of a fitted prior: which one an answer stands on.

/// Which fit of the prior was used; with the revision it makes an answer reproducible.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FitId {
    /// 0 for the prior that nothing was fitted to, then 1, 2, ...
    pub version: u64,
    /// How many transitions the environment had when it was made.
    pub revision: u64,
}
