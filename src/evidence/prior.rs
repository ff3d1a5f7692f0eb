//! From a fit and a state's tables to what is believed of that state.

use std::borrow::Cow;
use std::ops::Range;

use super::asymptotic::Estimate;
use super::deviants::Deviants;
use super::fit::Fit;
use super::habits::Habits;
use super::increments::add;
use super::likelihood::Likelihood;
use super::moments::{Moments, Policy};
use super::parameters::{DEVIANT_SLABS, FIXED, FIXED_GRID, OWN_SLABS, SLABS};
use super::posterior::Posterior;
use super::side::Side;
use crate::information::{Alphabet, Table};

/// The share of all slabs' posterior weight that moments are found for: the lighter ones change nothing, and there are many.
const WEIGHED: f64 = 0.9;

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

/// The probabilities of a state's hypotheses.
pub(super) struct Weights {
    pub dependent: f64,
    /// Given dependence, those of the slabs of each side; all sum to 1.
    pub slabs: [[f64; SLABS]; 2],
    /// What the rows of each slice say for deviating, as each side reads them.
    pub deviants: Vec<[Deviants; 2]>,
}

impl Weights {
    /// Returns the side, the number and the weight of the heaviest slabs, which have this share of the weight together.
    pub fn heaviest(&self, share: f64) -> Vec<(usize, usize, f64)> {
        let numbered = |side: usize| self.slabs[side].iter().enumerate().map(move |(slab, weight)| (side, slab, *weight));
        heaviest((0..2).flat_map(numbered).filter(|(.., weight)| *weight > 0.0).collect(), share)
    }

    /// Returns the same with fewer slabs to find moments for: what is light is taken together.
    fn condensed(self) -> Self {
        let mut slabs = [[0.0; SLABS]; 2];
        let grouped = Self { slabs: self.slabs.map(|side| grouped(&side)), ..self };
        grouped.heaviest(WEIGHED).into_iter().for_each(|(side, slab, weight)| slabs[side][slab] = weight);
        Self { slabs, ..grouped }
    }
}

/// Returns the weights of a side's slabs with those of neighbours in concentration given to the heaviest of them, where they are light together; and with those
/// of all slabs of one deviating row, which differ little but in which row it is.
fn grouped(slabs: &[f64; SLABS]) -> [f64; SLABS] {
    /// Concentrations that differ by not much more than a factor of four, and what they may weigh.
    const NEIGHBOURS: usize = 3;
    const LIGHT: f64 = 0.05;
    let mut grouped = [0.0; SLABS];
    let mut give = |group: Range<usize>| {
        let heaviest = group.clone().max_by(|a, b| slabs[*a].total_cmp(&slabs[*b])).unwrap_or(group.start);
        grouped[heaviest] = slabs[group].iter().sum();
    };
    for Range { start: mut from, end } in [0..FIXED_GRID, FIXED_GRID..FIXED, OWN_SLABS] {
        while from < end {
            let is_light = |to: &usize| slabs[from..*to].iter().sum::<f64>() <= LIGHT;
            let to = (from + 2..=end.min(from + NEIGHBOURS)).take_while(is_light).last().unwrap_or(from + 1);
            give(from..to);
            from = to;
        }
    }
    give(DEVIANT_SLABS);
    grouped
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
pub(super) type Reading<'a> = [Cow<'a, Table>; 2];

/// Returns the tables of a state as each side reads them; those without visits are left out.
pub(super) fn readings(slices: &[Table]) -> Vec<Reading<'_>> {
    slices.iter().filter(|slice| slice.total() > 0).map(reading).collect()
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
        let part = |(side, slab, weight): (usize, usize, f64)| {
            (weight, self.moments(side, slab, habits, &readings, &weights.deviants).doubted(doubt))
        };
        let parts = weights.heaviest(1.0).into_iter().map(part).collect();
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
        let mut logarithms = [0, 1].map(|side| self.sides[side].ln_slabs);
        let mut informed = false;
        let mut deviants = Vec::with_capacity(readings.len());
        for reading in readings {
            let said = [0, 1].map(|side| self.sides[side].said(&reading[side]));
            for (logarithms, said) in logarithms.iter_mut().zip(&said) {
                let Some(relative) = &said.relative else { continue };
                add(logarithms, relative);
                informed = true;
            }
            deviants.push(said.map(|said| said.deviants));
        }
        let largest = logarithms.iter().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
        let part = |ln: f64| if ln > largest - NEGLIGIBLE { (ln - largest).exp() } else { 0.0 };
        let parts = logarithms.map(|side| side.map(part));
        // Each side by itself, so that the order of the variables changes no bit.
        let sum = parts[0].iter().sum::<f64>() + parts[1].iter().sum::<f64>();
        let slabs = parts.map(|side| side.map(|part| part / sum));
        let prior = self.dependent;
        let odds = largest + sum.ln() + (prior / (1.0 - prior)).ln();
        Weights { dependent: if informed { 1.0 / (1.0 + (-odds).exp()) } else { prior }, slabs, deviants }
    }

    /// Returns what the rows of a slice without visits say for deviating.
    pub(super) fn unvisited(&self) -> [Deviants; 2] {
        [0, 1].map(|side| Deviants::none(self.sides[side].likelihood.drivers))
    }

    /// Returns the moments of mutual information under a slab of a side.
    fn moments(
        &self,
        side: usize,
        slab: usize,
        habits: &Habits,
        readings: &[Reading<'_>],
        deviants: &[[Deviants; 2]],
    ) -> Moments {
        let total: f64 = readings.iter().map(|[slice, _]| slice.total() as f64).sum();
        if total == 0.0 {
            return self.slice_moments(side, slab, habits, &Table::default(), &self.unvisited()[side]);
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
        deviants: &Deviants,
    ) -> Moments {
        self.sides[side].moments(slab, table, deviants, &self.policy(side, habits, table))
    }

    /// Returns the policy of the driver of a side.
    pub(super) fn policy<'a>(&self, side: usize, habits: &'a Habits, table: &Table) -> Policy<'a> {
        Policy::new(table, habits.driver(side), self.sides[side].habit)
    }

    /// Returns what the table says by itself, if it was seen at least as often as it has pairs of letters in use.
    fn estimate(&self, habits: &Habits, weights: &Weights, readings: &[Reading<'_>]) -> Option<Estimate> {
        let [reading] = readings else { return None };
        let pairs = habits.driver(0).used * habits.driver(1).used;
        if reading[0].total() < pairs || pairs > MOST_ESTIMATED {
            return None;
        }
        let [rows, columns] = self.predicted_both_ways(habits, weights, reading, &weights.deviants[0]);
        let estimate =
            |side: usize, cells: &[f64]| Estimate::new(&reading[side], cells, self.sides[side].letters());
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
