//! Sets of bins of one coordinate, as runs of neighbouring bins: one is as small for an integer of
//! a million values as for a label, and asked in a step or two.

use std::ops::Range;

/// Some bins of one coordinate: rising runs with a gap between any two, so that equal sets are
/// equal. Cloning copies the runs.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub(super) struct BinSet(Box<[Range<u32>]>);

impl BinSet {
    /// Makes the set of all bins of some runs, which may overlap or be empty.
    pub(super) fn of_runs(mut runs: Vec<Range<u32>>) -> Self {
        runs.retain(|run| !run.is_empty());
        runs.sort_unstable_by_key(|run| run.start);

        let mut merged: Vec<Range<u32>> = Vec::with_capacity(runs.len());
        for run in runs {
            match merged.last_mut() {
                Some(last) if run.start <= last.end => last.end = last.end.max(run.end),
                _ => merged.push(run),
            }
        }
        Self(merged.into())
    }

    /// Makes the set of these bins.
    pub(super) fn of_bins(bins: impl IntoIterator<Item = u32>) -> Self {
        Self::of_runs(bins.into_iter().map(|bin| bin..bin + 1).collect())
    }

    /// Returns whether a bin is in it.
    #[inline]
    pub(super) fn contains(&self, bin: u32) -> bool {
        let at = self.0.partition_point(|run| run.end <= bin);
        self.0.get(at).is_some_and(|run| run.start <= bin)
    }

    /// Returns the bins that are in another set too.
    pub(super) fn intersection(&self, other: &Self) -> Self {
        let shared = |a: &Range<u32>, b: &Range<u32>| a.start.max(b.start)..a.end.min(b.end);
        let pairs = self
            .0
            .iter()
            .flat_map(|a| other.0.iter().map(move |b| shared(a, b)));
        Self::of_runs(pairs.collect())
    }

    /// Returns its runs, rising.
    pub(super) fn runs(&self) -> &[Range<u32>] {
        &self.0
    }

    /// Returns its bins, rising.
    pub(super) fn bins(&self) -> impl Iterator<Item = u32> {
        self.0.iter().cloned().flatten()
    }

    /// Returns whether it has all of so many bins.
    pub(super) fn is_all(&self, bins: u32) -> bool {
        matches!(&*self.0, [run] if *run == (0..bins))
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_set_of_runs_is_a_set_of_bins(runs in proptest::collection::vec((0u32..40, 0u32..6), 0..9)) {
            let runs: Vec<Range<u32>> = runs.into_iter().map(|(start, len)| start..start + len).collect();
            let bins: BTreeSet<u32> = runs.iter().cloned().flatten().collect();
            let set = BinSet::of_runs(runs);

            prop_assert!(set.bins().eq(bins.iter().copied()));
            prop_assert!((0..50).all(|bin| set.contains(bin) == bins.contains(&bin)));
            prop_assert_eq!(&set, &BinSet::of_bins(bins.into_iter().rev()));
            prop_assert!(set.runs().windows(2).all(|two| two[0].end < two[1].start));
        }
    }

    proptest! {
        #[test]
        fn bins_of_two_sets_are_in_both(one in proptest::collection::vec(0u32..20, 0..9), other in proptest::collection::vec(0u32..20, 0..9)) {
            let both: BTreeSet<u32> = one.iter().filter(|bin| other.contains(bin)).copied().collect();
            let [one, other] = [one, other].map(BinSet::of_bins);
            prop_assert_eq!(one.intersection(&other), BinSet::of_bins(both));
        }
    }

    #[test]
    fn a_set_of_all_bins_is_known() {
        let set = |bins| BinSet::of_bins(bins);
        assert!(set(0..3).is_all(3));
        assert!(!set(0..3).is_all(4) && !set(1..3).is_all(3) && !set(0..0).is_all(1));
    }
}
