//! Hyperparameters of the spike-and-slab prior, and the grid of concentrations that it mixes.

use std::ops::Range;

/// Concentrations b of the null's shared response, for each of two bases.
///
/// They go up to where all states answer alike, and farther than the slabs': were the null's
/// response not allowed to be as close to the base as the rows of a slab, slabs would win where
/// states only resemble each other. In a hallway of 25 x 25 actions, whose neighbours' actions were
/// shuffled, that called a sixth of the states dependent; two dice thrown in every state, nearly
/// all.
///
/// They begin below the slabs': where each segment has a habit that it hardly ever leaves, a
/// response to each action would be told with fewer visits off it.
pub(super) const NULL_CONCENTRATIONS: [f64; 16] = [
    0.03, 0.1, 0.3, 0.7, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0, 400.0, 1_600.0, 12_800.0,
    1e6,
];

/// Concentrations k of the rows of the slabs on a fixed base: the environment's, or the uniform
/// one.
pub(super) const FIXED_CONCENTRATIONS: [f64; 12] = [
    0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0,
];

/// Those of the slabs on the state's own marginal, which begin alike. The larger, the weaker the
/// dependence that is looked for: about (K - 1) / 2k nats, a thousandth of one with 25 columns at
/// the last. So weak, all rows are closer to each other than to any base but their own.
pub(super) const OWN_CONCENTRATIONS: [f64; 18] = [
    0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0, 400.0, 800.0, 1_600.0,
    3_200.0, 6_400.0, 12_800.0,
];

/// Concentrations k of the one row that deviates, for each of two bases.
pub(super) const DEVIANT_CONCENTRATIONS: [f64; 3] = [0.15, 1.5, 15.0];

/// Concentrations of the null, of a slab and of a deviating row, on one base.
pub(super) const NULL_GRID: usize = NULL_CONCENTRATIONS.len();
pub(super) const FIXED_GRID: usize = FIXED_CONCENTRATIONS.len();
pub(super) const OWN_GRID: usize = OWN_CONCENTRATIONS.len();
pub(super) const DEVIANT_GRID: usize = DEVIANT_CONCENTRATIONS.len();

/// Components of the null: on the environment's base, then on the uniform one.
pub(super) const NULLS: usize = 2 * NULL_GRID;
/// Slabs on a fixed base: the environment's, then the uniform one.
pub(super) const FIXED: usize = 2 * FIXED_GRID;
/// Slabs of one deviating row: on the environment's base, then on the uniform one.
pub(super) const DEVIANTS: usize = 2 * DEVIANT_GRID;
/// Slabs on the state's own marginal, after those on the fixed bases.
pub(super) const OWN_SLABS: Range<usize> = FIXED..FIXED + OWN_GRID;
/// Slabs of one deviating row, last.
pub(super) const DEVIANT_SLABS: Range<usize> = OWN_SLABS.end..SLABS;
/// All slabs of a side.
pub(super) const SLABS: usize = FIXED + OWN_GRID + DEVIANTS;

/// Returns the concentration of a slab whose every row has its own response.
pub(super) fn concentration(slab: usize) -> f64 {
    if slab < FIXED {
        FIXED_CONCENTRATIONS[slab % FIXED_GRID]
    } else {
        OWN_CONCENTRATIONS[slab - FIXED]
    }
}

/// Pseudo-states that an environment's share of dependent states starts from: dependent ones, and
/// all. A Beta(3, 7) prior: with a flat one, an environment of a single independent state would be
/// called dependent 40 % of the time.
const DEPENDENT_PRIOR: [f64; 2] = [3.0, 10.0];
/// Pseudo-states of each weight.
const WEIGHT_PRIOR: f64 = 0.1;
/// Slabs beyond this concentration can hardly be told from the null where little was seen, and what
/// EM cannot tell apart keeps the proportions that it began with: so they begin with little.
const USUAL_CONCENTRATION: f64 = 200.0;
const WEAK_PRIOR: f64 = 0.01;

/// Pseudo-states whose habits are alike in all segments, and that differ. And those of each family
/// of dependence.
const HABIT_PRIOR: [f64; 2] = [0.5, 0.5];
const FAMILY_PRIOR: [f64; 3] = [0.5, 0.3, 0.2];

/// Concentrations of the habits of segments around those of their state. Those above differ by next
/// to nothing.
pub(super) const AROUND: usize = 11;

/// How habits go with segments: alike in all; drawn anew in each, by the components of the null, as
/// if there were no state; or drawn around the state's, with the first concentrations of slabs on
/// their own marginal.
pub(super) const HABITS: usize = 1 + NULLS + AROUND;
/// Those that are drawn anew.
pub(super) const APART: Range<usize> = 1..1 + NULLS;

/// The slabs that have a twin which is cut by segment: all but those of one deviating row.
pub(super) const CUT: usize = OWN_SLABS.end;

/// The hyperparameters of an environment's spike-and-slab prior: what a fit finds.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    /// The share pi of states in which the two actions depend on each other.
    pub dependent: f64,
    /// What it finds of either way to read a table: columns that respond to rows, then rows that
    /// respond to columns. All slabs together weigh 1.
    pub sides: [SideParameters; 2],
    /// How dependence goes with segments, where a state was seen in several: the weights of three
    /// families of slabs, which sum to 1. All segments share one response to each action; each has
    /// responses of its own; or one segment alone depends.
    pub families: [f64; 3],
}

/// The hyperparameters of one side, where one variable, the driver, is taken to drive the other,
/// the responder.
#[derive(Debug, Clone, PartialEq)]
pub struct SideParameters {
    /// The weights v of the null's concentrations, which sum to 1: on the environment's base, then
    /// on the uniform one.
    pub nulls: Vec<f64>,
    /// The weights w of the slabs: on the environment's base, the uniform one, the state's own
    /// marginal; then those of one deviating row.
    pub slabs: Vec<f64>,
    /// The concentration kappa of the driver's policies around its mean in the environment; `None`
    /// before one was fitted.
    pub habit: Option<f64>,
    /// The concentration kappa' of the driver's policies in segments around that in their state;
    /// `None` where no state was seen in several segments.
    pub habit_in_segments: Option<f64>,
    /// How the responder's habits go with segments, where nothing depends on anything: the weights
    /// of each kind, which sum to 1: alike in all segments, drawn around the environment's, or
    /// around the state's.
    pub segments: Vec<f64>,
}

/// The expected counts of EM, in states: of each null component's and of each slab's.
#[derive(Clone)]
pub(super) struct ExpectedCounts {
    pub nulls: [f64; NULLS],
    pub slabs: [f64; SLABS],
    /// Those with each kind of habits of the responder's.
    pub habits: [f64; HABITS],
}

/// The expected counts of the families: dependent states that were seen in several segments.
#[derive(Clone, Copy, Default)]
pub(super) struct ExpectedFamilies {
    pub families: [f64; 3],
}

impl Default for ExpectedCounts {
    fn default() -> Self {
        Self {
            nulls: [0.0; NULLS],
            slabs: [0.0; SLABS],
            habits: [0.0; HABITS],
        }
    }
}

impl Parameters {
    /// Returns what is supposed of an environment before anything was seen: three states in ten
    /// dependent, equal weights for all but the weakest slabs.
    pub fn cold() -> Self {
        Self::estimated(0.0, 0.0, &Default::default(), ExpectedFamilies::default())
    }

    /// Returns the estimate from the expected numbers of states: of all, of dependent ones, and of
    /// each component's.
    pub(super) fn estimated(
        states: f64,
        dependent: f64,
        expected: &[ExpectedCounts; 2],
        segmented: ExpectedFamilies,
    ) -> Self {
        let share = (dependent + DEPENDENT_PRIOR[0]) / (states + DEPENDENT_PRIOR[1]);
        let [first, second] =
            [0, 1].map(|side| posterior_counts(&expected[side].slabs, &slab_prior()));

        // Each side by itself, so that the order of the variables changes no bit.
        let total = first.iter().sum::<f64>() + second.iter().sum::<f64>();

        let side = |side: usize, slabs: Vec<f64>| {
            let nulls = posterior_counts(&expected[side].nulls, &[WEIGHT_PRIOR; NULLS]);
            let habits = posterior_counts(&expected[side].habits, &habit_prior());
            SideParameters {
                nulls: shares(&nulls, nulls.iter().sum()),
                slabs: shares(&slabs, total),
                habit: None,
                habit_in_segments: None,
                segments: shares(&habits, habits.iter().sum()),
            }
        };

        let families = posterior_counts(&segmented.families, &FAMILY_PRIOR);
        let total: f64 = families.iter().sum();

        Self {
            dependent: share.clamp(0.001, 0.999),
            sides: [side(0, first), side(1, second)],
            families: [families[0], families[1], families[2]].map(|states| states / total),
        }
    }
}

/// Returns the pseudo-states of the kinds of habits.
fn habit_prior() -> [f64; HABITS] {
    let [alike, differ] = HABIT_PRIOR;
    std::array::from_fn(|kind| match kind {
        0 => alike,
        kind if APART.contains(&kind) => 0.5 * differ / NULLS as f64,
        _ => 0.5 * differ / AROUND as f64,
    })
}

/// Returns the pseudo-states of the slabs of a side.
fn slab_prior() -> [f64; SLABS] {
    std::array::from_fn(|slab| {
        let is_weak = OWN_SLABS.contains(&slab) && concentration(slab) > USUAL_CONCENTRATION;
        if is_weak { WEAK_PRIOR } else { WEIGHT_PRIOR }
    })
}

fn posterior_counts(expected: &[f64], prior: &[f64]) -> Vec<f64> {
    expected
        .iter()
        .zip(prior)
        .map(|(expected, prior)| expected + prior)
        .collect()
}

fn shares(counts: &[f64], total: f64) -> Vec<f64> {
    counts.iter().map(|count| count / total).collect()
}
