//! A disk that is full, and has room again, without a restart.

use std::time::Duration;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use super::disk::Disk;
use super::{asked, eventually, scaled};
use crate::server::Server;
use crate::support::load::{Load, Shape, Voice, assert_exactly_once, make_lane};

const VOICES: [Voice; 4] = [Voice::Stream, Voice::Stream, Voice::Rest, Voice::Rest];

/// Few rows, each of which counts in several families: once the journal has its full length, a full
/// disk is noticed later.
const SHAPE: Shape = Shape {
    rows: 10,
    contents: 64,
    segments: 64,
    in_flight: 8,
    observed: true,
};

/// How often a disk fills up. Not oftener, for once the journal has its full length, commits write
/// over it and need no room.
const ROUNDS: u64 = 3;

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_refuses_and_once_there_is_room_everything_goes_on() {
    let disks = scaled(2, 35);
    let mut random = StdRng::seed_from_u64(3);
    let mut transitions = 0;
    for _ in 0..disks {
        transitions += fills_up(&mut random).await;
    }
    println!(
        "{} full disks, {transitions} transitions, 0 lost, 0 double",
        disks * ROUNDS
    );
}

/// Runs a service on a disk that fills up and has room again; returns how many transitions it
/// holds.
async fn fills_up(random: &mut StdRng) -> u64 {
    let disk = Disk::new();
    let mut command = Server::folding(disk.path(), "127.0.0.1:0");
    let mut server = Server::run(disk.under(&mut command)).expect("it starts");
    make_lane(server.address).await;
    let load = Load::start(server.address, SHAPE, &VOICES);
    for round in 0..ROUNDS {
        load.progress(20).await;
        load.refusals();
        disk.leave_room(random.random_range(0..300_000));
        // Each face has been told, and nothing else is told.
        let told = |refusals: &[String], face: &str| {
            refusals.iter().any(|refusal| refusal.starts_with(face))
        };
        let mut refusals: Vec<String> = Vec::new();
        eventually("it is told", async || {
            refusals.extend(load.refusals().into_keys());
            told(&refusals, "503 ") && told(&refusals, "Unavailable ")
        })
        .await;
        for refusal in &refusals {
            assert!(
                told(std::slice::from_ref(refusal), "503 ")
                    || told(std::slice::from_ref(refusal), "Unavailable "),
                "{refusal}"
            );
        }

        let full = load.acknowledged();
        for path in [
            "/livez",
            "/v1/environments/lane/states/0.0",
            "/v1/environments/lane/influence?key=0.0",
        ] {
            let (status, answer) = asked(server.address, path).await;
            assert_eq!(
                status, 200,
                "round {round}: what was counted is answered: {path}: {answer}"
            );
        }
        disk.make_room();
        load.progress(full.len() as u64 * 4).await;
    }
    let acknowledged = load.finish().await;
    server.ask_to_stop();
    let ended = server.ended_within(Duration::from_secs(10)).await;
    assert!(ended.is_some_and(|status| status.success()), "{ended:?}");
    let transitions = assert_exactly_once(disk.path(), SHAPE, &acknowledged).await;
    assert_eq!(
        transitions,
        acknowledged.iter().sum::<u64>() * SHAPE.rows as u64,
        "all that was sent"
    );
    transitions
}
