//! Steps a second through tracks that fill in lagged outcomes, of thousands of games at once.
//!
//! `cargo bench --bench tracks`. A game's tick has milliseconds: a step must cost next to nothing of
//! them, and a track as little memory as its greatest lag needs.

#![allow(missing_docs)]

use std::time::Instant;

use nudge::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use nudge::domain::{Schema, SchemaDraft};
use nudge::tracks::{Step, Track};

const GAMES: usize = 10_000;
const STEPS: usize = 50;

fn main() {
    println!("{:>5} {:>14} {:>12}", "lags", "steps/s", "ns a step");
    for lags in [0, 3, 12] {
        let seconds = played(&schema(lags));
        let steps = (GAMES * STEPS) as f64;
        println!(
            "{lags:>5} {:>14.0} {:>12.0}",
            steps / seconds,
            seconds / steps * 1e9
        );
    }
}

/// Plays all games at once, a step of each a tick, and returns the seconds that tracks took.
fn played(schema: &Schema) -> f64 {
    let mut tracks: Vec<Track> = (0..GAMES).map(|_| Track::new(schema)).collect();
    let mut released = 0;
    let began = Instant::now();
    for tick in 0..STEPS {
        for (game, track) in tracks.iter_mut().enumerate() {
            let at = (tick * 7 + game) as f32;
            let state = vec![at % 9.0, at % 5.0, at % 3.0];
            released += usize::from(
                track
                    .step(Step::new(state, vec![at % 6.0, at % 4.0]))
                    .is_some(),
            );
        }
    }
    released += tracks
        .into_iter()
        .map(|track| track.end().len())
        .sum::<usize>();
    let seconds = began.elapsed().as_secs_f64();

    assert_eq!(released, GAMES * STEPS);
    seconds
}

/// Three features and two agents of six moves, with so many lags of both.
fn schema(lags: i64) -> Schema {
    let feature = |name: &str, most| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, most)],
    };
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature("move", 5)],
        ..AgentDraft::default()
    };
    let draft = SchemaDraft {
        state: vec![feature("x", 8), feature("y", 4), feature("held", 2)],
        agents: vec![agent("a"), agent("b")],
        lags: (1..=lags).collect(),
        ..SchemaDraft::default()
    };
    Schema::try_from(&draft).expect("valid")
}
