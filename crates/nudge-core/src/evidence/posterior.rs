//! The posterior distribution of mutual information in one state, and its credible intervals.

use super::asymptotic::Estimate;
use super::beta::Beta;
use super::decision::Beliefs;
use super::moments::Moments;

/// The spike-and-slab posterior of mutual information, given the counts of a state and the fit of
/// its environment: a point mass at 0, and a mixture of Beta distributions on [0, ln min(R, K)] for
/// the rest, R and K counting the letters in use. In nats.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    dependent: f64,
    /// ln min(R, K).
    largest: f64,
    /// In order of their means; all weights sum to 1.
    components: Vec<Component>,
    /// What the table says by itself, where it was seen often.
    estimate: Option<Estimate>,
    by_segment: Option<BySegment>,
}

/// What segments change where a state was seen in several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BySegment {
    /// The probability that the habits of either variable differ by segment, if nothing depends on
    /// anything.
    pub differ: f64,
    /// P(dependent) of the same counts, were there no segments.
    pub pooled: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Component {
    weight: f64,
    /// As a share of `largest`.
    mean: f64,
    beta: Beta,
    /// The same with a larger variance, for intervals.
    wide: Beta,
}

/// The probability outside an interval, at each end.
const TAIL: f64 = 0.05;

impl Posterior {
    /// Joins the probability of dependence with what holds under the slabs of both sides, in
    /// proportion to their weights, and with what the table says by itself.
    pub(super) fn new(
        dependent: f64,
        largest: f64,
        slabs: Vec<(f64, Moments)>,
        estimate: Option<Estimate>,
    ) -> Self {
        let merged = merged(slabs);
        let total: f64 = merged.iter().map(|(weight, _)| weight).sum();

        let component = |(weight, moments): (f64, Moments)| {
            let mean = (moments.mean / largest).clamp(0.0, 1.0);
            let matched = |variance: f64| Beta::matched(mean, variance / (largest * largest));
            Component {
                weight: weight / total,
                mean,
                beta: matched(moments.variance),
                wide: matched(moments.wide),
            }
        };

        Self {
            dependent,
            largest,
            components: merged.into_iter().map(component).collect(),
            estimate,
            by_segment: None,
        }
    }

    /// Returns what is believed where one of the variables has a single letter: no dependence,
    /// since there is none to be had.
    pub(super) fn impossible() -> Self {
        Self {
            dependent: 0.0,
            largest: 0.0,
            components: Vec::new(),
            estimate: None,
            by_segment: None,
        }
    }

    pub(super) fn with_segments(self, by_segment: Option<BySegment>) -> Self {
        Self { by_segment, ..self }
    }

    /// Returns what segments change; `None` where there is one, or they are of no concern.
    pub fn by_segment(&self) -> Option<BySegment> {
        self.by_segment
    }

    /// Returns P(dependent): the probability that mutual information is above 0 at all.
    pub fn dependent(&self) -> f64 {
        self.dependent
    }

    /// Returns P(MI > t), for t >= 0 in nats. At 0 it is [`dependent`](Self::dependent).
    pub fn above(&self, nats: f64) -> f64 {
        self.dependent * self.above_if_dependent(nats)
    }

    /// Returns P(MI > t | dependent), for t >= 0 in nats.
    pub fn above_if_dependent(&self, nats: f64) -> f64 {
        match nats {
            _ if self.largest == 0.0 || nats >= self.largest => 0.0,
            _ if nats <= 0.0 => 1.0,
            _ => (1.0 - self.mixed(|component| component.beta.cdf(nats / self.largest).0))
                .clamp(0.0, 1.0),
        }
    }

    /// Returns what is believed at a threshold, t >= 0 in nats.
    pub fn beliefs(&self, nats: f64) -> Beliefs {
        let above_if_dependent = self.above_if_dependent(nats);
        Beliefs {
            dependent: self.dependent,
            above: self.dependent * above_if_dependent,
            above_if_dependent,
        }
    }

    /// Returns the posterior mean of mutual information, in nats: 0 to ln min(R, K). Where the
    /// table was seen often it lies within what the table says by itself.
    pub fn mean(&self) -> f64 {
        let mean = self.dependent * self.largest * self.mixed(|component| component.mean).min(1.0);
        let Some(estimate) = self.estimate else {
            return mean;
        };
        let [low, high] = estimate.interval();
        mean.clamp(low, high).min(self.largest)
    }

    /// Returns a 90 % credible interval of mutual information, in nats; conservative on purpose. It
    /// begins at 0 unless independence has less than 5 %, and while independence has more than
    /// that, it ends where it would if dependence were known. Where the table was seen often it
    /// holds what the table says by itself, too.
    pub fn interval(&self) -> [f64; 2] {
        let [low, high] = self.believed_interval();
        let Some(estimate) = self.estimate else {
            return [low, high];
        };
        let [least, most] = estimate.interval();
        [low.min(least), high.max(most).min(self.largest)]
    }

    fn believed_interval(&self) -> [f64; 2] {
        if self.components.is_empty() {
            return [0.0; 2];
        }

        let independent = 1.0 - self.dependent;
        let within = |p: f64| self.largest * self.quantile((p - independent) / self.dependent);

        if independent > TAIL {
            return [0.0, self.largest * self.quantile(1.0 - TAIL)];
        }

        let [low, high] = [
            if independent < TAIL {
                within(TAIL)
            } else {
                0.0
            },
            within(1.0 - TAIL),
        ];

        // Next to 0 both are only as good as the steps that found them.
        [low.min(high), high]
    }

    /// Returns the mean and the standard deviation of mutual information if there is dependence, in
    /// nats.
    pub fn moments_if_dependent(&self) -> [f64; 2] {
        let mean = self.mixed(|one| one.mean);
        let variance = self.mixed(|one| one.beta.variance() + (one.mean - mean).powi(2));
        [mean, variance.sqrt()].map(|figure| figure * self.largest)
    }

    /// Returns the mean of a figure over the slabs.
    fn mixed(&self, figure: impl Fn(&Component) -> f64) -> f64 {
        self.components
            .iter()
            .map(|one| one.weight * figure(one))
            .sum()
    }

    /// Returns the distribution function and density of the slabs' wider mixture at a share of the
    /// largest value, within (0, 1).
    fn wide(&self, x: f64) -> (f64, f64) {
        self.components
            .iter()
            .fold((0.0, 0.0), |(cdf, density), component| {
                let (c, d) = component.wide.cdf(x);
                (cdf + component.weight * c, density + component.weight * d)
            })
    }

    /// Returns where the slabs' wider mixture reaches p, as a share of the largest value.
    ///
    /// Newton's steps, above the middle on the logarithm of what is left, below on the logarithm of
    /// what is reached against that of x: both are nearly straight in the tails of a Beta
    /// distribution, so three or four steps suffice. Steps out of the bracket are replaced by
    /// halving it.
    fn quantile(&self, p: f64) -> f64 {
        /// So close to p, as a share of what is beyond it, the next step is off by no more than its
        /// square.
        const CLOSE: f64 = 0.03;
        const STEPS: u32 = 100;
        /// Nothing that could be told from x.
        const PRECISE: f64 = 1e-9;
        /// Nothing that could be told from 0.
        const TINY: f64 = 1e-12;

        let [mut low, mut high] = [0.0, 1.0];
        let mut x = self.guess(p);
        for _ in 0..STEPS {
            let (cdf, density) = self.wide(x);
            if cdf < p {
                low = x
            } else {
                high = x
            }

            let newton = if p > 0.5 {
                x + ((1.0 - cdf) / (1.0 - p)).ln() * (1.0 - cdf) / density
            } else {
                x * ((p / cdf).ln() * cdf / (x * density)).exp()
            };
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };

            let step = (next - x).abs();
            x = next;
            if (cdf - p).abs() < CLOSE * p.min(1.0 - p) || step < PRECISE * x || x < TINY {
                break;
            }
        }

        x
    }

    /// Returns about where the slabs' mixture reaches p: where a normal distribution would above
    /// the middle, a log-normal one below it.
    fn guess(&self, p: f64) -> f64 {
        /// Of the logistic distribution, as wide as the normal one in its tails.
        const SCALE: f64 = 0.58;

        let mean = self.mixed(|one| one.mean).max(1e-9);
        let variance = self.mixed(|one| one.wide.variance() + (one.mean - mean).powi(2));
        let deviations = SCALE * (p / (1.0 - p)).ln();

        let guess = if p > 0.5 {
            mean + deviations * variance.sqrt()
        } else {
            mean * (deviations * variance.sqrt() / mean).exp()
        };

        guess.clamp(1e-9, 0.5 * (1.0 + mean).min(1.0 - 1e-9))
    }
}

/// Joins slabs that say nearly the same: neighbours in order of their means, as long as these lie
/// within half a standard deviation. Two dozen slabs become a handful of distributions, whatever
/// the order they came in.
fn merged(mut slabs: Vec<(f64, Moments)>) -> Vec<(f64, Moments)> {
    /// In standard deviations.
    const NEAR: f64 = 0.5;

    slabs.sort_unstable_by(|(w, a), (v, b)| {
        a.mean
            .total_cmp(&b.mean)
            .then(a.variance.total_cmp(&b.variance))
            .then(w.total_cmp(v))
    });

    let mut from = 0;
    let mut merged = Vec::new();
    for to in 1..=slabs.len() {
        let first = slabs[from].1;
        let is_near = slabs.get(to).is_some_and(|(_, next)| {
            (next.mean - first.mean).powi(2) < NEAR * NEAR * first.variance.min(next.variance)
        });

        if !is_near {
            let group = &slabs[from..to];
            merged.push((
                group.iter().map(|(weight, _)| weight).sum(),
                Moments::mixed(group),
            ));
            from = to;
        }
    }

    merged
}
