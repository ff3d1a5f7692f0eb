//! Generators of states: the joint distribution of each, and how often it is seen.

use rand::RngExt;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use super::hard;
use super::joint::{dirichlet, joint, mixed};
use nudge_core::information::Alphabet;

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

/// How often a state is seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Visits {
    /// e^x for a normal x about ln of the median, at most so often.
    LogNormal { median: f64, most: f64 },
    /// Every order of magnitude between these is as likely as any other.
    LogUniform { least: f64, most: f64 },
}

/// The standard deviation of the logarithm of visits.
const SPREAD: f64 = 1.4;

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

    /// Returns how often its states are seen.
    pub(super) fn visits(self) -> Visits {
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

    /// Draws a joint distribution, rows first.
    pub(super) fn joint(self, dependent: bool, rng: &mut Pcg64) -> Vec<Vec<f64>> {
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
    /// Draws how often a state is seen.
    pub(super) fn sample(self, rng: &mut Pcg64) -> usize {
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
