//! The Beta distribution by its mean and variance, and mixtures of a few.

use crate::special_functions::ln_gamma;

/// A Beta distribution on [0, 1].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Beta {
    a: f64,
    b: f64,
    ln_beta: f64,
}

/// The largest a + b: beyond it the distribution is a point for every purpose.
const SHARPEST: f64 = 1e9;
/// The smallest a + b: below it the distribution is two points.
const BLUNTEST: f64 = 1e-3;

impl Beta {
    /// Returns the Beta distribution with this mean, and this variance as far as one can have it.
    pub fn matched(mean: f64, variance: f64) -> Self {
        let mean = mean.clamp(1e-9, 1.0 - 1e-9);
        let sharpness = mean * (1.0 - mean) / variance.max(f64::MIN_POSITIVE) - 1.0;
        let sharpness = sharpness.clamp(BLUNTEST, SHARPEST);
        let (a, b) = (mean * sharpness, (1.0 - mean) * sharpness);
        Self {
            a,
            b,
            ln_beta: ln_gamma(a) + ln_gamma(b) - ln_gamma(sharpness),
        }
    }

    /// Returns the variance, a b / ((a + b)^2 (a + b + 1)).
    pub fn variance(&self) -> f64 {
        let sum = self.a + self.b;
        self.a * self.b / (sum * sum * (sum + 1.0))
    }

    /// Returns P(X <= x) and the density at x, for x in (0, 1).
    pub fn cdf(&self, x: f64) -> (f64, f64) {
        let Self { a, b, ln_beta } = *self;
        let front = (a * x.ln() + b * (-x).ln_1p() - ln_beta).exp();
        let density = front / (x * (1.0 - x));

        let cdf = if a.min(b) > CONTINUED_TO {
            nearly_normal(a, b, x)
        } else if x < (a + 1.0) / (a + b + 2.0) {
            front * continued(a, b, x) / a
        } else {
            1.0 - front * continued(b, a, 1.0 - x) / b
        };

        (cdf.clamp(0.0, 1.0), density)
    }
}

/// Parameters up to which the fraction is evaluated: it takes some sqrt(a) steps.
const CONTINUED_TO: f64 = 3_000.0;

/// The continued fraction of the incomplete beta function (Didonato & Morris 1992 and earlier;
/// Lentz's evaluation).
fn continued(a: f64, b: f64, x: f64) -> f64 {
    const CONVERGED: f64 = 1e-10;
    const STEPS: u32 = 1_000;

    let mut c = 1.0;
    let mut d = 1.0 / nonzero(1.0 - (a + b) * x / (a + 1.0));
    let mut fraction = d;

    for step in 1..=STEPS {
        let m = f64::from(step);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        d = 1.0 / nonzero(1.0 + even * d);
        c = nonzero(1.0 + even / c);
        fraction *= d * c;

        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        d = 1.0 / nonzero(1.0 + odd * d);
        c = nonzero(1.0 + odd / c);
        fraction *= d * c;

        if (d * c - 1.0).abs() < CONVERGED {
            break;
        }
    }

    fraction
}

/// Returns what may be divided by.
fn nonzero(x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    if x.abs() < TINY { TINY } else { x }
}

/// The cube-root approximation (Abramowitz & Stegun 1964, 26.5.22), for large parameters.
fn nearly_normal(a: f64, b: f64, x: f64) -> f64 {
    let (v, w) = ((b * x).cbrt(), (a * (1.0 - x)).cbrt());
    let z = 3.0 * (v * (1.0 - 1.0 / (9.0 * b)) - w * (1.0 - 1.0 / (9.0 * a)))
        / (v * v / b + w * w / a).sqrt();
    0.5 * statrs::function::erf::erfc(-z / std::f64::consts::SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Of a probability, where it is evaluated and where it is approximated.
    const EVALUATED: f64 = 1e-8;
    const APPROXIMATED: f64 = 1e-4;

    #[test]
    fn a_point_and_two_points_are_told() {
        assert!(
            Beta::matched(0.3, 0.0).cdf(0.29).0 < 1e-9
                && Beta::matched(0.3, 0.0).cdf(0.31).0 > 1.0 - 1e-9
        );
        assert!((Beta::matched(0.3, 0.21).cdf(0.5).0 - 0.7).abs() < 1e-2);
        assert!(Beta::matched(0.0, 0.0).cdf(1e-6).0 > 0.999);
    }

    proptest! {
        #[test]
        fn the_fraction_agrees_with_statrs(mean in 0.001..0.999_f64, digits in 0.1..4.0_f64, deviations in -3.0..3.0_f64) {
            let beta = Beta::matched(mean, mean * (1.0 - mean) * 10_f64.powf(-digits));
            let x = mean + deviations * beta.variance().sqrt();
            prop_assume!(x > 0.0 && x < 1.0 && beta.a.min(beta.b) <= CONTINUED_TO);

            let expected = statrs::function::beta::beta_reg(beta.a, beta.b, x);

            prop_assert!((beta.cdf(x).0 - expected).abs() < EVALUATED, "{beta:?} {x}: {} {expected}", beta.cdf(x).0);
        }

        #[test]
        fn the_approximation_meets_the_fraction(mean in 0.01..0.99_f64, deviations in -3.0..3.0_f64) {
            let sharpness = 1.01 * CONTINUED_TO / mean.min(1.0 - mean);
            let beta = Beta::matched(mean, mean * (1.0 - mean) / (sharpness + 1.0));
            let x = mean + deviations * beta.variance().sqrt();

            let expected = statrs::function::beta::beta_reg(beta.a, beta.b, x);

            prop_assert!((beta.cdf(x).0 - expected).abs() < APPROXIMATED, "{beta:?} {x}: {} {expected}", beta.cdf(x).0);
        }
    }
}
