//! Counts of counts (the fingerprint of a sample, after Good 1953): how many letters were seen
//! once, how many twice. What depends on a count alone is found once for all letters that have it.

/// A count n, and how many letters have it.
pub(super) struct CountOfCounts {
    pub n: u64,
    pub times: f64,
}

/// Returns the counts of counts of a sample, ascending: each count once.
pub(super) fn counts_of_counts(counts: impl IntoIterator<Item = u64>) -> Vec<CountOfCounts> {
    let mut counts: Vec<u64> = counts.into_iter().collect();
    counts.sort_unstable();
    counts
        .chunk_by(|a, b| a == b)
        .map(|equal| CountOfCounts {
            n: equal[0],
            times: equal.len() as f64,
        })
        .collect()
}

/// Returns the sum of a function of the counts, from the smallest count to the largest.
pub(super) fn sum(counts: &[CountOfCounts], of: impl Fn(u64) -> f64) -> f64 {
    counts
        .iter()
        .fold(0.0, |sum, count| sum + count.times * of(count.n))
}
