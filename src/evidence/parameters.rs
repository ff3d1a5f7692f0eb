//! What a fit finds, and the grid of concentrations it weighs.

/// Concentrations b of the null's shared response, for each of two bases.
///
/// They go up to where all states answer alike, and farther than the slabs': were the null's response not allowed to be as close to the base as the
/// rows of a slab, slabs would win where states only resemble each other. In a hallway of 25 x 25 actions, whose neighbours' actions were shuffled, that
/// called a sixth of the states dependent; two dice thrown in every state, nearly all.
pub(super) const NULL_CONCENTRATIONS: [f64; 13] =
    [0.3, 0.6, 1.0, 2.0, 3.5, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0, 1e3, 1e6];
/// Concentrations k of the slabs' rows, for each of three bases.
/// The larger, the weaker the dependence that is looked for: about (K - 1) / 2k nats.
pub(super) const SLAB_CONCENTRATIONS: [f64; 12] = [0.1, 0.2, 0.4, 0.8, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0];

/// Concentrations of the null, and of a slab, on one base.
pub(super) const NULL_GRID: usize = NULL_CONCENTRATIONS.len();
/// Concentrations of the slabs on one base.
pub(super) const SLAB_GRID: usize = SLAB_CONCENTRATIONS.len();
/// Components of the null: on the environment's base, then on the uniform one.
pub(super) const NULLS: usize = 2 * NULL_GRID;
/// Slabs on a fixed base: the environment's, then the uniform one.
pub(super) const FIXED: usize = 2 * SLAB_GRID;
/// Slabs: on the fixed bases, then on the state's own marginal.
pub(super) const SLABS: usize = FIXED + SLAB_GRID;

/// Pseudo-states that an environment's share of dependent states starts from: dependent ones, and all. A Beta(3, 7) prior: with a flat one, an
/// environment of a single independent state would be called dependent 40 % of the time.
const DEPENDENT_PRIOR: [f64; 2] = [3.0, 10.0];
/// Pseudo-states of each weight.
const WEIGHT_PRIOR: f64 = 0.1;

/// What a fit finds about an environment.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameters {
    /// The share pi of states in which the two actions depend on each other.
    pub dependent: f64,
    /// The weights v of the null's concentrations, which sum to 1: on the environment's base, then on the uniform one.
    pub nulls: Vec<f64>,
    /// The weights w of the slabs' concentrations, which sum to 1: on the environment's base, the uniform one, the state's own marginal.
    pub slabs: Vec<f64>,
}

impl Parameters {
    /// Returns what is supposed of an environment before anything was seen: three states in ten dependent, equal weights.
    pub fn cold() -> Self {
        Self::estimated(0.0, 0.0, &[0.0; NULLS], &[0.0; SLABS])
    }

    /// Returns the estimate from the expected numbers of states: of all, of dependent ones, of each null component's and of each slab's.
    pub(super) fn estimated(states: f64, dependent: f64, nulls: &[f64; NULLS], slabs: &[f64; SLABS]) -> Self {
        let share = (dependent + DEPENDENT_PRIOR[0]) / (states + DEPENDENT_PRIOR[1]);
        Self { dependent: share.clamp(0.001, 0.999), nulls: weights(nulls), slabs: weights(slabs) }
    }
}

fn weights(expected: &[f64]) -> Vec<f64> {
    let total = expected.iter().sum::<f64>() + WEIGHT_PRIOR * expected.len() as f64;
    expected.iter().map(|expected| (expected + WEIGHT_PRIOR) / total).collect()
}
