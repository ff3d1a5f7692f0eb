//! Stratified worlds (Simpson 1951): states whose visits come in segments, between which habits may
//! differ and within which influence is planted, or is not.
//!
//! Pooled over segments, differing habits look like dependence. The truth is what happens within:
//! the conditional mutual information I = sum_g w_g I(p_g, rho_g), where w_g is the segment's share
//! of the visits, p_g the ego's habits in it and rho_g how the other responds there.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use super::joint::{
    Pull, dirichlet, draw, information, joint, multinomial, pulled, pulls, shuffle,
};
use nudge_core::information::{Alphabet, Occupied, Table};

/// The share of a dominant segment.
const DOMINANT: f64 = 0.9;

/// Where sizes fall, each segment has so much of the one before.
const FALLING: f64 = 0.5;

/// Where habits drift, their logarithms begin with a standard deviation of 1 and move by so much
/// from one segment to the next.
const STEP: f64 = 0.25;

/// How a state's visits are shared out between its segments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sizes {
    /// All alike.
    Equal,
    /// Each half of the one before.
    Falling,
    /// The first has nine visits in ten, the others share the rest.
    Dominated,
}

/// Whose habits differ between the segments of a state. Each that does is drawn afresh from Dir(1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Differ {
    /// Nobody's: segments do not matter.
    Neither,
    /// The ego's.
    Ego,
    /// The other's.
    Other,
    /// Both agents'.
    Both,
    /// Both agents': what is likely in one segment is unlikely in the next.
    Opposite,
    /// Both agents', slowly, from one segment to the next.
    Drift,
}

/// In which segments of a dependent state the other responds to the ego. Where it does, two of the
/// ego's actions or more each draw it from its habit towards a response of their own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dependence {
    /// In none of any state.
    Nowhere,
    /// In all of them, by the same responses.
    Shared,
    /// In a single one, any of them; there, each of the ego's actions has a response of its own
    /// (Dir(0.1)), for a weaker dependence is lost among the visits of the other segments.
    InOne,
    /// In all of them, by responses that differ from segment to segment.
    Differing,
}

/// A kind of world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct World {
    /// Its name.
    pub name: &'static str,
    /// How many actions either agent has.
    pub alphabet: Alphabet,
    /// How many segments a state is seen in.
    pub segments: usize,
    /// How its visits are shared out between them.
    pub sizes: Sizes,
    /// Whose habits differ.
    pub differ: Differ,
    /// Where the other responds to the ego.
    pub dependence: Dependence,
}

/// Every world: first those in which nothing depends on anything, then those in which some states
/// do.
pub const WORLDS: [World; 29] = [
    independent("alike", 8, Differ::Neither),
    independent("ego", 8, Differ::Ego),
    independent("other", 8, Differ::Other),
    independent("both", 8, Differ::Both),
    independent("both2", 2, Differ::Both),
    independent("both20", 20, Differ::Both),
    independent("both50", 50, Differ::Both),
    independent("both300", 300, Differ::Both),
    independent("opposite", 2, Differ::Opposite),
    independent("drift", 50, Differ::Drift),
    World {
        sizes: Sizes::Falling,
        ..independent("unequal", 8, Differ::Both)
    },
    World {
        sizes: Sizes::Dominated,
        ..independent("dominated", 8, Differ::Both)
    },
    World {
        alphabet: TWO_BY_TWO,
        ..independent("both-2x2", 8, Differ::Both)
    },
    World {
        alphabet: THREE_BY_TWENTY_FIVE,
        ..independent("both-3x25", 8, Differ::Both)
    },
    dependent("alike-some", 8, Differ::Neither, Dependence::Shared),
    dependent("ego-some", 8, Differ::Ego, Dependence::Shared),
    dependent("other-some", 8, Differ::Other, Dependence::Shared),
    dependent("both-some", 8, Differ::Both, Dependence::Shared),
    dependent("both2-some", 2, Differ::Both, Dependence::Shared),
    dependent("both20-some", 20, Differ::Both, Dependence::Shared),
    dependent("both50-some", 50, Differ::Both, Dependence::Shared),
    dependent("both300-some", 300, Differ::Both, Dependence::Shared),
    dependent("drift-some", 50, Differ::Drift, Dependence::Shared),
    World {
        sizes: Sizes::Falling,
        ..dependent("unequal-some", 8, Differ::Both, Dependence::Shared)
    },
    World {
        sizes: Sizes::Dominated,
        ..dependent("dominated-some", 8, Differ::Both, Dependence::Shared)
    },
    dependent("alike-in-one", 6, Differ::Neither, Dependence::InOne),
    dependent("both-in-one", 6, Differ::Both, Dependence::InOne),
    dependent("alike-differing", 6, Differ::Neither, Dependence::Differing),
    dependent("both-differing", 6, Differ::Both, Dependence::Differing),
];

const SIX_BY_SIX: Alphabet = Alphabet {
    rows: 6,
    columns: 6,
};
const TWO_BY_TWO: Alphabet = Alphabet {
    rows: 2,
    columns: 2,
};
const THREE_BY_TWENTY_FIVE: Alphabet = Alphabet {
    rows: 3,
    columns: 25,
};

const fn independent(name: &'static str, segments: usize, differ: Differ) -> World {
    dependent(name, segments, differ, Dependence::Nowhere)
}

const fn dependent(
    name: &'static str,
    segments: usize,
    differ: Differ,
    dependence: Dependence,
) -> World {
    World {
        name,
        alphabet: SIX_BY_SIX,
        segments,
        sizes: Sizes::Equal,
        differ,
        dependence,
    }
}

/// What to draw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// How many states.
    pub states: usize,
    /// The share of dependent states, where a world has any.
    pub dependent: f64,
    /// Visits of each state, over all of its segments.
    pub visits: usize,
    /// The same seed gives the same states.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            states: 200,
            dependent: 0.3,
            visits: 30,
            seed: 1,
        }
    }
}

/// One state, and the truth of it.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// What was seen in each segment by its number, ascending; rows are the ego's actions. Segments
    /// without visits are left out.
    pub tables: Vec<(usize, Table)>,
    /// The numbers of the segments in which the other depends on the ego, ascending; visited or
    /// not.
    pub dependent: Vec<usize>,
    /// sum_g w_g I(p_g, rho_g) in nats, w_g the expected share of the visits.
    pub information: f64,
}

impl State {
    /// Returns whether there is dependence within any segment.
    pub fn is_dependent(&self) -> bool {
        !self.dependent.is_empty()
    }

    /// Returns what was seen over all segments together.
    pub fn pooled(&self) -> Table {
        pooled(self.tables.iter().map(|(_, table)| table))
    }

    /// Returns what was seen, cut by segment.
    pub fn cut(&self) -> Vec<Table> {
        self.tables.iter().map(|(_, table)| table.clone()).collect()
    }
}

/// Adds tables up.
pub fn pooled<'a>(tables: impl IntoIterator<Item = &'a Table>) -> Table {
    let counts = |table: &'a Table| {
        let count = |cell: &Occupied| {
            (
                table.row_labels()[cell.row as usize],
                table.column_labels()[cell.column as usize],
                cell.n,
            )
        };
        table.cells().iter().map(count).collect::<Vec<_>>()
    };
    Table::from_counts(tables.into_iter().flat_map(counts))
}

/// Draws the states of a world.
pub fn states(world: &World, options: &Options) -> Vec<State> {
    let mut rng = Pcg64::seed_from_u64(options.seed);
    (0..options.states)
        .map(|_| state(world, options, &mut rng))
        .collect()
}

fn state(world: &World, options: &Options, rng: &mut Pcg64) -> State {
    let dependent = world.dependent_segments(rng.random_bool(options.dependent), rng);
    let joints = world.joints(&dependent, rng);
    let weights = world.weights();
    // Of the others it is 0, which sums would only nearly be.
    let information = dependent
        .iter()
        .map(|segment| weights[*segment] * information(&joints[*segment]))
        .sum();
    State {
        tables: seen(&weights, &joints, options.visits, rng),
        dependent,
        information,
    }
}

/// Deals visits to segments, and draws those of each.
fn seen(
    weights: &[f64],
    joints: &[Vec<Vec<f64>>],
    visits: usize,
    rng: &mut Pcg64,
) -> Vec<(usize, Table)> {
    let dealt = multinomial(&[weights.to_vec()], visits, rng);
    let mut table = |(segment, visits): (&u64, &u64)| {
        let segment = *segment as usize;
        let seen = draw(&joints[segment], *visits as usize, rng);
        (
            segment,
            Table::from_counts(seen.into_iter().map(|(ego, other)| (ego, other, 1))),
        )
    };
    dealt
        .column_labels()
        .iter()
        .zip(dealt.columns())
        .map(&mut table)
        .collect()
}

impl World {
    /// Returns the expected share of each segment in a state's visits.
    pub fn weights(&self) -> Vec<f64> {
        let rest = (1.0 - DOMINANT) / (self.segments - 1).max(1) as f64;
        let size = |segment: usize| match self.sizes {
            Sizes::Equal => 1.0,
            Sizes::Falling => FALLING.powi(segment as i32),
            Sizes::Dominated => {
                if segment == 0 {
                    DOMINANT
                } else {
                    rest
                }
            }
        };
        let sum: f64 = (0..self.segments).map(size).sum();
        (0..self.segments)
            .map(|segment| size(segment) / sum)
            .collect()
    }

    fn dependent_segments(&self, is_dependent: bool, rng: &mut Pcg64) -> Vec<usize> {
        match self.dependence {
            _ if !is_dependent => Vec::new(),
            Dependence::Nowhere => Vec::new(),
            Dependence::InOne => vec![rng.random_range(0..self.segments)],
            Dependence::Shared | Dependence::Differing => (0..self.segments).collect(),
        }
    }

    /// Draws the joint distribution of each segment of a state, rows first.
    fn joints(&self, dependent: &[usize], rng: &mut Pcg64) -> Vec<Vec<Vec<f64>>> {
        let [rows, columns] =
            [self.alphabet.rows, self.alphabet.columns].map(|letters| letters as usize);
        let egos = self.habits(matches!(self.differ, Differ::Ego | Differ::Both), rows, rng);
        let others = self.habits(
            matches!(self.differ, Differ::Other | Differ::Both),
            columns,
            rng,
        );

        let mut responses = || match self.dependence {
            Dependence::InOne => answers(rows, columns, rng),
            _ => pulls(rows, columns, rng.random_range(2..=rows), rng),
        };
        let shared = responses();
        let mut responses_in = |segment: usize| match self.dependence {
            _ if !dependent.contains(&segment) => Vec::new(),
            Dependence::Differing => responses(),
            _ => shared.clone(),
        };
        let in_segment = |segment: usize| {
            joint(
                &egos[segment],
                &pulled(rows, &others[segment], &responses_in(segment)),
            )
        };
        (0..self.segments).map(in_segment).collect()
    }

    /// Draws the habits of one agent in each segment of a state.
    fn habits(&self, differ: bool, letters: usize, rng: &mut Pcg64) -> Vec<Vec<f64>> {
        match self.differ {
            Differ::Opposite => opposite(self.segments, letters, rng),
            Differ::Drift => drifting(self.segments, letters, rng),
            _ if differ => (0..self.segments)
                .map(|_| dirichlet(1.0, letters, rng))
                .collect(),
            _ => vec![dirichlet(1.0, letters, rng); self.segments],
        }
    }
}

/// Draws a response to every one of the ego's actions, which the other always follows.
fn answers(rows: usize, columns: usize, rng: &mut Pcg64) -> Vec<Pull> {
    (0..rows)
        .map(|action| Pull {
            action,
            share: 1.0,
            response: dirichlet(0.1, columns, rng),
        })
        .collect()
}

/// Draws a habit and its opposite, in turns: the letter that is likeliest in one is unlikeliest in
/// the other.
fn opposite(segments: usize, letters: usize, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let mut sorted = dirichlet(1.0, letters, rng);
    sorted.sort_by(f64::total_cmp);
    let mut ranks: Vec<usize> = (0..letters).collect();
    shuffle(&mut ranks, rng);
    let habit = |segment: usize| {
        let rank = |rank: &usize| {
            if segment.is_multiple_of(2) {
                *rank
            } else {
                letters - 1 - rank
            }
        };
        ranks.iter().map(|at| sorted[rank(at)]).collect()
    };
    (0..segments).map(habit).collect()
}

/// Draws habits whose logarithms are a random walk.
fn drifting(segments: usize, letters: usize, rng: &mut Pcg64) -> Vec<Vec<f64>> {
    let mut logarithms: Vec<f64> = (0..letters).map(|_| StandardNormal.sample(rng)).collect();
    let mut habit = |_| {
        let exponentials: Vec<f64> = logarithms.iter().map(|ln| ln.exp()).collect();
        let sum: f64 = exponentials.iter().sum();
        for ln in &mut logarithms {
            let step: f64 = StandardNormal.sample(rng);
            *ln += STEP * step;
        }
        exponentials.into_iter().map(|e| e / sum).collect()
    };
    (0..segments).map(&mut habit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::planted::joint::margins;
    use nudge_core::information::{conditional, p_value, plug_in};

    const ROUNDING: f64 = 1e-12;

    fn named(name: &str) -> World {
        WORLDS
            .into_iter()
            .find(|world| world.name == name)
            .expect("a world")
    }

    /// Returns the share of states whose actions a test at .05 calls dependent, by what `slices`
    /// makes of them.
    fn alarms<'a>(
        states: impl IntoIterator<Item = &'a State>,
        slices: fn(&State) -> Vec<Table>,
    ) -> f64 {
        let alarms: Vec<bool> = states
            .into_iter()
            .map(|state| p_value(&slices(state), 199, 1).p_value <= 0.05)
            .collect();
        alarms.iter().filter(|alarm| **alarm).count() as f64 / alarms.len() as f64
    }

    fn together(state: &State) -> Vec<Table> {
        vec![state.pooled()]
    }

    #[test]
    fn every_world_has_a_name_of_its_own() {
        let mut names: Vec<&str> = WORLDS.iter().map(|world| world.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), WORLDS.len());
    }

    #[test]
    fn the_same_seed_gives_the_same_states() {
        for world in WORLDS {
            let drawn = |seed| {
                states(
                    &world,
                    &Options {
                        states: 5,
                        seed,
                        ..Options::default()
                    },
                )
            };
            assert_eq!(drawn(1), drawn(1), "{}", world.name);
            assert_ne!(drawn(1), drawn(2), "{}", world.name);
        }
    }

    #[test]
    fn visits_are_as_many_as_wanted_and_within_the_alphabet() {
        for world in WORLDS {
            let Alphabet { rows, columns } = world.alphabet;
            for state in states(
                &world,
                &Options {
                    states: 20,
                    visits: 150,
                    ..Options::default()
                },
            ) {
                let numbers: Vec<usize> =
                    state.tables.iter().map(|(segment, _)| *segment).collect();
                assert!(
                    numbers.is_sorted() && numbers.iter().all(|segment| *segment < world.segments)
                );
                assert!(
                    state.tables.iter().all(|(_, table)| table.total() > 0),
                    "{}",
                    world.name
                );

                let pooled = state.pooled();
                assert_eq!(pooled.total(), 150, "{}", world.name);
                assert!(
                    pooled.row_labels().iter().all(|label| *label < rows),
                    "{}",
                    world.name
                );
                assert!(
                    pooled.column_labels().iter().all(|label| *label < columns),
                    "{}",
                    world.name
                );
            }
        }
    }

    #[test]
    fn segments_have_the_shares_of_visits_that_they_should() {
        for world in WORLDS {
            let weights = world.weights();
            assert!(
                (weights.iter().sum::<f64>() - 1.0).abs() < ROUNDING,
                "{}",
                world.name
            );
            let mut seen = vec![0.0; world.segments];
            for (segment, table) in states(&world, &Options::default())
                .iter()
                .flat_map(|state| &state.tables)
            {
                seen[*segment] += table.total() as f64 / (200.0 * 30.0);
            }
            for (seen, weight) in seen.iter().zip(&weights) {
                // Four standard deviations of a share of 6,000 visits.
                assert!(
                    (seen - weight).abs() < 4.0 * (weight / 6_000.0).sqrt(),
                    "{}: {seen} {weight}",
                    world.name
                );
            }
        }
        assert!((named("dominated").weights()[0] - DOMINANT).abs() < ROUNDING);
        assert!((named("unequal").weights()[0] - 128.0 / 255.0).abs() < ROUNDING);
    }

    #[test]
    fn dependence_is_where_it_was_planted() {
        for world in WORLDS {
            let states = states(&world, &Options::default());
            let dependent: Vec<&State> =
                states.iter().filter(|state| state.is_dependent()).collect();
            let expected = if world.dependence == Dependence::Nowhere {
                0..=0
            } else {
                35..=85
            };
            assert!(
                expected.contains(&dependent.len()),
                "{}: {}",
                world.name,
                dependent.len()
            );

            let segments = if world.dependence == Dependence::InOne {
                1
            } else {
                world.segments
            };
            assert!(
                dependent
                    .iter()
                    .all(|state| state.dependent.len() == segments),
                "{}",
                world.name
            );
            for state in &states {
                assert!(
                    state.is_dependent() || state.information == 0.0,
                    "{}",
                    world.name
                );
                assert_eq!(
                    state.information > 1e-9,
                    state.is_dependent(),
                    "{}",
                    world.name
                );
            }
        }
    }

    #[test]
    fn habits_differ_between_segments_where_they_should() {
        for world in WORLDS
            .into_iter()
            .filter(|world| world.dependence == Dependence::Nowhere)
        {
            let joints = world.joints(&[], &mut Pcg64::seed_from_u64(1));
            let [egos, others]: [Vec<Vec<f64>>; 2] = {
                let margins: Vec<_> = joints.iter().map(|joint| margins(joint)).collect();
                [
                    margins.iter().map(|(ego, _)| ego.clone()).collect(),
                    margins.into_iter().map(|(_, other)| other).collect(),
                ]
            };
            let differ = |habits: &[Vec<f64>]| {
                habits
                    .iter()
                    .zip(&habits[1..])
                    .all(|(a, b)| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-3))
            };
            let same = |habits: &[Vec<f64>]| {
                habits.iter().all(|habit| {
                    habit
                        .iter()
                        .zip(&habits[0])
                        .all(|(a, b)| (a - b).abs() < ROUNDING)
                })
            };
            let [of_ego, of_other] = match world.differ {
                Differ::Neither => [false; 2],
                Differ::Ego => [true, false],
                Differ::Other => [false, true],
                Differ::Both | Differ::Opposite | Differ::Drift => [true; 2],
            };
            for (habits, should) in [(egos, of_ego), (others, of_other)] {
                assert_eq!(
                    [differ(&habits), same(&habits)],
                    [should, !should],
                    "{}",
                    world.name
                );
            }
        }
    }

    #[test]
    fn opposite_habits_are_each_others_reverse() {
        let [one, other] = &opposite(2, 6, &mut Pcg64::seed_from_u64(1))[..] else {
            panic!("two segments")
        };
        let ascending = |habit: &[f64]| {
            let mut letters: Vec<usize> = (0..6).collect();
            letters.sort_by(|a, b| habit[*a].total_cmp(&habit[*b]));
            letters
        };
        let mut reversed = ascending(other);
        reversed.reverse();
        assert_eq!(ascending(one), reversed);
    }

    #[test]
    fn drifting_habits_move_slowly_and_far() {
        let (mut near, mut far) = (0.0, 0.0);
        let mut rng = Pcg64::seed_from_u64(1);
        for _ in 0..100 {
            let habits = drifting(50, 6, &mut rng);
            let apart = |a: usize, b: usize| -> f64 {
                habits[a]
                    .iter()
                    .zip(&habits[b])
                    .map(|(a, b)| 0.5 * (a - b).abs())
                    .sum()
            };
            near += apart(0, 1) / 100.0;
            far += apart(0, 49) / 100.0;
        }
        assert!(near < 0.12 && far > 0.4, "{near} {far}");
    }

    #[test]
    fn the_truth_is_what_many_visits_show_within_segments() {
        for name in [
            "both",
            "dominated",
            "both-some",
            "unequal-some",
            "both-in-one",
            "alike-differing",
        ] {
            for state in states(
                &named(name),
                &Options {
                    states: 4,
                    dependent: 0.7,
                    visits: 60_000,
                    seed: 1,
                },
            ) {
                let seen = conditional(&state.cut(), plug_in);
                assert!(
                    (seen - state.information).abs() < 0.02,
                    "{name}: {seen} {}",
                    state.information
                );
            }
        }
    }

    #[test]
    fn nothing_depends_within_segments_where_nothing_was_planted() {
        for world in WORLDS {
            let states = states(
                &world,
                &Options {
                    visits: 150,
                    ..Options::default()
                },
            );
            let independent = states.iter().filter(|state| !state.is_dependent());
            // 140 states and more: .05 and three standard deviations.
            assert!(alarms(independent, State::cut) < 0.106, "{}", world.name);
        }
    }

    #[test]
    fn pooled_segments_show_dependence_that_is_not_there() {
        let told = |name: &str| {
            alarms(
                &states(
                    &named(name),
                    &Options {
                        visits: 150,
                        ..Options::default()
                    },
                ),
                together,
            )
        };
        assert!(told("opposite") > 0.5, "{}", told("opposite"));
        assert!(
            told("both") > 0.15 && told("both2") > 0.4,
            "{} {}",
            told("both"),
            told("both2")
        );
        for unmoved in ["alike", "ego", "other"] {
            assert!(
                told(unmoved) < 0.1,
                "{unmoved}: one agent's habits make nothing of themselves: {}",
                told(unmoved)
            );
        }
    }

    #[test]
    fn planted_dependence_shows_within_segments() {
        for name in ["alike-some", "both2-some", "both-in-one", "alike-differing"] {
            let states = states(
                &named(name),
                &Options {
                    visits: 150,
                    ..Options::default()
                },
            );
            let dependent = alarms(
                states.iter().filter(|state| state.is_dependent()),
                State::cut,
            );
            assert!(dependent > 0.15, "{name}: {dependent}");
        }
    }
}
