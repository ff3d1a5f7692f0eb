//! Sums of numbers that are too large or too small for an `f64`, by their logarithms (log-sum-exp).

/// The numbers `parts` times e^`ln_scale`; the largest part is 1.
pub(super) struct Scaled<const L: usize> {
    ln_scale: f64,
    parts: [f64; L],
}

impl<const L: usize> Scaled<L> {
    pub fn new(logarithms: [f64; L]) -> Self {
        let ln_scale = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Self {
            ln_scale,
            parts: logarithms.map(|ln| (ln - ln_scale).exp()),
        }
    }

    pub fn ln_weighted(&self, weights: &[f64]) -> f64 {
        self.ln(self.weighted(weights))
    }

    /// Returns the logarithm of a weighted sum of the parts, with their scale.
    pub fn ln(&self, weighted: f64) -> f64 {
        self.ln_scale + weighted.ln()
    }

    /// Returns the weighted sum of the parts.
    pub fn weighted(&self, weights: &[f64]) -> f64 {
        self.parts
            .iter()
            .zip(weights)
            .map(|(part, weight)| part * weight)
            .sum()
    }

    /// Adds a number of states to the components, in proportion to their weighted parts.
    pub fn share(&self, states: f64, weights: &[f64], expected: &mut [f64]) {
        self.share_of(self.weighted(weights), states, weights, expected);
    }

    /// Does the same, given the weighted sum of the parts.
    pub fn share_of(&self, weighted: f64, states: f64, weights: &[f64], expected: &mut [f64]) {
        let scale = states / weighted;
        for ((expected, part), weight) in expected.iter_mut().zip(self.parts).zip(weights) {
            *expected += scale * part * weight;
        }
    }
}

/// Returns ln sum e^x.
pub(super) fn ln_sum(logarithms: &[f64]) -> f64 {
    let largest = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest
        + logarithms
            .iter()
            .map(|ln| (ln - largest).exp())
            .sum::<f64>()
            .ln()
}

/// Returns numbers in proportion to e^x that sum to 1.
pub(super) fn normalised<const L: usize>(logarithms: [f64; L]) -> [f64; L] {
    let Scaled { parts, .. } = Scaled::new(logarithms);
    let sum: f64 = parts.iter().sum();
    parts.map(|part| part / sum)
}
