//! What is drawn is what the worlds say.

use super::*;
use nudge_core::information::{conditional, excess};

fn named(name: &str) -> World {
    let world = WORLDS.into_iter().find(|world| world.name == name);
    world.expect("a world of that name")
}

fn options(seed: u64) -> Options {
    Options {
        states: 6,
        near: 3,
        seed,
        ..Options::default()
    }
}

fn counted(world: World, draws: usize) -> Counted {
    let options = options(7);
    Counted::of_tracks(
        Tracks::new(world, options),
        &options,
        Draws::Renewed,
        [draws, 5],
    )
}

/// Returns what a lag shows beyond chance in the near states, and in the others.
fn shown(counted: &Counted, asked: Asked) -> [f64; 2] {
    [0, 3].map(|first| {
        let states = first..first + 3;
        states
            .map(|state| conditional(&counted.tables(state, asked), excess))
            .sum::<f64>()
            / 3.0
    })
}

#[test]
fn every_world_has_a_name_and_the_same_seed_gives_the_same_tracks() {
    for (at, world) in WORLDS.iter().enumerate() {
        assert!(WORLDS[..at].iter().all(|other| other.name != world.name));
        let tracks = |seed| {
            Tracks::new(*world, options(seed))
                .take(3)
                .collect::<Vec<_>>()
        };
        assert_eq!(tracks(1), tracks(1));
        assert_ne!(tracks(1), tracks(2));
        assert!(tracks(1).iter().all(|track| track.len() == 100));
    }
}

#[test]
fn actions_are_held_as_long_as_they_should() {
    // How often an action is another than the one before: three letters in four, or fewer where
    // habits are uneven, of the choices that there are.
    let changes = |name| {
        let tracks = Tracks::new(named(name), options(3)).take(200);
        let changed = tracks.map(|track| {
            let pairs = track.windows(2);
            pairs
                .filter(|pair| pair[0].actions[0] != pair[1].actions[0])
                .count()
        });
        changed.sum::<usize>() as f64 / (200.0 * 99.0)
    };
    let free = changes("none");
    assert!((0.3..0.75).contains(&free), "{free}");
    for (name, choices) in [
        ("none-hold3", 1.0 / 3.0),
        ("none-hold6", 1.0 / 6.0),
        ("none-kept90", 0.1),
    ] {
        let ratio = changes(name) / free;
        assert!((ratio / choices - 1.0).abs() < 0.1, "{name}: {ratio}");
    }
}

#[test]
fn where_nothing_is_held_only_the_planted_lag_shows() {
    for (name, planted) in [
        ("copy1", 1),
        ("copy3", 3),
        ("none", 9),
        ("copy3-shuffled", 9),
    ] {
        let counted = counted(named(name), 4_000);
        for ego in [0, 1] {
            for lag in 0..=5 {
                let [near, far] = shown(&counted, Asked { ego, lag });
                let is_planted = (ego, lag) == (0, planted);
                assert_eq!(near > 0.3, is_planted, "{name} {ego} {lag}: {near}");
                assert!(
                    is_planted || near.abs() < 0.01,
                    "{name} {ego} {lag}: {near}"
                );
                assert!(far.abs() < 0.01, "{name} {ego} {lag}: {far}");
            }
        }
    }
}

#[test]
fn where_actions_are_held_neighbours_show_less_and_the_follower_nothing() {
    for name in ["copy3-hold3", "copy3-hold6"] {
        let counted = counted(named(name), 4_000);
        let of = |ego| [1, 2, 3, 4, 5].map(|lag| shown(&counted, Asked { ego, lag })[0]);
        let [one, two, three, four, _] = of(0);
        assert!(
            three > four && four > two && two > one,
            "{name}: {:?}",
            of(0)
        );
        assert!(
            of(1).iter().all(|shown| shown.abs() < 0.01),
            "{name}: {:?}",
            of(1)
        );
    }
}

#[test]
fn who_roams_comes_by_a_few_states_and_leaves_each_at_once() {
    let tracks = Tracks::new(named("none-kept90-here"), options(5)).take(50);
    for track in tracks {
        let mut states: Vec<usize> = track.iter().map(|step| step.state).collect();
        assert!(states.windows(2).all(|pair| pair[0] != pair[1]));
        states.sort_unstable();
        states.dedup();
        assert!(states == [0, 1, 2] || states == [3, 4, 5], "{states:?}");
    }
    let visited = Tracks::new(named("none"), options(5))
        .next()
        .expect("endless");
    assert!(
        visited
            .windows(2)
            .any(|pair| pair[0].state == pair[1].state)
    );
}

#[test]
fn draws_are_as_many_as_wanted_and_go_on_to_the_greatest_lag() {
    let counted = counted(named("none-kept90-here"), 50);
    for state in 0..6 {
        for lag in 0..=5 {
            let tables = counted.tables(state, Asked { ego: 0, lag });
            assert_eq!(tables.iter().map(|table| table.total()).sum::<u64>(), 50);
            assert_eq!(tables.len(), if lag == 0 { 1 } else { 4 });
        }
    }
}
