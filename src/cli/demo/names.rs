//! What the demo's environments are called.

use crate::cli::twin::{Kind, Twin};

/// What their names begin with: they are the demo's own, as what is sent into them may be described
/// otherwise by the next build.
pub(super) const OWN: &str = "demo";

/// What is shown beside play in which something is found: nothing is to be found in it.
pub(super) const TWIN: Twin = Twin {
    kind: Kind::Shuffled,
    seed: 0,
};

/// Returns the name of an environment without what begins them all.
pub(super) fn short(name: &str) -> &str {
    let rest = name.strip_prefix(OWN);
    rest.and_then(|rest| rest.strip_prefix('.')).unwrap_or(name)
}
