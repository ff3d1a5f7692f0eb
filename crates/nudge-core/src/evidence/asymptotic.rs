//! The plug-in estimator less its bias, and its asymptotic standard error: what a table says by
//! itself where it was seen often.
//!
//! Slabs suppose a family of responses. Where the truth lies outside of it (a tilt in proportion to
//! the margins, say), many visits make them certain of something slightly wrong; the table itself
//! knows better. With cells p_ij, the plug-in has the bias
//!
//! (1/N) [sum_ij f(N p_ij) (1 - p_ij) - sum_i f(N p_i) (1 - p_i) - sum_j f(N p_j) (1 - p_j)],
//!
//! f(x) = E n ln n - x ln x for a Poisson n of mean x, which is 1/2 for large x (Miller 1955 takes
//! 1/2 for every cell that was seen), and to first order the variance Var ln(p_ij / p_i p_j) / N
//! (Moddemeijer 1989). Where the variables are independent that vanishes, and what is left is that
//! of half a chi-squared variable over N, bias / N.

use std::sync::LazyLock;

use crate::information::{Table, plug_in};

/// A bias-corrected estimate of mutual information, in nats, and its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Estimate {
    pub mean: f64,
    pub deviation: f64,
}

/// The quantile of a normal distribution beyond which 5 % lie.
const NORMAL_95: f64 = 1.645;

impl Estimate {
    /// Returns the estimate from a table whose cells have these probabilities, rows first.
    pub fn new(table: &Table, cells: &[f64], columns: usize) -> Self {
        let n = table.total() as f64;
        let rows: Vec<f64> = cells.chunks(columns).map(|row| row.iter().sum()).collect();
        let mut marginal = vec![0.0; columns];
        cells
            .chunks(columns)
            .for_each(|row| marginal.iter_mut().zip(row).for_each(|(sum, p)| *sum += p));

        let growth = |shares: &[f64]| {
            shares
                .iter()
                .map(|p| growth(n * p) * (1.0 - p))
                .sum::<f64>()
        };

        let bias = (growth(cells) - growth(&rows) - growth(&marginal)) / n;
        let variance = ln_ratio_variance(cells, &rows, &marginal) / n + bias.max(0.0) / n;

        Self {
            mean: plug_in(table) - bias,
            deviation: variance.sqrt(),
        }
    }

    /// Returns its 90 % interval, from 0 on.
    pub fn interval(&self) -> [f64; 2] {
        let reach = NORMAL_95 * self.deviation;
        [(self.mean - reach).max(0.0), (self.mean + reach).max(0.0)]
    }

    /// Returns the mean of two estimates.
    pub fn between(self, other: Self) -> Self {
        Self {
            mean: 0.5 * (self.mean + other.mean),
            deviation: 0.5 * (self.deviation + other.deviation),
        }
    }
}

/// Returns the variance of ln(p_ij / p_i p_j) over the cells.
fn ln_ratio_variance(cells: &[f64], rows: &[f64], marginal: &[f64]) -> f64 {
    let (mut first, mut second) = (0.0, 0.0);
    for (row, cells) in rows.iter().zip(cells.chunks(marginal.len())) {
        for (p, column) in cells.iter().zip(marginal).filter(|(p, _)| **p > 0.0) {
            let ln_ratio = (p / (row * column)).ln();
            first += p * ln_ratio;
            second += p * ln_ratio * ln_ratio;
        }
    }
    (second - first * first).max(0.0)
}

/// Means up to which the growth is tabulated, and steps of the table for each unit of the square
/// root.
const TABULATED_TO: f64 = 30.0;
const STEPS: f64 = 256.0;

/// Returns f(x) = E n ln n - x ln x for a Poisson n of mean x: how much an entropy's term is
/// expected to grow by chance.
fn growth(x: f64) -> f64 {
    static TABLE: LazyLock<Vec<f64>> = LazyLock::new(|| {
        let last = (TABULATED_TO.sqrt() * STEPS) as usize + 2;
        (0..=last)
            .map(|step| summed_growth((step as f64 / STEPS).powi(2)))
            .collect()
    });

    if x >= TABULATED_TO {
        let inverse = 1.0 / x;
        return 0.5 + inverse * (1.0 / 12.0 + inverse * (1.0 / 12.0 + inverse * 19.0 / 120.0));
    }

    let at = x.max(0.0).sqrt() * STEPS;
    let (below, share) = (at as usize, at.fract());
    TABLE[below] * (1.0 - share) + TABLE[below + 1] * share
}

fn summed_growth(x: f64) -> f64 {
    if x == 0.0 {
        return 0.0;
    }

    let (mut term, mut sum) = ((-x).exp(), 0.0);
    // A hundred and fifty are more than twenty standard deviations above the mean.
    for n in (1..150).map(f64::from) {
        term *= x / n;
        sum += term * n * n.ln();
    }

    sum - x * x.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn growth_is_that_of_poisson_counts() {
        // By summing in Python's floats: n = 1 adds nothing, so that for small means - x ln x is
        // left.
        for (x, expected) in [
            (5.0, 0.523_338_483),
            (10.0, 0.509_414_270),
            (20.0, 0.504_398_326),
            (50.0, 0.501_701_345),
        ] {
            assert!((growth(x) - expected).abs() < 1e-6, "{x}: {}", growth(x));
        }
        assert!((growth(1e-4) - 1e-4 * 1e4_f64.ln()).abs() < 1e-4 && growth(0.0) == 0.0);
    }

    #[test]
    fn an_estimate_has_no_bias_where_counts_are_large() {
        // Cells of 1,000 x (1 or 3): ln 2 less the entropy of 1/4, in nats.
        let table =
            Table::from_counts([(0, 0, 3_000), (0, 1, 1_000), (1, 0, 1_000), (1, 1, 3_000)]);
        let estimate = Estimate::new(&table, &[0.375, 0.125, 0.125, 0.375], 2);
        let truth = 0.130_812_035;
        assert!(
            (estimate.mean - truth + 0.5 / 8_000.0).abs() < 1e-5,
            "{}",
            estimate.mean
        );
        // p (ln 3/2)^2 + ... : the standard deviation of ln 1.5 with 3/4 and ln .5 with 1/4, over
        // sqrt N.
        assert!(
            (estimate.deviation - 0.475_71 / 8_000_f64.sqrt()).abs() < 1e-4,
            "{}",
            estimate.deviation
        );
    }
}
