//! States are what their generators are named, and influence is where it was planted.

use super::*;
use nudge_core::information::Alphabet;

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
            states
                .iter()
                .all(|state| state.table.row_labels().iter().all(|label| *label < rows))
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
            states
                .iter()
                .all(|state| state.table.row_labels().iter().all(|label| *label < rows))
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
