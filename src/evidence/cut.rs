//! What one state says of its segments: the hypotheses that are cut by segment, kept for fits; and what fits and answers share about them.

use super::increments::add;
use super::likelihood::{Likelihood, columns};
use super::parameters::{AROUND, CUT, Expected, FIXED, HABITS, NULLS, OWN_GRID, OWN_SLABS, Parameters, SideParameters};
use super::prior::ln_sum;
use super::state::Scaled;
use crate::information::Table;

/// What the parts of a state say, cut by segment.
pub(super) struct Cut {
    nulls: Vec<Scaled<NULLS>>,
    /// Relative to habits that are alike in all parts.
    pub around: Scaled<AROUND>,
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
    null: Scaled<NULLS>,
    fixed: Scaled<FIXED>,
    /// ln of its share of the visits beyond the first.
    ln_share: f64,
}

/// The weights of the families, and how much more each slab weighs in those that have no slabs of one deviating row.
pub(super) struct FamilyWeights {
    pub families: [f64; 3],
    pub cut: f64,
}

impl FamilyWeights {
    pub fn new(parameters: &Parameters) -> Self {
        let [first, second] = [0, 1].map(|side: usize| parameters.sides[side].slabs[..CUT].iter().sum::<f64>());
        Self { families: parameters.families, cut: 1.0 / (first + second) }
    }
}

/// What a state says of its habits in segments, relative to the null whose habits are alike in all of them.
pub(super) struct SegmentHabits {
    /// ln of the null of all kinds, and of those that differ.
    pub ln: f64,
    pub ln_differ: f64,
    /// The probability of each kind.
    pub kinds: [f64; HABITS],
}

impl SegmentHabits {
    /// Weighs the kinds, given ln l of habits that are drawn around the environment's, and around the state's.
    pub fn new(weights: &[f64], apart: f64, around: &[f64; AROUND]) -> Self {
        let relative = |kind: usize| match kind {
            0 => 0.0,
            1 => apart,
            _ => around[kind - 2],
        };
        let logarithms: [f64; HABITS] = std::array::from_fn(|kind| weights[kind].ln() + relative(kind));
        let differ: f64 = weights[1..].iter().sum();
        let ln = ln_sum(&logarithms);
        Self { ln, ln_differ: ln_sum(&logarithms[1..]) - differ.ln(), kinds: logarithms.map(|one| (one - ln).exp()) }
    }
}

impl Cut {
    /// Looks at the parts of a state; `is_whole` where they are of one table.
    pub fn new<'a>(likelihood: &Likelihood, is_whole: bool, parts: impl Iterator<Item = &'a Table> + Clone) -> Self {
        let null = |part: &Table| Scaled::new(likelihood.shared(columns(part), part.total()));
        let (mut fixed, mut own) = ([0.0; FIXED], [0.0; OWN_GRID]);
        let (mut several, mut one) = (Vec::new(), Vec::new());
        for part in parts.clone() {
            let apart = likelihood.rows_apart(part);
            add(&mut fixed, &apart);
            let of_part = if part.is_line() { [0.0; OWN_GRID] } else { likelihood.on_own_marginal(part) };
            add(&mut own, &of_part);
            let beyond = part.total().saturating_sub(1) as f64;
            one.push((beyond, of_part));
            if beyond > 0.0 {
                several.push(Part { null: null(part), fixed: Scaled::new(apart), ln_share: beyond.ln() });
            }
        }
        let total: f64 = one.iter().map(|(beyond, _)| beyond).sum();
        several.iter_mut().for_each(|part| part.ln_share -= total.ln());
        let around = if is_whole { likelihood.around(parts.clone()) } else { [0.0; AROUND] };
        Self {
            nulls: parts.map(null).collect(),
            around: Scaled::new(around),
            fixed: Scaled::new(fixed),
            own: Scaled::new(own),
            parts: several,
            one: Scaled::new(ln_mean(&one)),
        }
    }

    pub fn ln_null(&self, parameters: &SideParameters) -> f64 {
        self.nulls.iter().map(|part| part.ln_weighted(&parameters.nulls)).sum()
    }

    /// Returns ln of the mean over the parts of the slabs on fixed bases in one of them, relative to the null.
    pub fn ln_one_fixed(&self, parameters: &SideParameters) -> f64 {
        let told: Vec<f64> = self.parts.iter().map(|part| part.ln_fixed(parameters)).collect();
        if told.is_empty() { NOTHING } else { ln_sum(&told) }
    }

    /// Adds the state to the components, all parts together as one: `apart` states have the parts' own habits.
    pub fn expect(&self, [cut, one]: [[f64; 2]; 2], apart: f64, parameters: &SideParameters, expected: &mut Expected) {
        let SideParameters { nulls, slabs, .. } = parameters;
        self.fixed.share(cut[0], &slabs[..FIXED], &mut expected.slabs[..FIXED]);
        self.own.share(cut[1], &slabs[OWN_SLABS], &mut expected.slabs[OWN_SLABS]);
        self.one.share(one[1], &slabs[OWN_SLABS], &mut expected.slabs[OWN_SLABS]);
        let all = self.ln_one_fixed(parameters);
        for part in &self.parts {
            let share = one[0] * (part.ln_fixed(parameters) - all).exp();
            part.fixed.share(share, &slabs[..FIXED], &mut expected.slabs[..FIXED]);
        }
        let parts = self.nulls.len() as f64;
        self.nulls.iter().for_each(|part| part.share(apart / parts, nulls, &mut expected.nulls));
    }
}

impl Part {
    fn ln_fixed(&self, SideParameters { nulls, slabs, .. }: &SideParameters) -> f64 {
        self.ln_share + self.fixed.ln_weighted(&slabs[..FIXED]) - self.null.ln_weighted(nulls)
    }
}

/// Returns ln of the mean of e^x over the parts, each by its visits beyond the first: one visit depends on nothing. Nothing at all where there are no others.
pub(super) fn ln_mean<const L: usize>(parts: &[(f64, [f64; L])]) -> [f64; L] {
    let total: f64 = parts.iter().map(|(weight, _)| weight).sum();
    std::array::from_fn(|slab| {
        let largest = parts.iter().fold(f64::NEG_INFINITY, |largest, (_, part)| largest.max(part[slab]));
        let sum: f64 = parts.iter().map(|(weight, part)| weight * (part[slab] - largest).exp()).sum();
        if total > 0.0 { largest + (sum / total).ln() } else { NOTHING }
    })
}

/// ln of what cannot be.
const NOTHING: f64 = -1e300;
