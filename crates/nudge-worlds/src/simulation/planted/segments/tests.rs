//! The worlds are what they are named, and their truth is what many visits show.

use rand::SeedableRng;
use rand_pcg::Pcg64;

use super::habits::{drifting, opposite};
use super::world::DOMINANT;
use super::*;
use crate::simulation::planted::joint::margins;
use nudge_core::information::{Alphabet, conditional, p_value, plug_in};

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
            let numbers: Vec<usize> = state.tables.iter().map(|(segment, _)| *segment).collect();
            assert!(numbers.is_sorted() && numbers.iter().all(|segment| *segment < world.segments));
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
        let dependent: Vec<&State> = states.iter().filter(|state| state.is_dependent()).collect();
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
