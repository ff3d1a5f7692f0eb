//! Pruning: which conditions of a rule are worth keeping.

use super::rule::{Condition, FoundRule};
use super::states::States;
use super::sum::Sum;

/// A condition is dropped while the states that it keeps out differ by less, in standard deviations.
const DIFFERENT: f64 = 3.0;

impl States {
    /// Returns a rule without the conditions that change little.
    pub(super) fn simplified(&self, mut conditions: Vec<Condition>) -> FoundRule {
        loop {
            let sum = self.sum(&conditions);
            match self.least_different(&conditions, &sum) {
                Some((at, z)) if z < DIFFERENT => conditions.remove(at),
                _ => return FoundRule { conditions, sum },
            };
        }
    }

    /// Returns the condition whose states outside are most like the rule's own, and z of their
    /// difference.
    fn least_different(&self, conditions: &[Condition], inside: &Sum) -> Option<(usize, f64)> {
        let outside = |at: usize| {
            let mut others = conditions.to_vec();
            let without = others.remove(at);
            let is_kept_out = |state: usize| !self.meets(state, &without);
            inside.above(&self.sum_where(&others, is_kept_out))
        };
        let all = (0..conditions.len()).map(|at| (at, outside(at)));
        all.min_by(|(_, a), (_, b)| a.total_cmp(b))
    }
}
