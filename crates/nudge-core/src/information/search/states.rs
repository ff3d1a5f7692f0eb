//! The states of a search, column by column.

use super::rule::Condition;
use super::sum::Sum;

/// One coordinate of states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// Of so many bins that have an order: conditions are intervals.
    Ordered(u32),
    /// Without one: conditions are single bins.
    Unordered,
}

/// The states of a search.
#[derive(Debug, Clone)]
pub struct States {
    axes: Vec<Axis>,
    /// The bins of all states, axis by axis.
    bins: Vec<Vec<u32>>,
    sums: Vec<Sum>,
}

impl States {
    /// Returns no states, with these coordinates.
    pub fn new(axes: Vec<Axis>) -> Self {
        Self {
            bins: vec![Vec::new(); axes.len()],
            axes,
            sums: Vec::new(),
        }
    }

    /// Adds a state by its bin of each coordinate, with what its search half says.
    ///
    /// # Panics
    ///
    /// If there are fewer bins than coordinates.
    pub fn push(&mut self, bins: impl IntoIterator<Item = u32>, sum: Sum) {
        let mut bins = bins.into_iter();
        for column in &mut self.bins {
            column.push(bins.next().expect("a bin of each coordinate"));
        }
        self.sums.push(sum);
    }

    /// Returns how many there are.
    pub fn len(&self) -> usize {
        self.sums.len()
    }

    /// Returns whether there is none.
    pub fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    pub(super) fn sums(&self) -> &[Sum] {
        &self.sums
    }

    pub(super) fn axes(&self) -> &[Axis] {
        &self.axes
    }

    pub(super) fn bins(&self, axis: usize) -> &[u32] {
        &self.bins[axis]
    }

    #[inline]
    pub(super) fn meets(&self, state: usize, condition: &Condition) -> bool {
        condition.bins.contains(&self.bins[condition.axis][state])
    }

    /// Returns the sum of the states that meet all conditions.
    pub(super) fn sum(&self, conditions: &[Condition]) -> Sum {
        self.sum_where(conditions, |_| true)
    }

    pub(super) fn sum_where(&self, conditions: &[Condition], also: impl Fn(usize) -> bool) -> Sum {
        let mut sum = Sum::default();
        for (state, own) in self.sums.iter().enumerate() {
            if conditions.iter().all(|one| self.meets(state, one)) && also(state) {
                sum.add(own);
            }
        }
        sum
    }

    /// Drops the states that meet all conditions.
    pub(super) fn leave(&mut self, conditions: &[Condition]) {
        let meets = |state| conditions.iter().all(|one| self.meets(state, one));
        let stays: Vec<bool> = (0..self.len()).map(|state| !meets(state)).collect();
        let retain = |at: &mut usize| {
            *at += 1;
            stays[*at - 1]
        };
        for column in &mut self.bins {
            let mut at = 0;
            column.retain(|_| retain(&mut at));
        }
        let mut at = 0;
        self.sums.retain(|_| retain(&mut at));
    }
}
