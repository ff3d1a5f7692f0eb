//! Bayes factors against an expected response: how much more likely the counts of a state make
//! MI > t than it was, where a network said beforehand what both agents do.
//!
//! The evidence of [`super::Prior`] knows nothing of a state but its counts, and after two or three
//! observations it leans towards "below t" whatever the other did: too few of the ego's actions
//! were seen. With an expectation the same observations speak: they are likely under the responses
//! that were expected, or under one response to everything. The network must not have learned from
//! these counts.
//!
//! Per state, with the expected policy p_i, responses rho_ij and m_j = sum_i p_i rho_ij:
//!
//! * null: all rows share one response, ln DM(c; b x), x in {environment's base, uniform, m};
//!   without m, whoever knew the marginal better would win;
//! * slabs: each row its own, l = sum_i ln DM(n_i.; k z_i), z_ij proportional to
//!   m_j (rho_ij / m_j)^gamma: as expected, or sharper;
//! * T(n) = P(MI > t | slab, n), a Beta distribution with the moments of rows that are Dirichlet
//!   with parameters n_ij + k z_ij, under a policy that is Dirichlet with parameters
//!   r_i + kappa p_i. Observations move it as they move l: a slab in which MI can be large says
//!   nothing for MI > t where they have it that it is not. T(0) is the same without observations.
//!
//! Weights w of the slabs and the share pi of dependent states are fitted over all states by EM;
//! kappa (how far states keep to the expected policy) by maximum likelihood of the ego's actions,
//! ln DM(r; kappa p). P(n, MI > t | slab) = l T(n), so that the Bayes factor of a state is
//!
//! P(n | MI > t) / P(n | MI <= t) = [sum w l T(n) / sum w T(0)]
//! / [((1 - pi) l_0 + pi sum w l (1 - T(n))) / (1 - pi + pi sum w (1 - T(0)))].
//!
//! **With a variable held fixed** a state has a table, a policy and responses in each of its strata
//! h, which are expected with the probabilities u_h. Evidence is summed over them, each component
//! with one concentration for all, and m is each stratum's own. T is of the conditional mutual
//! information sum_h w_h I_h, w_h = (N_h + kappa u_h) / (N + kappa), whose weights are Dirichlet as
//! the policy is.
//!
//! Moments of so few numbers are crude below some eight observations: those who calibrate by Bayes
//! factors leave such states out.

use super::base::Base;
use super::beta::Beta;
use super::likelihood::rows_evidence;
use super::log_space::ln_sum;
use super::log_space::normalised;
use crate::information::{Alphabet, Table};
use crate::special_functions::{digamma, ln_rising};

/// Concentrations of the null on one base.
const NULLS: [f64; 8] = [0.6, 1.0, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0];
/// Bases of the null.
const BASES: usize = 3;
/// Components of the null.
const NULL_GRID: usize = NULLS.len() * BASES;
/// Sharpness gamma and concentration k of the slabs.
const SLABS: [(f64, f64); 6] = [
    (1.0, 3.0),
    (1.0, 12.0),
    (1.0, 50.0),
    (2.0, 3.0),
    (2.0, 12.0),
    (2.0, 50.0),
];
/// Concentrations kappa of a state's policy around the expected one.
const KAPPAS: [f64; 10] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 512.0, 2_048.0];
/// No response, and no action, is expected to be rarer.
const RAREST: f64 = 1e-4;
/// Concentrations and effective numbers of letters are not taken for smaller: they are divided by.
const NO_FEWER: f64 = 1e-9;
/// The logarithm of the largest Bayes factor that is told.
const MOST_CERTAIN: f64 = 60.0;
/// Rounds of EM.
const ROUNDS: usize = 60;
/// The prior of the share of dependent states, and of each weight, in states: as in
/// [`super::Fitter`].
const DEPENDENT_PRIOR: [f64; 2] = [3.0, 10.0];
const WEIGHT_PRIOR: f64 = 0.1;

/// A stratum's contingency table with the policy and the response that were expected of it.
pub struct ExpectedResponse<'a> {
    /// Its counts; rows are the ego's actions.
    pub table: &'a Table,
    /// The expected probability of what is held fixed in it; 1 where nothing is.
    pub share: f64,
    /// The expected probability of each of the ego's actions.
    pub ego: &'a [f64],
    /// The expected probability of each of the other's actions, after each of the ego's: row by
    /// row.
    pub response: &'a [f64],
}

/// The strata of a state, at least one.
pub type ExpectedState<'a> = Vec<ExpectedResponse<'a>>;

/// Returns the Bayes factor of each state: how much likelier its counts are if MI > threshold
/// (nats) than if not.
pub fn bayes_factors(
    states: &[ExpectedState<'_>],
    alphabet: Alphabet,
    base: &Base,
    threshold: f64,
) -> Vec<f64> {
    if threshold >= alphabet.largest_information() {
        return vec![f64::exp(-MOST_CERTAIN); states.len()];
    }

    let kappa = policy_concentration(states);
    let question = Question {
        alphabet,
        threshold,
        kappa,
    };

    let terms: Vec<Terms> = states
        .iter()
        .map(|state| Terms::new(state, base, question))
        .collect();

    let weights = Weights::fitted(&terms);
    terms
        .iter()
        .map(|terms| weights.bayes_factor(terms))
        .collect()
}

/// Returns the maximum-likelihood concentration kappa of the grid: where sum ln DM(r; kappa p) over
/// states is largest.
fn policy_concentration(states: &[ExpectedState<'_>]) -> f64 {
    let likelihoods = KAPPAS.map(|kappa| {
        let strata = states.iter().flatten();
        let of_strata = strata.map(|stratum| policy_likelihood(stratum, kappa));
        of_strata.sum::<f64>()
    });
    let best = (0..KAPPAS.len()).max_by(|a, b| likelihoods[*a].total_cmp(&likelihoods[*b]));
    best.map_or(KAPPAS[0], |at| KAPPAS[at])
}

/// Returns ln DM(r; kappa p) of the ego's actions in a stratum.
fn policy_likelihood(stratum: &ExpectedResponse<'_>, kappa: f64) -> f64 {
    let counts = stratum.table.row_labels().iter().zip(stratum.table.rows());
    let actions: f64 = counts
        .map(|(i, r)| ln_rising(kappa * stratum.ego[*i as usize].max(RAREST), *r))
        .sum();
    actions - ln_rising(kappa, stratum.table.total())
}

/// What is asked of every state.
#[derive(Clone, Copy)]
struct Question {
    alphabet: Alphabet,
    /// In nats.
    threshold: f64,
    /// How many observations the expected policy is worth.
    kappa: f64,
}

/// The log marginal likelihoods of a state under each component, and how probable MI > t is in each
/// slab.
struct Terms {
    nulls: [f64; NULL_GRID],
    slabs: [f64; SLABS.len()],
    /// T(0).
    prior_tail: [f64; SLABS.len()],
    /// T(n).
    posterior_tail: [f64; SLABS.len()],
}

impl Terms {
    fn new(state: &ExpectedState<'_>, base: &Base, question: Question) -> Self {
        let columns = question.alphabet.columns as usize;
        let marginals: Vec<Vec<f64>> = state
            .iter()
            .map(|stratum| expected_marginal(stratum, columns))
            .collect();
        let [nothing, counts]: [Vec<Counts>; 2] = [
            state
                .iter()
                .map(|_| Counts::none(question.alphabet))
                .collect(),
            state
                .iter()
                .map(|stratum| Counts::from_table(stratum.table, question.alphabet))
                .collect(),
        ];

        let mut slabs = [0.0; SLABS.len()];
        let [mut prior_tail, mut posterior_tail] = [[0.0; SLABS.len()]; 2];
        for (slab, (gamma, k)) in SLABS.into_iter().enumerate() {
            let rows: Vec<Vec<f64>> = state
                .iter()
                .zip(&marginals)
                .map(|(stratum, marginal)| sharpened(stratum, marginal, gamma))
                .collect();
            let evidence = |(stratum, rows): (&ExpectedResponse<'_>, &Vec<f64>)| {
                rows_evidence(stratum.table, k, |i, j| rows[i * columns + j])
            };
            slabs[slab] = state.iter().zip(&rows).map(evidence).sum();

            let tail = |counts| {
                tail(
                    conditional_moments(counts, state, &rows, k, question),
                    question,
                )
            };
            prior_tail[slab] = tail(&nothing);
            posterior_tail[slab] = tail(&counts);
        }

        let nulls = std::array::from_fn(|null| {
            let (x, b) = (null / NULLS.len(), NULLS[null % NULLS.len()]);
            let strata = state.iter().zip(&marginals);
            let of_stratum = |(stratum, marginal): (&ExpectedResponse<'_>, &Vec<f64>)| {
                null_likelihood(stratum.table, [base.shares(), marginal], x, b)
            };
            strata.map(of_stratum).sum()
        });

        Self {
            nulls,
            slabs,
            prior_tail,
            posterior_tail,
        }
    }
}

/// Returns ln DM(c; b x) of the other's actions in a stratum, x being the environment's base, the
/// uniform or the expected marginal.
fn null_likelihood(table: &Table, [base, marginal]: [&[f64]; 2], x: usize, b: f64) -> f64 {
    let uniform = 1.0 / marginal.len() as f64;
    let floored: f64 = marginal.iter().map(|m| m.max(RAREST)).sum();
    let share = |j: usize| [base[j], uniform, marginal[j].max(RAREST) / floored][x];

    let sums = table.column_labels().iter().zip(table.columns());
    let letters: f64 = sums
        .map(|(label, n)| ln_rising(b * share(*label as usize), *n))
        .sum();
    letters - ln_rising(b, table.total())
}

/// Returns m_j = sum_i p_i rho_ij.
fn expected_marginal(stratum: &ExpectedResponse<'_>, columns: usize) -> Vec<f64> {
    let rows = || stratum.ego.iter().zip(stratum.response.chunks(columns));
    (0..columns)
        .map(|j| rows().map(|(p, row)| p * row[j]).sum())
        .collect()
}

/// Returns the rows z, row by row.
fn sharpened(stratum: &ExpectedResponse<'_>, marginal: &[f64], gamma: f64) -> Vec<f64> {
    let mut rows = stratum.response.to_vec();
    for row in rows.chunks_mut(marginal.len()) {
        let sharp = |(rho, m): (&f64, &f64)| {
            if *m > 0.0 {
                m * (rho / m).powf(gamma)
            } else {
                0.0
            }
        };

        let sharper: Vec<f64> = row.iter().zip(marginal).map(sharp).collect();
        let sum: f64 = sharper.iter().sum();
        let floored: Vec<f64> = sharper.iter().map(|z| (z / sum).max(RAREST)).collect();
        let total: f64 = floored.iter().sum();

        row.iter_mut()
            .zip(floored)
            .for_each(|(z, floored)| *z = floored / total);
    }
    rows
}

/// The counts of a stratum, cell by cell.
struct Counts {
    cells: Vec<f64>,
    rows: Vec<f64>,
    total: f64,
}

impl Counts {
    fn none(alphabet: Alphabet) -> Self {
        let [rows, columns] = [alphabet.rows, alphabet.columns].map(|letters| letters as usize);
        Self {
            cells: vec![0.0; rows * columns],
            rows: vec![0.0; rows],
            total: 0.0,
        }
    }

    fn from_table(table: &Table, alphabet: Alphabet) -> Self {
        let mut counts = Self::none(alphabet);
        for (i, j, n) in table.triples() {
            counts.cells[(i * alphabet.columns + j) as usize] += n as f64;
            counts.rows[i as usize] += n as f64;
        }

        Self {
            total: table.total() as f64,
            ..counts
        }
    }
}

/// Returns P(MI > t | slab, counts): that of a Beta distribution on [0, ln min(R, K)] with the mean
/// and the variance of mutual information.
fn tail((mean, variance): (f64, f64), question: Question) -> f64 {
    let largest = question.alphabet.largest_information();
    let share = (mean / largest).clamp(1e-6, 1.0 - 1e-6);
    1.0 - Beta::matched(share, variance / (largest * largest))
        .cdf(question.threshold / largest)
        .0
}

/// Returns mean and variance of sum_h w_h I_h, of independent strata with the means M_h and the
/// variances V_h, whose weights are Dirichlet with parameters N_h + kappa u_h, S = N + kappa:
/// sum_h w_h M_h, and sum_h E w_h^2 V_h + (sum_h w_h M_h^2 - (sum_h w_h M_h)^2) / (S + 1). Of one
/// stratum both are its own.
fn conditional_moments(
    counts: &[Counts],
    state: &ExpectedState<'_>,
    rows: &[Vec<f64>],
    k: f64,
    question: Question,
) -> (f64, f64) {
    let s = counts.iter().map(|stratum| stratum.total).sum::<f64>() + question.kappa;
    let [mut mean, mut square, mut variance] = [0.0; 3];
    for ((counts, stratum), rows) in counts.iter().zip(state).zip(rows) {
        let weight = (counts.total + question.kappa * stratum.share) / s;
        let (m, v) = moments(counts, stratum.ego, rows, k, question);
        mean += weight * m;
        square += weight * m * m;
        variance += (weight * weight + weight * (1.0 - weight) / (s + 1.0)) * v;
    }

    let between = (square - mean * mean).max(0.0) / (s + 1.0);
    (mean, variance + between)
}

/// Returns mean and variance of a stratum's mutual information in nats where row i is Dirichlet with parameters
/// a_ij = n_ij + k z_ij, A_i = r_i + k, and the policy with parameters r_i + kappa p_i,
/// S = N + kappa. With their means rho_ij and p_i, q = sum_i p_i rho_i, L_ij = ln(rho_ij / q_j),
/// L_i = sum_j rho_ij L_ij, M = sum_i p_i L_i and E p_i^2 = p_i^2 + p_i (1 - p_i) / (S + 1):
///
/// * mean = E H(q) - sum_i p_i E H(row i). The rows' entropies are exact (Wolpert & Wolf 1995), the
///   marginal's is by a Beta distribution of variance v_j and concentration c_j matched to each
///   q_j:
///
///   E H(row i) = psi(A_i + 1) - sum_j rho_ij psi(a_ij + 1),
///
///   E H(q) = -sum_j q_j [psi(q_j c_j + 1) - psi(c_j + 1)],
///
///   c_j = q_j (1 - q_j) / v_j - 1,
///
///   v_j = sum_i E p_i^2 rho_ij (1 - rho_ij) / (A_i + 1)
///   + (sum_i p_i rho_ij^2 - q_j^2) / (S + 1);
///
/// * variance, to first order and with a term of second order, without which it would vanish where
///   rows are alike:
///
///   sum_i E p_i^2 (sum_j rho_ij L_ij^2 - L_i^2) / (A_i + 1)
///   + (sum_i p_i L_i^2 - M^2) / (S + 1)
///   + 2 (mean - M)^2 / ((1 / sum p_i^2 - 1) (1 / sum q_j^2 - 1)).
fn moments(counts: &Counts, ego: &[f64], rows: &[f64], k: f64, question: Question) -> (f64, f64) {
    let columns = question.alphabet.columns as usize;
    let s = counts.total + question.kappa;
    let p: Vec<f64> = ego
        .iter()
        .zip(&counts.rows)
        .map(|(p, r)| (r + question.kappa * p) / s)
        .collect();
    let a = |i: usize, j: usize| counts.cells[i * columns + j] + k * rows[i * columns + j];
    let rho = |i: usize, j: usize| a(i, j) / (counts.rows[i] + k);
    let q: Vec<f64> = (0..columns)
        .map(|j| p.iter().enumerate().map(|(i, p)| p * rho(i, j)).sum())
        .collect();

    let [mut entropy, mut of_rows, mut of_policy, mut divergence] = [0.0; 4];
    let mut spread = vec![0.0; columns];
    for (i, p) in p.iter().enumerate() {
        let concentration = counts.rows[i] + k;
        let square = (p * p + p * (1.0 - p) / (s + 1.0)) / (concentration + 1.0);
        let [mut first, mut second] = [0.0; 2];
        entropy += p * digamma(concentration + 1.0);
        for (j, q) in q.iter().enumerate() {
            let rho = rho(i, j);
            let ln_ratio = (rho / q).ln();
            entropy -= p * rho * digamma(a(i, j) + 1.0);
            first += rho * ln_ratio;
            second += rho * ln_ratio * ln_ratio;
            spread[j] += square * rho * (1.0 - rho) + p * (rho - q).powi(2) / (s + 1.0);
        }
        of_rows += square * (second - first * first);
        of_policy += p * first * first / (s + 1.0);
        divergence += p * first;
    }
    let of_column = |(q, v): (&f64, f64)| {
        let concentration = (q * (1.0 - q) / v.max(f64::MIN_POSITIVE) - 1.0).max(NO_FEWER);
        q * (digamma(concentration + 1.0) - digamma(q * concentration + 1.0))
    };
    let mean = q.iter().zip(spread).map(of_column).sum::<f64>() - entropy;
    let effective =
        |shares: &[f64]| 1.0 / shares.iter().map(|share| share * share).sum::<f64>() - 1.0;
    let alike = 2.0 * (mean - divergence).powi(2) / (effective(&p) * effective(&q)).max(NO_FEWER);
    (
        mean,
        of_rows + of_policy - divergence * divergence / (s + 1.0) + alike,
    )
}

/// The mixture weights that EM finds over all states.
struct Weights {
    dependent: f64,
    nulls: [f64; NULL_GRID],
    slabs: [f64; SLABS.len()],
}

impl Weights {
    fn fitted(states: &[Terms]) -> Self {
        let mut weights = Self {
            dependent: 0.3,
            nulls: [1.0 / NULL_GRID as f64; NULL_GRID],
            slabs: [1.0 / SLABS.len() as f64; SLABS.len()],
        };

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
            let [p, rest] = normalised([
                ln_sum(&slab) + self.dependent.ln(),
                ln_sum(&null) + (1.0 - self.dependent).ln(),
            ]);
            nulls
                .iter_mut()
                .zip(normalised(null))
                .for_each(|(sum, share)| *sum += rest * share);
            slabs
                .iter_mut()
                .zip(normalised(slab))
                .for_each(|(sum, share)| *sum += p * share);
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

    fn bayes_factor(&self, terms: &Terms) -> f64 {
        /// Keeps logarithms finite.
        const TINY: f64 = 1e-12;
        /// What was less probable beforehand is taken for so probable: moments are not known
        /// better, and the ratio of two errors would be told as evidence. So what was impossible
        /// before the counts and is impossible after them is not made probable by the rest of what
        /// they say.
        const LEAST: f64 = 0.05;

        let slabs = self.slab(terms);
        let sum = |part: &dyn Fn(f64) -> f64| {
            let logarithms: [f64; SLABS.len()] =
                std::array::from_fn(|slab| slabs[slab] + part(terms.posterior_tail[slab]).ln());
            let prior: f64 = self
                .slabs
                .iter()
                .zip(terms.prior_tail)
                .map(|(weight, tail)| weight * part(tail))
                .sum();
            (ln_sum(&logarithms), prior)
        };

        let (above, above_prior) = sum(&|tail| tail + TINY);
        let (below, below_prior) = sum(&|tail| 1.0 - tail + TINY);

        let null = ln_sum(&self.null(terms)) + (1.0 - self.dependent).ln();
        let otherwise = ln_sum(&[null, below + self.dependent.ln()]);
        let otherwise_prior = 1.0 - self.dependent + self.dependent * below_prior;

        let [above_prior, otherwise_prior] =
            [above_prior, otherwise_prior].map(|prior| prior.max(LEAST).ln());

        ((above - above_prior) - (otherwise - otherwise_prior))
            .clamp(-MOST_CERTAIN, MOST_CERTAIN)
            .exp()
    }
}

#[cfg(test)]
mod tests;
