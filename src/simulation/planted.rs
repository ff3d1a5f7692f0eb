//! Tables whose truth is known: states in which influence was planted, or was not. For measuring decisions, not for playing.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Gamma, Normal};
use rand_pcg::Pcg64;

use crate::information::{Alphabet, Table};

/// How states come about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Generator {
    /// G1, 6 x 6: where there is influence, two to six ego actions each draw the other towards a response of their own.
    Responses,
    /// G2, 6 x 6: where there is influence, the joint distribution is drawn whole.
    Joint,
    /// G3, 9 x 9: both agents have the habit of one action ("stay"); where there is influence, most ego actions draw the other a little.
    Habits,
}

/// What is done to the states once they are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arm {
    /// Nothing.
    Plain,
    /// A state without influence is the product of the margins of one with influence, so that margins give nothing away.
    LeakFree,
    /// The other's actions are shuffled within each state: nothing is left to find. The truth told is that before shuffling.
    Shuffled,
}

/// What to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How many states.
    pub states: usize,
    /// The share of states with influence.
    pub dependent: f64,
    /// What is done to them.
    pub arm: Arm,
    /// The same seed gives the same states.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { states: 2_500, dependent: 0.3, arm: Arm::Plain, seed: 1 }
    }
}

/// One state.
#[derive(Debug, Clone, PartialEq)]
pub struct Planted {
    /// What was seen; rows are the ego's actions.
    pub table: Table,
    /// The mutual information of the distribution it was drawn from, in nats.
    pub information: f64,
    /// Whether influence was planted.
    pub dependent: bool,
}

impl Generator {
    /// Every generator.
    pub const ALL: [Self; 3] = [Self::Responses, Self::Joint, Self::Habits];

    /// Returns the alphabets of its tables.
    pub fn alphabet(self) -> Alphabet {
        let letters = if self == Self::Habits { 9 } else { 6 };
        Alphabet { rows: letters, columns: letters }
    }

    /// Returns a joint distribution, rows first.
    fn joint(self, dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
        match self {
            Self::Responses => {
                let (policy, shared) = (dirichlet(1.0, 6, rng), dirichlet(0.7, 6, rng));
                let drawn = if dependent { rng.random_range(2..=6) } else { 0 };
                let mut actions = [0, 1, 2, 3, 4, 5];
                shuffle(&mut actions, rng);
                let mut rows = vec![shared.clone(); 6];
                for action in &actions[..drawn] {
                    let share = rng.random_range(0.5..1.0);
                    rows[*action] = mixed(&shared, &dirichlet(0.1, 6, rng), share);
                }
                joint(&policy, &rows)
            }
            Self::Joint if dependent => {
                let concentration = rng.random_range(0.05_f64.ln()..0.0).exp();
                dirichlet(concentration, 36, rng).chunks(6).map(<[f64]>::to_vec).collect()
            }
            Self::Joint => joint(&dirichlet(0.7, 6, rng), &vec![dirichlet(0.7, 6, rng); 6]),
            Self::Habits => {
                let mut stay = vec![0.0; 9];
                stay[5] = 1.0;
                let policy = mixed(&stay, &dirichlet(0.5, 9, rng), 0.65);
                let shared = mixed(&stay, &dirichlet(0.3, 9, rng), 0.65);
                let mut row = |_| {
                    let drawn = dependent && rng.random_bool(0.8);
                    let share = if drawn { rng.random_range(0.5..1.0) } else { 0.0 };
                    mixed(&shared, &dirichlet(0.15, 9, rng), share)
                };
                let rows: Vec<_> = (0..9).map(&mut row).collect();
                joint(&policy, &rows)
            }
        }
    }
}

/// Draws states.
pub fn planted(generator: Generator, options: &Options) -> Vec<Planted> {
    let mut rng = Pcg64::seed_from_u64(options.seed);
    let visits = Normal::new(12_f64.ln(), 1.4).expect("a finite spread");
    let mut state = || {
        let dependent = rng.random_bool(options.dependent);
        let leak_free = options.arm == Arm::LeakFree;
        let mut joint = generator.joint(dependent || leak_free, &mut rng);
        if leak_free && !dependent {
            joint = product_of_margins(&joint);
        }
        let visits = visits.sample(&mut rng).exp().round().clamp(1.0, 500.0) as usize;
        let mut seen = draw(&joint, visits, &mut rng);
        if options.arm == Arm::Shuffled {
            let mut others: Vec<u64> = seen.iter().map(|(_, other)| *other).collect();
            shuffle(&mut others, &mut rng);
            seen.iter_mut().zip(others).for_each(|((_, other), shuffled)| *other = shuffled);
        }
        let table = Table::from_counts(seen.into_iter().map(|(ego, other)| (ego, other, 1)));
        Planted { table, information: information(&joint), dependent }
    };
    (0..options.states).map(|_| state()).collect()
}

/// Draws from the symmetric Dirichlet distribution.
fn dirichlet(concentration: f64, letters: usize, rng: &mut Pcg64) -> Vec<f64> {
    let gamma = Gamma::new(concentration, 1.0).expect("a positive concentration");
    let draws: Vec<f64> = (0..letters).map(|_| gamma.sample(rng)).collect();
    let sum: f64 = draws.iter().sum();
    draws.into_iter().map(|draw| draw / sum).collect()
}

/// Returns (1 - share) a + share b.
fn mixed(a: &[f64], b: &[f64], share: f64) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| (1.0 - share) * a + share * b).collect()
}

fn joint(policy: &[f64], rows: &[Vec<f64>]) -> Vec<Vec<f64>> {
    policy.iter().zip(rows).map(|(p, row)| row.iter().map(|q| p * q).collect()).collect()
}

fn margins(joint: &[Vec<f64>]) -> (Vec<f64>, Vec<f64>) {
    let columns = (0..joint[0].len()).map(|column| joint.iter().map(|row| row[column]).sum()).collect();
    (joint.iter().map(|row| row.iter().sum()).collect(), columns)
}

fn product_of_margins(cells: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let (rows, columns) = margins(cells);
    joint(&rows, &vec![columns; rows.len()])
}

/// Returns the mutual information of a joint distribution, I = sum_ij p_ij ln(p_ij / (p_i p_j)), in nats.
pub fn information(joint: &[Vec<f64>]) -> f64 {
    let (rows, columns) = margins(joint);
    let cells =
        joint.iter().zip(&rows).flat_map(|(cells, r)| cells.iter().zip(&columns).map(move |(p, c)| (*p, r * c)));
    cells.filter(|(p, _)| *p > 0.0).map(|(p, independent)| p * (p / independent).ln()).sum::<f64>().max(0.0)
}

/// Draws visits: pairs of actions.
fn draw(joint: &[Vec<f64>], visits: usize, rng: &mut Pcg64) -> Vec<(u64, u64)> {
    let columns = joint[0].len();
    let mut reached = 0.0;
    let cumulative: Vec<f64> = joint
        .iter()
        .flatten()
        .map(|p| {
            reached += p;
            reached
        })
        .collect();
    let mut visit = || {
        let point = rng.random::<f64>() * reached;
        let at = cumulative.partition_point(|end| *end <= point).min(cumulative.len() - 1);
        ((at / columns) as u64, (at % columns) as u64)
    };
    (0..visits).map(|_| visit()).collect()
}

/// Shuffles by Fisher and Yates.
fn shuffle<T>(items: &mut [T], rng: &mut Pcg64) {
    for last in (1..items.len()).rev() {
        items.swap(last, rng.random_range(0..=last));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROUNDING: f64 = 1e-12;

    fn drawn(generator: Generator, arm: Arm) -> Vec<Planted> {
        planted(generator, &Options { states: 400, arm, ..Options::default() })
    }

    #[test]
    fn the_same_seed_gives_the_same_states() {
        for generator in Generator::ALL {
            assert_eq!(drawn(generator, Arm::Plain), drawn(generator, Arm::Plain));
            let other = planted(generator, &Options { states: 400, seed: 2, ..Options::default() });
            assert_ne!(drawn(generator, Arm::Plain), other);
        }
    }

    #[test]
    fn influence_is_where_it_was_planted() {
        for generator in Generator::ALL {
            for arm in [Arm::Plain, Arm::LeakFree] {
                let states = drawn(generator, arm);
                let dependent = states.iter().filter(|state| state.dependent).count();

                assert!((90..150).contains(&dependent), "{generator:?}: {dependent} of 400");
                for state in states {
                    assert_eq!(state.information > ROUNDING, state.dependent, "{generator:?}: {}", state.information);
                }
            }
        }
    }

    #[test]
    fn visits_and_letters_are_in_range() {
        for generator in Generator::ALL {
            let Alphabet { rows, columns } = generator.alphabet();
            let states = drawn(generator, Arm::Plain);

            assert!(states.iter().all(|state| (1..=500).contains(&state.table.total())));
            assert!(states.iter().all(|state| state.table.row_labels().iter().all(|label| *label < rows)));
            assert!(states.iter().all(|state| state.table.column_labels().iter().all(|label| *label < columns)));
        }
    }

    #[test]
    fn information_is_that_of_the_distribution() {
        let copy = [vec![0.5, 0.0], vec![0.0, 0.5]];
        assert!((information(&copy) - 2_f64.ln()).abs() < ROUNDING);
        assert!(information(&product_of_margins(&copy)) < ROUNDING);
    }

    #[test]
    fn shuffling_keeps_how_often_each_action_was_taken() {
        let mut rng = Pcg64::seed_from_u64(3);
        let mut items: Vec<u64> = (0..100).map(|at| at % 7).collect();
        let before = items.clone();
        shuffle(&mut items, &mut rng);

        assert_ne!(items, before);
        items.sort_unstable();
        let mut sorted = before;
        sorted.sort_unstable();
        assert_eq!(items, sorted);
    }
}
