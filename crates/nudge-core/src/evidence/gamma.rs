//! The gamma function's relatives, for arguments above 0: quick where they are asked for by the
//! million.

/// From here the asymptotic series have reached the precision of an `f64`.
const ASYMPTOTIC_FROM: u64 = 16;

/// Returns ln Gamma(a + n) - ln Gamma(a), the logarithm of a (a + 1) ... (a + n - 1), for a > 0.
pub(super) fn ln_rising(a: f64, n: u64) -> f64 {
    let product = (0..n.min(ASYMPTOTIC_FROM)).fold(1.0, |product, t| product * (a + t as f64));
    if n <= ASYMPTOTIC_FROM {
        return product.ln();
    }
    product.ln() + stirling(a + n as f64) - stirling(a + ASYMPTOTIC_FROM as f64)
}

/// Returns ln Gamma(x), for x > 0.
pub(super) fn ln_gamma(x: f64) -> f64 {
    if x >= ASYMPTOTIC_FROM as f64 {
        return stirling(x);
    }
    stirling(x + ASYMPTOTIC_FROM as f64) - ln_rising(x, ASYMPTOTIC_FROM)
}

/// Returns ln Gamma(x) by Stirling's series, whose error from 16 on is below 1e-13.
fn stirling(x: f64) -> f64 {
    const HALF_LN_TAU: f64 = 0.918_938_533_204_672_7;
    let inverse = 1.0 / x;
    let square = inverse * inverse;
    let series = inverse
        * (1.0 / 12.0 - square * (1.0 / 360.0 - square * (1.0 / 1_260.0 - square / 1_680.0)));
    (x - 0.5) * x.ln() - x + HALF_LN_TAU + series
}

/// Returns psi(x), the derivative of ln Gamma, for x > 0.
pub(super) fn digamma(x: f64) -> f64 {
    let (raised, less) = raised(x);
    raised.ln() - less
}

/// Returns psi(x) - psi(y), for x and y > 0.
pub(super) fn digamma_difference(x: f64, y: f64) -> f64 {
    let ((x, less), (y, more)) = (raised(x), raised(y));
    (x / y).ln() - less + more
}

/// Returns z and d with psi(x) = ln z - d.
fn raised(x: f64) -> (f64, f64) {
    // From 6 on, the first term left out of the series is below 1e-12.
    if x >= 6.0 {
        return (x, digamma_series(x));
    }
    // psi(x + 6) less 1/x + ... + 1/(x + 5), whose outermost terms pair up: with y = x (x + 5) they
    // are (2 x + 5) (1/y + 1/(y + 4) + 1/(y + 6)).
    let y = x * (x + 5.0);
    let [second, third] = [y + 4.0, y + 6.0];
    let reciprocals = (second * third + y * third + y * second) / (y * second * third);
    (
        x + 6.0,
        digamma_series(x + 6.0) + (2.0 * x + 5.0) * reciprocals,
    )
}

/// Returns ln x - psi(x).
fn digamma_series(x: f64) -> f64 {
    let inverse = 1.0 / x;
    let square = inverse * inverse;
    let series = square
        * (1.0 / 12.0
            - square
                * (1.0 / 120.0
                    - square
                        * (1.0 / 252.0
                            - square
                                * (1.0 / 240.0
                                    - square * (1.0 / 132.0 - square * 691.0 / 32_760.0)))));
    0.5 * inverse + series
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Of ln Gamma and psi, relative to 1 or to the value, whichever is larger.
    const PRECISION: f64 = 1e-12;

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= PRECISION * b.abs().max(1.0)
    }

    #[test]
    fn known_values() {
        // Gamma(1/2) = sqrt(pi); psi(1) = -Euler's constant; 20! by hand.
        assert!(close(ln_gamma(0.5), std::f64::consts::PI.sqrt().ln()));
        assert!(close(digamma(1.0), -0.577_215_664_901_532_9));
        assert!(close(
            ln_rising(1.0, 20),
            2_432_902_008_176_640_000_f64.ln()
        ));
        assert_eq!(ln_rising(0.1, 0), 0.0);
    }

    proptest! {
        #[test]
        fn agree_with_statrs(exponent in -9.0..9.0_f64) {
            let x = 10_f64.powf(exponent);
            prop_assert!(close(ln_gamma(x), statrs::function::gamma::ln_gamma(x)));
            prop_assert!(close(digamma(x), statrs::function::gamma::digamma(x)));
            prop_assert!((digamma_difference(x, 3.0) - digamma(x) + digamma(3.0)).abs() <= PRECISION * digamma(x).abs().max(1.0));
        }

        #[test]
        fn rising_is_the_difference_of_two(a in 1e-3..1e3_f64, n in 0..10_000_u64) {
            prop_assert!(close(ln_rising(a, n), ln_gamma(a + n as f64) - ln_gamma(a)));
        }
    }
}
