//! Observations of pedestrians that were placed by hand.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::dvec2;
use proptest::prelude::*;
use serde_json::Value;

use super::*;
use crate::simulation::hallway::{Hallway, Protocol};
use nudge_core::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use nudge_core::domain::{Entry, SchemaDraft};

/// Reads the description without the room that reads descriptions: it stands beside this one.
fn schema() -> Schema {
    let value: Value = serde_json::from_str(DESCRIPTION).expect("JSON");
    let state = features(&value["state"]);
    let agent = |agent: &Value| AgentDraft {
        name: text(&agent["name"]),
        action: features(&agent["action"]),
        ..AgentDraft::default()
    };
    let agents = value["agents"]
        .as_array()
        .expect("a list")
        .iter()
        .map(agent)
        .collect();
    Schema::try_from(&SchemaDraft {
        state,
        agents,
        ..SchemaDraft::default()
    })
    .expect("sound")
}

fn features(list: &Value) -> Vec<FeatureDraft> {
    let kind = |feature: &Value| match feature["circular"]["bins"].as_i64() {
        Some(bins) => KindDraft::Circular(bins, None),
        None => {
            let edges = feature["continuous"]["edges"].as_array().expect("edges");
            KindDraft::Continuous(edges.iter().filter_map(Value::as_f64).collect())
        }
    };
    let feature = |feature: &Value| FeatureDraft {
        name: text(&feature["name"]),
        unit: None,
        kinds: vec![kind(feature)],
    };
    list.as_array()
        .expect("a list")
        .iter()
        .map(feature)
        .collect()
}

fn text(value: &Value) -> String {
    value.as_str().expect("text").to_owned()
}

fn observer() -> Observer {
    Observer::new(&schema(), &SocialForce::default())
}

/// One who wants to walk to the right.
fn at(id: u32, position: (f64, f64), velocity: (f64, f64)) -> Pedestrian {
    let (position, velocity) = (position.into(), velocity.into());
    Pedestrian {
        id,
        position,
        velocity,
        direction: DVec2::X,
        desired_speed: 1.34,
    }
}

fn close(values: &[f32], expected: &[f32]) -> bool {
    const ROUNDING: f32 = 1e-5;
    values.len() == expected.len()
        && values
            .iter()
            .zip(expected)
            .all(|(a, b)| (a - b).abs() < ROUNDING)
}

#[test]
fn the_values_stand_as_the_description_has_them() {
    let schema = schema();
    let state: Vec<&str> = schema
        .state()
        .iter()
        .map(|feature| feature.name.as_str())
        .collect();
    assert_eq!(
        state,
        [
            "a_distance",
            "a_bearing",
            "b_distance",
            "b_bearing",
            "ego_heading",
            "neighbour_heading"
        ]
    );
    let actions: Vec<String> = schema
        .action_features()
        .map(|(agent, feature)| format!("{}.{}", agent.name, feature.name))
        .collect();
    assert_eq!(
        actions,
        [
            "walker.turn",
            "walker.speed_change",
            "neighbour.turn",
            "neighbour.speed_change"
        ]
    );
    let bins: Vec<u32> = schema
        .state()
        .iter()
        .map(|feature| feature.kind.bins())
        .collect();
    assert_eq!(bins, [7, 8, 4, 4, 4, 4]);
    assert_eq!(
        schema
            .agents()
            .iter()
            .map(|agent| agent.actions())
            .collect::<Vec<_>>(),
        [25, 25]
    );
}

#[test]
fn a_row_is_a_pair_seen_by_the_ego() {
    let before = [
        at(0, (5.0, 1.0), (1.0, 0.0)),
        at(1, (7.0, 1.0), (-1.0, 0.0)),
        at(2, (7.0, 4.0), (0.0, 2.0)),
    ];
    let after = [
        at(0, (5.2, 1.0), (0.0, 1.5)),
        at(1, (6.8, 1.0), (-1.0, 0.0)),
        at(2, (7.0, 4.4), (0.0, 1.9)),
    ];
    let rows = observer().observe(0.0, &before, &after);
    let pairs: Vec<(u32, u32)> = rows.iter().map(|row| (row.ego, row.neighbour)).collect();
    assert_eq!(
        pairs,
        [(0, 1), (0, 2), (1, 0), (1, 2), (2, 1), (2, 0)],
        "by ego, the closest first"
    );
    // The closest to pedestrian 1 is pedestrian 0, the ego itself, two metres to its left.
    let first = &rows[0].transition;
    assert!(
        close(&first.state, &[2.0, 0.0, 2.0, PI, 0.0, PI]),
        "{:?}",
        first.state
    );
    assert!(
        close(&first.actions, &[FRAC_PI_2, 0.5, 0.0, 0.0]),
        "{:?}",
        first.actions
    );
    // The closest to pedestrian 2 is pedestrian 1, three metres below.
    let second = &rows[1].transition;
    assert!(
        close(
            &second.state,
            &[
                13_f32.sqrt(),
                1.5_f32.atan(),
                3.0,
                -FRAC_PI_2,
                0.0,
                FRAC_PI_2
            ]
        ),
        "{:?}",
        second.state
    );
    assert!(
        close(&second.actions, &[FRAC_PI_2, 0.5, 0.0, -0.1]),
        "{:?}",
        second.actions
    );
}

#[test]
fn a_turn_is_the_short_way_round() {
    let heading = |degrees: f64| DVec2::from_angle(degrees.to_radians());
    let turn = |from: f64, to: f64| {
        let walking = |degrees| Pedestrian {
            velocity: heading(degrees),
            ..at(0, (0.0, 0.0), (0.0, 0.0))
        };
        action(&walking(from), &walking(to))[0].to_degrees().round()
    };
    assert_eq!(
        [
            turn(170.0, -170.0),
            turn(-170.0, 170.0),
            turn(10.0, 30.0),
            turn(0.0, 180.0)
        ],
        [20.0, -20.0, 20.0, 180.0]
    );
    assert_eq!(wrapped(-std::f64::consts::PI), std::f64::consts::PI);
}

#[test]
fn who_stands_heads_where_it_wants_to_go() {
    let standing = Pedestrian {
        direction: DVec2::NEG_Y,
        ..at(0, (0.0, 0.0), (0.0, 0.0))
    };
    assert_eq!(heading(&standing), -std::f64::consts::FRAC_PI_2);
}

#[test]
fn a_row_is_dropped_if_either_leaves_within_the_record() {
    let before = [
        at(0, (1.0, 1.0), (1.0, 0.0)),
        at(1, (2.0, 1.0), (1.0, 0.0)),
        at(2, (19.9, 1.0), (1.0, 0.0)),
    ];
    let rows = observer().observe(0.0, &before, &before[..2]);
    let pairs: Vec<(u32, u32)> = rows.iter().map(|row| (row.ego, row.neighbour)).collect();
    assert_eq!(pairs, [(0, 1), (1, 0)]);
    assert!(
        observer()
            .observe(0.0, &before[..1], &before[..1])
            .is_empty(),
        "nobody to see"
    );
}

#[test]
fn a_pair_enters_when_its_bins_change_or_it_was_not_seen_before() {
    let mut observer = observer();
    // The pair of 0 and 1 by the distance of 1, and of 0 and 2 by whether 3, who is close to 0,
    // hides it.
    let mut entry = |distance: f64, is_hidden: bool, turn: f64| {
        let mut all = vec![
            at(0, (0.0, 0.0), (1.0, 0.0)),
            at(1, (distance, 0.0), (1.0, 0.0)),
            at(2, (9.0, 0.0), (1.0, 0.0)),
        ];
        if is_hidden {
            all.push(at(3, (0.1, 0.0), (1.0, 0.0)));
        }
        let after: Vec<Pedestrian> = all
            .iter()
            .map(|one| Pedestrian {
                velocity: DVec2::from_angle(turn),
                ..*one
            })
            .collect();
        let rows = observer.observe(0.0, &all, &after);
        let entry = |neighbour| {
            let row = rows
                .iter()
                .find(|row| (row.ego, row.neighbour) == (0, neighbour));
            row.map(|row| row.transition.entry == Entry::Entered)
        };
        (entry(1), entry(2))
    };
    let (left, right) = (1.0, -1.0);
    assert_eq!(
        entry(1.1, false, left),
        (Some(true), Some(true)),
        "seen for the first time"
    );
    assert_eq!(
        entry(1.4, false, right),
        (Some(false), Some(false)),
        "within the bin from 1 to 1.5 m"
    );
    assert_eq!(
        entry(1.6, false, left),
        (Some(true), Some(false)),
        "the next bin"
    );
    assert_eq!(entry(1.6, true, right).1, None);
    assert_eq!(
        entry(1.6, false, left),
        (Some(false), Some(true)),
        "not seen at the record before"
    );
    let again = [1.1, 1.6, 1.1, 1.6].map(|distance| entry(distance, false, left).0);
    let expected = [true, true, false, false].map(Some);
    assert_eq!(again, expected, "both turn as they did there before");
}

#[test]
fn the_labels_say_who_acts_on_whom() {
    // The second walks to the left, so its step of 2 s ends at 6: the first, at 7 and a bit aside,
    // lies in its ellipse and walks away from it.
    let ego = at(0, (7.0, 1.2), (-1.0, 0.0));
    let ego = Pedestrian {
        direction: DVec2::NEG_X,
        ..ego
    };
    let neighbour = Pedestrian {
        direction: DVec2::NEG_X,
        ..at(1, (8.0, 1.0), (-1.0, 0.0))
    };
    let rows = observer().observe(0.0, &[ego, neighbour], &[ego, neighbour]);
    let labels = |row: &Observation| (row.ego, row.in_neighbours_ellipse, row.neighbour_in_ellipse);
    assert_eq!(
        labels(&rows[0]),
        (0, true, false),
        "who walks behind acts on who walks ahead"
    );
    assert_eq!(
        labels(&rows[1]),
        (1, false, true),
        "the same, seen by the other"
    );
    // And so does the model: sight left aside, the one ahead is pushed and the one behind is not.
    let model = SocialForce::default();
    let step = dvec2(-2.0, 0.0);
    let push = |on: &Pedestrian, by: &Pedestrian| {
        model.repulsion(on.position - by.position, step).length()
    };
    assert!(push(&ego, &neighbour) > 10.0 * push(&neighbour, &ego));
}

#[test]
fn a_trial_is_observed_from_its_first_record_to_its_last() {
    let hallway = Hallway::try_from(Protocol {
        longest_trial: 3.0,
        ..Protocol::default()
    })
    .expect("sound");
    let observe = || Observations::of_trial(hallway.trial(1).expect("there is room"), &schema());
    let records: Vec<Vec<Observation>> = observe().collect();
    assert_eq!(records.len(), 15);
    assert!(
        records.iter().all(|rows| rows.len() == 20),
        "two neighbours each, and nobody leaves in 3 s"
    );
    assert!(
        records[0]
            .iter()
            .all(|row| row.time == 0.0 && row.transition.entry == Entry::Entered)
    );
    assert!(
        records
            .iter()
            .flatten()
            .any(|row| row.transition.entry == Entry::Stayed)
    );
    assert_eq!(observe().collect::<Vec<_>>(), records);
}

proptest! {
    #[test]
    fn the_two_closest_are_found_however_many_there_are(places in prop::collection::vec((0.0..200.0, 0.0..4.0), 1..300)) {
        let all: Vec<Pedestrian> = (0..).zip(places).map(|(id, place)| at(id, place, (1.0, 0.0))).collect();
        for (i, found) in two_closest(&all).into_iter().enumerate() {
            let distance = |j: &usize| all[i].position.distance_squared(all[*j].position);
            let mut others: Vec<usize> = (0..all.len()).filter(|j| *j != i).collect();
            others.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
            others.truncate(2);
            prop_assert_eq!(found, others);
        }
    }
}
