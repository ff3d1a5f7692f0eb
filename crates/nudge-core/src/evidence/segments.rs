//! Stratification by segment: Bayes factors and moments of the hypotheses that are cut by segment.
//! Habits that differ from one to the other are not influence.
//!
//! Where a state was seen in several segments, every hypothesis has a twin that is cut by segment.
//! A null of either kind, and slabs of three families, all relative to the null whose habits all
//! segments share:
//!
//! * independence: habits alike in all segments; drawn around the environment's in each, as if
//!   there were no state; or drawn around the state's, with some concentration, which is the
//!   evidence for dependence in the table of segments and letters;
//! * shared responses: the slabs of the pooled table;
//! * responses that are cut: the product of the segments' slabs, each with responses of its own;
//! * one alone: the mean over the segments of its slab alone; the others are independent, each with
//!   habits of its own.
//!
//! Mutual information is that within segments, sum_g w_g I_g with w_g the segment's share of the
//! visits. Under a shared response it is smaller than the pooled table's where the driver's habits
//! differ: by a factor that is found once, for the responses that are expected.

use super::cut::{SegmentHabits, ln_mean};
use super::habits::{Habits, Usage};
use super::moments::{Moments, Slice};
use super::parameters::{CUT, FIXED, SLABS};
use super::parts_evidence::PartsEvidence;
use super::prior::Prior;
use super::readings::{Parts, Reading};
use super::weights::Segments;
use crate::information::Table;

/// The most slabs that stand for all that are cut by segment.
const MOST_CUT: usize = 2;
/// The most parts that are looked at where one alone depends.
const MOST_PARTS: usize = 2;
/// Visits of a part up to which one stands for all that have as many.
const FEW: u64 = 5;

impl Prior {
    /// Returns what the parts say from each side; `is_whole` where they are of one table.
    pub(super) fn parts_evidence(&self, is_whole: bool, parts: &Parts<'_>) -> [PartsEvidence; 2] {
        [0, 1].map(|at| {
            let side = &self.sides[at];
            let mut evidence = PartsEvidence::with_capacity(parts.several.len());

            parts
                .several
                .iter()
                .for_each(|part| side.add_part(&part[at], &mut evidence));
            parts
                .single
                .responses(at)
                .for_each(|(letter, n)| side.add_single_visits(letter, n, &mut evidence));

            if is_whole {
                evidence.around = side.likelihood.around(parts.by_part(at));
            }
            evidence
        })
    }

    /// Adds what is known of segments to the logarithms of the slabs, whose null is `nulls`, and
    /// returns those of the slabs that are cut.
    pub(super) fn cut(
        &self,
        slabs: &mut [[f64; SLABS]; 2],
        nulls: [f64; 2],
        evidence: [PartsEvidence; 2],
    ) -> Segments {
        let [shared, cut, one] = self.segments.families;
        let [cut, one] = [cut, one].map(|ln| ln + self.segments.cut);
        let mut segments = Segments::default();

        for (side, evidence) in evidence.into_iter().enumerate() {
            let ln_slabs = &self.sides[side].ln_slabs;
            let habits = SegmentHabits::new(
                &self.segments.habits[side],
                nulls[side],
                &evidence.null,
                &evidence.around,
            );
            let parts: Vec<_> = evidence
                .parts
                .iter()
                .map(|part| part.beside(habits.likeliest))
                .collect();

            slabs[side]
                .iter_mut()
                .for_each(|ln| *ln += shared - habits.ln);

            let null = |at: usize| {
                if at < FIXED {
                    -nulls[side]
                } else {
                    habits.ln_differ
                }
            };
            segments.cut[side] = std::array::from_fn(|at| {
                ln_slabs[at] + evidence.cut[at] + null(at) + cut - habits.ln
            });

            let null = |at: usize| {
                if at < FIXED {
                    habits.ln_apart
                } else {
                    habits.ln_differ
                }
            };

            let mean = ln_mean(&parts);
            segments.one[side] =
                std::array::from_fn(|at| ln_slabs[at] + mean[at] + null(at) + one - habits.ln);

            segments.differ[side] = 1.0 - habits.kinds[0];
            segments.parts[side] = parts;
        }

        segments
    }

    /// Looks at the parts of a state, whose policies are drawn towards the state's. Of those that
    /// were visited a few times, the first of each number of visits stands for all: what is
    /// expected of them is mostly the slab's, and each has a small share.
    pub(super) fn parts<'a>(
        &'a self,
        parts: &'a Parts<'_>,
        usages: &'a [Usage; 2],
    ) -> Vec<[Slice<'a>; 2]> {
        let part = |part: &'a Reading<'_>| {
            [0, 1].map(|side| self.sides[side].part(&part[side], &usages[side]))
        };
        let for_all = |first: &'a Reading<'_>, alike| part(first).map(|slice| slice.for_all(alike));

        let single = parts
            .single
            .first
            .iter()
            .map(|first| for_all(first, parts.single.number));

        let alike = (2..=FEW).filter_map(|visits| {
            let mut alike = parts
                .several
                .iter()
                .filter(|part| part[0].total() == visits);
            Some(for_all(alike.next()?, 1 + alike.count()))
        });

        parts
            .several
            .iter()
            .filter(|part| part[0].total() > FEW)
            .map(part)
            .chain(single)
            .chain(alike)
            .collect()
    }

    /// Returns the policies of both drivers in a state.
    pub(super) fn usages(&self, habits: &Habits, wholes: &[Reading<'_>]) -> [Usage; 2] {
        [0, 1].map(|side| {
            let visits: f64 = wholes.iter().map(|whole| whole[side].total() as f64).sum();
            let mut shares = vec![0.0; habits.driver(side).shares.len()];

            for whole in wholes {
                let weight = if visits == 0.0 {
                    1.0
                } else {
                    whole[side].total() as f64 / visits
                };

                let policy = self.mean_policy(side, habits, &whole[side]);
                shares
                    .iter_mut()
                    .zip(policy)
                    .for_each(|(sum, p)| *sum += weight * p);
            }

            Usage::of_shares(shares)
        })
    }

    /// Returns the weights and the moments of the slabs that are cut: the heaviest stand for all.
    pub(super) fn cut_moments(
        &self,
        segments: &Segments,
        parts: &Parts<'_>,
        usages: &[Usage; 2],
    ) -> Vec<(f64, Moments)> {
        let slices = self.parts(parts, usages);
        let cut = heaviest(segments.cut.each_ref().map(|side| &side[..]));
        let cut = cut
            .into_iter()
            .map(|(side, slab, weight)| (weight, self.moments(side, slab, &slices)));

        let one = heaviest(segments.one.each_ref().map(|side| &side[..]));
        let one = one.into_iter().map(|(side, slab, weight)| {
            (
                weight,
                self.one_dependent(side, slab, &segments.parts[side], parts, &usages[side]),
            )
        });

        cut.chain(one).collect()
    }

    /// Returns the moments where one part alone depends, over which it is; `evidence` is what each
    /// part that was visited more than once says.
    fn one_dependent(
        &self,
        side: usize,
        slab: usize,
        evidence: &[(f64, [f64; CUT])],
        parts: &Parts<'_>,
        usage: &Usage,
    ) -> Moments {
        let total = parts.visits();

        let weighed = evidence.iter().zip(&parts.several);
        let mut candidates: Vec<(f64, &Table)> = weighed
            .map(|((beyond, ln), part)| (beyond.ln() + ln[slab], &*part[side]))
            .collect();
        candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
        candidates.truncate(MOST_PARTS);

        let largest = candidates.first().map_or(0.0, |(ln, _)| *ln);
        let moments = |(ln, part): (f64, &Table)| {
            let slice = self.sides[side].part(part, usage);
            (
                (ln - largest).exp(),
                self.sides[side]
                    .moments(slab, &slice)
                    .scaled(part.total() as f64 / total),
            )
        };

        Moments::mixed(&candidates.into_iter().map(moments).collect::<Vec<_>>())
    }
}

/// Returns the heaviest of these, by side, with the weight of all.
fn heaviest(sides: [&[f64]; 2]) -> Vec<(usize, usize, f64)> {
    let numbered = |side: usize| {
        sides[side]
            .iter()
            .enumerate()
            .map(move |(at, weight)| (side, at, *weight))
    };

    let mut heaviest: Vec<(usize, usize, f64)> = Vec::with_capacity(MOST_CUT + 1);
    for one in (0..2)
        .flat_map(numbered)
        .filter(|(.., weight)| *weight > 0.0)
    {
        let lighter = heaviest.partition_point(|(.., weight)| *weight >= one.2);
        if lighter < MOST_CUT {
            heaviest.insert(lighter, one);
            heaviest.truncate(MOST_CUT);
        }
    }

    // Each side by itself, so that the order of the variables changes no bit.
    let total = sides[0].iter().sum::<f64>() + sides[1].iter().sum::<f64>();
    let kept: f64 = heaviest.iter().map(|(.., weight)| weight).sum();

    heaviest
        .into_iter()
        .map(|(side, at, weight)| (side, at, weight * total / kept))
        .collect()
}
