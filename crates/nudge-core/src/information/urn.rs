//! The hypergeometric distribution: what chance makes of one cell of a table whose margins are
//! known. Not its random variates: those belong to the permutation tests.

use super::x_ln_x;

/// An urn of `total` balls, `marked` of them marked, from which `drawn` are drawn: a cell in a row
/// of `marked` and a column of `drawn` visits, or the other way round.
///
/// `marked` and `drawn` are at least 1, and at most `total`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Urn {
    pub marked: u64,
    pub drawn: u64,
    pub total: u64,
}

impl Urn {
    /// Returns how many marked balls are drawn on average: e = r c / N.
    pub fn mean(self) -> f64 {
        self.marked as f64 * (self.drawn as f64 / self.total as f64)
    }

    /// Returns the fewest and the most marked balls that can be drawn.
    pub fn range(self) -> [u64; 2] {
        let fewest = (u128::from(self.marked) + u128::from(self.drawn))
            .saturating_sub(u128::from(self.total));
        [fewest as u64, self.marked.min(self.drawn)]
    }

    /// Tells each number of marked balls and its weight, beside 1 for the likeliest: upwards from
    /// that one, then downwards, to where the weights are `negligible` beside it.
    ///
    /// By the ratios p(x + 1) / p(x) = (r - x)(c - x) / ((x + 1)(N - r - c + x + 1)), so that no
    /// factorial is needed. They fall on both sides of the mode, faster than geometrically.
    pub fn each(self, negligible: f64, mut tell: impl FnMut(u64, f64)) {
        let [fewest, most] = self.range();
        let mode = self.mode();
        let [r, c, n] = [self.marked, self.drawn, self.total].map(|n| n as f64);
        let spare = n - r - c;

        tell(mode, 1.0);
        let (mut weight, mut x) = (1.0, mode as f64);
        for next in mode + 1..=most {
            weight *= (r - x) * (c - x) / ((x + 1.0) * (spare + x + 1.0));
            x += 1.0;
            if weight < negligible {
                break;
            }
            tell(next, weight);
        }

        let (mut weight, mut x) = (1.0, mode as f64);
        for next in (fewest..mode).rev() {
            weight *= x * (spare + x) / ((r - x + 1.0) * (c - x + 1.0));
            x -= 1.0;
            if weight < negligible {
                break;
            }
            tell(next, weight);
        }
    }

    fn mode(self) -> u64 {
        let [r, c, n] = [self.marked, self.drawn, self.total].map(u128::from);
        ((r + 1) * (c + 1) / (n + 2)) as u64
    }

    /// Returns the second, third and fourth central moment.
    ///
    /// With p = r / N and q = c / N, from the cumulants of the hypergeometric distribution
    /// (Johnson, Kemp & Kotz 2005, "Univariate Discrete Distributions", 6.3). There are at least
    /// four balls.
    pub fn central_moments(self) -> [f64; 3] {
        let [r, c, n] = [self.marked, self.drawn, self.total].map(|n| n as f64);
        let [p, q] = [r / n, c / n];
        let [of_p, of_q] = [p * (1.0 - p), q * (1.0 - q)];

        let second = of_p * of_q * n * n / (n - 1.0);
        let third = second * (1.0 - 2.0 * p) * (1.0 - 2.0 * q) * n / (n - 2.0);
        let excess = (n - 1.0) * ((n + 1.0) / n - 6.0 * of_p - 6.0 * of_q)
            + 6.0 * of_p * of_q * (5.0 * n - 6.0);
        let kurtosis = 3.0 + excess / (of_p * of_q * (n - 2.0) * (n - 3.0));

        [second, third, second * second * kurtosis]
    }

    /// Returns the mean of x ln(x / e), in nats, where x marked balls are drawn and e on average:
    /// what this cell is expected to add to N times the plug-in mutual information. Never negative,
    /// but for rounding.
    ///
    /// Summed, or by [`expanded`](Self::expanded) where the urn is large and `e` at least
    /// [`EXPANDED_FROM`].
    pub fn mean_deviance(self) -> f64 {
        if self.is_expanded() {
            self.expanded()
        } else {
            self.summed()
        }
    }

    /// Returns whether [`mean_deviance`](Self::mean_deviance) is expanded instead of summed.
    pub fn is_expanded(self) -> bool {
        self.total > x_ln_x::LARGEST && self.mean() >= EXPANDED_FROM
    }

    fn summed(self) -> f64 {
        /// Weights this small beside the largest are left out.
        const NEGLIGIBLE: f64 = 1e-19;

        let (mut weights, mut sum) = (0.0, 0.0);
        self.each(NEGLIGIBLE, |x, weight| {
            weights += weight;
            sum += weight * x_ln_x::at(x);
        });
        let e = self.mean();
        sum / weights - e * e.ln()
    }

    /// The mean of the Taylor series of x ln(x / e) - x + e about e, to the sixth order, with the
    /// fifth and sixth moments of a nearly normal distribution, 10 mu_2 mu_3 and 15 mu_2^3.
    ///
    /// mu_2 / 2e - mu_3 / 6e^2 + mu_4 / 12e^3 - mu_2 mu_3 / 2e^4 + mu_2^3 / 2e^5. What is left out
    /// is about 1 / 6e^3.
    fn expanded(self) -> f64 {
        let e = self.mean();
        let [second, third, fourth] = self.central_moments();
        let of_normal = second * (second * second / e - third) / (2.0 * e);
        (second / 2.0 - (third / 6.0 - (fourth / 12.0 + of_normal) / e) / e) / e
    }
}

/// The mean number of marked balls from which the series is good to a few 1e-7 of a nat.
const EXPANDED_FROM: f64 = 100.0;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn urn(marked: u64, drawn: u64, total: u64) -> Urn {
        Urn {
            marked,
            drawn,
            total,
        }
    }

    /// The mean of a function of the number drawn, over all there can be.
    fn mean(urn: Urn, of: impl Fn(f64) -> f64) -> f64 {
        let (mut weights, mut sum) = (0.0, 0.0);
        urn.each(0.0, |x, weight| {
            weights += weight;
            sum += weight * of(x as f64);
        });
        sum / weights
    }

    proptest! {
        #[test]
        fn every_number_is_told_once_and_has_its_weight((marked, drawn, total) in urns(40)) {
            let urn = urn(marked, drawn, total);
            let mut told = Vec::new();
            urn.each(0.0, |x, weight| told.push((x, weight)));
            told.sort_by_key(|(x, _)| *x);

            let [fewest, most] = urn.range();
            prop_assert!(told.iter().map(|(x, _)| *x).eq(fewest..=most));
            let ways = |x: u64| choose(marked, x) * choose(total - marked, drawn - x);
            let likeliest = told.iter().map(|(x, _)| ways(*x)).fold(0.0, f64::max);
            for (x, weight) in told {
                prop_assert!((weight - ways(x) / likeliest).abs() < 1e-13);
            }
        }

        #[test]
        fn moments_are_those_of_all_numbers((marked, drawn, total) in urns(300)) {
            prop_assume!(total >= 4 && marked < total && drawn < total);
            let urn = urn(marked, drawn, total);
            let e = urn.mean();
            for (k, moment) in (2..).zip(urn.central_moments()) {
                let summed = mean(urn, |x| (x - e).powi(k));
                prop_assert!((moment - summed).abs() < 1e-10 * mean(urn, |x| (x - e).abs().powi(k)).max(1e-3));
            }
        }
    }

    #[test]
    fn the_series_meets_the_sum() {
        for (marked, drawn, total) in [
            (1_000, 1_000, 10_000),
            (9_000, 1_000, 10_000),
            (300, 500, 1_500),
            (20_000, 20_000, 1_000_000),
        ] {
            let urn = urn(marked, drawn, total);

            assert!(
                (urn.expanded() - urn.summed()).abs() < 0.2 * urn.mean().powi(-3),
                "{urn:?} {} {} {}",
                urn.expanded() - urn.summed(),
                urn.mean().powi(-3),
                urn.summed()
            );
        }
    }

    fn urns(most: u64) -> impl Strategy<Value = (u64, u64, u64)> {
        (1..=most).prop_flat_map(|total| (1..=total, 1..=total, Just(total)))
    }

    fn choose(of: u64, n: u64) -> f64 {
        (1..=n).map(|k| (of - n + k) as f64 / k as f64).product()
    }
}
