//! The files that come with the program, and files that are wrong.

use super::*;
use nudge_core::domain::{DerivedFeatures, Entry, Schema};
use nudge_core::tracks::{Step as Played, Track};

const HEADER: &str = "layout,trial,t,state,action0,action1\n";
const STATE: &str = r#""{""p"":[[1,1,""N"",""""],[3,2,""S"",""onion""]],""o"":[]}""#;

fn games(file: usize) -> Vec<Game> {
    read_games(embedded()[file].1).expect("it comes with the program")
}

fn steps(games: &[Game], layout: &str) -> usize {
    games
        .iter()
        .filter(|game| game.layout == layout)
        .map(|game| game.steps.len())
        .sum()
}

fn error(rows: &[&str]) -> String {
    read_games(format!("{HEADER}{}", rows.join("\n")).as_bytes())
        .expect_err("wrong")
        .to_string()
}

#[test]
fn the_files_hold_what_their_source_says() {
    let layouts = Kitchen::all().into_iter().map(|kitchen| kitchen.name);
    let counts: Vec<_> = {
        let (train, test) = (games(0), games(1));
        assert_eq!((train.len(), test.len()), (39, 37));
        layouts
            .map(|layout| (steps(&train, &layout), steps(&test, &layout)))
            .collect()
    };
    let expected = [
        (10_768, 9_617),
        (9_619, 9_562),
        (9_627, 8_344),
        (9_564, 9_626),
        (7_151, 7_224),
    ];
    assert_eq!(counts, expected);
    assert_eq!(
        counts
            .iter()
            .fold((0, 0), |(a, b), (train, test)| (a + train, b + test)),
        (46_729, 44_373)
    );
}

#[test]
fn every_step_has_a_state_and_actions_in_every_environment() {
    let games: Vec<Game> = [games(0), games(1)].concat();
    for kitchen in Kitchen::all() {
        for abstraction in Abstraction::ALL {
            let world = World::new(kitchen.clone(), abstraction);
            let schema = Schema::try_from(&world.description()).expect("a valid description");
            for step in games
                .iter()
                .filter(|game| game.layout == kitchen.name)
                .flat_map(|game| &game.steps)
            {
                let (state, actions) = world.values(step);
                schema.key_of_values(&state).expect("a valid state");
                let moves = schema.action_features().zip(&actions);
                assert!(
                    moves
                        .into_iter()
                        .all(|((_, feature), value)| feature.kind.bin(*value).is_ok())
                );
            }
        }
    }
}

/// People hold their moves for a few steps only: what counts as a draw of a state is nearly every
/// step that entered it.
#[test]
fn human_play_keeps_nearly_all_of_its_entries() {
    for (kitchen, least) in Kitchen::all()
        .into_iter()
        .zip([0.97, 0.98, 0.97, 0.97, 0.98])
    {
        let world = World::new(kitchen.clone(), Abstraction::default());
        let schema = Schema::try_from(&world.description()).expect("a valid description");
        let (mut entered, mut counted) = (0, 0);
        for game in [games(0), games(1)].concat() {
            if game.layout != kitchen.name {
                continue;
            }
            let (mut track, mut last) = (Track::new(&schema), None);
            for step in &game.steps {
                let (state, actions) = world.values(step);
                let key = schema.key_of_values(&state).ok();
                let enters = key != last;
                last = key;
                let record = track.step(Played::new(state, actions));
                let counts = record.expect("no outcomes").entry == Entry::Entered;
                assert!(enters || !counts, "a stay is no draw");
                entered += u32::from(enters);
                counted += u32::from(counts);
            }
        }
        let kept = f64::from(counted) / f64::from(entered);
        assert!(kept >= least && kept < 1.0, "{}: {kept}", kitchen.name);
    }
}

#[test]
fn a_step_becomes_values_in_the_order_of_the_description() {
    let text = format!("{HEADER}cramped_room,w1,0,{STATE},N,interact\n");
    let world = World::new(
        Kitchen::named("cramped_room").expect("known"),
        Abstraction::PosOriHeldPot,
    );
    let schema = Schema::try_from(&world.description()).expect("valid");
    let names: Vec<String> = schema
        .state()
        .iter()
        .map(|feature| feature.name.to_string())
        .collect();
    let player = |i| ["position", "orientation", "held"].map(|part| format!("player_{i}.{part}"));
    assert_eq!(
        names,
        [
            player(0).to_vec(),
            player(1).to_vec(),
            vec!["pot_2_0".into()]
        ]
        .concat()
    );
    let (state, actions) = world.values(&read_games(text.as_bytes()).expect("right")[0].steps[0]);
    assert_eq!(state, [0.0, 0.0, 0.0, 5.0, 1.0, 1.0, 0.0]);
    assert_eq!(actions, [0.0, 5.0]);
}

#[test]
fn at_lags_places_are_numbers_and_what_is_held_is_an_outcome() {
    for kitchen in Kitchen::all() {
        for abstraction in Abstraction::ALL {
            let usual = World::new(kitchen.clone(), abstraction);
            let unchanged = usual.clone().at_lags(Vec::new());
            assert_eq!(unchanged.description(), usual.description());

            let world = usual.at_lags(vec![1, 3]);
            assert_eq!(world.environment_name(), unchanged.environment_name());
            let schema = Schema::try_from(&world.description()).expect("valid");
            let names = schema.state().iter().map(|feature| feature.name.as_str());
            let places: Vec<&str> = names
                .filter(|name| name.ends_with(".x") || name.ends_with(".y"))
                .collect();
            let expected = ["player_0.x", "player_0.y", "player_1.x", "player_1.y"];
            assert_eq!(places, expected);
            let outcomes = schema.outcomes().iter().map(|one| one.name.as_str());
            assert_eq!(
                outcomes.collect::<Vec<_>>(),
                [
                    "player_0@1",
                    "player_0@3",
                    "player_1@1",
                    "player_1@3",
                    "player_0.held_next",
                    "player_1.held_next"
                ]
            );
        }
    }
}

#[test]
fn at_lags_players_are_so_far_apart_as_the_recording_says() {
    for game in games(1) {
        let kitchen = Kitchen::named(&game.layout).expect("known");
        let usual = World::new(kitchen, Abstraction::Pos);
        assert_eq!(usual.derived(), [], "places are labels");

        let world = usual.at_lags(vec![1]);
        let schema = Schema::try_from(&world.description()).expect("valid");
        let derived = DerivedFeatures::checked(&world.derived(), &schema).expect("valid");
        for step in &game.steps {
            let key = schema.key_of_values(&world.values(step).0).expect("valid");
            let [zero, one] = &step.players;
            let [dx, dy] = [(zero.x, one.x), (zero.y, one.y)]
                .map(|(from, to)| i64::from(to) - i64::from(from));
            let expected = [dx, dy, dx.abs() + dy.abs()].map(|number| number.to_string());
            let told: Vec<String> = derived
                .iter()
                .map(|feature| feature.kind.bin_label(feature.bin(&key)))
                .collect();
            assert_eq!(told, expected, "{}", game.layout);
        }
    }
}

/// What follows a step is what the recording has there, and places tell as much as labels did.
#[test]
fn a_track_of_play_has_what_follows_each_step() {
    let game = games(1).into_iter().next().expect("there are games");
    let kitchen = Kitchen::named(&game.layout).expect("known");
    let usual = World::new(kitchen, Abstraction::default());
    let world = usual.clone().at_lags(vec![1, 2]);
    let [before, schema] =
        [&usual, &world].map(|world| Schema::try_from(&world.description()).expect("valid"));

    let mut track = Track::new(&schema);
    let mut records = Vec::new();
    for step in &game.steps {
        let (state, actions) = world.values(step);
        records.extend(track.step(Played::new(state, actions).observing(world.observed(step))));
    }
    records.extend(track.end());

    assert_eq!(records.len(), game.steps.len());
    let mut keys = std::collections::HashMap::new();
    for (at, record) in records.iter().enumerate() {
        let moved = |player: usize, lag: usize| {
            let later = game.steps.get(at + lag)?;
            Move::ALL
                .iter()
                .position(|one| *one == later.actions[player])
        };
        let held = |player: usize| {
            let later = game.steps.get(at + 1)?;
            Held::ALL
                .iter()
                .position(|one| *one == later.players[player].held)
        };
        let follows = [
            moved(0, 1),
            moved(0, 2),
            moved(1, 1),
            moved(1, 2),
            held(0),
            held(1),
        ];
        for (outcome, expected) in follows.into_iter().enumerate() {
            let all = record.outcomes_present.is_empty() && !record.outcomes.is_empty();
            let is_there = record.outcomes_present.get(outcome).copied().unwrap_or(all);
            assert_eq!(
                is_there,
                expected.is_some(),
                "outcome {outcome} of step {at}"
            );
            if let Some(expected) = expected {
                assert_eq!(
                    record.outcomes[outcome], expected as f32,
                    "outcome {outcome}"
                );
            }
        }

        let (state, _) = usual.values(&game.steps[at]);
        let label = before.key_of_values(&state).expect("valid");
        let key = schema.key_of_values(&record.state).expect("valid");
        assert_eq!(keys.entry(key).or_insert(label.clone()), &label);
    }
}

#[test]
fn pots_fill_cook_and_are_ready() {
    let world = World::new(
        Kitchen::named("cramped_room").expect("known"),
        Abstraction::PosOriHeldPot,
    );
    let pot = |items, timer| {
        let mut step = read_games(format!("{HEADER}cramped_room,w1,0,{STATE},N,N\n").as_bytes())
            .expect("right")[0]
            .steps[0]
            .clone();
        step.objects = vec![Object {
            x: 2,
            y: 0,
            thing: Thing::Soup { items, timer },
        }];
        world.values(&step).0[6]
    };
    assert_eq!(
        [
            pot(1, 0),
            pot(2, 0),
            pot(3, 1),
            pot(3, 19),
            pot(3, 20),
            pot(3, 99)
        ],
        [1.0, 2.0, 3.0, 3.0, 4.0, 4.0]
    );
}

#[test]
fn environments_of_one_layout_have_different_names() {
    let names = Abstraction::ALL.map(|abstraction| abstraction.environment_name("counter_circuit"));
    assert_eq!(
        names,
        [
            "counter_circuit.pos",
            "counter_circuit.pos_ori",
            "counter_circuit",
            "counter_circuit.pos_ori_held_pot"
        ]
    );
    assert!("full_binned".parse::<Abstraction>().is_err());
}

#[test]
fn an_error_names_the_line_and_the_column() {
    let good = format!("cramped_room,w1,0,{STATE},N,stay");
    let later =
        |t: u32, state: &str, action: &str| format!("cramped_room,w1,{t},{state},{action},stay");
    let wall = STATE.replace("[1,1", "[0,0");
    let held = STATE.replace("onion", "cat");
    let soup = STATE.replace("[]", r#"[[1,1,""soup""]]"#);
    let cases = [
        (
            later(1, STATE, "jump"),
            "line 3, column `action0`: got \"jump\", expected one of",
        ),
        (
            later(2, STATE, "N"),
            "line 3, column `t`: got 2, expected 1",
        ),
        (
            later(1, &wall, "N"),
            "line 3, column `state`: a player at 0,0, where nobody can stand in cramped_room",
        ),
        (later(1, &held, "N"), "line 3, column `state`: got \"cat\""),
        (
            later(1, &soup, "N"),
            "line 3, column `state`: got \"soup\", expected \"onion\" or \"dish\"",
        ),
        (
            later(1, "{}", "N"),
            "line 3, column `state`: is no state: missing field `p`",
        ),
        (
            format!("moon_base,w1,0,{STATE},N,N"),
            "line 3, column `layout`: unknown layout \"moon_base\"",
        ),
        (
            "cramped_room,w1,1".into(),
            "line 3: got 3 columns, expected 6",
        ),
    ];
    for (row, expected) in cases {
        let told = error(&[&good, &row]);
        assert!(told.starts_with(expected), "{told}");
    }
}

#[test]
fn the_rows_of_a_game_stay_together() {
    let row = |trial: &str, t: u32| format!("cramped_room,{trial},{t},{STATE},N,stay");
    let told = error(&[&row("w1", 0), &row("w2", 0), &row("w1", 1)]);
    assert!(
        told.starts_with("line 4, column `trial`: \"w1\" was read before"),
        "{told}"
    );
}

#[test]
fn a_file_that_is_something_else_is_refused() {
    let told = |bytes: &[u8]| read_games(bytes).expect_err("wrong").to_string();
    assert_eq!(
        told(b"layout,trial,t\n"),
        "line 1: column `state` is missing"
    );
    assert!(told(&[0x1f, 0x8b, 1, 2, 3]).contains("broken gzip"));
    let cut = &embedded()[0].1[..10_000];
    assert!(told(cut).contains("broken gzip"));
}
