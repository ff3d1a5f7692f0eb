//! Marginal likelihoods of one state cut by segment, kept for fits; and what fits and answers share
//! about them.

use std::ops::Range;

use super::increments::add;
use super::likelihood::{Likelihood, by_part, columns};
use super::log_space::{Scaled, ln_sum};
use super::parameters::{
    APART, AROUND, CUT, FIXED, HABITS, NULLS, OWN_GRID, OWN_SLABS, Parameters, SLABS,
    SideParameters,
};
use crate::information::Table;

/// The marginal likelihoods of a state's parts, cut by segment.
pub(super) struct Cut {
    /// ln of the parts' null by each component.
    null: [f64; NULLS],
    /// ln l of habits drawn around the state's, relative to those that are alike in all parts.
    around: [f64; AROUND],
    pub fixed: Scaled<FIXED>,
    /// Relative to the parts' null.
    pub own: Scaled<OWN_GRID>,
    /// Those with more than one visit.
    parts: Vec<Part>,
    /// Where one part alone depends, relative to the parts' null.
    pub one: Scaled<OWN_GRID>,
}

/// A part of a state.
struct Part {
    null: [f64; NULLS],
    fixed: Scaled<FIXED>,
    /// ln of its share of the visits beyond the first.
    ln_share: f64,
}

/// The logarithms of a fit's weights that concern segments: of the families, of how much more each
/// slab weighs in those that have no slabs of one deviating row, and of the kinds of each
/// responder's habits.
pub(super) struct SegmentWeights {
    pub families: [f64; 3],
    pub cut: f64,
    pub habits: [HabitWeights; 2],
}

impl SegmentWeights {
    pub fn new(parameters: &Parameters) -> Self {
        let [first, second] =
            [0, 1].map(|side: usize| parameters.sides[side].slabs[..CUT].iter().sum::<f64>());

        let habits = parameters
            .sides
            .each_ref()
            .map(|side| HabitWeights::new(&side.segments));

        Self {
            families: parameters.families.map(f64::ln),
            cut: -(first + second).ln(),
            habits,
        }
    }
}

/// The logarithms of the weights of the kinds of habits: of each, of those that differ, and of
/// those drawn anew in each segment.
pub(super) struct HabitWeights {
    kinds: [f64; HABITS],
    differ: f64,
    apart: f64,
}

impl HabitWeights {
    fn new(weights: &[f64]) -> Self {
        let ln_of = |kinds: Range<usize>| weights[kinds].iter().sum::<f64>().ln();
        Self {
            kinds: std::array::from_fn(|kind| weights[kind].ln()),
            differ: ln_of(1..HABITS),
            apart: ln_of(APART),
        }
    }
}

/// The Bayes factors of a state's habits in segments, against the null whose habits are alike in
/// all of them.
pub(super) struct SegmentHabits {
    /// ln of the null of all kinds, of those that differ, and of those drawn anew in each segment.
    pub ln: f64,
    pub ln_differ: f64,
    pub ln_apart: f64,
    /// The likeliest component by which they are drawn anew.
    pub likeliest: usize,
    /// The probability of each kind.
    pub kinds: [f64; HABITS],
}

impl SegmentHabits {
    /// Weighs the kinds, given ln of the null of the state and of its parts by each component, and
    /// ln l of habits that are drawn around the state's.
    pub fn new(
        weights: &HabitWeights,
        pooled: f64,
        apart: &[f64; NULLS],
        around: &[f64; AROUND],
    ) -> Self {
        let relative = |kind: usize| match kind {
            0 => 0.0,
            kind if APART.contains(&kind) => apart[kind - APART.start] - pooled,
            kind => around[kind - APART.end],
        };

        let logarithms: [f64; HABITS] =
            std::array::from_fn(|kind| weights.kinds[kind] + relative(kind));
        let likeliest = (0..NULLS)
            .max_by(|a, b| logarithms[APART.start + a].total_cmp(&logarithms[APART.start + b]));
        let ln = ln_sum(&logarithms);

        Self {
            ln,
            ln_differ: ln_sum(&logarithms[1..]) - weights.differ,
            ln_apart: ln_sum(&logarithms[APART]) - weights.apart,
            likeliest: likeliest.unwrap_or(0),
            kinds: logarithms.map(|one| (one - ln).exp()),
        }
    }
}

impl Cut {
    /// Looks at the parts of a state; `is_whole` where they are of one table.
    pub fn new<'a>(
        likelihood: &Likelihood,
        is_whole: bool,
        parts: impl Iterator<Item = &'a Table> + Clone,
    ) -> Self {
        let (mut null, mut fixed, mut own) = ([0.0; NULLS], [0.0; FIXED], [0.0; OWN_GRID]);
        let (mut several, mut one) = (Vec::new(), Vec::new());

        for part in parts.clone() {
            let (of_null, apart) = (
                likelihood.shared(columns(part), part.total()),
                likelihood.rows_apart(part),
            );
            add(&mut null, &of_null);
            add(&mut fixed, &apart);

            let of_part = if part.is_line() {
                [0.0; OWN_GRID]
            } else {
                likelihood.on_own_marginal(part)
            };
            add(&mut own, &of_part);

            let beyond = part.total().saturating_sub(1) as f64;
            one.push((beyond, of_part));
            if beyond > 0.0 {
                several.push(Part {
                    null: of_null,
                    fixed: Scaled::new(apart),
                    ln_share: beyond.ln(),
                });
            }
        }

        let total: f64 = one.iter().map(|(beyond, _)| beyond).sum();
        several
            .iter_mut()
            .for_each(|part| part.ln_share -= total.ln());

        let around = if is_whole {
            likelihood.around(by_part(parts))
        } else {
            [0.0; AROUND]
        };

        Self {
            null,
            around,
            fixed: Scaled::new(fixed),
            own: Scaled::new(own),
            parts: several,
            one: Scaled::new(ln_mean(&one)),
        }
    }

    /// Weighs its habits in segments, given ln of the null of the state.
    pub fn habits(&self, pooled: f64, weights: &HabitWeights) -> SegmentHabits {
        SegmentHabits::new(weights, pooled, &self.null, &self.around)
    }

    /// Returns ln of the mean over the parts of the slabs on fixed bases in one of them, relative
    /// to a component of the null.
    pub fn ln_one_fixed(&self, null: usize, parameters: &SideParameters) -> f64 {
        let told: Vec<f64> = self
            .parts
            .iter()
            .map(|part| part.ln_fixed(null, parameters))
            .collect();

        if told.is_empty() {
            NOTHING
        } else {
            ln_sum(&told)
        }
    }

    /// Adds the state to the slabs: cut by segment, and in one segment alone beside a component of
    /// the null.
    pub fn expect(
        &self,
        [cut, one]: [[f64; 2]; 2],
        null: usize,
        parameters: &SideParameters,
        slabs: &mut [f64; SLABS],
    ) {
        let weights = &parameters.slabs;
        self.fixed
            .share(cut[0], &weights[..FIXED], &mut slabs[..FIXED]);
        self.own
            .share(cut[1], &weights[OWN_SLABS], &mut slabs[OWN_SLABS]);
        self.one
            .share(one[1], &weights[OWN_SLABS], &mut slabs[OWN_SLABS]);

        let all = self.ln_one_fixed(null, parameters);
        for part in &self.parts {
            let share = one[0] * (part.ln_fixed(null, parameters) - all).exp();
            part.fixed
                .share(share, &weights[..FIXED], &mut slabs[..FIXED]);
        }
    }
}

impl Part {
    fn ln_fixed(&self, null: usize, parameters: &SideParameters) -> f64 {
        self.ln_share + self.fixed.ln_weighted(&parameters.slabs[..FIXED]) - self.null[null]
    }
}

/// Returns ln of the mean of e^x over the parts, each by its visits beyond the first: one visit
/// depends on nothing. Nothing at all where there are no others.
pub(super) fn ln_mean<const L: usize>(parts: &[(f64, [f64; L])]) -> [f64; L] {
    let total: f64 = parts.iter().map(|(weight, _)| weight).sum();

    std::array::from_fn(|slab| {
        let largest = parts.iter().fold(f64::NEG_INFINITY, |largest, (_, part)| {
            largest.max(part[slab])
        });
        let sum: f64 = parts
            .iter()
            .map(|(weight, part)| weight * (part[slab] - largest).exp())
            .sum();

        if total > 0.0 {
            largest + (sum / total).ln()
        } else {
            NOTHING
        }
    })
}

/// ln of what cannot be.
const NOTHING: f64 = -1e300;

#[cfg(test)]
mod tests {
    use super::super::base::Base;
    use super::*;
    use crate::information::samples::grid;

    /// Of logarithms, and of shares of a state.
    const ROUNDING: f64 = 1e-12;

    fn is_close(a: f64, b: f64) -> bool {
        (a - b).abs() <= ROUNDING * b.abs().max(1.0)
    }

    fn cold() -> Parameters {
        Parameters::cold()
    }

    #[test]
    fn a_mean_over_parts_is_weighed_by_visits_beyond_the_first() {
        // (1 e^900 + 3 * 5 e^900) / 4, too large for an f64 by itself.
        let [mean] = ln_mean(&[(1.0, [900.0]), (3.0, [900.0 + 5_f64.ln()]), (0.0, [800.0])]);
        assert!(is_close(mean, 900.0 + 4_f64.ln()), "{mean}");
        for nothing in [ln_mean(&[(0.0, [1.0])]), ln_mean(&[])] {
            assert_eq!((nothing, nothing[0].exp()), ([NOTHING], 0.0));
        }
    }

    #[test]
    fn habits_that_no_kind_explains_better_keep_their_weights() {
        let weights = &cold().sides[0].segments;
        let habits = SegmentHabits::new(
            &HabitWeights::new(weights),
            -7.0,
            &[-7.0; NULLS],
            &[0.0; AROUND],
        );

        for ln in [habits.ln, habits.ln_differ, habits.ln_apart] {
            assert!(ln.abs() < ROUNDING, "{ln}");
        }
        assert!((0..HABITS).all(|kind| is_close(habits.kinds[kind], weights[kind])));
    }

    #[test]
    fn habits_go_to_the_kind_that_explains_them() {
        let weights = &cold().sides[0].segments;
        let mut apart = [-7.0; NULLS];
        apart[3] += 2.0;

        let habits = SegmentHabits::new(&HabitWeights::new(weights), -7.0, &apart, &[0.0; AROUND]);

        // Beside one, each weight counts as it is: e^2 - 1 more of this one's.
        let more = weights[APART.start + 3] * (2_f64.exp() - 1.0);
        let of_apart: f64 = weights[APART].iter().sum();
        assert!(is_close(habits.ln, (1.0 + more).ln()));
        assert!(is_close(
            habits.ln_differ,
            (1.0 + more / (1.0 - weights[0])).ln()
        ));
        assert!(is_close(habits.ln_apart, (1.0 + more / of_apart).ln()));
        assert!(is_close(habits.kinds[0], weights[0] / (1.0 + more)));
        assert_eq!(habits.likeliest, 3);
    }

    #[test]
    fn slabs_that_are_cut_share_the_weight_of_all_slabs() {
        let weights = SegmentWeights::new(&cold());
        let deviants: f64 = cold()
            .sides
            .iter()
            .flat_map(|side| &side.slabs[CUT..])
            .sum();
        assert!(is_close(weights.cut, -(1.0 - deviants).ln()));
        assert!(deviants > 0.01);
    }

    /// Three parts: one that tells, one of a single row, one of a single visit.
    fn cut(is_whole: bool) -> (Likelihood, [Table; 3], Cut) {
        let likelihood = Likelihood::new(2, Base::new(&[3, 5]));
        let parts = [
            grid(&[&[4, 1], &[0, 3]]),
            grid(&[&[0, 0], &[2, 3]]),
            grid(&[&[1, 0]]),
        ];
        let cut = Cut::new(&likelihood, is_whole, parts.iter());
        (likelihood, parts, cut)
    }

    #[test]
    fn what_parts_say_apart_adds_up() {
        let (likelihood, parts, cut) = cut(true);
        let null = |part: &Table| likelihood.shared(columns(part), part.total())[2];
        let slabs = &cold().sides[0];

        assert!(is_close(cut.null[2], parts.iter().map(null).sum()));
        let mut apart = [0.0; FIXED];
        parts
            .iter()
            .for_each(|part| add(&mut apart, &likelihood.rows_apart(part)));
        let expected = Scaled::new(apart).ln_weighted(&slabs.slabs[..FIXED]);
        assert!(is_close(
            cut.fixed.ln_weighted(&slabs.slabs[..FIXED]),
            expected
        ));

        // On their own marginals only the first part tells, with 7 of 11 visits beyond a first one.
        let own = likelihood.on_own_marginal(&parts[0]);
        let weights = &slabs.slabs[OWN_SLABS];
        assert!(is_close(
            cut.own.ln_weighted(weights),
            Scaled::new(own).ln_weighted(weights)
        ));
        let one = own.map(|ln| (7.0 * ln.exp() + 4.0) / 11.0);
        let expected: f64 = one.iter().zip(weights).map(|(one, w)| one * w).sum();
        assert!(is_close(cut.one.ln_weighted(weights), expected.ln()));

        assert_ne!(cut.around, [0.0; AROUND]);
        assert_eq!(self::cut(false).2.around, [0.0; AROUND]);
    }

    #[test]
    fn one_part_alone_depends_beside_the_null_of_that_part() {
        let (likelihood, parts, cut) = cut(true);
        let slabs = &cold().sides[0];
        let relative = |part: &Table| {
            let apart = Scaled::new(likelihood.rows_apart(part));
            let null = likelihood.shared(columns(part), part.total())[2];
            (apart.ln_weighted(&slabs.slabs[..FIXED]) - null).exp()
        };

        let expected = (7.0 * relative(&parts[0]) + 4.0 * relative(&parts[1])) / 11.0;

        assert!(is_close(cut.ln_one_fixed(2, slabs), expected.ln()));
        let single = Cut::new(&likelihood, true, parts[2..].iter());
        assert_eq!(single.ln_one_fixed(2, slabs), NOTHING);
    }

    #[test]
    fn expected_counts_are_shared_out_whole() {
        let (_, _, cut) = cut(true);
        let mut slabs = [0.0; SLABS];

        cut.expect([[0.1, 0.2], [0.3, 0.25]], 2, &cold().sides[0], &mut slabs);

        assert!(is_close(slabs[..FIXED].iter().sum(), 0.1 + 0.3));
        assert!(is_close(slabs[OWN_SLABS].iter().sum(), 0.2 + 0.25));
        assert!(slabs[CUT..].iter().all(|states| *states == 0.0));
    }
}
