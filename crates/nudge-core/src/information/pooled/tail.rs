//! The p-value of the pooled statistic: the tail of a gamma distribution with its moments, or of
//! seeded permutations within strata.

use rand::SeedableRng;
use rand_pcg::Pcg64;
use statrs::function::gamma::gamma_ur;

use crate::information::null::moments::Moments;
use crate::information::significance::{Sampler, bar, freedoms};
use crate::information::table::Table;

/// How the p-value of a pool was found.
///
/// [`Gamma`](Self::Gamma) alone is too small by up to 20 where few visits can be paired up in few
/// ways (ten states of two to six visits, at .001), and too large by up to 2 where one action has
/// nearly all visits. `benches/pooled.rs` prints how far each is from 100,000 permutations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TailMethod {
    /// From seeded permutations within strata, ended early where p is large (Besag & Clifford 1991,
    /// "Sequential Monte Carlo p-values"): to 256 visits that can be exchanged, and to 64 that are not
    /// of the commonest action of either agent.
    Permutation,
    /// From the gamma distribution with the exact mean and variance of the statistic and a third
    /// moment by permutations of each stratum (Pearson's type III): to 16,384 such visits, and in
    /// all pools whose gamma distribution is still skewed.
    ShiftedGamma,
    /// From the gamma distribution with the exact mean and variance: in larger pools.
    Gamma,
}

impl TailMethod {
    /// Returns the name the method goes by in answers: `permutation`, `shifted_gamma` or `gamma`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Permutation => "permutation",
            Self::ShiftedGamma => "shifted_gamma",
            Self::Gamma => "gamma",
        }
    }
}

/// To so many visits, a statistic takes few values, and no smooth distribution is like it.
const FEW_VISITS: u64 = 256;
/// The same of visits beside those of the commonest row or column: of 10,000 visits of which one is
/// in another row and one in another column, the statistic takes two values.
const FEW_RARE: u64 = 64;
/// Permutations of a pool of few visits, at most, and of all its strata together.
const MOST_PERMUTATIONS: usize = 100_000;
const MOST_SHUFFLES: usize = 4_000_000;
/// So many permutations that reach the statistic are enough: p is then known to 4 %.
const ENOUGH_REACHING: u32 = 600;

/// To so many visits, the third moment costs milliseconds.
const SOME_VISITS: u64 = 16_384;
/// A gamma distribution of this shape has skewness .06, and so little more or less of it that p is
/// right to a fifth at .001.
const NEARLY_NORMAL: f64 = 1_000.0;

/// The informative strata of a pool, until it is known to be large.
#[derive(Debug, Clone, Default)]
pub(super) struct Kept {
    /// Each with its own moments.
    strata: Vec<(Table, Moments)>,
    visits: u64,
    /// Those beside the commonest row or column of each stratum.
    rare: u64,
    is_large: bool,
}

impl Kept {
    /// Keeps a stratum with its own moments, of a pool that has `null` with it.
    pub fn add(&mut self, table: &Table, own: Moments, null: Moments) {
        self.visits += table.total();
        self.rare += rare(table);
        if self.visits > SOME_VISITS && shape(null) > NEARLY_NORMAL {
            self.is_large = true;
            self.strata = Vec::new();
        }
        if !self.is_large {
            self.strata.push((table.clone(), own));
        }
    }

    /// Returns the probability that independence reaches the statistic T, and how it was found.
    pub fn p_value(&self, statistic: f64, null: Moments, seed: u64) -> (f64, TailMethod) {
        if self.is_large || self.strata.is_empty() {
            (gamma_tail(statistic, null), TailMethod::Gamma)
        } else if self.visits <= FEW_VISITS || self.rare <= FEW_RARE {
            (self.permuted(statistic, seed), TailMethod::Permutation)
        } else {
            let third = self.third_moment(null, seed);
            (
                shifted_gamma_tail(statistic, null, third),
                TailMethod::ShiftedGamma,
            )
        }
    }

    /// Returns h / l where the l-th permutation is the h-th that reaches the statistic, h being
    /// enough; else (1 + how many reach it) / (1 + all): never too small on average.
    fn permuted(&self, statistic: f64, seed: u64) -> f64 {
        let bar = bar(statistic);
        let mut random = Pcg64::seed_from_u64(seed);
        let mut samplers: Vec<Sampler> = self.tables().map(sampler).collect();
        let mut draw = || -> f64 {
            samplers
                .iter_mut()
                .map(|sampler| sampler.draw(&mut random))
                .sum()
        };

        let mut reaching = 0;
        let most = MOST_PERMUTATIONS.min(MOST_SHUFFLES / self.strata.len()) as u32;
        for permutation in 1..=most {
            reaching += u32::from(draw() >= bar);
            if reaching == ENOUGH_REACHING {
                return f64::from(reaching) / f64::from(permutation);
            }
        }
        f64::from(1 + reaching) / f64::from(1 + most)
    }

    /// Returns the third central moment of the statistic: the sum of the strata's, each from its
    /// own permutations about its exact mean. Their errors add up without those of products between
    /// strata: so many strata need but few permutations each.
    fn third_moment(&self, null: Moments, seed: u64) -> f64 {
        let mut random = Pcg64::seed_from_u64(seed);
        let squares = self.strata.iter().map(|(_, own)| own.variance.powi(2));
        let cells = self
            .tables()
            .map(|table| table.rows().len() * table.columns().len());
        let draws = draws(null.variance.powi(2) / squares.sum::<f64>(), cells.sum());

        let third = |(table, own): &(Table, Moments)| {
            let mut sampler = sampler(table);
            let cubes: f64 = (0..draws)
                .map(|_| (sampler.draw(&mut random) - own.mean).powi(3))
                .sum();
            cubes / f64::from(draws)
        };
        self.strata.iter().map(third).sum()
    }

    fn tables(&self) -> impl Iterator<Item = &Table> {
        self.strata.iter().map(|(table, _)| table)
    }
}

fn sampler(table: &Table) -> Sampler {
    Sampler::new(table, freedoms(table))
}

/// Returns how many permutations of each of so many equal strata leave the skewness of them all
/// with a standard error of .03: that of one is sqrt(15 / B), and of their sum an S-th of it; fewer
/// where all have so many cells that it would take longer than some tenths of a second.
fn draws(strata: f64, cells: usize) -> u32 {
    /// 15 / .03^2
    const OF_ONE: f64 = 16_667.0;
    /// Cells drawn in all.
    const MOST_CELLS: f64 = 1.5e6;
    let affordable = (MOST_CELLS / cells as f64).clamp(256.0, 8_192.0);
    (OF_ONE / (strata * strata)).clamp(256.0, affordable) as u32
}

/// Returns how many visits are beside those of the commonest row or column, whichever leaves fewer.
fn rare(table: &Table) -> u64 {
    let beside = |sums: &[u64]| table.total() - sums.iter().max().copied().unwrap_or(0);
    beside(table.rows()).min(beside(table.columns()))
}

/// Returns the shape of the gamma distribution with these moments.
fn shape(null: Moments) -> f64 {
    null.mean * null.mean / null.variance
}

/// Returns Q(M^2 / V, T M / V), the upper tail at T of the gamma distribution with mean M and
/// variance V; 1 where there is no variance.
pub fn gamma_tail(statistic: f64, null: Moments) -> f64 {
    let scaled = statistic * null.mean / null.variance;
    if scaled > 0.0 && shape(null) < LARGEST_SHAPE {
        gamma_ur(shape(null), scaled).clamp(0.0, 1.0)
    } else {
        1.0
    }
}

/// With less variance beside the mean there is none but rounding.
const LARGEST_SHAPE: f64 = 1e12;

/// Returns the upper tail at T of the gamma distribution, moved along the axis, with these moments
/// and this third central moment: shape 4 / g^2 of its skewness g.
fn shifted_gamma_tail(statistic: f64, null: Moments, third: f64) -> f64 {
    /// Shape 40,000, all but normal. Less skewness makes p no more than a fifth smaller at .0001.
    const LEAST_SKEWNESS: f64 = 0.01;

    let deviation = null.variance.sqrt();
    let skewness = (third / (deviation * null.variance)).max(LEAST_SKEWNESS);
    let moved = Moments {
        mean: 2.0 * deviation / skewness,
        ..null
    };
    gamma_tail(statistic - null.mean + moved.mean, moved)
}
