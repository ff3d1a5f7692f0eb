//! Kill -9 of the real binary, at random times, under a stream load: nothing that was acknowledged
//! is lost, nothing is counted twice. The human of the lane is absent now and then, and what it does
//! later is counted too.
//!
//! `NUDGE_KILLS=2000 cargo test kill` kills more often. The control forgets its producer id at
//! every reconnect, as if there were no watermark, and must show doubles: a test that cannot see
//! them would prove nothing. The journal is folded after every few commits. `faults/deaths.rs` and
//! `faults/folds.rs` kill where it hurts: at each step to the disk of a migration, a deletion, a fold
//! and a move.

use std::time::Duration;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tempfile::TempDir;

use crate::faults;
use crate::server::Server;
use crate::support::load::{
    Cells, Load, Shape, Voice, expected, make_lane, read_held, transitions,
};

/// Returns how many kills there are: as many as were asked for, or those of the short or long form.
pub fn kills(short: u64) -> u64 {
    let told = std::env::var("NUDGE_KILLS")
        .ok()
        .and_then(|kills| kills.parse().ok());
    told.unwrap_or(faults::scaled(short, 2_000))
}

/// What a run of kills left behind.
struct Aftermath {
    /// Counted by the service.
    counted: Cells,
    /// Sent and acknowledged, or known committed.
    expected: Cells,
}

async fn run(voice: Voice, kills: u64) -> Aftermath {
    let directory = TempDir::new().expect("a temporary directory");
    let start = |listen: &str| {
        Server::run(&mut Server::folding(directory.path(), listen)).expect("it starts")
    };
    let mut server = start("127.0.0.1:0");
    let address = server.address;
    make_lane(address).await;
    let load = Load::start(address, Shape::SMALL, &[voice; 4]);
    let mut random = StdRng::seed_from_u64(7);
    for _ in 0..kills {
        // A kill counts only under load: wait until something was acknowledged, then for a random
        // moment of the work.
        load.progress(1).await;
        tokio::time::sleep(Duration::from_micros(random.random_range(0..30_000))).await;
        server.kill();
        server = start(&address.to_string());
    }
    let expected = expected(Shape::SMALL, &load.finish().await);
    server.kill();
    let held = read_held(directory.path(), 4).await;
    let counted = held.expect("an environment that was made stays").cells;
    Aftermath { counted, expected }
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_lost_or_doubled_by_kills() {
    let kills = kills(60);
    let aftermath = run(Voice::Stream, kills).await;
    let transitions = transitions(&aftermath.expected);
    assert!(
        transitions > kills * Shape::SMALL.rows as u64,
        "there was a load: {transitions} transitions"
    );
    assert_eq!(aftermath.counted, aftermath.expected);
    println!("{kills} kills, {transitions} transitions, 0 lost, 0 double");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_the_watermark_kills_show_doubles() {
    // More kills than the run needs: one double is enough, and each kill under load makes one
    // likely.
    let aftermath = run(Voice::Forgetful, 40).await;
    let [counted, expected] = [&aftermath.counted, &aftermath.expected].map(transitions);
    assert!(
        counted > expected,
        "the control must double: {counted} counted, {expected} sent"
    );
    println!("control: {} doubled", counted - expected);
}
