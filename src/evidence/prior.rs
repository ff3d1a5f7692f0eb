//! From a fit and a state's tables to what is believed of that state.

use std::borrow::Cow;

use super::asymptotic::Estimate;
use super::deviants::Deviants;
use super::fit::Fit;
use super::habits::Habits;
use super::likelihood::Likelihood;
use super::moments::{Moments, Slice};
use super::parameters::SLABS;
use super::posterior::Posterior;
use super::side::Side;
use super::weights::Weights;
use crate::information::{Alphabet, Table};

/// The logarithm of a ratio that no sum of slabs would notice.
const NEGLIGIBLE: f64 = 50.0;

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

/// A table, and the same with rows and columns exchanged: as each side reads it.
pub(super) type Reading<'a> = [Cow<'a, Table>; 2];

/// Returns the tables of a state as each side reads them: those that were visited, or one that was not.
pub(super) fn readings(slices: &[Table]) -> Vec<Reading<'_>> {
    let visited: Vec<Reading<'_>> = slices.iter().filter(|slice| slice.total() > 0).map(reading).collect();
    if visited.is_empty() { vec![Reading::default()] } else { visited }
}

fn reading(slice: &Table) -> Reading<'_> {
    [Cow::Borrowed(slice), Cow::Owned(slice.transposed())]
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
        let weights = self.weights(&readings).condensed();
        let estimate = self.estimate(habits, &weights, &readings);
        let doubt = if estimate.is_some() { 0.0 } else { doubt(habits) };
        let slices = self.slices(habits, &readings, &weights.deviants);
        let part =
            |(side, slab, weight): (usize, usize, f64)| (weight, self.moments(side, slab, &slices).doubted(doubt));
        let parts = weights.present().map(part).collect();
        Posterior::new(weights.dependent, largest, parts, estimate)
    }

    /// Returns P(dependent) alone, which takes a fraction of the time of a whole [`posterior`](Self::posterior).
    pub fn dependent(&self, slices: &[Table]) -> f64 {
        if self.alphabet.largest_information() == 0.0 {
            return 0.0;
        }
        let telling = slices.iter().filter(|slice| !slice.is_line());
        self.weights(&telling.map(reading).collect::<Vec<_>>()).dependent
    }

    /// Returns the probabilities of dependence and of the slabs.
    pub(super) fn weights(&self, readings: &[Reading<'_>]) -> Weights {
        let mut slabs = [0, 1].map(|side| self.sides[side].ln_slabs);
        let said = |reading: &Reading<'_>| [0, 1].map(|side| self.sides[side].said(&reading[side], &mut slabs[side]));
        let deviants = readings.iter().map(said).collect();
        let largest = slabs.as_flattened().iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for ln in slabs.as_flattened_mut() {
            *ln = if *ln > largest - NEGLIGIBLE { (*ln - largest).exp() } else { 0.0 };
        }
        // Each side by itself, so that the order of the variables changes no bit.
        let sum = slabs[0].iter().sum::<f64>() + slabs[1].iter().sum::<f64>();
        slabs.as_flattened_mut().iter_mut().for_each(|part| *part /= sum);
        let prior = self.dependent;
        let odds = largest + sum.ln() + (prior / (1.0 - prior)).ln();
        let is_told = readings.iter().any(|[table, _]| !table.is_line());
        Weights { dependent: if is_told { 1.0 / (1.0 + (-odds).exp()) } else { prior }, slabs, deviants }
    }

    /// Looks at every slice from both sides.
    pub(super) fn slices<'a>(
        &self,
        habits: &'a Habits,
        readings: &'a [Reading<'_>],
        deviants: &'a [[Deviants; 2]],
    ) -> Vec<[Slice<'a>; 2]> {
        let slice = |(reading, deviants): (&'a Reading<'_>, &'a [Deviants; 2])| {
            [0, 1].map(|side| self.sides[side].slice(&reading[side], &deviants[side], habits.driver(side)))
        };
        readings.iter().zip(deviants).map(slice).collect()
    }

    /// Returns the moments of mutual information under a slab of a side.
    fn moments(&self, side: usize, slab: usize, slices: &[[Slice<'_>; 2]]) -> Moments {
        let total: f64 = slices.iter().map(|slice| slice[side].table.total() as f64).sum();
        slices.iter().fold(Moments::default(), |sum, slice| {
            let slice = &slice[side];
            let share = if total == 0.0 { 1.0 } else { slice.table.total() as f64 / total };
            let Moments { mean, variance, wide } = self.sides[side].moments(slab, slice);
            let square = share * share;
            Moments {
                mean: sum.mean + share * mean,
                variance: sum.variance + square * variance,
                wide: sum.wide + square * wide,
            }
        })
    }

    /// Returns what the table says by itself, if it was seen at least as often as it has pairs of letters in use.
    fn estimate(&self, habits: &Habits, weights: &Weights, readings: &[Reading<'_>]) -> Option<Estimate> {
        let [reading] = readings else { return None };
        let pairs = habits.driver(0).used * habits.driver(1).used;
        if reading[0].total() < pairs || pairs > MOST_ESTIMATED {
            return None;
        }
        let [rows, columns] = self.predicted_both_ways(habits, weights, reading, &weights.deviants[0]);
        let estimate = |side: usize, cells: &[f64]| Estimate::new(&reading[side], cells, self.sides[side].letters());
        // Read in both ways, so that the order of the variables changes no bit.
        Some(estimate(0, &rows).between(estimate(1, &columns)))
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
