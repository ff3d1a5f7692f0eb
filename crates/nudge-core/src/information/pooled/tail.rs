//! The p-value of the pooled statistic: the tail of a gamma distribution with the statistic's exact
//! mean and variance, or of seeded permutations within strata.

use rand::SeedableRng;
use rand_pcg::Pcg64;
use statrs::function::gamma::gamma_ur;

use crate::information::null::moments::Moments;
use crate::information::significance::{Sampler, bar, freedoms};
use crate::information::table::Table;

/// How the p-value of a pool was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TailMethod {
    /// From the gamma distribution with the exact mean and variance of the statistic: where there
    /// are strata enough.
    Gamma,
    /// From seeded permutations within strata, ended early where p is large (Besag & Clifford 1991).
    Permutation,
}

impl TailMethod {
    /// Returns the name the method goes by in answers: `gamma` or `permutation`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Gamma => "gamma",
            Self::Permutation => "permutation",
        }
    }
}

/// A pool of more visits than this is large enough for the gamma distribution.
const FEW_VISITS: u64 = 2_000;
/// Permutations of a small pool, at most.
const MOST_PERMUTATIONS: u64 = 100_000;
/// So many permutations that reach the statistic are enough: p is then known to 4 %.
const ENOUGH_REACHING: u64 = 600;

/// The informative strata of a pool while they are few enough to be permuted.
#[derive(Debug, Clone, Default)]
pub(super) struct Kept {
    strata: Vec<Table>,
    visits: u64,
}

impl Kept {
    /// Keeps a stratum, or drops them all where there are too many visits.
    pub fn add(&mut self, table: &Table) {
        self.visits += table.total();
        if self.visits <= FEW_VISITS {
            self.strata.push(table.clone());
        } else {
            self.strata = Vec::new();
        }
    }

    /// Returns the probability that independence reaches the statistic T.
    pub fn p_value(&self, statistic: f64, null: Moments, seed: u64) -> (f64, TailMethod) {
        if self.strata.is_empty() {
            (gamma_tail(statistic, null), TailMethod::Gamma)
        } else {
            let p_value = permuted(&self.strata, statistic, seed);
            (p_value, TailMethod::Permutation)
        }
    }
}

/// Returns Q(M^2 / V, T M / V), the upper tail of the gamma distribution with mean M and variance V.
pub(super) fn gamma_tail(statistic: f64, null: Moments) -> f64 {
    let shape = null.mean * null.mean / null.variance;
    let scaled = statistic * null.mean / null.variance;
    if scaled > 0.0 && shape.is_finite() {
        gamma_ur(shape, scaled).clamp(0.0, 1.0)
    } else {
        1.0
    }
}

/// Returns h / l where the l-th permutation is the h-th that reaches the statistic, h being enough;
/// else (1 + how many reach it) / (1 + all): never too small on average.
fn permuted(strata: &[Table], statistic: f64, seed: u64) -> f64 {
    let bar = bar(statistic);
    let mut random = Pcg64::seed_from_u64(seed);
    let mut samplers: Vec<Sampler> = strata
        .iter()
        .map(|table| Sampler::new(table, freedoms(table)))
        .collect();

    let mut reaching = 0;
    for permutation in 1..=MOST_PERMUTATIONS {
        let drawn: f64 = samplers
            .iter_mut()
            .map(|sampler| sampler.draw(&mut random))
            .sum();
        reaching += u64::from(drawn >= bar);
        if reaching == ENOUGH_REACHING {
            return reaching as f64 / permutation as f64;
        }
    }
    (1 + reaching) as f64 / (1 + MOST_PERMUTATIONS) as f64
}
