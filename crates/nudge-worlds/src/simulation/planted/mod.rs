//! Tables whose truth is known: states in which influence was planted, or was not. For measuring
//! decisions, not for playing.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use nudge_core::information::{Alphabet, Table};

pub mod graphs;
mod hard;
mod joint;
pub mod segments;

pub use joint::information;
use joint::{dirichlet, draw, joint, mixed, multinomial, product_of_margins, shuffle};

/// How states come about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Generator {
    /// G1, 6 x 6: where there is influence, two to six ego actions each draw the other towards a
    /// response of their own.
    Responses,
    /// G2, 6 x 6: where there is influence, the joint distribution is drawn whole.
    Joint,
    /// G3, 9 x 9: both agents have the habit of one action ("stay"); where there is influence, most
    /// ego actions draw the other a little.
    Habits,
    /// 2 x 2: any response is as likely as any other.
    TwoByTwo,
    /// 3 x 25.
    ThreeByTwentyFive,
    /// 6 x 6: the ego stays 95 times in a hundred, the other mostly.
    Stay95,
    /// 25 x 25: the ego stays nine times in ten, the other mostly.
    Stay25,
    /// 6 x 6: one action that is rarely taken does everything.
    Rare,
    /// 6 x 6: the ego takes one action nine times in ten.
    EpsilonGreedy,
    /// The other copies the ego, of so many actions.
    Copy(u16),
    /// The other answers each of 64 actions by one of its own.
    Answer64,
    /// Dependence of 0.01 to 0.1 nats among so many actions each, seen a thousand to a million
    /// times.
    Weak(u16),
    /// 20 x 20, of which each agent may use three in a state.
    Masked,
    /// 6 x 6: eight segments with habits of their own, each seen forty times, and no dependence
    /// within any.
    Segments,
}

/// What is done to the states once they are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arm {
    /// Nothing.
    Plain,
    /// A state without influence is the product of the margins of one with influence, so that
    /// margins give nothing away.
    LeakFree,
    /// The other's actions are shuffled within each state: nothing is left to find. The truth told
    /// is that before shuffling.
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
        Self {
            states: 2_500,
            dependent: 0.3,
            arm: Arm::Plain,
            seed: 1,
        }
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
    /// What was seen in each segment; empty where there is only one.
    pub segments: Vec<Table>,
}

/// How often a state is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Visits {
    /// e^x for a normal x about ln of the median, at most so often.
    LogNormal { median: f64, most: f64 },
    /// Every order of magnitude between these is as likely as any other.
    LogUniform { least: f64, most: f64 },
}

/// The standard deviation of the logarithm of visits.
const SPREAD: f64 = 1.4;

/// Above this, visits are not drawn one by one.
const ONE_BY_ONE: usize = 5_000;

/// Segments, and visits of each.
const SEGMENTS: usize = 8;
const SEGMENT_VISITS: usize = 40;

impl Generator {
    /// The usual generators: the worlds that the evidence was first measured in.
    pub const USUAL: [Self; 3] = [Self::Responses, Self::Joint, Self::Habits];

    /// The generators of hard worlds.
    pub const HARD: [Self; 14] = [
        Self::TwoByTwo,
        Self::ThreeByTwentyFive,
        Self::Stay95,
        Self::Stay25,
        Self::Rare,
        Self::EpsilonGreedy,
        Self::Copy(6),
        Self::Copy(25),
        Self::Answer64,
        Self::Weak(6),
        Self::Weak(25),
        Self::Weak(64),
        Self::Masked,
        Self::Segments,
    ];

    /// Returns the alphabets of its tables.
    pub fn alphabet(self) -> Alphabet {
        let [rows, columns] = match self {
            Self::Habits => [9; 2],
            Self::TwoByTwo => [2; 2],
            Self::ThreeByTwentyFive => [3, 25],
            Self::Stay25 => [25; 2],
            Self::Copy(letters) | Self::Weak(letters) => [u64::from(letters); 2],
            Self::Answer64 => [64; 2],
            Self::Masked => [20; 2],
            _ => [6; 2],
        };
        Alphabet { rows, columns }
    }

    fn visits(self) -> Visits {
        match self {
            Self::Responses | Self::Joint | Self::Habits => Visits::LogNormal {
                median: 12.0,
                most: 500.0,
            },
            Self::Stay95 | Self::Stay25 => Visits::LogNormal {
                median: 40.0,
                most: 2_000.0,
            },
            Self::Rare => Visits::LogNormal {
                median: 60.0,
                most: 5_000.0,
            },
            Self::Answer64 => Visits::LogNormal {
                median: 100.0,
                most: 5_000.0,
            },
            Self::Weak(_) => Visits::LogUniform {
                least: 1e3,
                most: 1e6,
            },
            _ => Visits::LogNormal {
                median: 12.0,
                most: 2_000.0,
            },
        }
    }

    /// Returns a joint distribution, rows first.
    fn joint(self, dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
        match self {
            Self::Responses => {
                let (policy, shared) = (dirichlet(1.0, 6, rng), dirichlet(0.7, 6, rng));
                joint(&policy, &hard::some_rows_drawn(6, &shared, dependent, rng))
            }
            Self::Joint if dependent => {
                let concentration = rng.random_range(0.05_f64.ln()..0.0).exp();
                dirichlet(concentration, 36, rng)
                    .chunks(6)
                    .map(<[f64]>::to_vec)
                    .collect()
            }
            Self::Joint => joint(&dirichlet(0.7, 6, rng), &vec![dirichlet(0.7, 6, rng); 6]),
            Self::Habits => {
                let mut stay = vec![0.0; 9];
                stay[5] = 1.0;
                let policy = mixed(&stay, &dirichlet(0.5, 9, rng), 0.65);
                let shared = mixed(&stay, &dirichlet(0.3, 9, rng), 0.65);
                let mut row = |_| {
                    let drawn = dependent && rng.random_bool(0.8);
                    let share = if drawn {
                        rng.random_range(0.5..1.0)
                    } else {
                        0.0
                    };
                    mixed(&shared, &dirichlet(0.15, 9, rng), share)
                };
                let rows: Vec<_> = (0..9).map(&mut row).collect();
                joint(&policy, &rows)
            }
            Self::TwoByTwo => hard::two_by_two(dependent, rng),
            Self::ThreeByTwentyFive => hard::three_by_twenty_five(dependent, rng),
            Self::Stay95 => hard::stays(6, [0.95, 0.8, 1.0, 0.5], dependent, rng),
            Self::Stay25 => hard::stays(25, [0.9, 0.6, 0.3, 0.2], dependent, rng),
            Self::Rare => hard::rare(dependent, rng),
            Self::EpsilonGreedy => hard::epsilon_greedy(dependent, rng),
            Self::Copy(letters) => hard::copy(usize::from(letters), false, dependent, rng),
            Self::Answer64 => hard::copy(64, true, dependent, rng),
            Self::Weak(letters) => hard::weak(usize::from(letters), dependent, rng),
            Self::Masked => hard::masked(dependent, rng),
            Self::Segments => hard::segment(rng),
        }
    }
}

impl Visits {
    fn sample(self, rng: &mut Pcg64) -> usize {
        match self {
            Self::LogNormal { median, most } => {
                let normal = Normal::new(median.ln(), SPREAD).expect("a finite spread");
                normal.sample(rng).exp().round().clamp(1.0, most) as usize
            }
            Self::LogUniform { least, most } => {
                rng.random_range(least.ln()..most.ln()).exp().round() as usize
            }
        }
    }
}

/// Draws states.
pub fn planted(generator: Generator, options: &Options) -> Vec<Planted> {
    let mut rng = Pcg64::seed_from_u64(options.seed);
    let mut state = || match generator {
        Generator::Segments => in_segments(&mut rng),
        _ => state(generator, options, &mut rng),
    };
    (0..options.states).map(|_| state()).collect()
}

fn state(generator: Generator, options: &Options, rng: &mut Pcg64) -> Planted {
    let dependent = rng.random_bool(options.dependent);
    let leak_free = options.arm == Arm::LeakFree;
    let mut joint = generator.joint(dependent || leak_free, rng);
    if leak_free && !dependent {
        joint = product_of_margins(&joint);
    }
    let visits = generator.visits().sample(rng);
    let table = match options.arm {
        Arm::Shuffled => shuffled(&joint, visits, rng),
        _ if visits > ONE_BY_ONE => multinomial(&joint, visits, rng),
        _ => Table::from_counts(
            draw(&joint, visits, rng)
                .into_iter()
                .map(|(ego, other)| (ego, other, 1)),
        ),
    };
    Planted {
        table,
        information: information(&joint),
        dependent,
        segments: Vec::new(),
    }
}

fn shuffled(joint: &[Vec<f64>], visits: usize, rng: &mut Pcg64) -> Table {
    let seen = draw(joint, visits, rng);
    let mut others: Vec<u64> = seen.iter().map(|(_, other)| *other).collect();
    shuffle(&mut others, rng);
    Table::from_counts(
        seen.into_iter()
            .zip(others)
            .map(|((ego, _), other)| (ego, other, 1)),
    )
}

fn in_segments(rng: &mut Pcg64) -> Planted {
    let mut all = Vec::with_capacity(SEGMENTS * SEGMENT_VISITS);
    let mut segment = || {
        let seen = draw(&hard::segment(rng), SEGMENT_VISITS, rng);
        all.extend_from_slice(&seen);
        Table::from_counts(seen.into_iter().map(|(ego, other)| (ego, other, 1)))
    };
    let segments = (0..SEGMENTS).map(|_| segment()).collect();
    let table = Table::from_counts(all.into_iter().map(|(ego, other)| (ego, other, 1)));
    Planted {
        table,
        information: 0.0,
        dependent: false,
        segments,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROUNDING: f64 = 1e-12;

    fn drawn(generator: Generator, arm: Arm) -> Vec<Planted> {
        planted(
            generator,
            &Options {
                states: 400,
                arm,
                ..Options::default()
            },
        )
    }

    #[test]
    fn the_same_seed_gives_the_same_states() {
        for generator in Generator::USUAL {
            assert_eq!(drawn(generator, Arm::Plain), drawn(generator, Arm::Plain));
            let other = planted(
                generator,
                &Options {
                    states: 400,
                    seed: 2,
                    ..Options::default()
                },
            );
            assert_ne!(drawn(generator, Arm::Plain), other);
        }
    }

    #[test]
    fn influence_is_where_it_was_planted() {
        for generator in Generator::USUAL {
            for arm in [Arm::Plain, Arm::LeakFree] {
                let states = drawn(generator, arm);
                let dependent = states.iter().filter(|state| state.dependent).count();

                assert!(
                    (90..150).contains(&dependent),
                    "{generator:?}: {dependent} of 400"
                );
                for state in states {
                    assert_eq!(
                        state.information > ROUNDING,
                        state.dependent,
                        "{generator:?}: {}",
                        state.information
                    );
                }
            }
        }
    }

    #[test]
    fn visits_and_letters_are_in_range() {
        for generator in Generator::USUAL {
            let Alphabet { rows, columns } = generator.alphabet();
            let states = drawn(generator, Arm::Plain);

            assert!(
                states
                    .iter()
                    .all(|state| (1..=500).contains(&state.table.total()))
            );
            assert!(
                states.iter().all(|state| state
                    .table
                    .row_labels()
                    .iter()
                    .all(|label| *label < rows))
            );
            assert!(states.iter().all(|state| {
                state
                    .table
                    .column_labels()
                    .iter()
                    .all(|label| *label < columns)
            }));
        }
    }

    #[test]
    fn hard_worlds_are_as_they_are_named() {
        for generator in Generator::HARD {
            let states = planted(
                generator,
                &Options {
                    states: 40,
                    dependent: 0.5,
                    ..Options::default()
                },
            );
            let Alphabet { rows, columns } = generator.alphabet();

            assert!(
                states.iter().all(|state| state
                    .table
                    .row_labels()
                    .iter()
                    .all(|label| *label < rows))
            );
            assert!(states.iter().all(|state| {
                state
                    .table
                    .column_labels()
                    .iter()
                    .all(|label| *label < columns)
            }));
            for Planted {
                information,
                dependent,
                table,
                segments,
            } in &states
            {
                assert_eq!(
                    *information > 1e-9,
                    *dependent,
                    "{generator:?}: {information}"
                );
                let seen: u64 = segments.iter().map(Table::total).sum();
                assert_eq!(
                    seen,
                    if generator == Generator::Segments {
                        table.total()
                    } else {
                        0
                    }
                );
            }
        }
        let weak = planted(
            Generator::Weak(6),
            &Options {
                states: 40,
                dependent: 1.0,
                ..Options::default()
            },
        );
        let in_range = |state: &Planted| {
            (0.009..0.11).contains(&state.information)
                && (1_000..=1_000_000).contains(&state.table.total())
        };
        assert!(weak.iter().all(in_range));
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
