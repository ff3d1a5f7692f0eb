//! From a fit and a state's tables to what is believed of that state.

use super::fit::{Fit, normalised};
use super::gamma::digamma;
use super::increments::{add, depth};
use super::likelihood::Likelihood;
use super::moments::{Letter, Moments, Rest, Slab, Term, moments};
use super::parameters::{FIXED, NULLS, Parameters, SLAB_CONCENTRATIONS, SLAB_GRID, SLABS};
use super::posterior::Posterior;
use crate::information::Table;

/// Slabs below this share of all slabs' posterior weight are left out of the moments.
const NEGLIGIBLE: f64 = 1e-4;

/// A fit made ready to answer with: shared by any number of threads.
pub struct Prior {
    pub(super) likelihood: Likelihood,
    pub(super) parameters: Parameters,
    ln_nulls: [f64; NULLS],
    ln_slabs: [f64; SLABS],
    /// ln min(R, K).
    largest: f64,
    /// psi(r + k + 1) by slab, then by visits r.
    row_psi: Vec<[f64; SLAB_GRID]>,
    /// On the environment's base, and the uniform one.
    bases: [Vec<Tabulated>; 2],
    unseen: Posterior,
}

/// The terms of one slab on a fixed base.
struct Tabulated {
    depth: u64,
    /// By letter, then by count.
    terms: Vec<Term>,
    /// What all letters have together.
    all: Rest,
}

/// The probabilities of a state's hypotheses.
pub(super) struct Weights {
    pub dependent: f64,
    /// Given dependence; they sum to 1.
    pub slabs: [f64; SLABS],
}

impl Prior {
    /// Makes a fit ready.
    ///
    /// # Panics
    ///
    /// If the base, the weights or the alphabets of the fit do not belong together.
    pub fn new(fit: &Fit) -> Self {
        let Fit { alphabet, base, parameters, .. } = fit;
        assert_eq!(base.shares().len() as u64, alphabet.columns, "a base has one share for each letter of the columns");
        assert_eq!(parameters.slabs.len(), SLABS, "one weight for each slab");
        let uniform = [1.0 / alphabet.columns.max(1) as f64];
        let tabulated = |shares: &[f64], times: f64| {
            SLAB_CONCENTRATIONS.iter().map(|k| Tabulated::new(*k, shares, times)).collect::<Vec<_>>()
        };
        let bases = [tabulated(base.shares(), 1.0), tabulated(&uniform, alphabet.columns as f64)];
        let mut prior = Self {
            likelihood: Likelihood::new(*alphabet, base.clone()),
            parameters: parameters.clone(),
            ln_nulls: std::array::from_fn(|b| parameters.nulls[b].ln()),
            ln_slabs: std::array::from_fn(|slab| parameters.slabs[slab].ln()),
            row_psi: (0..depth(1)).map(|r| SLAB_CONCENTRATIONS.map(|k| digamma(r as f64 + k + 1.0))).collect(),
            largest: alphabet.largest_information(),
            bases,
            unseen: Posterior::impossible(),
        };
        prior.unseen = prior.posterior(&[]);
        prior
    }

    /// Returns what is believed of a state that was never seen.
    pub fn unseen(&self) -> &Posterior {
        &self.unseen
    }

    /// Returns what the counts of a state let one believe: its table, or one table for each joint action of the agents held fixed.
    ///
    /// Over several slices the evidence adds up. Mutual information is then its mean over the slices, weighted by their visits; under each slab the
    /// slices are independent, so that its variance is sum_c (n_c / N)^2 variance_c.
    pub fn posterior(&self, slices: &[Table]) -> Posterior {
        if self.largest == 0.0 {
            return Posterior::impossible();
        }
        let Weights { dependent, slabs } = self.weights(slices);
        let kept: f64 = slabs.iter().filter(|weight| **weight >= NEGLIGIBLE).sum();
        let kept = slabs
            .iter()
            .enumerate()
            .filter(|(_, weight)| **weight >= NEGLIGIBLE)
            .map(|(slab, weight)| (slab, weight / kept));
        Posterior::new(dependent, self.largest, kept.map(|(slab, weight)| (weight, self.moments(slab, slices))))
    }

    /// Returns P(dependent) alone, which takes a twentieth of the time of a whole [`posterior`](Self::posterior).
    pub fn dependent(&self, slices: &[Table]) -> f64 {
        if self.largest == 0.0 { 0.0 } else { self.weights(slices).dependent }
    }

    /// Returns the probabilities of dependence and of the slabs.
    pub(super) fn weights(&self, slices: &[Table]) -> Weights {
        let dependent = self.parameters.dependent;
        let shared = |logarithms: &[f64; NULLS]| {
            ln_sum(&std::array::from_fn::<_, NULLS, _>(|b| logarithms[b] + self.ln_nulls[b]))
        };
        let mut logarithms = self.ln_slabs;
        let mut informed = false;
        for slice in slices {
            let Some(evidence) = self.likelihood.evidence(slice) else { continue };
            // Relative to the null, so that it need not be kept.
            let null = shared(&evidence.nulls);
            let fixed = evidence.anchor.map_or(0.0, |anchor| shared(&anchor)) - null;
            add(&mut logarithms[..FIXED], evidence.fixed.map(|ln| ln + fixed));
            add(&mut logarithms[FIXED..], evidence.own);
            informed = true;
        }
        let slabs = normalised(logarithms);
        if !informed {
            return Weights { dependent, slabs };
        }
        let odds = ln_sum(&logarithms) + (dependent / (1.0 - dependent)).ln();
        Weights { dependent: 1.0 / (1.0 + (-odds).exp()), slabs }
    }

    /// Returns the moments of mutual information under a slab.
    fn moments(&self, slab: usize, slices: &[Table]) -> Moments {
        let total: f64 = slices.iter().map(|slice| slice.total() as f64).sum();
        if total == 0.0 {
            return self.slice_moments(slab, &Table::default());
        }
        slices.iter().filter(|slice| slice.total() > 0).fold(Moments::default(), |sum, slice| {
            let share = slice.total() as f64 / total;
            let Moments { mean, variance } = self.slice_moments(slab, slice);
            Moments { mean: sum.mean + share * mean, variance: sum.variance + share * share * variance }
        })
    }

    pub(super) fn slice_moments(&self, slab: usize, table: &Table) -> Moments {
        let k = SLAB_CONCENTRATIONS[slab % SLAB_GRID];
        let alphabet = self.likelihood.alphabet;
        let shares = self.likelihood.base.shares();
        let psi_a1 = |r: u64| match self.row_psi.get(r as usize) {
            Some(psi) => psi[slab % SLAB_GRID],
            None => digamma(r as f64 + k + 1.0),
        };
        let labels = table.column_labels();
        if slab < FIXED {
            let on_base = slab < SLAB_GRID;
            let tabulated = &self.bases[usize::from(!on_base)][slab % SLAB_GRID];
            let share = |at: usize| if on_base { shares[labels[at] as usize] } else { 1.0 / alphabet.columns as f64 };
            let letter = |at: usize| if on_base { labels[at] as usize } else { 0 };
            let term = |at: usize, n: u64| tabulated.term(letter(at), n, k * share(at));
            let columns: Vec<Letter> =
                (0..labels.len()).map(|at| Letter { share: share(at), empty: term(at, 0) }).collect();
            let rest = tabulated.all.without(k, &columns);
            return moments(table, alphabet, &Slab { concentration: k, columns: &columns, rest }, psi_a1, term);
        }
        let share = |at: usize| self.likelihood.own_share(table, at);
        let columns: Vec<Letter> =
            (0..labels.len()).map(|at| Letter { share: share(at), empty: Term::of(k * share(at)) }).collect();
        let mut rest = Rest::default();
        let mut occupied = labels.iter().peekable();
        for (label, share) in shares.iter().enumerate() {
            if occupied.next_if(|next| **next == label as u64).is_none() {
                rest.add(k, share / (table.total() as f64 + 1.0), 1.0);
            }
        }
        let term = |at: usize, n: u64| Term::of(n as f64 + k * columns[at].share);
        moments(table, alphabet, &Slab { concentration: k, columns: &columns, rest }, psi_a1, term)
    }
}

impl Tabulated {
    fn new(k: f64, shares: &[f64], times: f64) -> Self {
        let depth = depth(shares.len());
        let mut all = Rest::default();
        shares.iter().for_each(|share| all.add(k, *share, times));
        let terms = shares.iter().flat_map(|share| (0..depth).map(move |n| Term::of(n as f64 + k * share)));
        Self { depth, terms: terms.collect(), all }
    }

    fn term(&self, letter: usize, n: u64, start: f64) -> Term {
        if n < self.depth { self.terms[letter * self.depth as usize + n as usize] } else { Term::of(n as f64 + start) }
    }
}

impl Rest {
    fn add(&mut self, k: f64, share: f64, times: f64) {
        self.letters += times;
        self.share += times * share;
        self.x_ln_x += times * share * share.ln();
        self.psi += times * Term::of(k * share).psi;
    }

    /// Returns what is left without these letters: exactly nothing where they are all.
    fn without(&self, k: f64, letters: &[Letter]) -> Self {
        if letters.len() as f64 >= self.letters {
            return Self::default();
        }
        letters.iter().fold(*self, |rest, Letter { share, empty }| Self {
            letters: rest.letters - 1.0,
            share: rest.share - share,
            x_ln_x: rest.x_ln_x - share * (empty.ln - k.ln()),
            psi: rest.psi - empty.psi,
        })
    }
}

/// Returns ln sum e^x.
pub(super) fn ln_sum(logarithms: &[f64]) -> f64 {
    let largest = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + logarithms.iter().map(|ln| (ln - largest).exp()).sum::<f64>().ln()
}
