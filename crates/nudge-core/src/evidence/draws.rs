//! Posterior sampling: joint distributions of a state, drawn from what is believed of it. For what
//! has no formula, and to check what has one.

use std::borrow::Cow;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Gamma};
use rand_pcg::Pcg64;

use super::counted::{Counted, Ego};
use super::habits::Habits;
use super::moments::{Moments, Slice};
use super::parameters::{
    DEVIANT_CONCENTRATIONS, DEVIANT_GRID, DEVIANT_SLABS, NULL_CONCENTRATIONS, NULL_GRID, SLABS,
    concentration,
};
use super::posterior::Posterior;
use super::predicted::{add_columns, add_row};
use super::prior::Prior;
use super::readings::{Reading, Readings};
use super::side::Side;
use super::weights::Weights;
use crate::information::Table;

/// The posterior of a state's joint distributions, ready to draw from. Everything is seen from the
/// ego, whose actions come first, so that the order of the variables changes nothing.
pub(super) struct Draws<'a> {
    pub prior: &'a Prior,
    pub habits: &'a Habits,
    /// The side on which the ego drives.
    pub ego: usize,
    /// The slices that were visited, or one that was not; where habits rather differ by segment,
    /// their parts.
    pub slices: Vec<Reading<'a>>,
    /// Whether they are parts.
    pub are_parts: bool,
    pub weights: Weights,
}

/// The probability of habits that differ by segment from which a state is looked at segment by
/// segment.
const DIFFER: f64 = 0.5;

/// A joint distribution of one slice.
#[derive(Debug, Clone)]
pub(super) struct Joint {
    /// The driver's distribution.
    pub policy: Vec<f64>,
    /// The responder's after each of the driver's actions, one after another.
    pub responses: Vec<f64>,
}

impl<'a> Draws<'a> {
    /// `most`: of how many parts, those that were visited most.
    pub fn new(
        prior: &'a Prior,
        habits: &'a Habits,
        counted: Counted<'a>,
        ego: Ego,
        most: usize,
    ) -> Self {
        let all = prior.weights(&Readings::new(counted));
        let are_parts = all
            .by_segment()
            .is_some_and(|by_segment| by_segment.differ > DIFFER);

        let mut readings = Readings::new(
            if are_parts {
                counted.parts
            } else {
                counted.slices
            }
            .into(),
        );

        if are_parts {
            readings
                .wholes
                .sort_by_key(|part| std::cmp::Reverse(part[0].total()));
            readings.wholes.truncate(most);
        }

        // What is believed of the parts by themselves, or of the wholes, with the probability of
        // dependence that they have together.
        let weights = Weights {
            dependent: all.dependent,
            ..prior.weights(&readings)
        };

        Self {
            prior,
            habits,
            ego: ego.side(),
            slices: readings.wholes,
            are_parts,
            weights,
        }
    }

    /// Returns what is believed of tables that take the place of the slices, and the tables that
    /// count for it.
    pub fn posterior_of<'t>(&self, tables: &'t [Table]) -> (Posterior, Cow<'t, [Table]>) {
        if !self.are_parts {
            return (self.prior.posterior(self.habits, tables), tables.into());
        }

        let whole = Table::sum(tables);
        let posterior = self.prior.posterior(
            self.habits,
            Counted {
                slices: std::slice::from_ref(&whole),
                parts: tables,
            },
        );

        (posterior, vec![whole].into())
    }

    /// Returns the share of the visits that a slice has.
    pub fn share(&self, slice: usize) -> f64 {
        let total: u64 = self.slices.iter().map(|[slice, _]| slice.total()).sum();
        if total == 0 {
            1.0
        } else {
            self.slices[slice][0].total() as f64 / total as f64
        }
    }

    /// Returns a generator of random numbers that depends on the counts alone, so that the same
    /// counts give the same answers.
    pub fn generator(&self) -> Pcg64 {
        let cells = self
            .slices
            .iter()
            .flat_map(|reading| reading[self.ego].triples().flat_map(<[u64; 3]>::from));

        // Fowler, Noll and Vo's hash, over whole numbers.
        let seed = cells.fold(0xcbf2_9ce4_8422_2325_u64, |hash, n| {
            (hash ^ n).wrapping_mul(0x0100_0000_01b3)
        });

        Pcg64::seed_from_u64(seed)
    }

    /// Draws a joint distribution of each slice. `point`, in 0 to 1, chooses among independence and
    /// the slabs by their probabilities: evenly spaced points draw each as often as it is probable.
    /// With independence, the responses of each slice are equal.
    pub fn draw(&self, point: f64, rng: &mut Pcg64) -> Vec<Joint> {
        let left = point - (1.0 - self.weights.dependent);
        if left < 0.0 {
            return self
                .slices
                .iter()
                .map(|slice| self.independent(slice, rng))
                .collect();
        }

        let sides = [self.ego, 1 - self.ego]
            .map(|side| self.weights.slabs[side])
            .concat();
        let chosen = chosen(&sides, left / self.weights.dependent);
        let side = if chosen < SLABS {
            self.ego
        } else {
            1 - self.ego
        };

        let slices = self
            .prior
            .slices(self.habits, &self.slices, &self.weights.deviants);

        let joint = |slice: &[Slice<'_>; 2]| {
            let joint = self.prior.sides[side].draw_dependent(chosen % SLABS, &slice[side], rng);
            if side == self.ego {
                joint
            } else {
                joint.turned()
            }
        };

        slices.iter().map(joint).collect()
    }

    fn independent(&self, slice: &Reading<'_>, rng: &mut Pcg64) -> Joint {
        let (side, table) = (&self.prior.sides[self.ego], &slice[self.ego]);
        let null = chosen(&side.null_weights(table), rng.random());
        let b = NULL_CONCENTRATIONS[null % NULL_GRID];

        let mut counts: Vec<f64> = (0..side.letters())
            .map(|letter| b * side.null_share(null, letter))
            .collect();
        add_columns(&mut counts, table, 1.0);

        let response = dirichlet(&counts, rng);
        let policy = dirichlet(
            &side
                .policy(table, self.habits.driver(self.ego))
                .parameters(table),
            rng,
        );

        Joint {
            responses: response.repeat(policy.len()),
            policy,
        }
    }
}

impl Joint {
    /// Returns the same distribution with driver and responder exchanged.
    pub fn turned(&self) -> Self {
        let columns = self.responses.len() / self.policy.len();
        let policy = self.marginal();

        let response = |column: usize| {
            let seen = policy[column];
            // A column whose probability underflowed tells nothing of the row.
            let p = move |(row, p): (usize, &f64)| {
                if seen > 0.0 {
                    p * self.responses[row * columns + column] / seen
                } else {
                    *p
                }
            };
            self.policy.iter().enumerate().map(p)
        };

        Self {
            responses: (0..columns).flat_map(response).collect(),
            policy: policy.clone(),
        }
    }

    /// Returns what the responder does on the whole.
    pub fn marginal(&self) -> Vec<f64> {
        let mut marginal = vec![0.0; self.responses.len() / self.policy.len()];
        for (p, row) in self
            .policy
            .iter()
            .zip(self.responses.chunks(marginal.len()))
        {
            marginal
                .iter_mut()
                .zip(row)
                .for_each(|(sum, rho)| *sum += p * rho);
        }

        marginal
    }

    /// Returns its mutual information, in nats.
    pub fn information(&self) -> f64 {
        let marginal = self.marginal();
        let rows = self
            .policy
            .iter()
            .zip(self.responses.chunks(marginal.len()));

        // What underflowed adds nothing.
        let term = |p: f64, rho: f64, q: f64| {
            if p * rho > 0.0 {
                p * rho * (rho / q).ln()
            } else {
                0.0
            }
        };

        rows.map(|(p, row)| {
            row.iter()
                .zip(&marginal)
                .map(|(rho, q)| term(*p, *rho, *q))
                .sum::<f64>()
        })
        .sum()
    }
}

/// Cells that may be drawn for what is believed of states never seen, the most draws, and the
/// fewest that are worth anything.
const UNSEEN_CELLS: usize = 2_000_000;
const MOST_UNSEEN: usize = 5_000;
const FEWEST_UNSEEN: usize = 250;
/// Draws of any slab that is not negligible.
const FEWEST_OF_SLAB: usize = 16;
/// The share of all slabs' weight that is drawn from.
const WEIGHED: f64 = 0.99;

impl Prior {
    /// Returns what is believed of a state that was never seen, by sampling: the formulas of the
    /// moments are crude without counts. `None` where alphabets are so large that sampling would
    /// take long.
    pub(super) fn sampled_unseen(&self) -> Option<Posterior> {
        let cells = (self.alphabet.rows * self.alphabet.columns) as usize;
        let draws = (UNSEEN_CELLS / cells).min(MOST_UNSEEN);
        let largest = self.habits().largest_information();
        if largest == 0.0 || draws < FEWEST_UNSEEN {
            return None;
        }

        let readings = Readings::new((&[] as &[Table]).into());
        let weights = self.weights(&readings);
        let [slices] = &self.slices(self.habits(), &readings.wholes, &weights.deviants)[..] else {
            return None;
        };

        let sampled = |(side, slab, weight): (usize, usize, f64)| {
            let draws = ((weight * draws as f64) as usize).max(FEWEST_OF_SLAB);
            (
                weight,
                self.sides[side].sampled_moments(slab, &slices[side], draws),
            )
        };

        let parts = weights.heaviest(WEIGHED).into_iter().map(sampled).collect();
        Some(Posterior::new(weights.dependent, largest, parts, None))
    }
}

impl Side {
    /// Each slab has random numbers of its own, so that the order of the sides changes nothing.
    fn sampled_moments(&self, slab: usize, slice: &Slice<'_>, draws: usize) -> Moments {
        let mut rng = Pcg64::seed_from_u64(slab as u64);
        let drawn: Vec<f64> = (0..draws)
            .map(|_| self.draw_dependent(slab, slice, &mut rng).information())
            .collect();

        let mean = drawn.iter().sum::<f64>() / draws as f64;
        let variance = drawn.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / draws as f64;

        Moments {
            mean,
            variance,
            wide: variance,
        }
    }

    /// Draws from a slab.
    fn draw_dependent(&self, slab: usize, slice: &Slice<'_>, rng: &mut Pcg64) -> Joint {
        let policy = dirichlet(&slice.policy.parameters(slice.table), rng);
        let responses = match slab.checked_sub(DEVIANT_SLABS.start) {
            Some(deviant) => self.draw_deviating(deviant, slice, policy.len(), rng),
            None => self.draw_rows(slab, slice.table, policy.len(), rng),
        };
        Joint { policy, responses }
    }

    fn draw_rows(&self, slab: usize, table: &Table, rows: usize, rng: &mut Pcg64) -> Vec<f64> {
        let mut base = self.slab_base(slab, table);
        base.iter_mut()
            .for_each(|share| *share *= concentration(slab));
        let row = |label: usize| {
            let mut counts = base.clone();
            add_row(&mut counts, table, label, 1.0);
            dirichlet(&counts, rng)
        };
        (0..rows).flat_map(row).collect()
    }

    fn draw_deviating(
        &self,
        deviant: usize,
        slice: &Slice<'_>,
        rows: usize,
        rng: &mut Pcg64,
    ) -> Vec<f64> {
        let (k, table) = (DEVIANT_CONCENTRATIONS[deviant % DEVIANT_GRID], slice.table);
        let deviating = slice.deviants.probable(deviant);
        let weights: Vec<f64> = (0..rows)
            .map(|label| deviating.probability(table, label))
            .collect();
        let deviates = chosen(&weights, rng.random());

        let mut own: Vec<f64> = (0..self.letters())
            .map(|letter| k * self.deviant_share(deviant, letter))
            .collect();
        let mut rest = self.likelihood.base.shares().to_vec();

        (0..rows).for_each(|row| {
            add_row(
                if row == deviates { &mut own } else { &mut rest },
                table,
                row,
                1.0,
            )
        });

        let [own, rest] = [dirichlet(&own, rng), dirichlet(&rest, rng)];
        (0..rows)
            .flat_map(|row| {
                if row == deviates {
                    own.clone()
                } else {
                    rest.clone()
                }
            })
            .collect()
    }
}

/// Returns which of these, in proportion to their weights, a point in 0 to 1 falls on.
fn chosen(weights: &[f64], point: f64) -> usize {
    let mut left = point * weights.iter().sum::<f64>();
    let found = weights.iter().position(|weight| {
        left -= weight;
        left < 0.0
    });

    // Rounding could lead past the end.
    found.unwrap_or_else(|| {
        (0..)
            .zip(weights)
            .max_by(|a, b| a.1.total_cmp(b.1))
            .map_or(0, |(at, _)| at)
    })
}

/// Draws from a Dirichlet distribution, in logarithms: with tiny parameters every gamma variate
/// would underflow. A parameter of 0 leaves a letter out.
pub(super) fn dirichlet(parameters: &[f64], rng: &mut Pcg64) -> Vec<f64> {
    let variate = |a: &f64| {
        if *a > 0.0 {
            ln_gamma_variate(*a, rng)
        } else {
            f64::NEG_INFINITY
        }
    };

    let mut draws: Vec<f64> = parameters.iter().map(variate).collect();
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

    /// Draws of a state, standard errors allowed for them, and nats for what the formulas leave
    /// out.
    const TIMES: usize = 1_000;
    const ERRORS: f64 = 4.0;
    const ORDER: f64 = 0.03;

    /// Of the standard deviation, for which formulas are on the wide side.
    const NARROWEST: f64 = 0.75;
    const WIDEST: f64 = 1.5;

    /// Draws mutual information from what is believed of a state, if it is dependent.
    fn sampled(prior: &Prior, slices: &[Table]) -> Vec<f64> {
        let draws = Draws::new(prior, prior.habits(), slices.into(), Ego::Rows, 1);
        let mut rng = draws.generator();
        let p = draws.weights.dependent;
        let mut draw = |time: usize| {
            let joints = draws.draw(1.0 - p + p * (time as f64 + 0.5) / TIMES as f64, &mut rng);
            joints
                .iter()
                .enumerate()
                .map(|(slice, joint)| draws.share(slice) * joint.information())
                .sum()
        };
        (0..TIMES).map(&mut draw).collect()
    }

    /// So many draws from a joint distribution that is itself drawn.
    fn table(Alphabet { rows, columns }: Alphabet, visits: usize, rng: &mut Pcg64) -> Table {
        let cells = dirichlet(&vec![0.3; (rows * columns) as usize], rng);
        let mut visit = |_| chosen(&cells, rng.random()) as u64;
        Table::from_counts(
            (0..visits)
                .map(&mut visit)
                .map(|cell| (cell / columns, cell % columns, 1)),
        )
    }

    fn prior(alphabet: Alphabet) -> Prior {
        let base = |letters: u64| {
            Base::new(
                &(0..letters)
                    .map(|letter| 20 + 30 * (letter % 3))
                    .collect::<Vec<_>>(),
            )
        };
        Prior::new(&Fit {
            bases: [base(alphabet.rows), base(alphabet.columns)],
            ..Fit::cold(alphabet)
        })
    }

    #[test]
    fn formulas_are_those_of_what_is_drawn() {
        for (rows, columns) in [(2, 2), (2, 25), (3, 7), (6, 6), (9, 9)] {
            let alphabet = Alphabet { rows, columns };
            let (prior, mut rng) = (prior(alphabet), Pcg64::seed_from_u64(rows * columns));
            for visits in [0, 1, 2, 3, 8, 30, 300] {
                let table = table(alphabet, visits, &mut rng);
                let slices = if visits == 0 { vec![] } else { vec![table] };
                let drawn = sampled(&prior, &slices);
                let mean = drawn.iter().sum::<f64>() / TIMES as f64;
                let deviation = (drawn.iter().map(|one| (one - mean).powi(2)).sum::<f64>()
                    / TIMES as f64)
                    .sqrt();

                let posterior = if visits == 0 {
                    prior.unseen().clone()
                } else {
                    prior.posterior(prior.habits(), &slices)
                };
                let [told, told_deviation] = posterior.moments_if_dependent();

                let allowed = ORDER + ERRORS * deviation / (TIMES as f64).sqrt();
                assert!(
                    (told - mean).abs() < allowed,
                    "{alphabet:?}, {visits} visits: {told} {mean}"
                );
                let ratio = told_deviation / deviation;
                assert!(
                    (NARROWEST..WIDEST).contains(&ratio),
                    "{alphabet:?}, {visits} visits: {told_deviation} {deviation}"
                );
            }
        }
    }

    /// 2 x 25 without counts: a Taylor term gave -2.06 nats, where .3 to .4 are drawn.
    #[test]
    fn an_unseen_state_is_believed_to_be_what_is_drawn() {
        let prior = prior(Alphabet {
            rows: 2,
            columns: 25,
        });
        let drawn = sampled(&prior, &[]);
        let above =
            |nats: f64| drawn.iter().filter(|one| **one > nats).count() as f64 / TIMES as f64;

        for nats in [0.1, 0.3, 0.5] {
            let told = prior.unseen().above_if_dependent(nats);
            assert!(
                (told - above(nats)).abs() < 0.08,
                "{nats}: {told} {}",
                above(nats)
            );
        }
        assert_eq!(prior.unseen().above(2_f64.ln()), 0.0);
    }
}
