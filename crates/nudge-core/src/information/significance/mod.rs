//! Tests of independence: the p-value of the plug-in mutual information at fixed margins, by an
//! exact test, by permutation or by a likelihood-ratio test. Could chance alone have made these
//! counts?
//!
//! Not the strength of an influence, nor the probability of one: with many visits, the weakest
//! dependence is significant; with few, the strongest is not; and of a thousand states without any,
//! fifty pass at .05. Tests take the visits for independent draws, which the steps of one stay in a
//! state are not.

mod discoveries;
mod enumeration;
mod g_test;
mod hypergeometric;
mod margins;
mod permutation;
#[cfg(test)]
mod tests;

pub use discoveries::{bayesian_fdr, benjamini_hochberg, q_values};
pub(super) use g_test::freedoms;
pub(super) use hypergeometric::draw as draw_marked;
pub(super) use permutation::Sampler;

use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::mutual_information::plug_in;
use super::table::Table;
use enumeration::enumerate;
use g_test::{expects_enough, g_test};
use margins::{few_tables, least_probability};

/// The p-value of a test of independence: how likely chance alone is to give at least as much
/// information as was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Significance {
    /// The probability, in (0, 1]; a G test of overwhelming evidence may round to 0.
    pub p_value: f64,
    /// How it was found.
    pub method: Method,
}

/// How a p-value was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// From every table with these margins.
    Exact,
    /// From seeded random tables with these margins.
    Permutation,
    /// From the chi-square distribution, the limit for many visits.
    GTest,
}

impl Method {
    /// Returns the name the method goes by in answers: `exact`, `permutation` or `g_test`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Permutation => "permutation",
            Self::GTest => "g_test",
        }
    }
}

/// Values of the statistic closer than this, relative to the larger of it and 1, are a tie:
/// rounding apart, they are the same. Ties count as chance doing as well.
const TIE: f64 = 1e-9;

/// Exact where there are at most this many tables, or as many as permutations were asked for: about
/// the same work.
const FEW_TABLES: u64 = 1_000;

/// Returns the p-value of a test of independence: the probability that independent actions with the
/// same margins give at least the plug-in mutual information that was seen.
///
/// `slices` are tables to be judged together: one for each segment or each value of other agents'
/// actions, or a single one. The statistic is sum N_s I_s, half of Woolf's G (1957); visits are
/// exchanged within slices only.
///
/// - One occupied row or column in every slice: 1, exactly.
/// - Exact: the probabilities of all tables with these margins (Fisher 1935; Freeman & Halton
///   1951), where there are at most 1,000 (or `permutations`, if more) and no slice has more than
///   1,000 visits.
/// - The G test with Williams's correction: chi-square with sum (R'_s - 1)(C'_s - 1) degrees of
///   freedom on the occupied rows and columns, where every expected count is at least 20.
/// - Else (1 + how many of `permutations` random tables reach it) / (1 + `permutations`), which is
///   never too small, however few they are (Phipson & Smyth 2010). The same `seed` gives the same
///   answer.
///
/// Of independent states, at most a share p has a p-value of p or less, at any number of visits; at
/// few visits a far smaller share, since few values are possible: see [`smallest_p`].
pub fn p_value(slices: &[Table], permutations: u64, seed: u64) -> Significance {
    p_value_while(slices, permutations, seed, &|| true).expect("nobody ends it")
}

/// Returns the same, asking now and then whether to go on; `None` where it was ended.
pub fn p_value_while(
    slices: &[Table],
    permutations: u64,
    seed: u64,
    goes_on: &dyn Fn() -> bool,
) -> Option<Significance> {
    let slices = informative(slices);
    let (p_value, method) = if few_tables(&slices, permutations.max(FEW_TABLES)) {
        (exact(&slices, statistic(&slices)), Method::Exact)
    } else if slices.iter().all(|slice| expects_enough(slice)) {
        (g_test(&slices), Method::GTest)
    } else {
        (
            by_permutation(&slices, permutations, seed, goes_on)?,
            Method::Permutation,
        )
    };

    Some(Significance { p_value, method })
}

/// Returns the smallest attainable p-value, that of any table with these margins: 1 where nothing
/// can be learnt.
///
/// Exact where all tables can be enumerated ([`p_value`] says where, whatever its permutations);
/// else a lower bound of the probability of any single table, prod r_i! prod c_j! / (N! prod n_ij!)
/// with prod n_ij! at most what the margins allow. A state whose smallest p-value is above the
/// level can never pass at this level, whatever its counts, and should not be counted among the
/// tests (Tarone 1990).
pub fn smallest_p(slices: &[Table]) -> f64 {
    let slices = informative(slices);
    if !few_tables(&slices, FEW_TABLES) {
        return slices
            .iter()
            .map(|slice| least_probability(slice))
            .product();
    }

    let mut largest = f64::NEG_INFINITY;
    enumerate(&slices, |statistic, _| largest = largest.max(statistic));
    exact(&slices, largest)
}

/// Returns the slices that have more than one table with their margins: the others change nothing.
fn informative(slices: &[Table]) -> Vec<&Table> {
    slices
        .iter()
        .filter(|slice| freedoms(slice) > 0.0)
        .collect()
}

/// Returns sum N_s I_s, half of G.
fn statistic(slices: &[&Table]) -> f64 {
    slices
        .iter()
        .map(|slice| slice.total() as f64 * plug_in(slice))
        .sum()
}

/// Returns the least value that counts as reaching a statistic.
pub(super) fn bar(statistic: f64) -> f64 {
    statistic - TIE * statistic.max(1.0)
}

/// Returns the probability of the tables that reach a statistic.
fn exact(slices: &[&Table], statistic: f64) -> f64 {
    let bar = bar(statistic);
    let mut reaching = 0.0;
    enumerate(slices, |statistic, probability| {
        reaching += if statistic >= bar { probability } else { 0.0 }
    });
    reaching.min(1.0)
}

fn by_permutation(
    slices: &[&Table],
    permutations: u64,
    seed: u64,
    goes_on: &dyn Fn() -> bool,
) -> Option<f64> {
    /// Permutations from one look to the next whether to go on.
    const LOOK: u64 = 256;

    let mut random = Pcg64::seed_from_u64(seed);
    let mut samplers: Vec<Sampler> = slices
        .iter()
        .map(|slice| Sampler::new(slice, freedoms(slice)))
        .collect();
    let bar = bar(statistic(slices));
    let mut draw = || {
        samplers
            .iter_mut()
            .map(|sampler| sampler.draw(&mut random))
            .sum::<f64>()
    };
    let mut reaching = 0;
    for permutation in 0..permutations {
        if permutation % LOOK == 0 && !goes_on() {
            return None;
        }
        reaching += u64::from(draw() >= bar);
    }
    Some((1 + reaching) as f64 / (1.0 + permutations as f64))
}
