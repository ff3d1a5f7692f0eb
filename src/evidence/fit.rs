//! What all states of an environment say together: how many are dependent, and how strongly rows are drawn to their base. By expectation and
//! maximisation (Dempster, Laird & Rubin 1977).
//!
//! A table is read in both ways, columns that respond to rows and rows that respond to columns, and the slabs of both are components of one mixture: so
//! one fit serves both directions of a pair, and the order of the variables changes nothing.

use super::base::Base;
use super::habits::Uses;
use super::increments::add;
use super::likelihood::{Likelihood, NullMixture, columns};
use super::parameters::{
    DEVIANT_SLABS, DEVIANTS, Expected, FIXED, NULLS, OWN_GRID, OWN_SLABS, Parameters, SideParameters,
};
use crate::information::{Alphabet, Table};

/// Rounds of the fit, from [`Parameters::cold`]: without slabs of one deviating row, then with them and the null's weights as they are, since their
/// evidence depends on those.
const ROUNDS: [usize; 2] = [40, 80];

/// Draws from which a state takes part in a fit. Thousands of states of two or three draws are all explained alike by no dependence in varied habits and by
/// much dependence in usual ones: fitted to them, the share of dependent states was .45 to .9 where .31 were.
const FEWEST_DRAWS: u64 = 6;

/// A fit, whole: plain data, from which a [`Prior`](super::Prior) can be made again to the bit.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The alphabets of the pair; rows are the actions of the earlier variable.
    pub alphabet: Alphabet,
    /// What the earlier variable does on the whole, and what the later one does.
    pub bases: [Base; 2],
    /// What was found.
    pub parameters: Parameters,
    /// The states it was found from: those whose tables can tell dependence from independence.
    pub states: u64,
}

impl Fit {
    /// Returns what is supposed before any state was fitted.
    pub fn cold(alphabet: Alphabet) -> Self {
        let base = |letters: u64| Base::new(&vec![0; letters as usize]);
        let bases = [base(alphabet.rows), base(alphabet.columns)];
        Self { alphabet, bases, parameters: Parameters::cold(), states: 0 }
    }
}

/// Gathers states and fits them: about 1.5 kB a state that can tell, none for the others.
pub struct Fitter {
    alphabet: Alphabet,
    likelihoods: [Likelihood; 2],
    habits: [Option<f64>; 2],
    states: Vec<State>,
}

/// What one state says, as multiples of its likeliest component, in either way to read it.
struct State {
    slices: Vec<[Table; 2]>,
    sides: [Side; 2],
}

/// What one state says where its columns respond to its rows.
struct Side {
    nulls: Vec<Scaled<NULLS>>,
    anchors: Vec<Scaled<NULLS>>,
    fixed: Scaled<FIXED>,
    /// Relative to the null, as are the deviants.
    own: Scaled<OWN_GRID>,
    deviants: Option<Scaled<DEVIANTS>>,
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
    /// Begins a fit of a pair with these alphabets, whose letters all states of the environment use so.
    pub fn new(alphabet: Alphabet, uses: &Uses) -> Self {
        let [rows, columns] = uses.bases();
        let likelihoods = [Likelihood::new(alphabet.rows, columns), Likelihood::new(alphabet.columns, rows)];
        Self { alphabet, likelihoods, habits: uses.concentrations(), states: Vec::new() }
    }

    /// Adds a state by its tables, one for each joint action of the agents held fixed. Sums run in the order of adding, so that the same states in
    /// the same order give the same bits.
    ///
    /// Slices of one occupied row or column are left out: they are as likely either way, so they would leave the share of dependent states and the
    /// weights of the slabs where those settle without them. So are states of fewer than six draws.
    pub fn add(&mut self, slices: &[Table]) {
        let telling = slices.iter().filter(|slice| !slice.is_line());
        let telling: Vec<[Table; 2]> = telling.map(|slice| [slice.clone(), slice.transposed()]).collect();
        let draws: u64 = telling.iter().map(|[slice, _]| slice.total()).sum();
        if draws >= FEWEST_DRAWS {
            let side = |side: usize| Side::new(&self.likelihoods[side], telling.iter().map(|slice| &slice[side]));
            self.states.push(State { sides: [side(0), side(1)], slices: telling });
        }
    }

    /// Fits.
    pub fn fit(mut self) -> Fit {
        let mut parameters = Parameters::cold();
        for _ in 0..ROUNDS[0] {
            parameters = round(&self.states, &parameters);
        }
        self.look_for_deviants(&parameters);
        let nulls = parameters.clone().sides.map(|side| side.nulls);
        for _ in 0..ROUNDS[1] {
            parameters = round(&self.states, &parameters);
            parameters.sides.iter_mut().zip(&nulls).for_each(|(side, nulls)| side.nulls.clone_from(nulls));
        }
        let [columns, rows] = self.likelihoods.map(|likelihood| likelihood.base);
        parameters.sides.iter_mut().zip(self.habits).for_each(|(side, habit)| side.habit = habit);
        Fit { alphabet: self.alphabet, bases: [rows, columns], parameters, states: self.states.len() as u64 }
    }

    fn look_for_deviants(&mut self, parameters: &Parameters) {
        for (side, likelihood) in self.likelihoods.iter().enumerate() {
            let nulls = NullMixture::new(&parameters.sides[side].nulls);
            for state in &mut self.states {
                let mut deviants = [0.0; DEVIANTS];
                for slice in &state.slices {
                    let null = nulls.given(&likelihood.shared(columns(&slice[side]), slice[side].total()));
                    add(&mut deviants, &likelihood.deviants(&slice[side], &nulls, &null).evidence());
                }
                state.sides[side].deviants = Some(Scaled::new(deviants));
            }
        }
    }
}

fn round(states: &[State], parameters: &Parameters) -> Parameters {
    let (mut dependent, mut expected) = (0.0, [Expected::default(), Expected::default()]);
    for state in states {
        let shares = state.shares(parameters);
        dependent += shares[0].iter().sum::<f64>() + shares[1].iter().sum::<f64>();
        for (at, side) in state.sides.iter().enumerate() {
            side.expect(shares[at], &parameters.sides[at], &mut expected[at]);
        }
    }
    Parameters::estimated(states.len() as f64, dependent, &expected)
}

impl State {
    /// Returns the probabilities of its hypotheses, for each side: of the slabs on fixed bases, of those on the state's own marginal, and of the deviants. What
    /// is left is independence.
    fn shares(&self, parameters: &Parameters) -> [[f64; 3]; 2] {
        let ln_dependent = parameters.dependent.ln();
        let sides = [0, 1].map(|at| self.sides[at].ln_hypotheses(&parameters.sides[at]).map(|ln| ln + ln_dependent));
        let independent = (-parameters.dependent).ln_1p();
        let largest = sides.iter().flatten().fold(independent, |largest, ln| largest.max(*ln));
        let parts = sides.map(|side| side.map(|ln| (ln - largest).exp()));
        // Each side by itself, so that the order of the variables changes no bit.
        let dependent = parts[0].iter().sum::<f64>() + parts[1].iter().sum::<f64>();
        let total = (independent - largest).exp() + dependent;
        parts.map(|side| side.map(|part| part / total))
    }
}

impl Side {
    fn new<'a>(likelihood: &Likelihood, slices: impl Iterator<Item = &'a Table>) -> Self {
        let (mut fixed, mut own) = ([0.0; FIXED], [0.0; OWN_GRID]);
        let (mut nulls, mut anchors) = (Vec::new(), Vec::new());
        for evidence in slices.map(|slice| likelihood.evidence(slice)) {
            nulls.push(Scaled::new(evidence.nulls));
            anchors.extend(evidence.anchor.map(Scaled::new));
            add(&mut fixed, &evidence.fixed);
            add(&mut own, &evidence.own);
        }
        Self { nulls, anchors, fixed: Scaled::new(fixed), own: Scaled::new(own), deviants: None }
    }

    /// Returns, relative to the null, how likely the state is under all slabs on fixed bases, on its own marginal, and of one deviating row.
    fn ln_hypotheses(&self, SideParameters { nulls, slabs, .. }: &SideParameters) -> [f64; 3] {
        let shared = |slices: &[Scaled<NULLS>]| -> f64 { slices.iter().map(|slice| slice.ln_weighted(nulls)).sum() };
        [
            self.fixed.ln_weighted(&slabs[..FIXED]) + shared(&self.anchors) - shared(&self.nulls),
            self.own.ln_weighted(&slabs[OWN_SLABS]),
            self.deviants.as_ref().map_or(f64::NEG_INFINITY, |deviants| deviants.ln_weighted(&slabs[DEVIANT_SLABS])),
        ]
    }

    /// Adds the state to the components in proportion to their probabilities.
    fn expect(&self, [fixed, own, deviant]: [f64; 3], parameters: &SideParameters, expected: &mut Expected) {
        let SideParameters { nulls, slabs, .. } = parameters;
        self.fixed.share(fixed, &slabs[..FIXED], &mut expected.slabs[..FIXED]);
        self.own.share(own, &slabs[OWN_SLABS], &mut expected.slabs[OWN_SLABS]);
        if let Some(deviants) = &self.deviants {
            deviants.share(deviant, &slabs[DEVIANT_SLABS], &mut expected.slabs[DEVIANT_SLABS]);
        }
        // Only slabs on fixed bases do without the null's response.
        self.nulls.iter().for_each(|slice| slice.share(1.0 - fixed, nulls, &mut expected.nulls));
        self.anchors.iter().for_each(|slice| slice.share(fixed, nulls, &mut expected.nulls));
    }
}

/// Returns numbers in proportion to e^x that sum to 1.
pub(super) fn normalised<const L: usize>(logarithms: [f64; L]) -> [f64; L] {
    let Scaled { parts, .. } = Scaled::new(logarithms);
    let sum: f64 = parts.iter().sum();
    parts.map(|part| part / sum)
}
