//! That the worlds are what they are said to be.

use std::sync::LazyLock;

use super::*;
use crate::experiments::kitchens::Layout;
use crate::experiments::measures::Hits;

/// Sums of six probabilities, and logarithms of them.
const ROUNDING: f64 = 1e-12;

/// Read once for all tests.
static VISITS: LazyLock<[Visits; 2]> = LazyLock::new(|| Layout::ALL.map(Visits::of_layout));

fn scenes() -> impl Iterator<Item = Scene> {
    VISITS.iter().flat_map(|visits| {
        ResponseModel::ALL.map(|response_model| Scene::of_visits(visits, response_model, None))
    })
}

fn yielding(layout: Layout) -> Scene {
    Scene::of_visits(&VISITS[layout as usize], ResponseModel::Yield, None)
}

#[test]
fn visits_are_those_of_the_recordings() {
    let told = |layout| {
        let scene = yielding(layout);
        let steps: usize = scene.unseen.iter().map(|(_, steps)| steps).sum();
        let strong = scene
            .unseen
            .iter()
            .filter(|(state, _)| scene.states[*state].is_strong());
        let strong: usize = strong.map(|(_, steps)| steps).sum();
        let permille = (1_000.0 * strong as f64 / steps as f64).round() as usize;
        [
            scene.states.len(),
            scene.train.len(),
            scene.unseen.len(),
            steps,
            permille,
        ]
    };
    assert_eq!(
        told(Layout::AsymmetricAdvantages),
        [4_619, 10_768, 1_445, 3_168, 167]
    );
    assert_eq!(
        told(Layout::CounterCircuit),
        [3_962, 9_627, 1_158, 2_633, 390]
    );
}

#[test]
fn policies_are_probabilities_with_little_staying() {
    for scene in scenes() {
        for state in &scene.states {
            for policy in [state.ego].iter().chain(&state.responses) {
                assert!(
                    (policy.iter().sum::<f64>() - 1.0).abs() < ROUNDING,
                    "{policy:?}"
                );
                assert!(policy.iter().all(|share| *share > 0.0), "{policy:?}");
            }
            assert!(state.ego[4] < 0.3 + ROUNDING, "{:?}", state.ego);
        }
    }
}

#[test]
fn there_is_influence_where_the_ego_is_answered_and_nowhere_else() {
    for scene in scenes() {
        for state in &scene.states {
            let most = if state.is_answered {
                6_f64.ln()
            } else {
                ROUNDING
            };
            assert!((0.0..=most).contains(&state.information), "{state:?}");
        }
    }
}

#[test]
fn who_knows_when_the_ego_is_answered_knows_where_influence_is_strong() {
    for layout in Layout::ALL {
        let scene = yielding(layout);
        let hits = Hits::of_decisions(scene.unseen.iter().map(|(state, _)| {
            let state = &scene.states[*state];
            (state.is_answered, state.is_strong())
        }));
        assert!(
            hits.f1().expect("there is influence") > 0.99,
            "{layout:?}: {hits:?}"
        );
    }
}

#[test]
fn the_same_seed_draws_the_same_actions() {
    let scene = yielding(Layout::CounterCircuit);
    let drawn = scene.draw(3);
    assert_eq!((drawn.len(), &drawn), (scene.train.len(), &scene.draw(3)));
    assert_ne!(drawn, scene.draw(4));
}

#[test]
fn drawn_actions_are_as_frequent_as_they_are_probable() {
    let scene = yielding(Layout::CounterCircuit);
    let drawn = scene.draw(1);
    for action in 0..ACTIONS {
        let expected: f64 = scene
            .train
            .iter()
            .map(|state| scene.states[*state].ego[action])
            .sum();
        let times = drawn.iter().filter(|[ego, _]| *ego == action).count() as f64;
        // Five standard deviations of a sum of draws.
        assert!(
            (times - expected).abs() < 5.0 * expected.sqrt(),
            "{action}: {times} of {expected}"
        );
    }
}

#[test]
fn shuffling_moves_what_the_other_does_within_a_state() {
    let scene = yielding(Layout::CounterCircuit);
    let drawn = scene.draw(1);
    let shuffled = scene.shuffled(&drawn, 1);
    assert_ne!(drawn, shuffled);
    let habits = |actions: &[Actions]| {
        let mut pairs: Vec<_> = scene
            .train
            .iter()
            .zip(actions)
            .map(|(state, [_, other])| (*state, *other))
            .collect();
        pairs.sort_unstable();
        pairs
    };
    assert_eq!(habits(&drawn), habits(&shuffled));
    assert!(
        drawn
            .iter()
            .zip(&shuffled)
            .all(|(before, after)| before[0] == after[0])
    );
}
