//! What counts say of what was expected of them: how much more likely they make MI > t than it was, where a network said beforehand what both agents do.
//!
//! The evidence of [`super::Prior`] knows nothing of a state but its counts, and after two or three draws it leans towards "below t" whatever the other
//! did: too few of the ego's actions were seen. With an expectation the same draws speak: they are likely under the responses that were expected, or
//! under one response to everything. The network must not have learned from these counts.
//!
//! Per state, with the expected policy p_i, responses rho_ij and m_j = sum_i p_i rho_ij:
//!
//! * null: all rows share one response, ln DM(c; b x), x in {environment's base, uniform, m}; without m, whoever knew the marginal better would win;
//! * slabs: each row its own, sum_i ln DM(n_i.; k z_i), z_ij proportional to m_j (rho_ij / m_j)^gamma: as expected, or sharper;
//! * T = P(MI > t) of a slab without counts, by the moments of its Dirichlet rows under the policy p.
//!
//! Weights and the share of dependent states are fitted over all states by EM. The factor of a state is
//! P(n | MI > t) / P(n | MI <= t) = [sum w T l / sum w T] / [((1 - pi) l_0 + pi sum w (1 - T) l) / (1 - pi + pi sum w (1 - T))].

use super::base::Base;
use super::beta::Beta;
use super::fit::normalised;
use super::gamma::{digamma, ln_rising};
use super::likelihood::rows_evidence;
use super::prior::ln_sum;
use crate::information::{Alphabet, Table};

/// Concentrations of the null on one base.
const NULLS: [f64; 8] = [0.6, 1.0, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0];
/// Bases of the null.
const BASES: usize = 3;
/// Components of the null.
const NULL_GRID: usize = NULLS.len() * BASES;
/// Sharpness gamma and concentration k of the slabs.
const SLABS: [(f64, f64); 6] = [(1.0, 3.0), (1.0, 12.0), (1.0, 50.0), (2.0, 3.0), (2.0, 12.0), (2.0, 50.0)];
/// No response is expected to be rarer.
const RAREST: f64 = 1e-4;
/// The logarithm of the largest factor that is told.
const MOST_CERTAIN: f64 = 60.0;
/// Rounds of EM.
const ROUNDS: usize = 60;
/// The prior of the share of dependent states, and of each weight, in states: as in [`super::Fitter`].
const DEPENDENT_PRIOR: [f64; 2] = [3.0, 10.0];
const WEIGHT_PRIOR: f64 = 0.1;

/// A state with what was expected of it.
pub struct Expected<'a> {
    /// Its draws; rows are the ego's actions.
    pub table: &'a Table,
    /// The expected probability of each of the ego's actions.
    pub ego: &'a [f64],
    /// The expected probability of each of the other's actions, after each of the ego's: row by row.
    pub response: &'a [f64],
}

/// Returns for each state how much likelier its draws are if MI > threshold (nats) than if not.
pub fn factors(states: &[Expected<'_>], alphabet: Alphabet, base: &Base, threshold: f64) -> Vec<f64> {
    if threshold >= alphabet.largest_information() {
        return vec![f64::exp(-MOST_CERTAIN); states.len()];
    }
    let terms: Vec<Terms> = states.iter().map(|state| Terms::new(state, alphabet, base, threshold)).collect();
    let weights = Weights::fitted(&terms);
    terms.iter().map(|terms| weights.factor(terms)).collect()
}

/// What a state says for each component, in logarithms, and how probable MI > t is in each slab.
struct Terms {
    nulls: [f64; NULL_GRID],
    slabs: [f64; SLABS.len()],
    tails: [f64; SLABS.len()],
}

impl Terms {
    fn new(state: &Expected<'_>, alphabet: Alphabet, base: &Base, threshold: f64) -> Self {
        let columns = alphabet.columns as usize;
        let marginal: Vec<f64> = (0..columns)
            .map(|j| state.ego.iter().enumerate().map(|(i, p)| p * state.response[i * columns + j]).sum())
            .collect();
        let uniform = 1.0 / columns as f64;
        let floored: f64 = marginal.iter().map(|m| m.max(RAREST)).sum();
        let share = |x: usize, j: usize| [base.shares()[j], uniform, marginal[j].max(RAREST) / floored][x];
        let mut slabs = [0.0; SLABS.len()];
        let mut tails = [0.0; SLABS.len()];
        for (slab, (gamma, k)) in SLABS.into_iter().enumerate() {
            let rows = sharpened(state, &marginal, gamma);
            slabs[slab] = rows_evidence(state.table, k, |i, j| rows[i * columns + j]);
            tails[slab] = tail(state.ego, &rows, columns, k, alphabet, threshold);
        }
        let nulls = std::array::from_fn(|null| {
            let (x, b) = (null / NULLS.len(), NULLS[null % NULLS.len()]);
            let sums = state.table.column_labels().iter().zip(state.table.columns());
            let letters: f64 = sums.map(|(label, n)| ln_rising(b * share(x, *label as usize), *n)).sum();
            letters - ln_rising(b, state.table.total())
        });
        Self { nulls, slabs, tails }
    }
}

/// Returns the rows z, row by row.
fn sharpened(state: &Expected<'_>, marginal: &[f64], gamma: f64) -> Vec<f64> {
    let mut rows = state.response.to_vec();
    for row in rows.chunks_mut(marginal.len()) {
        let sharp = |(rho, m): (&f64, &f64)| if *m > 0.0 { m * (rho / m).powf(gamma) } else { 0.0 };
        let sharper: Vec<f64> = row.iter().zip(marginal).map(sharp).collect();
        let sum: f64 = sharper.iter().sum();
        let floored: Vec<f64> = sharper.iter().map(|z| (z / sum).max(RAREST)).collect();
        let total: f64 = floored.iter().sum();
        row.iter_mut().zip(floored).for_each(|(z, floored)| *z = floored / total);
    }
    rows
}

/// Returns P(MI > t) where row i is Dirichlet with parameters k z_i: a Beta distribution with the moments of `super::moments` without counts.
fn tail(ego: &[f64], rows: &[f64], columns: usize, k: f64, alphabet: Alphabet, threshold: f64) -> f64 {
    let largest = alphabet.largest_information();
    let marginal = |j: usize| ego.iter().zip(rows.chunks(columns)).map(|(p, row)| p * row[j]).sum::<f64>();
    let q: Vec<f64> = (0..columns).map(marginal).collect();
    let (mut mean, mut variance) = (q.iter().map(|q| -q * q.ln()).sum::<f64>(), 0.0);
    let psi = digamma(k + 1.0);
    for (p, row) in ego.iter().zip(rows.chunks(columns)) {
        let [mut entropy, mut curvature, mut square, mut divergence] = [psi, 0.0, 0.0, 0.0];
        for (z, q) in row.iter().zip(&q) {
            let ln_ratio = (z / q).ln();
            entropy -= z * digamma(k * z + 1.0);
            curvature += z * (1.0 - z) / q;
            square += z * ln_ratio * ln_ratio;
            divergence += z * ln_ratio;
        }
        mean -= p * entropy + 0.5 * p * p * curvature / (k + 1.0);
        variance += p * p * (square - divergence * divergence) / (k + 1.0);
    }
    let share = (mean / largest).clamp(1e-6, 1.0 - 1e-6);
    1.0 - Beta::matched(share, variance / (largest * largest)).cdf(threshold / largest).0
}

/// What EM finds over all states.
struct Weights {
    dependent: f64,
    nulls: [f64; NULL_GRID],
    slabs: [f64; SLABS.len()],
}

impl Weights {
    fn fitted(states: &[Terms]) -> Self {
        let even = |n: usize| 1.0 / n as f64;
        let mut weights =
            Self { dependent: 0.3, nulls: [even(NULL_GRID); NULL_GRID], slabs: [even(SLABS.len()); SLABS.len()] };
        for _ in 0..ROUNDS {
            weights = weights.improved(states);
        }
        weights
    }

    fn improved(&self, states: &[Terms]) -> Self {
        let (mut nulls, mut slabs) = ([WEIGHT_PRIOR; NULL_GRID], [WEIGHT_PRIOR; SLABS.len()]);
        let mut dependent = 0.0;
        for terms in states {
            let (null, slab) = (self.null(terms), self.slab(terms));
            let [p, rest] =
                normalised([ln_sum(&slab) + self.dependent.ln(), ln_sum(&null) + (1.0 - self.dependent).ln()]);
            nulls.iter_mut().zip(normalised(null)).for_each(|(sum, share)| *sum += rest * share);
            slabs.iter_mut().zip(normalised(slab)).for_each(|(sum, share)| *sum += p * share);
            dependent += p;
        }
        let share = (dependent + DEPENDENT_PRIOR[0]) / (states.len() as f64 + DEPENDENT_PRIOR[1]);
        let (null_sum, slab_sum): (f64, f64) = (nulls.iter().sum(), slabs.iter().sum());
        Self {
            dependent: share.clamp(0.001, 0.999),
            nulls: nulls.map(|sum| sum / null_sum),
            slabs: slabs.map(|sum| sum / slab_sum),
        }
    }

    fn null(&self, terms: &Terms) -> [f64; NULL_GRID] {
        std::array::from_fn(|null| terms.nulls[null] + self.nulls[null].ln())
    }

    fn slab(&self, terms: &Terms) -> [f64; SLABS.len()] {
        std::array::from_fn(|slab| terms.slabs[slab] + self.slabs[slab].ln())
    }

    fn factor(&self, terms: &Terms) -> f64 {
        /// Keeps logarithms finite.
        const TINY: f64 = 1e-12;
        let slabs = self.slab(terms);
        let sum = |part: &dyn Fn(f64) -> f64| {
            let logarithms: [f64; SLABS.len()] = std::array::from_fn(|slab| slabs[slab] + part(terms.tails[slab]).ln());
            let prior: f64 = self.slabs.iter().zip(terms.tails).map(|(weight, tail)| weight * part(tail)).sum();
            (ln_sum(&logarithms), prior)
        };
        let (above, above_prior) = sum(&|tail| tail + TINY);
        let (below, below_prior) = sum(&|tail| 1.0 - tail + TINY);
        let null = ln_sum(&self.null(terms)) + (1.0 - self.dependent).ln();
        let otherwise = ln_sum(&[null, below + self.dependent.ln()]);
        let otherwise_prior = 1.0 - self.dependent + self.dependent * below_prior;
        ((above - above_prior.ln()) - (otherwise - otherwise_prior.ln())).clamp(-MOST_CERTAIN, MOST_CERTAIN).exp()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COIN: Alphabet = Alphabet { rows: 2, columns: 2 };
    const COPIES: [f64; 4] = [0.95, 0.05, 0.05, 0.95];
    const IGNORES: [f64; 4] = [0.5; 4];

    /// Twenty states in which the other copies, as expected or not, and as many in which it throws a coin.
    fn found(expected: [&[f64]; 2]) -> (f64, f64) {
        let copied = Table::from_counts([(0, 0, 3), (1, 1, 3)]);
        let thrown = Table::from_counts([(0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 2)]);
        let state = |at: usize| Expected {
            table: if at < 20 { &copied } else { &thrown },
            ego: &[0.5, 0.5],
            response: expected[usize::from(at >= 20)],
        };
        let states: Vec<Expected<'_>> = (0..40).map(state).collect();
        let factors = factors(&states, COIN, &Base::new(&[100, 100]), 0.3);
        (factors[0], factors[39])
    }

    #[test]
    fn what_was_expected_and_happened_speaks_for_itself() {
        let (copied, thrown) = found([&COPIES, &IGNORES]);
        assert!(copied > 5.0 && thrown < 1.5, "{copied} {thrown}");
    }

    #[test]
    fn what_was_expected_and_did_not_happen_speaks_against_it() {
        let (copied, thrown) = found([&COPIES, &COPIES]);
        assert!(copied > 5.0 && thrown < 0.5, "{copied} {thrown}");
    }

    #[test]
    fn a_state_without_draws_says_nothing() {
        let empty = Table::default();
        let state = Expected { table: &empty, ego: &[0.5, 0.5], response: &COPIES };
        let factor = factors(&[state], COIN, &Base::new(&[1, 1]), 0.3)[0];
        assert!((factor - 1.0).abs() < 1e-9, "{factor}");
    }
}
