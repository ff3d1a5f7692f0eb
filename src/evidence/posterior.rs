//! What is believed of mutual information in one state.

use super::beta::Beta;
use super::moments::Moments;

/// What the counts of a state and the fit of its environment let one believe about mutual information: a point mass at 0, and a mixture of Beta
/// distributions on [0, ln min(R, K)] for the rest. In nats.
#[derive(Debug, Clone, PartialEq)]
pub struct Posterior {
    dependent: f64,
    /// ln min(R, K).
    largest: f64,
    /// Weights sum to 1.
    components: Vec<Component>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Component {
    weight: f64,
    /// As a share of `largest`.
    mean: f64,
    beta: Beta,
}

/// The probability outside an interval, at each end.
const TAIL: f64 = 0.05;

impl Posterior {
    /// Joins the probability of dependence with what holds under each slab; weights sum to 1.
    pub(super) fn new(dependent: f64, largest: f64, slabs: impl Iterator<Item = (f64, Moments)>) -> Self {
        let component = |(weight, moments): (f64, Moments)| {
            let mean = (moments.mean / largest).clamp(0.0, 1.0);
            Component { weight, mean, beta: Beta::matched(mean, moments.variance / (largest * largest)) }
        };
        Self { dependent, largest, components: slabs.map(component).collect() }
    }

    /// Returns what is believed where one of the variables has a single letter: no dependence, since there is none to be had.
    pub(super) fn impossible() -> Self {
        Self { dependent: 0.0, largest: 0.0, components: Vec::new() }
    }

    /// Returns P(dependent): the probability that mutual information is above 0 at all.
    pub fn dependent(&self) -> f64 {
        self.dependent
    }

    /// Returns P(MI > t), for t >= 0 in nats. At 0 it is [`dependent`](Self::dependent).
    pub fn above(&self, nats: f64) -> f64 {
        if nats <= 0.0 {
            return self.dependent;
        }
        if nats >= self.largest {
            return 0.0;
        }
        self.dependent * (1.0 - self.slabs(nats / self.largest).0).max(0.0)
    }

    /// Returns the posterior mean of mutual information, in nats: 0 to ln min(R, K).
    pub fn mean(&self) -> f64 {
        let mean: f64 = self.components.iter().map(|component| component.weight * component.mean).sum();
        self.dependent * self.largest * mean.min(1.0)
    }

    /// Returns a 90 % interval of mutual information, in nats; conservative on purpose. It begins at 0 unless independence has less than 5 %, and
    /// while independence has more than that, it ends where it would if dependence were known.
    pub fn interval(&self) -> [f64; 2] {
        if self.components.is_empty() {
            return [0.0; 2];
        }
        let independent = 1.0 - self.dependent;
        let within = |p: f64| self.largest * self.quantile((p - independent) / self.dependent);
        if independent > TAIL {
            return [0.0, self.largest * self.quantile(1.0 - TAIL)];
        }
        [if independent < TAIL { within(TAIL) } else { 0.0 }, within(1.0 - TAIL)]
    }

    /// Returns the distribution function and density of the slabs' mixture at a share of the largest value, within (0, 1).
    fn slabs(&self, x: f64) -> (f64, f64) {
        self.components.iter().fold((0.0, 0.0), |(cdf, density), component| {
            let (c, d) = component.beta.cdf(x);
            (cdf + component.weight * c, density + component.weight * d)
        })
    }

    /// Returns where the slabs' mixture reaches p, as a share of the largest value.
    ///
    /// Newton's steps, above the middle on the logarithm of what is left, below on the logarithm of what is reached against that of x: both are nearly
    /// straight in the tails of a Beta distribution, so three or four steps suffice. Steps out of the bracket are replaced by halving it.
    fn quantile(&self, p: f64) -> f64 {
        /// A step this small, as a share of x, has a far smaller error.
        const PRECISE: f64 = 1e-4;
        const STEPS: u32 = 100;
        /// Nothing that could be told from 0.
        const TINY: f64 = 1e-12;
        let [mut low, mut high] = [0.0, 1.0];
        let mut x = self.guess(p);
        for _ in 0..STEPS {
            let (cdf, density) = self.slabs(x);
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
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            let step = (next - x).abs();
            x = next;
            if step < PRECISE * x || x < TINY {
                break;
            }
        }
        x
    }

    /// Returns about where the slabs' mixture reaches p: where a normal distribution would above the middle, a log-normal one below it.
    fn guess(&self, p: f64) -> f64 {
        /// Of the logistic distribution, as wide as the normal one in its tails.
        const SCALE: f64 = 0.58;
        let sum =
            |figure: &dyn Fn(&Component) -> f64| self.components.iter().map(|c| c.weight * figure(c)).sum::<f64>();
        let mean = sum(&|c| c.mean).max(1e-9);
        let variance = sum(&|c| c.beta.variance() + (c.mean - mean).powi(2));
        let deviations = SCALE * (p / (1.0 - p)).ln();
        let guess = if p > 0.5 {
            mean + deviations * variance.sqrt()
        } else {
            mean * (deviations * variance.sqrt() / mean).exp()
        };
        guess.clamp(1e-9, 0.5 * (1.0 + mean).min(1.0 - 1e-9))
    }
}
