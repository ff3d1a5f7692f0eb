//! What the other does in an environment on the whole.

/// The overall distribution g of the column variable in an environment, from its counts and half a visit more of each letter.
#[derive(Debug, Clone, PartialEq)]
pub struct Base {
    counts: Vec<u64>,
    shares: Vec<f64>,
}

impl Base {
    /// Returns the base of these counts, one a letter, over all states.
    pub fn new(counts: &[u64]) -> Self {
        let smoothed = || counts.iter().map(|count| *count as f64 + 0.5);
        let total: f64 = smoothed().sum();
        Self { counts: counts.to_vec(), shares: smoothed().map(|count| count / total).collect() }
    }

    /// Returns the counts it was made of.
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Returns the share of each letter, above 0.
    pub fn shares(&self) -> &[f64] {
        &self.shares
    }
}
