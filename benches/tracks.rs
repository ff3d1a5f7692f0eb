//! Steps a second through tracks that fill in lagged outcomes, of thousands of games at once; and what
//! those that are left to the service take of it at worst.
//!
//! `cargo bench --bench tracks`. A game's tick has milliseconds: a step must cost next to nothing of
//! them, and a track as little memory as its greatest lag needs.

#![allow(missing_docs)]

use std::time::Instant;

use nudge::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use nudge::domain::{Entry, Schema, SchemaDraft};
use nudge::ingest::{self, Tracks};
use nudge::tracks::{Step, Track};

const GAMES: usize = 10_000;
const STEPS: usize = 50;

fn main() {
    // First, while nothing that was given back is taken again.
    left_to_the_service();
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

/// One stream with as many tracks as are remembered and more, whose agents hold what they do while
/// each comes to a new state with every step: nothing may be forgotten for long.
fn left_to_the_service() {
    const TRACKS: u64 = 3_000;
    const STEPS: u64 = 1_500;
    let draft = SchemaDraft {
        state: vec![feature("x", 1_999)],
        agents: vec![agent("a"), agent("b")],
        ..SchemaDraft::default()
    };
    let schema = Schema::try_from(&draft).expect("valid");
    let mut tracks = Tracks::default();
    let before = resident_mb();
    let began = Instant::now();
    for track in 0..TRACKS {
        for state in 0..STEPS {
            let step = ingest::Step {
                track,
                state,
                joint: 0,
                sent: Entry::Unknown,
            };
            tracks.entry(&schema, &step, |_| false);
        }
    }
    println!(
        "left to the service at worst: {:.1} MB a stream, {:.0} ns a step",
        resident_mb() - before,
        began.elapsed().as_secs_f64() / (TRACKS * STEPS) as f64 * 1e9
    );
}

/// Returns the memory that this process has, in MB.
fn resident_mb() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().strip_suffix(" kB"));
    let kib: f64 = kib.and_then(|kib| kib.parse().ok()).expect("a number");
    kib * 1_024.0 / 1e6
}

fn feature(name: &str, most: i64) -> FeatureDraft {
    FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, most)],
    }
}

fn agent(name: &str) -> AgentDraft {
    AgentDraft {
        name: name.into(),
        action: vec![feature("move", 5)],
        ..AgentDraft::default()
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
    let draft = SchemaDraft {
        state: vec![feature("x", 8), feature("y", 4), feature("held", 2)],
        agents: vec![agent("a"), agent("b")],
        lags: (1..=lags).collect(),
        ..SchemaDraft::default()
    };
    Schema::try_from(&draft).expect("valid")
}
