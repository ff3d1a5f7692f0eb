//! From a fit and a state's tables to what is believed of that state.

use super::asymptotic::Estimate;
use super::fit::Fit;
use super::habits::Habits;
use super::increments::add;
use super::likelihood::Likelihood;
use super::moments::{Moments, Policy};
use super::parameters::{DEVIANT_SLABS, SLABS};
use super::posterior::Posterior;
use super::side::{DeviantRows, Side};
use crate::information::{Alphabet, Table};

/// The share of all slabs' posterior weight that moments are found for: the lighter ones change nothing, and there are many.
const WEIGHED: f64 = 0.9;

/// The most pairs of letters in use for which a table's own estimate is made: it looks at every one of them.
const MOST_ESTIMATED: u64 = 65_536;

/// A fit made ready to answer with: shared by any number of threads.
pub struct Prior {
    pub(super) alphabet: Alphabet,
    /// pi.
    dependent: f64,
    /// Columns that respond to rows, and rows that respond to columns.
    pub(super) sides: [Side; 2],
    habits: Habits,
    unseen: Posterior,
}

/// The probabilities of a state's hypotheses.
pub(super) struct Weights {
    pub dependent: f64,
    /// Given dependence, those of the slabs of each side; all sum to 1.
    pub slabs: [[f64; SLABS]; 2],
    /// What the rows of each slice say for deviating, as each side reads them.
    pub deviants: Vec<[DeviantRows; 2]>,
}

impl Weights {
    /// Returns the side, the number and the weight of the heaviest slabs, which have this share of the weight together.
    pub fn heaviest(&self, share: f64) -> Vec<(usize, usize, f64)> {
        heaviest((0..2).flat_map(|side| numbered(side, &self.slabs[side], 0..SLABS)).collect(), share)
    }

    /// Returns the same, but of the slabs of one deviating row only the heaviest of each side, for all of them: they differ little but in which row it is.
    pub fn summed(&self, share: f64) -> Vec<(usize, usize, f64)> {
        let side = |side: usize| {
            let slabs = &self.slabs[side];
            let deviants = numbered(side, slabs, DEVIANT_SLABS);
            let weight = slabs[DEVIANT_SLABS].iter().sum();
            let heaviest = deviants.max_by(|a, b| a.2.total_cmp(&b.2)).map(|(side, slab, _)| (side, slab, weight));
            numbered(side, slabs, 0..DEVIANT_SLABS.start).chain(heaviest)
        };
        heaviest((0..2).flat_map(side).collect(), share)
    }
}

fn numbered(
    side: usize,
    slabs: &[f64; SLABS],
    range: std::ops::Range<usize>,
) -> impl Iterator<Item = (usize, usize, f64)> + use<'_> {
    range.map(move |slab| (side, slab, slabs[slab]))
}

/// Returns those of the heaviest weights that have this share together, in their order.
fn heaviest(mut weights: Vec<(usize, usize, f64)>, share: f64) -> Vec<(usize, usize, f64)> {
    let mut ordered: Vec<f64> = weights.iter().map(|(.., weight)| *weight).collect();
    ordered.sort_unstable_by(|a, b| b.total_cmp(a));
    let mut left = share;
    let lightest = ordered.into_iter().find(|weight| {
        left -= weight;
        left <= 0.0
    });
    weights.retain(|(.., weight)| *weight >= lightest.unwrap_or(0.0));
    weights
}

/// A table, and the same with rows and columns exchanged: as each side reads it.
pub(super) type Reading = [Table; 2];

/// Returns the tables of a state as each side reads them; those without visits are left out.
pub(super) fn readings(slices: &[Table]) -> Vec<Reading> {
    slices.iter().filter(|slice| slice.total() > 0).map(|slice| [slice.clone(), slice.transposed()]).collect()
}

impl Prior {
    /// Makes a fit ready.
    ///
    /// # Panics
    ///
    /// If the bases, the weights or the alphabets of the fit do not belong together.
    pub fn new(fit: &Fit) -> Self {
        let Fit { alphabet, bases: [rows, columns], parameters, .. } = fit;
        assert_eq!(rows.shares().len() as u64, alphabet.rows, "a base has one share for each letter of the rows");
        assert_eq!(
            columns.shares().len() as u64,
            alphabet.columns,
            "a base has one share for each letter of the columns"
        );
        assert!(parameters.sides.iter().all(|side| side.slabs.len() == SLABS), "one weight for each slab");
        let [first, second] = &parameters.sides;
        let sides = [
            Side::new(Likelihood::new(alphabet.rows, columns.clone()), first),
            Side::new(Likelihood::new(alphabet.columns, rows.clone()), second),
        ];
        let mut prior = Self {
            alphabet: *alphabet,
            dependent: parameters.dependent,
            sides,
            habits: Habits::of([rows, columns]),
            unseen: Posterior::impossible(),
        };
        prior.unseen = prior.sampled_unseen().unwrap_or_else(|| prior.posterior(&prior.habits, &[]));
        prior
    }

    /// Returns the habits of the environment when it was fitted.
    pub fn habits(&self) -> &Habits {
        &self.habits
    }

    /// Returns what is believed of a state that was never seen.
    pub fn unseen(&self) -> &Posterior {
        &self.unseen
    }

    /// Returns what the counts of a state let one believe: its table, or one table for each joint action of the agents held fixed; `habits` are those of the
    /// environment by now.
    ///
    /// Over several slices the evidence adds up. Mutual information is then its mean over the slices, weighted by their visits; under each slab the
    /// slices are independent, so that its variance is sum_c (n_c / N)^2 variance_c.
    pub fn posterior(&self, habits: &Habits, slices: &[Table]) -> Posterior {
        let largest = habits.largest_information();
        if largest == 0.0 {
            return Posterior::impossible();
        }
        let readings = readings(slices);
        let weights = self.weights(&readings);
        let estimate = self.estimate(habits, &weights, &readings);
        let doubt = if estimate.is_some() { 0.0 } else { doubt(habits) };
        let part = |(side, slab, weight): (usize, usize, f64)| {
            (weight, self.moments(side, slab, habits, &readings, &weights.deviants).doubted(doubt))
        };
        let parts = weights.summed(WEIGHED).into_iter().map(part).collect();
        Posterior::new(weights.dependent, largest, parts, estimate)
    }

    /// Returns P(dependent) alone, which takes a fraction of the time of a whole [`posterior`](Self::posterior).
    pub fn dependent(&self, slices: &[Table]) -> f64 {
        if self.alphabet.largest_information() == 0.0 { 0.0 } else { self.weights(&readings(slices)).dependent }
    }

    /// Returns the probabilities of dependence and of the slabs.
    pub(super) fn weights(&self, readings: &[Reading]) -> Weights {
        let mut logarithms = [0, 1].map(|side| self.sides[side].ln_slabs);
        let mut informed = false;
        let deviant_rows = |reading: &Reading| [0, 1].map(|side| self.sides[side].deviant_rows(&reading[side]));
        let deviants: Vec<[DeviantRows; 2]> = readings.iter().map(deviant_rows).collect();
        for (reading, deviants) in readings.iter().zip(&deviants) {
            for (side, table) in reading.iter().enumerate() {
                let Some(relative) = self.sides[side].ln_relative(table, &deviants[side]) else { continue };
                add(&mut logarithms[side], relative);
                informed = true;
            }
        }
        let largest = logarithms.iter().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
        let parts = logarithms.map(|side| side.map(|ln| (ln - largest).exp()));
        // Each side by itself, so that the order of the variables changes no bit.
        let sum = parts[0].iter().sum::<f64>() + parts[1].iter().sum::<f64>();
        let slabs = parts.map(|side| side.map(|part| part / sum));
        let prior = self.dependent;
        let odds = largest + sum.ln() + (prior / (1.0 - prior)).ln();
        Weights { dependent: if informed { 1.0 / (1.0 + (-odds).exp()) } else { prior }, slabs, deviants }
    }

    /// Returns the moments of mutual information under a slab of a side.
    fn moments(
        &self,
        side: usize,
        slab: usize,
        habits: &Habits,
        readings: &[Reading],
        deviants: &[[DeviantRows; 2]],
    ) -> Moments {
        let total: f64 = readings.iter().map(|[slice, _]| slice.total() as f64).sum();
        if total == 0.0 {
            return self.slice_moments(side, slab, habits, &Table::default(), &DeviantRows::new());
        }
        readings.iter().zip(deviants).fold(Moments::default(), |sum, (reading, deviants)| {
            let share = reading[side].total() as f64 / total;
            let table = &reading[side];
            let Moments { mean, variance, wide } = self.slice_moments(side, slab, habits, table, &deviants[side]);
            let square = share * share;
            Moments {
                mean: sum.mean + share * mean,
                variance: sum.variance + square * variance,
                wide: sum.wide + square * wide,
            }
        })
    }

    /// Returns the moments of a slice under a slab of a side, as that side reads it.
    pub(super) fn slice_moments(
        &self,
        side: usize,
        slab: usize,
        habits: &Habits,
        table: &Table,
        deviants: &DeviantRows,
    ) -> Moments {
        self.sides[side].moments(slab, table, deviants, &self.policy(side, habits, table))
    }

    /// Returns the policy of the driver of a side.
    pub(super) fn policy<'a>(&self, side: usize, habits: &'a Habits, table: &Table) -> Policy<'a> {
        Policy::new(table, habits.driver(side), self.sides[side].habit)
    }

    /// Returns what the table says by itself, if it was seen at least as often as it has pairs of letters in use.
    fn estimate(&self, habits: &Habits, weights: &Weights, readings: &[Reading]) -> Option<Estimate> {
        let [reading] = readings else { return None };
        let pairs = habits.driver(0).used * habits.driver(1).used;
        if reading[0].total() < pairs || pairs > MOST_ESTIMATED {
            return None;
        }
        let estimate = |side: usize| {
            let cells = self.predicted(side, habits, weights, reading, &weights.deviants[0]);
            Estimate::new(&reading[side], &cells, self.sides[side].letters())
        };
        // Read in both ways, so that the order of the variables changes no bit.
        Some(estimate(0).between(estimate(1)))
    }
}

/// Returns by which part of itself what a slab says is uncertain where the table says too little by itself: the slabs' rows are of one family, and in a large
/// table dozens of rows make them certain of its shape, whatever the truth is (one letter of each row's own, say, among all others).
fn doubt(habits: &Habits) -> f64 {
    /// In the largest alphabets, and the pairs of letters up to which there is none.
    const MOST: f64 = 0.25;
    const NONE: f64 = 100.0;
    let pairs = (habits.driver(0).used * habits.driver(1).used) as f64;
    MOST * (1.0 - NONE / pairs).max(0.0)
}

/// Returns ln sum e^x.
pub(super) fn ln_sum(logarithms: &[f64]) -> f64 {
    let largest = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    largest + logarithms.iter().map(|ln| (ln - largest).exp()).sum::<f64>().ln()
}
