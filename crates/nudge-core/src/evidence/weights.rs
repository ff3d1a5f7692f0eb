//! Posterior probabilities of the hypotheses of one state, and which of them matter.

use std::ops::Range;

use super::deviants::Deviants;
use super::parameters::{CUT, DEVIANT_SLABS, FIXED, FIXED_GRID, OWN_SLABS, SLABS};
use super::posterior::BySegment;

/// The share of all slabs' posterior weight that moments are found for: the lighter ones change
/// nothing, and there are many.
const WEIGHED: f64 = 0.9;

/// What neighbouring slabs may weigh that are taken together: so much of the weight of all slabs,
/// and more where that is as little of all hypotheses.
const LIGHT: f64 = 0.05;
const UNHEARD: f64 = 0.01;
const MOST_LIGHT: f64 = 0.15;

/// The posterior probabilities of a state's hypotheses.
pub(super) struct Weights {
    pub dependent: f64,
    /// Given dependence, those of the slabs of each side; all sum to 1.
    pub slabs: [[f64; SLABS]; 2],
    /// What the rows of each slice say for deviating, as each side reads them.
    pub deviants: Vec<[Deviants; 2]>,
    /// What is cut by segment, which is part of that 1.
    pub segments: Option<Box<Segments>>,
}

/// The posterior probabilities of the hypotheses that are cut by segment.
pub(super) struct Segments {
    /// Of each side's slabs, given dependence.
    pub cut: [[f64; CUT]; 2],
    /// Of each side's slabs where one part alone depends.
    pub one: [[f64; CUT]; 2],
    /// Of each part that was visited more than once: its visits beyond the first, and ln l of its
    /// slabs relative to its null.
    pub parts: [Vec<(f64, [f64; CUT])>; 2],
    /// That the habits of each side's responder differ by segment, if nothing depends on anything.
    pub differ: [f64; 2],
    /// P(dependent) of the same counts, were there no segments.
    pub pooled: f64,
}

impl Segments {
    /// Returns whether nothing would change were there no segments.
    pub fn is_negligible(&self) -> bool {
        const NEGLIGIBLE: f64 = 0.02;
        let cut: f64 = self
            .cut
            .as_flattened()
            .iter()
            .chain(self.one.as_flattened())
            .sum();
        cut < NEGLIGIBLE && self.differ.iter().all(|p| *p < NEGLIGIBLE)
    }
}

impl Default for Segments {
    fn default() -> Self {
        Self {
            cut: [[0.0; CUT]; 2],
            one: [[0.0; CUT]; 2],
            parts: Default::default(),
            differ: [0.0; 2],
            pooled: 0.0,
        }
    }
}

impl Weights {
    /// Returns the side, the number and the weight of the heaviest slabs, which have this share of
    /// the weight together.
    pub fn heaviest(&self, share: f64) -> Vec<(usize, usize, f64)> {
        heaviest(self.present().collect(), share)
    }

    /// Returns what segments change; `None` where there are none.
    pub fn by_segment(&self) -> Option<BySegment> {
        let Segments {
            differ: [first, second],
            pooled,
            ..
        } = **self.segments.as_ref()?;
        Some(BySegment {
            differ: 1.0 - (1.0 - first) * (1.0 - second),
            pooled,
        })
    }

    /// Returns the side, the number and the weight of the slabs that have any.
    pub fn present(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let numbered = |side: usize| {
            self.slabs[side]
                .iter()
                .enumerate()
                .map(move |(slab, weight)| (side, slab, *weight))
        };
        (0..2)
            .flat_map(numbered)
            .filter(|(.., weight)| *weight > 0.0)
    }

    /// Returns the same with fewer slabs to find moments for: light neighbours are taken together,
    /// and the lightest are left out.
    pub fn condensed(self) -> Self {
        let light = (UNHEARD / self.dependent).clamp(LIGHT, MOST_LIGHT);
        let grouped = Self {
            slabs: self.slabs.map(|side| grouped(&side, light)),
            ..self
        };

        let mut slabs = [[0.0; SLABS]; 2];
        grouped
            .heaviest(WEIGHED)
            .into_iter()
            .for_each(|(side, slab, weight)| slabs[side][slab] = weight);

        // Each side by itself, so that the order of the variables changes no bit.
        let sum =
            |slabs: &[[f64; SLABS]; 2]| slabs[0].iter().sum::<f64>() + slabs[1].iter().sum::<f64>();
        let scale = sum(&grouped.slabs) / sum(&slabs);

        slabs
            .as_flattened_mut()
            .iter_mut()
            .for_each(|weight| *weight *= scale);

        Self { slabs, ..grouped }
    }
}

/// The logarithm of a ratio that no sum of slabs would notice.
const NEGLIGIBLE: f64 = 50.0;

/// Makes weights of logarithms, which sum to 1, and returns the largest of them and the sum of all
/// as a multiple of its exponential.
pub(super) fn normalise(
    slabs: &mut [[f64; SLABS]; 2],
    segments: Option<&mut Segments>,
) -> (f64, f64) {
    let [first, second] = slabs;
    let mut sides: [Vec<&mut [f64]>; 2] = [vec![first], vec![second]];
    if let Some(Segments { cut, one, .. }) = segments {
        let parts = cut
            .iter_mut()
            .map(|cut| &mut cut[..])
            .zip(one.iter_mut().map(|one| &mut one[..]));
        sides
            .iter_mut()
            .zip(parts)
            .for_each(|(side, (cut, one))| side.extend([cut, one]));
    }

    let all = sides
        .iter()
        .flatten()
        .flat_map(|slabs| slabs.iter().copied());
    let largest = all.fold(f64::NEG_INFINITY, f64::max);

    for ln in sides
        .iter_mut()
        .flatten()
        .flat_map(|slabs| slabs.iter_mut())
    {
        *ln = if *ln > largest - NEGLIGIBLE {
            (*ln - largest).exp()
        } else {
            0.0
        };
    }

    // Each side by itself, so that the order of the variables changes no bit.
    let of_side = |side: &Vec<&mut [f64]>| {
        side.iter()
            .map(|slabs| slabs.iter().sum::<f64>())
            .sum::<f64>()
    };
    let sum = of_side(&sides[0]) + of_side(&sides[1]);

    sides
        .iter_mut()
        .flatten()
        .flat_map(|slabs| slabs.iter_mut())
        .for_each(|part| *part /= sum);

    (largest, sum)
}

/// Returns the weights of a side's slabs with those of neighbours in concentration given to the
/// middle one by weight, where they are light together; and with those of all slabs of one
/// deviating row, which differ little but in which row it is, to the heaviest.
fn grouped(slabs: &[f64; SLABS], light: f64) -> [f64; SLABS] {
    /// Concentrations that differ by not much more than a factor of four.
    const NEIGHBOURS: usize = 3;

    let mut grouped = [0.0; SLABS];
    for Range {
        start: mut from,
        end,
    } in [0..FIXED_GRID, FIXED_GRID..FIXED, OWN_SLABS]
    {
        while from < end {
            let is_light = |to: &usize| slabs[from..*to].iter().sum::<f64>() <= light;
            let to = (from + 2..=end.min(from + NEIGHBOURS))
                .take_while(is_light)
                .last()
                .unwrap_or(from + 1);

            grouped[middle(slabs, from..to)] = slabs[from..to].iter().sum();
            from = to;
        }
    }

    let heaviest = DEVIANT_SLABS
        .max_by(|a, b| slabs[*a].total_cmp(&slabs[*b]))
        .unwrap_or(DEVIANT_SLABS.start);
    grouped[heaviest] = slabs[DEVIANT_SLABS].iter().sum();
    grouped
}

/// Returns where half of the weight of a group is reached.
fn middle(slabs: &[f64; SLABS], group: Range<usize>) -> usize {
    let mut left = 0.5 * slabs[group.clone()].iter().sum::<f64>();
    let found = group.clone().find(|slab| {
        left -= slabs[*slab];
        left <= 0.0
    });
    found.unwrap_or(group.start)
}

/// Returns those of the heaviest weights that have this share together, in their order.
fn heaviest(mut weights: Vec<(usize, usize, f64)>, share: f64) -> Vec<(usize, usize, f64)> {
    let mut ordered: Vec<f64> = weights.iter().map(|(.., weight)| *weight).collect();
    ordered.sort_unstable_by(|a, b| b.total_cmp(a));
    let mut left = share * ordered.iter().sum::<f64>();
    let lightest = ordered.into_iter().find(|weight| {
        left -= weight;
        left <= 0.0
    });
    weights.retain(|(.., weight)| *weight >= lightest.unwrap_or(0.0));
    weights
}
