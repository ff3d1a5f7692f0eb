//! Marginal likelihoods of the parts of a state by segment, for every hypothesis, from one side.

use super::parameters::{AROUND, CUT, FIXED, NULLS};

/// The log marginal likelihoods of the parts of a state, from one side.
pub(super) struct PartsEvidence {
    /// ln l of the slabs that are cut: on fixed bases by itself, on the parts' marginals relative
    /// to the parts' null.
    pub cut: [f64; CUT],
    /// Those that were visited more than once.
    pub parts: Vec<PartEvidence>,
    /// ln of the null of all by each component.
    pub null: [f64; NULLS],
    /// ln of habits drawn around the state's, relative to those that are alike.
    pub around: [f64; AROUND],
}

/// The log marginal likelihoods of one part, from one side.
pub(super) struct PartEvidence {
    /// Its visits beyond the first.
    pub beyond: f64,
    /// ln l of the slabs: on fixed bases by itself, on its own marginal relative to its null.
    pub slabs: [f64; CUT],
    /// ln of its null by each component.
    pub null: [f64; NULLS],
}

impl PartsEvidence {
    /// Begins without parts, with room for so many.
    pub fn with_capacity(parts: usize) -> Self {
        Self {
            cut: [0.0; CUT],
            parts: Vec::with_capacity(parts),
            null: [0.0; NULLS],
            around: [0.0; AROUND],
        }
    }
}

impl PartEvidence {
    /// Returns its visits beyond the first, and ln l of the slabs relative to a component of its
    /// null.
    pub fn beside(&self, null: usize) -> (f64, [f64; CUT]) {
        let mut slabs = self.slabs;
        slabs[..FIXED]
            .iter_mut()
            .for_each(|ln| *ln -= self.null[null]);
        (self.beyond, slabs)
    }
}
