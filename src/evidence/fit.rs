//! What all states of an environment say together: how many are dependent, and how strongly rows are drawn to their base. By expectation and
//! maximisation (Dempster, Laird & Rubin 1977); one fit serves both directions of a pair, since mutual information is symmetric.

use super::base::Base;
use super::likelihood::Likelihood;
use super::parameters::{FIXED, NULLS, Parameters, SLAB_GRID, SLABS};
use crate::information::{Alphabet, Table};

/// Rounds of the fit, from [`Parameters::cold`].
const ROUNDS: usize = 80;

/// A fit, whole: plain data, from which a [`Prior`](super::Prior) can be made again to the bit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The alphabets of the pair; rows are the actions of the earlier variable.
    pub alphabet: Alphabet,
    /// What the later variable does on the whole.
    pub base: Base,
    /// What was found.
    pub parameters: Parameters,
    /// The states it was found from: those whose tables can tell dependence from independence.
    pub states: u64,
}

impl Fit {
    /// Returns what is supposed before any state was fitted.
    pub fn cold(alphabet: Alphabet, base: Base) -> Self {
        Self { alphabet, base, parameters: Parameters::cold(), states: 0 }
    }
}

/// Gathers states and fits them: about 450 bytes a state that can tell, none for the others.
pub struct Fitter {
    likelihood: Likelihood,
    states: Vec<State>,
}

/// What one state says, as multiples of its likeliest component.
struct State {
    nulls: Vec<Scaled<NULLS>>,
    anchors: Vec<Scaled<NULLS>>,
    fixed: Scaled<FIXED>,
    own: Scaled<SLAB_GRID>,
}

/// The numbers `parts` times e^`ln_scale`; the largest part is 1.
struct Scaled<const L: usize> {
    ln_scale: f64,
    parts: [f64; L],
}

impl<const L: usize> Scaled<L> {
    fn new(logarithms: [f64; L]) -> Self {
        let ln_scale = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Self { ln_scale, parts: logarithms.map(|ln| (ln - ln_scale).exp()) }
    }

    fn ln_weighted(&self, weights: &[f64]) -> f64 {
        self.ln_scale + self.weighted(weights).ln()
    }

    fn weighted(&self, weights: &[f64]) -> f64 {
        self.parts.iter().zip(weights).map(|(part, weight)| part * weight).sum()
    }

    /// Adds a number of states to the components, in proportion to their weighted parts.
    fn share(&self, states: f64, weights: &[f64], expected: &mut [f64]) {
        let scale = states / self.weighted(weights);
        for ((expected, part), weight) in expected.iter_mut().zip(self.parts).zip(weights) {
            *expected += scale * part * weight;
        }
    }
}

impl Fitter {
    /// Begins a fit of a pair with these alphabets, whose later variable has this base.
    pub fn new(alphabet: Alphabet, base: Base) -> Self {
        Self { likelihood: Likelihood::new(alphabet, base), states: Vec::new() }
    }

    /// Adds a state by its tables, one for each joint action of the agents held fixed. Sums run in the order of adding, so that the same states in
    /// the same order give the same bits.
    ///
    /// Slices of one occupied row or column are left out: they are as likely either way, so they would leave the share of dependent states and the
    /// weights of the slabs where those settle without them.
    pub fn add(&mut self, slices: &[Table]) {
        let (mut fixed, mut own) = ([0.0; FIXED], [0.0; SLAB_GRID]);
        let (mut nulls, mut anchors) = (Vec::new(), Vec::new());
        for slice in slices {
            let Some(evidence) = self.likelihood.evidence(slice) else { continue };
            nulls.push(Scaled::new(evidence.nulls));
            anchors.extend(evidence.anchor.map(Scaled::new));
            super::increments::add(&mut fixed, evidence.fixed);
            super::increments::add(&mut own, evidence.own);
        }
        if !nulls.is_empty() {
            self.states.push(State { nulls, anchors, fixed: Scaled::new(fixed), own: Scaled::new(own) });
        }
    }

    /// Fits.
    pub fn fit(self) -> Fit {
        let mut parameters = Parameters::cold();
        for _ in 0..ROUNDS {
            parameters = round(&self.states, &parameters);
        }
        let Likelihood { alphabet, base, .. } = self.likelihood;
        Fit { alphabet, base, parameters, states: self.states.len() as u64 }
    }
}

fn round(states: &[State], parameters: &Parameters) -> Parameters {
    let (mut dependent, mut nulls, mut slabs) = (0.0, [0.0; NULLS], [0.0; SLABS]);
    for state in states {
        let [independent, fixed, own] = state.shares(parameters);
        dependent += fixed + own;
        state.fixed.share(fixed, &parameters.slabs[..FIXED], &mut slabs[..FIXED]);
        state.own.share(own, &parameters.slabs[FIXED..], &mut slabs[FIXED..]);
        // Slabs on the state's own marginal are likelihoods relative to the null, and go through it.
        for slice in &state.nulls {
            slice.share(independent + own, &parameters.nulls, &mut nulls);
        }
        for slice in &state.anchors {
            slice.share(fixed, &parameters.nulls, &mut nulls);
        }
    }
    Parameters::estimated(states.len() as f64, dependent, &nulls, &slabs)
}

impl State {
    /// Returns the probabilities of independence, of the slabs on fixed bases, and of those on the state's own marginal.
    fn shares(&self, parameters: &Parameters) -> [f64; 3] {
        let shared =
            |slices: &[Scaled<NULLS>]| -> f64 { slices.iter().map(|slice| slice.ln_weighted(&parameters.nulls)).sum() };
        let (null, dependent) = (shared(&self.nulls), parameters.dependent.ln());
        normalised([
            null + (-parameters.dependent).ln_1p(),
            dependent + self.fixed.ln_weighted(&parameters.slabs[..FIXED]) + shared(&self.anchors),
            dependent + self.own.ln_weighted(&parameters.slabs[FIXED..]) + null,
        ])
    }
}

/// Returns numbers in proportion to e^x that sum to 1.
pub(super) fn normalised<const L: usize>(logarithms: [f64; L]) -> [f64; L] {
    let Scaled { parts, .. } = Scaled::new(logarithms);
    let sum: f64 = parts.iter().sum();
    parts.map(|part| part / sum)
}
