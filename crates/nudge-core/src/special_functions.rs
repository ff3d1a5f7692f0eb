//! Special functions: ln Gamma, digamma, trigamma, and the logarithms of the beta function and of
//! the rising factorial (Pochhammer symbol), for arguments above 0.
//!
//! Quick ones for Dirichlet-multinomial likelihoods and the moments of Dirichlet distributions,
//! which ask for them by the million; and such as statrs does not have, or has only with a loss of
//! digits. Not for arguments of 0 or below.

use statrs::function::gamma;

/// From here the asymptotic series have reached the precision of an `f64`.
const ASYMPTOTIC_FROM: u64 = 16;

/// Returns the logarithm of the rising factorial a (a + 1) ... (a + n - 1),
/// ln Gamma(a + n) - ln Gamma(a): quick, for whole n.
pub(crate) fn ln_rising(a: f64, n: u64) -> f64 {
    let product = (0..n.min(ASYMPTOTIC_FROM)).fold(1.0, |product, t| product * (a + t as f64));
    if n <= ASYMPTOTIC_FROM {
        return product.ln();
    }
    product.ln() + stirling(a + n as f64) - stirling(a + ASYMPTOTIC_FROM as f64)
}

/// Returns ln Gamma(x): quick.
pub(crate) fn ln_gamma(x: f64) -> f64 {
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

/// Returns the digamma function psi(x), the derivative of ln Gamma: quick.
pub(crate) fn digamma(x: f64) -> f64 {
    let (raised, less) = raised(x);
    raised.ln() - less
}

/// Returns psi(x) - psi(y).
pub(crate) fn digamma_difference(x: f64, y: f64) -> f64 {
    let ((x, less), (y, more)) = (raised(x), raised(y));
    (x / y).ln() - less + more
}

/// Returns z and d with psi(x) = ln z - d.
fn raised(x: f64) -> (f64, f64) {
    // From 6 on, the first term left out of the series is below 1e-12. What is below is raised
    // without a branch: arguments are on either side as it happens.
    let is_small = x < 6.0;
    let z = if is_small { x + 6.0 } else { x };

    // psi(x + 6) less 1/x + ... + 1/(x + 5), whose outermost terms pair up: with y = x (x + 5) they
    // are (2 x + 5) (1/y + 1/(y + 4) + 1/(y + 6)).
    let y = x * (x + 5.0);
    let [second, third] = [y + 4.0, y + 6.0];
    let numerator = (2.0 * x + 5.0) * (second * third + y * third + y * second);
    let numerator = if is_small { numerator } else { 0.0 };

    (z, digamma_series(z) + numerator / (y * second * third))
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

/// Returns ln B(a, b) = ln Gamma(a) + ln Gamma(b) - ln Gamma(a + b), accurate however much the
/// arguments differ.
pub(crate) fn ln_beta(a: f64, b: f64) -> f64 {
    let (small, large) = if a < b { (a, b) } else { (b, a) };
    gamma::ln_gamma(small) - ln_pochhammer(large, small)
}

/// Returns ln Gamma(x + n) - ln Gamma(x): the logarithm of the rising factorial x (x + 1) ... (x +
/// n - 1), for n of any kind, to the last digits. For large x by Stirling's series for both terms
/// at once, so that what they share never arises.
pub(crate) fn ln_pochhammer(x: f64, n: f64) -> f64 {
    if x < ASYMPTOTIC_FROM as f64 {
        return gamma::ln_gamma(x + n) - gamma::ln_gamma(x);
    }
    let leading = n * (x + n).ln() + ((x - 0.5) * (n / x).ln_1p() - n);
    leading + stirling_tail(x + n) - stirling_tail(x)
}

/// What Stirling's formula leaves of ln Gamma(x) (Abramowitz & Stegun 1964, 6.1.41).
fn stirling_tail(x: f64) -> f64 {
    let square = 1.0 / (x * x);
    (1.0 / 12.0
        - square
            * (1.0 / 360.0
                - square * (1.0 / 1_260.0 - square * (1.0 / 1_680.0 - square / 1_188.0))))
        / x
}

/// Returns k x psi'(k x + 1) - x psi'(x + 1) for k >= 1: how fast the mean entropy of k letters
/// with Dirichlet concentration x each grows with ln x.
///
/// For large x both products approach 1, and the difference is taken of what they lack.
pub(crate) fn entropy_growth(x: f64, k: f64) -> f64 {
    if x < ASYMPTOTIC_FROM as f64 {
        return k * x * trigamma(k * x + 1.0) - x * trigamma(x + 1.0);
    }
    lack(x) - lack(k * x)
}

/// 1 - x psi'(x + 1) for large x, from the series of [`trigamma`] less 1 / x^2.
fn lack(x: f64) -> f64 {
    let square = 1.0 / (x * x);
    0.5 / x
        - square
            * (1.0 / 6.0
                - square
                    * (1.0 / 30.0
                        - square * (1.0 / 42.0 - square * (1.0 / 30.0 - square * 5.0 / 66.0))))
}

/// psi'(x): steps up by psi'(x) = psi'(x + 1) + 1 / x^2, then the series of Abramowitz & Stegun
/// 1964, 6.4.12.
fn trigamma(mut x: f64) -> f64 {
    let mut steps = 0.0;
    while x < ASYMPTOTIC_FROM as f64 {
        steps += 1.0 / (x * x);
        x += 1.0;
    }
    // x psi'(x + 1) = x psi'(x) - 1 / x
    steps + (1.0 - lack(x) + 1.0 / x) / x
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Of the quick functions, relative to 1 or to the value, whichever is larger.
    const QUICK: f64 = 1e-12;
    /// Of the others, likewise.
    const ROUNDING: f64 = 1e-13;

    fn is_close(a: f64, b: f64, precision: f64) -> bool {
        (a - b).abs() <= precision * b.abs().max(1.0)
    }

    /// Every reference here: mpmath 1.4.1, 60 digits, of exactly these arguments.
    fn close(value: f64, reference: f64) {
        assert!(
            is_close(value, reference, ROUNDING),
            "{value:e} instead of {reference:e}"
        );
    }

    #[test]
    fn quick_functions_have_known_values() {
        // Gamma(1/2) = sqrt(pi); psi(1) = -Euler's constant; 20! by hand.
        assert!(is_close(
            ln_gamma(0.5),
            std::f64::consts::PI.sqrt().ln(),
            QUICK
        ));
        assert!(is_close(digamma(1.0), -0.577_215_664_901_532_9, QUICK));
        assert!(is_close(
            ln_rising(1.0, 20),
            2_432_902_008_176_640_000_f64.ln(),
            QUICK
        ));
        assert_eq!(ln_rising(0.1, 0), 0.0);
    }

    #[test]
    fn the_digamma_of_statrs_is_good_enough() {
        close(gamma::digamma(1e-12), -1_000_000_000_000.577_2);
        close(gamma::digamma(0.1), -10.423_754_940_411_076);
        close(gamma::digamma(1.0), -0.577_215_664_901_532_9);
        close(gamma::digamma(3.7), 1.167_153_539_361_511_4);
        close(gamma::digamma(11.9999), 2.442_652_989_750_788_6);
        close(gamma::digamma(12.5), 2.485_195_651_274_912);
        close(gamma::digamma(1e9 + 1.0), 20.723_265_837_446_41);
    }

    #[test]
    fn trigamma_matches_the_references() {
        close(trigamma(0.01), 10_001.621_213_528_313);
        close(trigamma(1.0), 1.644_934_066_848_226_4);
        close(trigamma(2.5), 0.490_357_756_100_234_9);
        close(trigamma(15.9), 0.064_912_281_599_060_11);
        close(trigamma(16.5), 0.062_479_682_677_969);
        close(trigamma(1e6), 1.000_000_500_000_166_7e-6);
    }

    #[test]
    fn the_growth_of_entropy_keeps_its_digits_at_both_ends() {
        let references = [
            (1e-40, 4.0, 4.934_802_200_544_679e-40),
            (1e-3, 36.0, 0.054_604_180_707_793_21),
            (1.0, 36.0, 0.341_305_625_251_050_07),
            (15.999, 2.0, 0.015_138_109_899_205_052),
            (16.0, 2.0, 0.015_137_194_197_837_096),
            (1e9, 4.0, 3.749_999_998_437_5e-10),
            (1e18, 36.0, 4.861_111_111_111_111e-19),
            (1e-30, 1e38, 0.999_999_995),
        ];
        for (x, k, reference) in references {
            close(entropy_growth(x, k) / reference, 1.0);
        }
    }

    #[test]
    fn beta_matches_the_references_however_far_apart_its_arguments_are() {
        close(ln_beta(1e9, 1e-12), 27.631_021_115_907_25);
        close(ln_beta(1e18, 0.5), -20.150_900_894_021_71);
        close(ln_beta(3.0, 1e-40), 92.103_403_719_761_83);
        close(ln_beta(7.0, 1e12), -186.837_896_599_510_74);
        close(ln_beta(15.9, 16.1), -22.293_035_843_333_08);
        close(ln_beta(250.0, 0.25), -0.091_967_579_955_295_82);
        close(ln_beta(5e8, 36.0), -628.948_097_286_225_6);
        close(
            ln_beta(9.223_372_036_854_776e18, 6.0),
            -257.222_142_508_877_3,
        );
    }

    proptest! {
        #[test]
        fn quick_functions_agree_with_statrs(exponent in -9.0..9.0_f64) {
            let x = 10_f64.powf(exponent);
            prop_assert!(is_close(ln_gamma(x), gamma::ln_gamma(x), QUICK));
            prop_assert!(is_close(digamma(x), gamma::digamma(x), QUICK));
            prop_assert!((digamma_difference(x, 3.0) - digamma(x) + digamma(3.0)).abs() <= QUICK * digamma(x).abs().max(1.0));
        }

        #[test]
        fn a_rising_factorial_is_the_difference_of_two(a in 1e-3..1e3_f64, n in 0..10_000_u64) {
            prop_assert!(is_close(ln_rising(a, n), ln_gamma(a + n as f64) - ln_gamma(a), QUICK));
        }

        #[test]
        fn a_rising_factorial_is_its_product(x in 1e-3..1e3_f64, n in 0..20_u32) {
            let product: f64 = (0..n).map(|step| (x + f64::from(step)).ln()).sum();

            prop_assert!((ln_pochhammer(x, f64::from(n)) - product).abs() < 1e-12);
        }
    }
}
