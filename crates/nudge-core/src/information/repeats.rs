//! Counts that occur more than once: what depends on a count alone is found once for all of them.

/// A count, and how often it occurs.
pub(super) struct Repeated {
    pub n: u64,
    pub times: f64,
}

/// Returns each count once, ascending.
pub(super) fn repeated(counts: impl IntoIterator<Item = u64>) -> Vec<Repeated> {
    let mut counts: Vec<u64> = counts.into_iter().collect();
    counts.sort_unstable();
    counts
        .chunk_by(|a, b| a == b)
        .map(|equal| Repeated {
            n: equal[0],
            times: equal.len() as f64,
        })
        .collect()
}

/// Returns the sum of a function of the counts, from the smallest count to the largest.
pub(super) fn sum(counts: &[Repeated], of: impl Fn(u64) -> f64) -> f64 {
    counts
        .iter()
        .fold(0.0, |sum, count| sum + count.times * of(count.n))
}
