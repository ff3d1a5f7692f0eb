//! The spike-and-slab prior at work: from a fit and a state's tables to its posterior.

use super::asymptotic::Estimate;
use super::counted::Counted;
use super::cut::SegmentWeights;
use super::deviants::Deviants;
use super::fit::Fit;
use super::habits::Habits;
use super::likelihood::Likelihood;
use super::moments::{Moments, Slice};
use super::parameters::SLABS;
use super::posterior::Posterior;
use super::readings::{Parts, Reading, Readings, reading};
use super::side::{Side, StateMargins};
use super::weights::{Segments, Weights, normalise};
use crate::information::{Alphabet, Table};

/// The most pairs of letters in use for which a table's own estimate is made: it looks at every one
/// of them.
const MOST_ESTIMATED: u64 = 65_536;

/// The probability of habits that differ by segment up to which a pooled table tells by itself.
const ALIKE: f64 = 0.05;

/// A fitted spike-and-slab prior, made ready to answer with: shared by any number of threads.
pub struct Prior {
    pub(super) alphabet: Alphabet,
    /// pi.
    dependent: f64,
    /// Columns that respond to rows, and rows that respond to columns.
    pub(super) sides: [Side; 2],
    pub(super) segments: SegmentWeights,
    habits: Habits,
    unseen: Posterior,
}

impl Prior {
    /// Makes a fit ready.
    ///
    /// # Panics
    ///
    /// If the bases, the weights or the alphabets of the fit do not belong together.
    pub fn new(fit: &Fit) -> Self {
        let Fit {
            alphabet,
            bases: [rows, columns],
            parameters,
            ..
        } = fit;

        assert_eq!(
            rows.shares().len() as u64,
            alphabet.rows,
            "a base has one share for each letter of the rows"
        );
        assert_eq!(
            columns.shares().len() as u64,
            alphabet.columns,
            "a base has one share for each letter of the columns"
        );
        assert!(
            parameters
                .sides
                .iter()
                .all(|side| side.slabs.len() == SLABS),
            "one weight for each slab"
        );

        let [first, second] = &parameters.sides;
        let sides = [
            Side::new(Likelihood::new(alphabet.rows, columns.clone()), first),
            Side::new(Likelihood::new(alphabet.columns, rows.clone()), second),
        ];

        let mut prior = Self {
            alphabet: *alphabet,
            dependent: parameters.dependent,
            sides,
            segments: SegmentWeights::new(parameters),
            habits: Habits::from_bases([rows, columns]),
            unseen: Posterior::impossible(),
        };

        prior.unseen = prior
            .sampled_unseen()
            .unwrap_or_else(|| prior.posterior(&prior.habits, &[] as &[Table]));
        prior
    }

    /// Returns the habits of the environment when it was fitted.
    pub fn habits(&self) -> &Habits {
        &self.habits
    }

    /// Returns the prior distribution of mutual information: what is believed of a state that was
    /// never seen.
    pub fn unseen(&self) -> &Posterior {
        &self.unseen
    }

    /// Returns the posterior of mutual information, given the counts of a state: its table, or one
    /// table for each joint action of the agents held fixed, and their parts by segment; `habits`
    /// are those of the environment by now.
    ///
    /// Over several slices the evidence adds up. Mutual information is then its mean over the
    /// slices, weighted by their visits; under each slab the slices are independent, so that its
    /// variance is sum_c (n_c / N)^2 variance_c. Where parts are told, it is that within segments.
    pub fn posterior<'a>(&self, habits: &Habits, counted: impl Into<Counted<'a>>) -> Posterior {
        let largest = habits.largest_information();
        if largest == 0.0 {
            return Posterior::impossible();
        }

        let readings = Readings::new(counted.into());
        let weights = self.weights(&readings).condensed();
        let estimate = self.estimate(habits, &weights, &readings.wholes);

        let doubt = if estimate.is_some() {
            0.0
        } else {
            doubt(habits).max(doubt_of_segments(habits, &weights, &readings))
        };

        let parts = self.weighed(habits, &weights, &readings);
        let parts = parts
            .into_iter()
            .map(|(weight, moments)| (weight, moments.doubted(doubt)))
            .collect();

        Posterior::new(weights.dependent, largest, parts, estimate)
            .with_segments(weights.by_segment())
    }

    /// Returns P(dependent) alone, which takes a fraction of the time of a whole
    /// [`posterior`](Self::posterior).
    pub fn dependent<'a>(&self, counted: impl Into<Counted<'a>>) -> f64 {
        if self.alphabet.largest_information() == 0.0 {
            return 0.0;
        }

        let Counted { slices, parts } = counted.into();
        let telling = slices.iter().filter(|slice| !slice.is_line());
        let readings = Readings {
            wholes: telling.map(reading).collect(),
            parts: Parts::new(parts),
        };

        self.weights(&readings).dependent
    }

    /// Returns the probabilities of dependence and of the slabs.
    pub(super) fn weights(&self, readings: &Readings<'_>) -> Weights {
        let mut slabs = [0, 1].map(|side| self.sides[side].ln_slabs);
        let telling = readings.wholes.iter().filter(|[table, _]| !table.is_line());
        let are_several = telling.count() > 1;
        let mut margins = [(); 2].map(|()| StateMargins::none(are_several));
        let mut said = |side: usize, reading: &Reading<'_>| {
            self.sides[side].add_bayes_factors(&reading[side], &mut slabs[side], &mut margins[side])
        };

        let deviants = readings
            .wholes
            .iter()
            .map(|reading| [0, 1].map(|side| said(side, reading)))
            .collect();
        let nulls = [0, 1].map(|side| self.sides[side].join(&margins[side], &mut slabs[side]));

        let mut segments = (readings.parts.number() > 0).then(|| {
            let pooled = self.dependent_given(normalise(&mut slabs.clone(), None));
            let evidence = self.parts_evidence(readings.wholes.len() == 1, &readings.parts);
            Box::new(Segments {
                pooled,
                ..self.cut(&mut slabs, nulls, evidence)
            })
        });

        let likelihood = normalise(&mut slabs, segments.as_deref_mut());
        let is_informative = readings.wholes.iter().any(|[table, _]| !table.is_line());
        let dependent = if is_informative {
            self.dependent_given(likelihood)
        } else {
            self.dependent
        };

        Weights {
            dependent,
            slabs,
            deviants,
            segments,
        }
    }

    /// Returns P(dependent), given the likelihood of dependence relative to the null: e^x times a
    /// factor.
    fn dependent_given(&self, (ln, factor): (f64, f64)) -> f64 {
        let odds = ln + factor.ln() + (self.dependent / (1.0 - self.dependent)).ln();
        1.0 / (1.0 + (-odds).exp())
    }

    /// Returns the moments of mutual information under every slab that has any weight.
    fn weighed(
        &self,
        habits: &Habits,
        weights: &Weights,
        readings: &Readings<'_>,
    ) -> Vec<(f64, Moments)> {
        let wholes = self.slices(habits, &readings.wholes, &weights.deviants);
        let shared = |(side, slab, weight): (usize, usize, f64)| {
            (side, weight, self.moments(side, slab, &wholes))
        };
        let shared = weights.present().map(shared);

        let Some(segments) = weights
            .segments
            .as_ref()
            .filter(|segments| !segments.is_negligible())
        else {
            return shared
                .map(|(_, weight, moments)| (weight, moments))
                .collect();
        };

        let usages = self.usages(habits, &readings.wholes);
        let within = [0, 1].map(|side| self.within(side, weights, readings, &usages));
        let shared = shared.map(|(side, weight, moments)| (weight, moments.scaled(within[side])));

        shared
            .chain(self.cut_moments(segments, &readings.parts, &usages))
            .collect()
    }

    /// Looks at every slice from both sides.
    pub(super) fn slices<'a>(
        &self,
        habits: &'a Habits,
        readings: &'a [Reading<'_>],
        deviants: &'a [[Deviants; 2]],
    ) -> Vec<[Slice<'a>; 2]> {
        let slice = |(reading, deviants): (&'a Reading<'_>, &'a [Deviants; 2])| {
            [0, 1].map(|side| {
                self.sides[side].slice(&reading[side], &deviants[side], habits.driver(side))
            })
        };
        readings.iter().zip(deviants).map(slice).collect()
    }

    /// Returns the moments of mutual information under a slab of a side.
    pub(super) fn moments(&self, side: usize, slab: usize, slices: &[[Slice<'_>; 2]]) -> Moments {
        let total: f64 = slices
            .iter()
            .map(|slice| slice[side].times * slice[side].table.total() as f64)
            .sum();

        slices.iter().fold(Moments::default(), |sum, slice| {
            let slice = &slice[side];
            let share = if total == 0.0 {
                1.0
            } else {
                slice.table.total() as f64 / total
            };

            let Moments {
                mean,
                variance,
                wide,
            } = self.sides[side].moments(slab, slice).scaled(share);

            Moments {
                mean: sum.mean + slice.times * mean,
                variance: sum.variance + slice.times * variance,
                wide: sum.wide + slice.times * wide,
            }
        })
    }

    /// Returns what the table says by itself, if it was seen at least as often as it has pairs of
    /// letters in use.
    fn estimate(
        &self,
        habits: &Habits,
        weights: &Weights,
        readings: &[Reading<'_>],
    ) -> Option<Estimate> {
        let [reading] = readings else { return None };
        if weights
            .by_segment()
            .is_some_and(|by_segment| by_segment.differ > ALIKE)
        {
            return None;
        }

        let pairs = habits.driver(0).used * habits.driver(1).used;
        if reading[0].total() < pairs || pairs > MOST_ESTIMATED {
            return None;
        }

        let [rows, columns] =
            self.predicted_both_ways(habits, weights, reading, &weights.deviants[0]);
        let estimate = |side: usize, cells: &[f64]| {
            Estimate::new(&reading[side], cells, self.sides[side].letters())
        };

        // Read in both ways, so that the order of the variables changes no bit.
        Some(estimate(0, &rows).between(estimate(1, &columns)))
    }
}

/// Returns by which part of itself what a slab says is uncertain where the table says too little by
/// itself: the slabs' rows are of one family, and in a large table dozens of rows make them certain
/// of its shape, whatever the truth is (one letter of each row's own, say, among all others).
fn doubt(habits: &Habits) -> f64 {
    /// In the largest alphabets, and the pairs of letters up to which there is none.
    const MOST: f64 = 0.25;
    const NONE: f64 = 100.0;
    let pairs = (habits.driver(0).used * habits.driver(1).used) as f64;
    MOST * (1.0 - NONE / pairs).max(0.0)
}

/// Returns the same where habits differ by segment: how dependence goes with segments is of three
/// families, and the truth need not be of any. The more visits there are for each pair of letters
/// in each segment, the less depends on that.
fn doubt_of_segments(habits: &Habits, weights: &Weights, readings: &Readings<'_>) -> f64 {
    const MOST: f64 = 0.25;

    let pairs = (habits.driver(0).used * habits.driver(1).used) as f64;
    let visits: f64 = readings
        .wholes
        .iter()
        .map(|[whole, _]| whole.total() as f64)
        .sum();

    let cells = pairs * readings.parts.number() as f64;

    MOST * weights
        .by_segment()
        .map_or(0.0, |by_segment| by_segment.differ)
        * (cells / visits.max(1.0)).sqrt().min(1.0)
}
