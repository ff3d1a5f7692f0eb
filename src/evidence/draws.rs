//! Joint distributions of a state, drawn from what is believed of it: for what has no formula.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Gamma};
use rand_pcg::Pcg64;

use super::fit::normalised;
use super::parameters::{FIXED, NULL_CONCENTRATIONS, NULL_GRID, NULLS, SLAB_CONCENTRATIONS, SLAB_GRID};
use super::prior::{Prior, Weights};
use crate::information::Table;

/// What is believed of a state, ready to draw from.
pub(super) struct Draws<'a> {
    prior: &'a Prior,
    pub slices: Vec<Slice<'a>>,
    weights: Weights,
}

/// One table of a state.
pub(super) struct Slice<'a> {
    pub table: &'a Table,
    /// Its share of the visits.
    pub share: f64,
    /// The probabilities of the null's components.
    nulls: [f64; NULLS],
}

/// A joint distribution of one slice.
pub(super) struct Joint {
    /// The row variable's distribution.
    pub policy: Vec<f64>,
    /// The column variable's in each row, rows first; one row after another.
    pub responses: Vec<f64>,
}

/// The table of a state that was never seen.
static UNSEEN: std::sync::LazyLock<Table> = std::sync::LazyLock::new(Table::default);

impl<'a> Draws<'a> {
    pub fn new(prior: &'a Prior, slices: &'a [Table]) -> Self {
        let total: f64 = slices.iter().map(|slice| slice.total() as f64).sum();
        let slice = |table: &'a Table, share| Slice { table, share, nulls: prior.null_weights(table) };
        let mut seen: Vec<Slice> = slices
            .iter()
            .filter(|table| table.total() > 0)
            .map(|table| slice(table, table.total() as f64 / total))
            .collect();
        if seen.is_empty() {
            seen.push(slice(&UNSEEN, 1.0));
        }
        Self { prior, slices: seen, weights: prior.weights(slices) }
    }

    /// Returns a generator of random numbers that depends on the counts alone, so that the same counts give the same answers.
    pub fn generator(&self) -> Pcg64 {
        let cells = self.slices.iter().flat_map(|slice| {
            let label = |labels: &[u64], at: u32| labels[at as usize];
            let table = slice.table;
            table.cells().iter().flat_map(move |cell| {
                [label(table.row_labels(), cell.row), label(table.column_labels(), cell.column), cell.n]
            })
        });
        // Fowler, Noll and Vo's hash, over whole numbers.
        let seed = cells.fold(0xcbf2_9ce4_8422_2325_u64, |hash, n| (hash ^ n).wrapping_mul(0x0100_0000_01b3));
        Pcg64::seed_from_u64(seed)
    }

    /// Draws a joint distribution of each slice. `point`, in 0 to 1, chooses among independence and the slabs by their probabilities: evenly spaced
    /// points draw each as often as it is probable. With independence, the rows of each slice are equal.
    pub fn draw(&self, point: f64, rng: &mut Pcg64) -> Vec<Joint> {
        let mut left = point - (1.0 - self.weights.dependent);
        if left < 0.0 {
            return self.slices.iter().map(|slice| self.independent(slice, rng)).collect();
        }
        left /= self.weights.dependent;
        let slab = self.weights.slabs.iter().position(|weight| {
            left -= weight;
            left < 0.0
        });
        let likeliest = || (0..).zip(self.weights.slabs).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(slab, _)| slab);
        let slab = slab.unwrap_or_else(likeliest);
        self.slices.iter().map(|slice| self.dependent(slice, slab, rng)).collect()
    }

    fn independent(&self, slice: &Slice, rng: &mut Pcg64) -> Joint {
        let mut left: f64 = rng.random();
        let null = slice.nulls.iter().position(|weight| {
            left -= weight;
            left < 0.0
        });
        let null = null.unwrap_or(NULLS - 1);
        let mut counts = self.prior.null_base(null);
        counts.iter_mut().for_each(|share| *share *= NULL_CONCENTRATIONS[null % NULL_GRID]);
        for (label, n) in slice.table.column_labels().iter().zip(slice.table.columns()) {
            counts[*label as usize] += *n as f64;
        }
        let response = dirichlet(&counts, rng);
        let policy = self.policy(slice.table, rng);
        Joint { responses: response.repeat(policy.len()), policy }
    }

    fn dependent(&self, slice: &Slice, slab: usize, rng: &mut Pcg64) -> Joint {
        let table = slice.table;
        let mut base = self.prior.slab_base(slab, table);
        base.iter_mut().for_each(|share| *share *= SLAB_CONCENTRATIONS[slab % SLAB_GRID]);
        let policy = self.policy(table, rng);
        let mut responses = Vec::with_capacity(policy.len() * base.len());
        let mut occupied = table.row_labels().iter().enumerate().peekable();
        for label in 0..policy.len() as u64 {
            let mut counts = base.clone();
            if let Some((row, _)) = occupied.next_if(|(_, next)| **next == label) {
                for cell in table.row(row) {
                    counts[table.column_labels()[cell.column as usize] as usize] += cell.n as f64;
                }
            }
            responses.extend(dirichlet(&counts, rng));
        }
        Joint { policy, responses }
    }

    fn policy(&self, table: &Table, rng: &mut Pcg64) -> Vec<f64> {
        let mut counts = vec![0.5; self.prior.likelihood.alphabet.rows as usize];
        for (label, n) in table.row_labels().iter().zip(table.rows()) {
            counts[*label as usize] += *n as f64;
        }
        dirichlet(&counts, rng)
    }

    /// Returns the probability of each joint action at the next visit of a slice, rows first: p_i rho_ij, averaged over what is believed.
    pub fn predicted(&self, slice: &Slice) -> Vec<f64> {
        let table = slice.table;
        let alphabet = self.prior.likelihood.alphabet;
        let columns = alphabet.columns as usize;
        let total = table.total() as f64;
        let row_of = |label: u64| table.row_labels().binary_search(&label).ok();

        let mut shared = vec![0.0; columns];
        for (null, weight) in slice.nulls.iter().enumerate() {
            let b = NULL_CONCENTRATIONS[null % NULL_GRID];
            let weight = weight * (1.0 - self.weights.dependent) / (total + b);
            shared.iter_mut().zip(self.prior.null_base(null)).for_each(|(sum, share)| *sum += weight * b * share);
            for (label, n) in table.column_labels().iter().zip(table.columns()) {
                shared[*label as usize] += weight * *n as f64;
            }
        }
        let bases: Vec<Vec<f64>> =
            (0..self.weights.slabs.len()).map(|slab| self.prior.slab_base(slab, table)).collect();
        let mut joint = Vec::with_capacity(alphabet.rows as usize * columns);
        for label in 0..alphabet.rows {
            let row = row_of(label);
            let visits = row.map_or(0.0, |row| table.rows()[row] as f64);
            let mut response = shared.clone();
            for (slab, weight) in self.weights.slabs.iter().enumerate() {
                let k = SLAB_CONCENTRATIONS[slab % SLAB_GRID];
                let weight = weight * self.weights.dependent / (visits + k);
                response.iter_mut().zip(&bases[slab]).for_each(|(sum, share)| *sum += weight * k * share);
                for cell in row.map_or(&[][..], |row| table.row(row)) {
                    response[table.column_labels()[cell.column as usize] as usize] += weight * cell.n as f64;
                }
            }
            let policy = (visits + 0.5) / (total + 0.5 * alphabet.rows as f64);
            joint.extend(response.into_iter().map(|p| policy * p));
        }
        joint
    }
}

impl Prior {
    /// Returns the probabilities of the null's components, were a table independent.
    fn null_weights(&self, table: &Table) -> [f64; NULLS] {
        let columns = table.column_labels().iter().copied().zip(table.columns().iter().copied());
        let evidence = self.likelihood.shared(columns, table.total());
        normalised(std::array::from_fn(|b| evidence[b] + self.parameters.nulls[b].ln()))
    }

    fn null_base(&self, null: usize) -> Vec<f64> {
        if null < NULL_GRID { self.likelihood.base.shares().to_vec() } else { self.uniform() }
    }

    fn slab_base(&self, slab: usize, table: &Table) -> Vec<f64> {
        match slab {
            0..SLAB_GRID => self.likelihood.base.shares().to_vec(),
            SLAB_GRID..FIXED => self.uniform(),
            _ => {
                let mut counts = self.likelihood.base.shares().to_vec();
                for (label, n) in table.column_labels().iter().zip(table.columns()) {
                    counts[*label as usize] += *n as f64;
                }
                counts.iter_mut().for_each(|count| *count /= table.total() as f64 + 1.0);
                counts
            }
        }
    }

    fn uniform(&self) -> Vec<f64> {
        let columns = self.likelihood.alphabet.columns;
        vec![1.0 / columns as f64; columns as usize]
    }
}

/// Draws from a Dirichlet distribution, in logarithms: with tiny parameters every gamma variate would underflow.
fn dirichlet(parameters: &[f64], rng: &mut Pcg64) -> Vec<f64> {
    let mut draws: Vec<f64> = parameters.iter().map(|a| ln_gamma_variate(*a, rng)).collect();
    let largest = draws.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    draws.iter_mut().for_each(|ln| *ln = (*ln - largest).exp());
    let sum: f64 = draws.iter().sum();
    draws.iter_mut().for_each(|draw| *draw /= sum);
    draws
}

/// Draws ln G, G ~ Gamma(a); below 1 as that of a + 1 and ln U / a (Marsaglia & Tsang 2000).
fn ln_gamma_variate(a: f64, rng: &mut Pcg64) -> f64 {
    let gamma = |a: f64| Gamma::new(a, 1.0).expect("a positive shape");
    if a >= 1.0 {
        return gamma(a).sample(rng).ln();
    }
    let uniform = 1.0 - rng.random::<f64>();
    gamma(a + 1.0).sample(rng).ln() + uniform.ln() / a
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::{Base, Fit};
    use crate::information::Alphabet;

    /// Mutual information of a drawn distribution, in nats.
    fn information(joint: &Joint) -> f64 {
        let columns = joint.responses.len() / joint.policy.len();
        let rows = || joint.policy.iter().zip(joint.responses.chunks(columns));
        let marginal: Vec<f64> = (0..columns).map(|j| rows().map(|(p, row)| p * row[j]).sum()).collect();
        let term = |p: f64, rho: f64, q: f64| if rho > 0.0 { p * rho * (rho / q).ln() } else { 0.0 };
        rows().map(|(p, row)| row.iter().zip(&marginal).map(|(rho, q)| term(*p, *rho, *q)).sum::<f64>()).sum()
    }

    /// Standard errors allowed for the draws, and nats for the second order that moments go to.
    const ERRORS: f64 = 4.0;
    const ORDER: f64 = 0.04;

    #[test]
    fn moments_are_those_of_what_is_drawn() {
        let alphabet = Alphabet { rows: 6, columns: 6 };
        let prior = Prior::new(&Fit::cold(alphabet, Base::new(&[9, 4, 1, 6, 2, 2])));
        let leaning = |each: u64| {
            Table::from_counts((0..36).map(|cell| (cell / 6, cell % 6, each * if cell % 7 == 0 { 5 } else { 1 })))
        };
        let some = Table::from_counts([(0, 0, 4), (0, 2, 1), (1, 0, 2), (3, 3, 5), (3, 0, 1), (4, 1, 2)]);
        for slices in [vec![], vec![some.clone()], vec![leaning(1)], vec![leaning(20)], vec![some, leaning(3)]] {
            let draws = Draws::new(&prior, &slices);
            let mut rng = draws.generator();
            let times = 4_000;
            let mut drawn = |time: usize| {
                let joints = draws.draw((time as f64 + 0.5) / times as f64, &mut rng);
                joints.iter().zip(&draws.slices).map(|(joint, slice)| slice.share * information(joint)).sum::<f64>()
            };
            let information: Vec<f64> = (0..times).map(&mut drawn).collect();
            let mean = information.iter().sum::<f64>() / times as f64;
            let variance = information.iter().map(|mi| (mi - mean).powi(2)).sum::<f64>() / times as f64;

            let posterior = prior.posterior(&slices);

            let allowed = ORDER + ERRORS * (variance / times as f64).sqrt();
            assert!((posterior.mean() - mean).abs() < allowed, "{} {mean}", posterior.mean());
            let above = information.iter().filter(|mi| **mi > 0.3).count() as f64 / times as f64;
            assert!((posterior.above(0.3) - above).abs() < 0.1, "{} {above}", posterior.above(0.3));
        }
    }
}
