//! The marginal likelihood of several slices under the null: what the responder's margins say, be
//! its habits in every slice by another component of the null (apart) or in all by the same
//! (together), which are as likely beforehand.
//!
//! Slabs have one concentration for all slices of a state. Were the null's drawn for each slice by
//! itself, weak slabs would fit many slices of usual habits better than the null does, whatever
//! depends on what: where half of the states had such slices, and habits varied from slice to slice
//! in the other half, all of the first were called dependent.

use std::f64::consts::LN_2;

use super::increments::add;
use super::likelihood::NullMixture;
use super::log_space::{Scaled, ln_sum};
use super::parameters::{
    FIXED, FIXED_CONCENTRATIONS, FIXED_GRID, NULL_CONCENTRATIONS, NULL_GRID, NULLS,
};

/// Returns, for each slab on a fixed base, how likely habits are beforehand that are as usual as it
/// says: rows within k of a base have a margin that is no farther from it. The null pays as much
/// for them; a slab of a state of several slices that did not would have its usual habits for
/// nothing. (Of one slice the weights of slabs were fitted and measured without.)
pub(super) fn usual_habits(weights: &[f64]) -> [f64; FIXED] {
    std::array::from_fn(|slab| {
        let k = FIXED_CONCENTRATIONS[slab % FIXED_GRID];
        let as_usual = |null: &(usize, &f64)| NULL_CONCENTRATIONS[null.0 % NULL_GRID] >= k;
        let shares = weights.iter().enumerate().filter(as_usual);
        shares.map(|(_, share)| share).sum()
    })
}

/// ln of (e^apart + e^together) / 2.
fn ln_either(apart: f64, together: f64) -> f64 {
    ln_sum(&[apart, together]) - LN_2
}

/// The margins of slices, to answer from: one slice has none to be together with.
pub(super) struct Margins {
    slices: usize,
    /// sum_s ln sum_b v_b e^l_sb.
    apart: f64,
    /// sum_s l_sb.
    together: [f64; NULLS],
}

impl Margins {
    pub fn none() -> Self {
        Self {
            slices: 0,
            apart: 0.0,
            together: [0.0; NULLS],
        }
    }

    /// Adds a slice by what the components say of it, and their mixture.
    pub fn add(&mut self, evidence: &[f64; NULLS], ln_mixed: f64) {
        self.slices += 1;
        self.apart += ln_mixed;
        add(&mut self.together, evidence);
    }

    /// Returns how much likelier the margins are than if they were apart for certain.
    pub fn beyond_apart(&self, nulls: &NullMixture) -> f64 {
        if !self.are_several() {
            return 0.0;
        }
        ln_either(0.0, nulls.ln_mixed(&self.together) - self.apart)
    }

    /// Returns whether there are several slices.
    pub fn are_several(&self) -> bool {
        self.slices > 1
    }

    /// Returns ln of the null.
    pub fn ln(&self, nulls: &NullMixture) -> f64 {
        self.apart + self.beyond_apart(nulls)
    }
}

/// The margins of slices, to fit to.
pub(super) struct FittedMargins {
    apart: Vec<Scaled<NULLS>>,
    together: Option<Scaled<NULLS>>,
}

impl FittedMargins {
    /// Looks at slices by what the components say of each.
    pub fn new(slices: &[[f64; NULLS]]) -> Self {
        let mut sums = [0.0; NULLS];
        slices.iter().for_each(|slice| add(&mut sums, slice));
        Self {
            apart: slices.iter().copied().map(Scaled::new).collect(),
            together: (slices.len() > 1).then(|| Scaled::new(sums)),
        }
    }

    /// Returns whether there are several slices.
    pub fn are_several(&self) -> bool {
        self.together.is_some()
    }

    /// Mixes the components by their weights.
    pub fn mixed(&self, weights: &[f64]) -> MixedMargins {
        let apart: Vec<f64> = self
            .apart
            .iter()
            .map(|slice| slice.weighted(weights))
            .collect();
        let slices = self.apart.iter().zip(&apart);
        MixedMargins {
            ln_apart: slices.map(|(slice, sum)| slice.ln(*sum)).sum(),
            apart,
            ln_together: self
                .together
                .as_ref()
                .map(|together| together.ln_weighted(weights)),
        }
    }

    /// Adds a number of states to the components: one a slice where they are apart, one for all
    /// where they are together. `mixed` is what the weights make of the margins.
    pub fn share(&self, mixed: &MixedMargins, states: f64, weights: &[f64], expected: &mut [f64]) {
        let both = self.together.as_ref().zip(mixed.ln_together);
        let together = both.map_or(0.0, |(together, ln_together)| {
            let beyond = mixed.ln_apart - ln_together;
            let share = states / (1.0 + beyond.exp());
            together.share(share, weights, expected);
            share
        });
        for (slice, weighted) in self.apart.iter().zip(&mixed.apart) {
            slice.share_of(*weighted, states - together, weights, expected);
        }
    }
}

/// The margins of slices, mixed by the weights of the null's components.
pub(super) struct MixedMargins {
    /// By slice: the weighted sum of its parts.
    apart: Vec<f64>,
    ln_apart: f64,
    /// `None` of a single slice.
    ln_together: Option<f64>,
}

impl MixedMargins {
    /// Returns ln of the null.
    pub fn ln(&self) -> f64 {
        self.ln_together
            .map_or(self.ln_apart, |together| ln_either(self.ln_apart, together))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: [f64; NULLS] = [1.0 / NULLS as f64; NULLS];

    /// What components say of a slice that is as likely by one of them, and by no other.
    fn by(component: usize) -> [f64; NULLS] {
        std::array::from_fn(|at| if at == component { -1.0 } else { -1_000.0 })
    }

    fn said(slices: &[[f64; NULLS]]) -> [f64; 2] {
        let nulls = NullMixture::new(&WEIGHTS);
        let mut margins = Margins::none();
        for slice in slices {
            margins.add(slice, nulls.ln_mixed(slice));
        }
        [
            margins.ln(&nulls),
            FittedMargins::new(slices).mixed(&WEIGHTS).ln(),
        ]
    }

    fn close(left: f64, right: f64) -> bool {
        (left - right).abs() < 1e-12
    }

    #[test]
    fn slices_alike_pay_for_their_component_once_and_others_each() {
        let ln_weight = -(NULLS as f64).ln();
        for of_one in said(&[by(3)]) {
            assert!(close(of_one, -1.0 + ln_weight));
        }
        for alike in said(&[by(3); 4]) {
            let once = -4.0 + ln_weight - LN_2;
            assert!(close(alike, once + (3.0 * ln_weight).exp().ln_1p()));
        }
        for apart in said(&[by(3), by(4)]) {
            assert!(close(apart, -2.0 + 2.0 * ln_weight - LN_2));
        }
        assert_eq!(said(&[]), [0.0; 2]);
    }

    #[test]
    fn components_are_counted_as_often_as_they_were_drawn() {
        let counted = |slices: &[[f64; NULLS]]| {
            let mut expected = [0.0; NULLS];
            let margins = FittedMargins::new(slices);
            margins.share(&margins.mixed(&WEIGHTS), 1.0, &WEIGHTS, &mut expected);
            expected
        };
        assert!(close(counted(&[by(3)])[3], 1.0));
        let apart = counted(&[by(3), by(4)]);
        assert!(close(apart[3], 1.0) && close(apart[4], 1.0));
        let together = counted(&[by(3); 4])[3];
        assert!((1.0..1.001).contains(&together), "{together}");
    }
}
