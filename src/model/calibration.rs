//! Platt scaling of a network's mutual information to a probability: P(MI > t) = logistic(a + b
//! ln(MI + 0.005)), fitted to what held-out counts say.
//!
//! The truth of a held-out state is unknown; its Bayes factor
//! F = P(counts | MI > t) / P(counts | MI <= t) is what its counts say of it. The likelihood of all
//! of them, sum ln(1 - P + P F), is made as large as possible by EM, with b >= 0 and a weak prior
//! on it.

use super::network::logistic;
use crate::domain::Calibration;

/// The prior of the slope, in units of the spread of ln MI: a normal distribution of variance
/// 1 / this.
const RIDGE: f64 = 1.0;
/// The prior of the intercept: one state more, of usual ln MI, that is above t with this
/// probability. Without it, where no state is above t, certainty grows without bound.
const PRIOR: f64 = 0.1;
/// Rounds of EM, of Newton's steps in each, and the gain below which it is done.
const ROUNDS: usize = 200;
const STEPS: usize = 3;
const DONE: f64 = 1e-6;

/// Fits a calibration, by expectation maximisation, to states by their ln MI and their Bayes
/// factors. Without states, or without any difference between them, nothing is called.
pub fn fit_calibration(states: &[(f64, f64)]) -> Calibration {
    let n = states.len().max(1) as f64;
    let mean = states.iter().map(|(x, _)| x).sum::<f64>() / n;
    let spread = (states.iter().map(|(x, _)| (x - mean).powi(2)).sum::<f64>() / n)
        .sqrt()
        .max(1e-9);
    let scaled: Vec<(f64, f64)> = states
        .iter()
        .map(|(x, factor)| ((x - mean) / spread, *factor))
        .collect();

    let mut line = Line {
        intercept: -1.5,
        slope: 1.0,
    };
    let mut last = f64::NEG_INFINITY;
    for _ in 0..ROUNDS {
        line = line.improved(&scaled);
        let now = line.likelihood(&scaled);
        if now - last < DONE {
            break;
        }
        last = now;
    }

    let slope = line.slope / spread;
    Calibration {
        intercept: line.intercept - slope * mean,
        slope,
    }
}

#[derive(Clone, Copy)]
struct Line {
    intercept: f64,
    slope: f64,
}

impl Line {
    fn probability(self, z: f64) -> f64 {
        logistic((self.intercept + self.slope * z).clamp(-30.0, 30.0))
    }

    fn likelihood(self, states: &[(f64, f64)]) -> f64 {
        let each = |(z, factor): &(f64, f64)| {
            let p = self.probability(*z);
            (1.0 - p + p * factor).ln()
        };

        let p = self.probability(0.0);
        let prior = PRIOR * p.ln() + (1.0 - PRIOR) * (1.0 - p).ln();
        states.iter().map(each).sum::<f64>() + prior - 0.5 * RIDGE * self.slope * self.slope
    }

    /// One round: how probable MI > t is in each state, then a logistic regression on that.
    fn improved(self, states: &[(f64, f64)]) -> Self {
        let responsibility = |(z, factor): &(f64, f64)| {
            let p = self.probability(*z);
            p * factor / (1.0 - p + p * factor)
        };
        let targets: Vec<f64> = states.iter().map(responsibility).collect();
        (0..STEPS).fold(self, |line, _| line.step(states, &targets))
    }

    fn step(self, states: &[(f64, f64)], targets: &[f64]) -> Self {
        let prior = self.probability(0.0);
        let [mut by_intercept, mut by_slope] = [PRIOR - prior, -RIDGE * self.slope];
        let [mut aa, mut ab, mut bb] = [1e-9 + prior * (1.0 - prior), 0.0, RIDGE];

        for ((z, _), target) in states.iter().zip(targets) {
            let p = self.probability(*z);
            let (error, curvature) = (target - p, p * (1.0 - p));
            by_intercept += error;
            by_slope += error * z;
            aa += curvature;
            ab += curvature * z;
            bb += curvature * z * z;
        }

        let determinant = aa * bb - ab * ab;
        let intercept =
            self.intercept + ((bb * by_intercept - ab * by_slope) / determinant).clamp(-1.0, 1.0);
        let slope =
            self.slope + ((aa * by_slope - ab * by_intercept) / determinant).clamp(-1.0, 1.0);
        Self {
            intercept: intercept.clamp(-30.0, 30.0),
            slope: slope.max(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// States whose counts settle the question: above where x > 0, with a tenth of exceptions.
    fn settled() -> Vec<(f64, f64)> {
        let state = |at: usize| {
            let x = at as f64 / 50.0 - 1.0;
            let above = (x > 0.0) != at.is_multiple_of(10);
            (x, if above { 1e3 } else { 1e-3 })
        };
        (0..100).map(state).collect()
    }

    #[test]
    fn probabilities_are_as_frequent_as_they_say() {
        let states = settled();
        let Calibration { intercept, slope } = fit_calibration(&states);
        let expected: f64 = states
            .iter()
            .map(|(x, _)| logistic(intercept + slope * x))
            .sum();
        let above = states.iter().filter(|(_, factor)| *factor > 1.0).count() as f64;
        assert!((expected - above).abs() < 1.0, "{expected} {above}");
        assert!(
            logistic(intercept + slope * 0.9) > 0.85 && logistic(intercept - slope * 0.9) < 0.15,
            "{intercept} {slope}"
        );
    }

    #[test]
    fn counts_that_say_nothing_leave_the_prior() {
        let silent: Vec<(f64, f64)> = (0..100).map(|at| (at as f64, 1.0)).collect();
        let Calibration { slope, .. } = fit_calibration(&silent);
        assert!(slope < 0.1, "{slope}");
        assert!(fit_calibration(&[]).intercept.is_finite());
    }

    #[test]
    fn counts_that_speak_against_it_call_nothing() {
        let against: Vec<(f64, f64)> = (0..100).map(|at| (at as f64 / 100.0, 0.2)).collect();
        let Calibration { intercept, slope } = fit_calibration(&against);
        assert!(logistic(intercept + slope) < 0.1);
        let never: Vec<(f64, f64)> = (0..1_000).map(|at| (at as f64 / 1_000.0, 0.0)).collect();
        let Calibration { intercept, slope } = fit_calibration(&never);
        let p = logistic(intercept + 0.5 * slope);
        assert!(
            (1e-5..1e-3).contains(&p),
            "a thousand states that are not above t leave about one in ten thousand: {p}"
        );
    }
}
