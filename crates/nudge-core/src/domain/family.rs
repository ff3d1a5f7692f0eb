//! Families of cells: joint actions are counted alone, and once more beside each outcome, never
//! beside several. So a table of an outcome takes no more cells than there are combinations of its
//! own.
//!
//! A cell of an outcome's family is (joint action, value). For an agent's action k steps later, k
//! above 1, the agent's own action in that joint action is the one at k - 1, where that is an
//! outcome too: what a question at lag k holds fixed (transfer entropy), and instead of its action
//! now, which no such question asks for. So `agent@k` takes as many cells as `agent@1` does, and is
//! read in the same way.

use super::{Outcome, Schema};

/// The number of a family of cells in its environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct Family(u32);

impl Family {
    /// The joint action alone.
    pub const JOINT: Self = Self(0);

    /// Returns that of the outcome at a position.
    pub fn of_outcome(at: usize) -> Self {
        Self(at as u32 + 1)
    }

    /// Returns that of a number, which may be none of the schema's.
    pub fn from_number(number: u32) -> Self {
        Self(number)
    }

    /// Returns the number: 0 for the joint action alone, then outcomes in their order.
    pub fn number(self) -> u32 {
        self.0
    }

    /// Returns the position of the outcome; `None` for the joint action alone.
    pub fn outcome(self) -> Option<usize> {
        self.0.checked_sub(1).map(|at| at as usize)
    }
}

impl Schema {
    /// Returns the families: the joint action's, then one for each outcome.
    pub fn families(&self) -> impl ExactSizeIterator<Item = Family> + use<> {
        (0..self.outcomes().len() as u32 + 1).map(Family)
    }

    /// Returns how many cells a state can have of a family in each segment, at most 2^62; `None`
    /// where there is no such family.
    pub fn cells_of_family(&self, family: Family) -> Option<u64> {
        self.cells().get(family.number() as usize).copied()
    }

    /// Returns the position of the outcome that an agent's action at lag - 1 is, where the outcome
    /// at a position is counted beside it; `None` where it is counted beside the joint action as it
    /// is.
    pub fn own_before(&self, outcome: usize) -> Option<usize> {
        self.befores()[outcome]
    }

    /// Returns the lag at which the agent's own action is held fixed in the family of its later
    /// action: lag - 1, or 0 where that is no outcome. `None` for other outcomes.
    pub fn own_lag(&self, outcome: usize) -> Option<u32> {
        let Outcome { agent, .. } = &self.outcomes()[outcome];
        agent.map(|_| {
            self.own_before(outcome)
                .map_or(0, |at| self.outcomes()[at].lag)
        })
    }

    /// Returns the joint action of a cell, which is one of this family, and the outcome's value; the
    /// value is 0 in the joint action's own family.
    #[inline]
    pub fn split(&self, family: Family, cell: u64) -> (u64, u64) {
        match family {
            Family::JOINT => (cell, 0),
            family => {
                let values = self.cells()[family.number() as usize] / self.joint_actions();
                (cell / values, cell % values)
            }
        }
    }

    /// Returns a joint action with another letter of an agent.
    pub(super) fn with_letter(&self, joint: u64, agent: usize, letter: u64) -> u64 {
        joint - self.action_of(joint, agent) * self.stride(agent) + letter * self.stride(agent)
    }
}
