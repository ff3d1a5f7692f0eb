//! Empirical Bayes: the prior that all states of an environment suggest together, by
//! expectation-maximisation (Dempster, Laird & Rubin 1977). How many states are dependent, and how
//! strongly rows are drawn to their base.
//!
//! A table is read in both ways, columns that respond to rows and rows that respond to columns, and
//! the slabs of both are components of one mixture: so one fit serves both directions of a pair,
//! and the order of the variables changes nothing.

use super::base::Base;
use super::counted::Counted;
use super::habits::{Habits, Segments, Uses, margins};
use super::likelihood::{Likelihood, NullMixture};
use super::parameters::{ExpectedCounts, ExpectedFamilies, Parameters};
use super::state::{Round, State};
use crate::information::{Alphabet, Table};

/// Rounds of the fit, from [`Parameters::cold`]: without slabs of one deviating row, then with them
/// and the null's weights as they are, since their evidence depends on those.
const ROUNDS: [usize; 2] = [40, 80];

/// Observations from which a state takes part in a fit. Thousands of states of two or three
/// observations are all explained alike by no dependence in varied habits and by much dependence in
/// usual ones: fitted to them, the share of dependent states was .45 to .9 where .31 were.
const FEWEST_OBSERVATIONS: u64 = 6;

/// A prior fitted by empirical Bayes, whole: plain data, from which a [`Prior`](super::Prior) can
/// be made again to the bit.
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
        Self {
            alphabet,
            bases,
            parameters: Parameters::cold(),
            states: 0,
        }
    }
}

/// Gathers states and fits their prior by empirical Bayes: about 1.5 kB a state that can tell, none
/// for the others.
pub struct Fitter {
    alphabet: Alphabet,
    likelihoods: [Likelihood; 2],
    habits: Habits,
    /// kappa of both drivers.
    concentrations: [Option<f64>; 2],
    segments: [Segments; 2],
    states: Vec<State>,
}

impl Fitter {
    /// Begins a fit of a pair with these alphabets, whose letters all states of the environment use
    /// so.
    pub fn new(alphabet: Alphabet, uses: &Uses) -> Self {
        let [rows, columns] = uses.bases();
        let likelihoods = [
            Likelihood::new(alphabet.rows, columns),
            Likelihood::new(alphabet.columns, rows),
        ];
        let (habits, concentrations) = (uses.habits(), uses.concentrations());

        Self {
            alphabet,
            likelihoods,
            habits,
            concentrations,
            segments: Default::default(),
            states: Vec::new(),
        }
    }

    /// Adds a state by its tables, one for each joint action of the agents held fixed, and their
    /// parts by segment. Sums run in the order of adding, so that the same states in the same order
    /// give the same bits.
    ///
    /// Slices of one occupied row or column are left out: they are as likely either way, so they
    /// would leave the share of dependent states and the weights of the slabs where those settle
    /// without them. So are states of fewer than six observations.
    pub fn add<'a>(&mut self, counted: impl Into<Counted<'a>>) {
        let Counted { slices, parts } = counted.into();
        let telling = slices.iter().filter(|slice| !slice.is_line());
        let telling: Vec<[Table; 2]> = telling
            .map(|slice| [slice.clone(), slice.transposed()])
            .collect();
        let observations: u64 = telling.iter().map(|[slice, _]| slice.total()).sum();

        if observations >= FEWEST_OBSERVATIONS {
            let several = parts.iter().map(margins);
            (0..2).for_each(|side| {
                self.segments[side].add(several.clone().map(|margins| margins[side]))
            });
            self.states.push(State::new(
                &self.likelihoods,
                telling,
                slices.len() == 1,
                parts,
            ));
        }
    }

    /// Fits the hyperparameters by EM.
    pub fn fit(self) -> Fit {
        self.fit_while(&|| true).expect("nobody ends it")
    }

    /// Fits, asking before each round whether to go on; `None` where it was ended.
    pub fn fit_while(mut self, goes_on: &dyn Fn() -> bool) -> Option<Fit> {
        let mut parameters = Parameters::cold();
        for _ in 0..ROUNDS[0] {
            goes_on().then_some(())?;
            parameters = round(&self.states, &parameters);
        }

        self.look_for_deviants(&parameters, goes_on);
        let nulls = parameters.clone().sides.map(|side| side.nulls);

        for _ in 0..ROUNDS[1] {
            goes_on().then_some(())?;
            parameters = round(&self.states, &parameters);
            parameters
                .sides
                .iter_mut()
                .zip(&nulls)
                .for_each(|(side, nulls)| side.nulls.clone_from(nulls));
        }

        let [columns, rows] = self.likelihoods.map(|likelihood| likelihood.base);
        for (at, side) in parameters.sides.iter_mut().enumerate() {
            side.habit = self.concentrations[at];
            side.habit_in_segments = self.segments[at].concentration(self.habits.driver(at));
        }

        Some(Fit {
            alphabet: self.alphabet,
            bases: [rows, columns],
            parameters,
            states: self.states.len() as u64,
        })
    }

    fn look_for_deviants(&mut self, parameters: &Parameters, goes_on: &dyn Fn() -> bool) {
        for (side, likelihood) in self.likelihoods.iter().enumerate() {
            let nulls = NullMixture::new(&parameters.sides[side].nulls);
            let states = self.states.iter_mut().take_while(|_| goes_on());
            states.for_each(|state| state.look_for_deviants(side, likelihood, &nulls));
        }
    }
}

fn round(states: &[State], parameters: &Parameters) -> Parameters {
    let (mut dependent, mut expected) =
        (0.0, [ExpectedCounts::default(), ExpectedCounts::default()]);
    let mut segmented = ExpectedFamilies::default();
    let round = Round::new(parameters);

    for state in states {
        let responsibilities = state.responsibilities(&round);
        dependent += 1.0 - responsibilities.independent;
        state.expect(&responsibilities, &round, &mut expected, &mut segmented);
    }
    Parameters::estimated(states.len() as f64, dependent, &expected, segmented)
}
