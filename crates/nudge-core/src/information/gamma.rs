//! Relatives of the gamma function that statrs does not have, or has only with a loss of digits.
//! Positive arguments.

use statrs::function::gamma::ln_gamma;

/// From here on the asymptotic series below reach double precision.
const ASYMPTOTIC: f64 = 16.0;

/// Returns ln B(a, b) = ln Gamma(a) + ln Gamma(b) - ln Gamma(a + b), accurate however much the
/// arguments differ.
pub(super) fn ln_beta(a: f64, b: f64) -> f64 {
    let (small, large) = if a < b { (a, b) } else { (b, a) };
    ln_gamma(small) - ln_pochhammer(large, small)
}

/// Returns ln Gamma(x + n) - ln Gamma(x): the logarithm of the rising factorial x (x + 1) ...
/// (x + n - 1), for n of any kind. For large x by Stirling's series for both terms at once, so that
/// what they share never arises.
pub(super) fn ln_pochhammer(x: f64, n: f64) -> f64 {
    if x < ASYMPTOTIC {
        return ln_gamma(x + n) - ln_gamma(x);
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
pub(super) fn entropy_growth(x: f64, k: f64) -> f64 {
    if x < ASYMPTOTIC {
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
    while x < ASYMPTOTIC {
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
    use statrs::function::gamma::digamma;

    /// Relative, or absolute where the figure is below 1.
    const ROUNDING: f64 = 1e-13;

    /// Every reference here: mpmath 1.4.1, 60 digits, of exactly these arguments.
    fn close(value: f64, reference: f64) {
        assert!(
            (value - reference).abs() <= ROUNDING * reference.abs().max(1.0),
            "{value:e} instead of {reference:e}"
        );
    }

    #[test]
    fn the_digamma_of_statrs_is_good_enough() {
        close(digamma(1e-12), -1_000_000_000_000.577_2);
        close(digamma(0.1), -10.423_754_940_411_076);
        close(digamma(1.0), -0.577_215_664_901_532_9);
        close(digamma(3.7), 1.167_153_539_361_511_4);
        close(digamma(11.9999), 2.442_652_989_750_788_6);
        close(digamma(12.5), 2.485_195_651_274_912);
        close(digamma(1e9 + 1.0), 20.723_265_837_446_41);
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
        fn a_rising_factorial_is_its_product(x in 1e-3..1e3_f64, n in 0..20_u32) {
            let product: f64 = (0..n).map(|step| (x + f64::from(step)).ln()).sum();

            prop_assert!((ln_pochhammer(x, f64::from(n)) - product).abs() < 1e-12);
        }
    }
}
