//! The support of a training: which bins of each feature its states had. Beyond it a network
//! extrapolates, and gives no verdict.
//!
//! Kept with the weights as runs of bins, `[first, last]`, feature by feature. They are about bins
//! one by one: two bins that were each seen, though never together, are within.

use std::collections::BTreeSet;

use crate::domain::{Schema, StateKey};

/// Runs that are kept of all features together: some hundred kilobytes of text. Of more, the
/// narrowest gaps are closed.
const MOST_RUNS: usize = 1 << 14;

/// Bins one after the other: the first and the last.
pub type Run = [u32; 2];

/// Which bins of each feature were seen, in runs. Of no feature any, unless it was made by
/// [`Seeing`] or read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Seen(Vec<Vec<Run>>);

impl Seen {
    /// Gathers the bins of states of one schema.
    pub fn in_states<'a>(schema: &Schema, states: impl Iterator<Item = &'a StateKey>) -> Self {
        let mut seeing = Seeing::new(schema);
        states.for_each(|state| seeing.add(state));
        seeing.seen()
    }

    /// Returns whether a state has no bin that was not seen.
    pub fn holds(&self, state: &StateKey) -> bool {
        self.outside(state).next().is_none()
    }

    /// Returns the features of which a state has a bin that was not seen, by position.
    pub fn outside<'s>(&'s self, state: &'s StateKey) -> impl Iterator<Item = usize> + 's {
        let is_seen = |at: usize, bin: u32| self.0.get(at).is_some_and(|runs| is_in(runs, bin));
        state
            .bins()
            .iter()
            .enumerate()
            .filter(move |(at, bin)| !is_seen(*at, **bin))
            .map(|(at, _)| at)
    }

    /// Returns the runs of each feature, in order.
    pub fn runs(&self) -> &[Vec<Run>] {
        &self.0
    }

    /// Takes runs back; `None` unless there are some for each feature of a schema, in order and
    /// within its bins.
    pub fn from_runs(schema: &Schema, runs: Vec<Vec<Run>>) -> Option<Self> {
        let features = schema.state();
        let fits = |(runs, bins): (&Vec<Run>, u32)| {
            let ordered = runs.windows(2).all(|pair| pair[0][1] < pair[1][0]);
            ordered
                && runs
                    .iter()
                    .all(|[first, last]| first <= last && *last < bins)
        };
        let fit = runs.len() == features.len()
            && runs
                .iter()
                .zip(features.iter().map(|one| one.kind.bins()))
                .all(fits);
        fit.then_some(Self(runs))
    }
}

/// Runs are in order.
fn is_in(runs: &[Run], bin: u32) -> bool {
    let after = runs.partition_point(|[first, _]| *first <= bin);
    after.checked_sub(1).is_some_and(|at| bin <= runs[at][1])
}

/// Gathers bins, state by state.
pub struct Seeing(Vec<BTreeSet<u32>>);

impl Seeing {
    /// Begins with nothing.
    pub fn new(schema: &Schema) -> Self {
        Self(vec![BTreeSet::new(); schema.state().len()])
    }

    /// Adds the bins of a state.
    pub fn add(&mut self, state: &StateKey) {
        for (bins, bin) in self.0.iter_mut().zip(state.bins()) {
            bins.insert(*bin);
        }
    }

    /// Returns what was seen.
    pub fn seen(self) -> Seen {
        let most = (MOST_RUNS / self.0.len().max(1)).max(1);
        Seen(
            self.0
                .into_iter()
                .map(|bins| few(runs(&bins), most))
                .collect(),
        )
    }
}

fn runs(bins: &BTreeSet<u32>) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for bin in bins {
        match runs.last_mut() {
            Some([_, last]) if *last + 1 == *bin => *last = *bin,
            _ => runs.push([*bin, *bin]),
        }
    }
    runs
}

/// Returns at most so many runs, with the narrowest gaps between them closed, the first of equals.
fn few(runs: Vec<Run>, most: usize) -> Vec<Run> {
    if runs.len() <= most {
        return runs;
    }
    let mut gaps: Vec<usize> = (1..runs.len()).collect();
    gaps.sort_by_key(|at| runs[*at][0] - runs[*at - 1][1]);
    let closed: BTreeSet<usize> = gaps.into_iter().take(runs.len() - most).collect();
    let mut kept: Vec<Run> = Vec::with_capacity(most);
    for (at, run) in runs.into_iter().enumerate() {
        match kept.last_mut() {
            Some([_, last]) if closed.contains(&at) => *last = run[1],
            _ => kept.push(run),
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn set(bins: &[u32]) -> BTreeSet<u32> {
        bins.iter().copied().collect()
    }

    #[test]
    fn bins_become_runs() {
        assert_eq!(runs(&set(&[])), [[0; 2]; 0]);
        assert_eq!(runs(&set(&[3, 0, 1, 7, 6, 2])), [[0, 3], [6, 7]]);
        let all = runs(&set(&[0, 1, 4, 9]));
        let inside: Vec<u32> = (0..12).filter(|bin| is_in(&all, *bin)).collect();
        assert_eq!(inside, [0, 1, 4, 9]);
    }

    #[test]
    fn of_too_many_runs_the_narrowest_gaps_are_closed() {
        let all = runs(&set(&[0, 2, 10, 13, 30]));
        assert_eq!(few(all.clone(), 5), all);
        assert_eq!(few(all.clone(), 3), [[0, 2], [10, 13], [30, 30]]);
        assert_eq!(few(all, 1), [[0, 30]]);
    }

    #[test]
    fn features_are_told_by_position_and_what_is_unknown_is_outside() {
        let seen = Seen(vec![vec![[0, 1]], vec![[2, 2], [5, 8]]]);
        let outside = |bins: &[u32]| seen.outside(&StateKey::new(bins)).collect::<Vec<_>>();
        assert_eq!(outside(&[1, 6]), [0; 0]);
        assert_eq!(outside(&[2, 3]), [0, 1]);
        assert_eq!(outside(&[0, 9]), [1]);
        assert!(!Seen::default().holds(&StateKey::new(&[0])));
    }
}
