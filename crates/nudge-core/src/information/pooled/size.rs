//! The size of a dependence over many sparse strata: an estimate of the mutual information behind
//! the counts that does not shrink with the visits of a stratum, and its confidence intervals.

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::clusters::{Clusters, Consecutive, Ratio};
use super::haldane::{PearsonSquare, sampling_variance};
use super::stratum::Stratum;

/// Half the standard normal quantiles of a 95 % interval apart.
const NORMAL: f64 = 1.959_963_984_540_054;
/// With fewer segments, how they differ cannot be told.
const FEWEST_SEGMENTS: usize = 3;

/// What the size is made of: 1/2 sum (X^2 - E_0) above, sum N kappa below.
#[derive(Debug, Clone, Default)]
pub(super) struct Sizes {
    whole: Ratio,
    /// Of 1/2 sum X^2, under independence.
    variance: f64,
    /// Of the same by sampling, in strata that were seen often, beyond independence.
    sampling: f64,
    states: Consecutive,
    segments: Clusters,
}

impl Sizes {
    pub fn add(&mut self, stratum: Stratum<'_>) {
        let mut part = Ratio::default();
        if !stratum.table.is_line() {
            let square = PearsonSquare::new(stratum.table);
            let kappa = (square.variance / (2.0 * square.freedoms)).min(1.0);
            part.above = (square.value - square.mean) / 2.0;
            part.below = stratum.table.total() as f64 * kappa;
            self.variance += square.variance / 4.0;
            self.sampling += sampling_variance(stratum.table) / 4.0;
        }

        self.whole.add(part);
        self.states.add(stratum.state, part);
        self.segments.add(stratum.segment, part);
    }

    /// Returns how many states and segments there are.
    pub fn clusters(&self) -> [u64; 2] {
        [self.states.len(), self.segments.len()]
    }

    pub fn effective_visits(&self) -> f64 {
        self.whole.below
    }

    pub fn size(&self) -> f64 {
        self.whole.value()
    }

    pub fn interval(&self) -> Option<[f64; 2]> {
        (self.whole.below > 0.0).then(|| self.about(self.half_width()))
    }

    pub fn interval_new_segments(&self) -> Option<[f64; 2]> {
        if self.segments.informative() < FEWEST_SEGMENTS {
            return None;
        }

        let freedom = self.segments.effective(self.whole) - 1.0;
        let t = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(0.975);
        let of_segments = t * self.segments.deviation(self.whole);
        Some(self.about(self.half_width().max(of_segments)))
    }

    fn half_width(&self) -> f64 {
        let of_strata = (self.variance + self.sampling).sqrt() / self.whole.below;
        NORMAL * of_strata.max(self.states.deviation(self.whole))
    }

    fn about(&self, half_width: f64) -> [f64; 2] {
        [self.size() - half_width, self.size() + half_width]
    }
}
