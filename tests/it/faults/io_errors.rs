//! The Nth call to the disk fails, once or from then on: what was acknowledged is counted once,
//! what was not is refused in a way that can be sent again, and the service goes on by itself once
//! the disk does.

use std::collections::HashMap;
use std::net::SocketAddr;

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};

use super::disk::{CHANGES, Disk, EIO, ENOSPC, FOR_EVER, READ, SYNC, TRUNCATE, WRITE};
use super::{asked, eventually, scaled, settled};
use crate::server::Server;
use crate::support::fixtures::Fixture;
use crate::support::load::{
    Load, Shape, Voice, assert_exactly_once, make_lane, read_held, transitions,
};

const VOICES: [Voice; 4] = [Voice::Stream, Voice::Stream, Voice::Stream, Voice::Rest];

/// Few on the way, so that a fault meets many commits.
const SHAPE: Shape = Shape {
    rows: 40,
    contents: 64,
    segments: 16,
    in_flight: 4,
    observed: true,
};

/// What is done to the disk.
#[derive(Debug, Clone, Copy)]
struct Fault {
    classes: u64,
    pass: u64,
    failures: u64,
    errno: u64,
    /// Whether the process is killed while it lasts.
    killed: bool,
}

impl Fault {
    fn random(random: &mut StdRng) -> Self {
        const CLASSES: [u64; 6] = [
            WRITE,
            SYNC,
            SYNC,
            WRITE | SYNC,
            CHANGES,
            WRITE | TRUNCATE | READ,
        ];
        Self {
            classes: CLASSES[random.random_range(0..CLASSES.len())],
            pass: random.random_range(0..60),
            failures: [1, 1, 2, 7, FOR_EVER][random.random_range(0..5_usize)],
            errno: [EIO, ENOSPC][random.random_range(0..2_usize)],
            killed: random.random_bool(0.5),
        }
    }
}

/// Returns what is sent into a fault: outcomes and absences too, but where reads fail. SQLite tells an
/// EIO of a read as a damaged database, so that where it is met twice the environment takes no more
/// batches until it is found to be sound, and producers are told so; with outcomes such reads are met
/// sooner. What becomes of them is for `reads`.
fn shape(fault: Fault) -> Shape {
    Shape {
        observed: fault.classes & READ == 0,
        ..SHAPE
    }
}

/// What producers may be told while a disk fails: that it is worth sending again.
fn assert_may_be_sent_again(refusals: &HashMap<String, u64>, fault: Fault) {
    for refusal in refusals.keys() {
        assert!(
            refusal.starts_with("Unavailable ") || refusal.starts_with("503 "),
            "{fault:?}: {refusal}"
        );
    }
}

/// Runs a service into a fault; returns how many calls failed.
async fn survives(fault: Fault) -> u64 {
    let disk = Disk::new();
    let server = Server::run(disk.under(&mut Server::folding(disk.path(), "127.0.0.1:0")))
        .expect("it starts");
    make_lane(server.address).await;
    let shape = shape(fault);
    let load = Load::start(server.address, shape, &VOICES);
    load.progress(8).await;
    disk.fail(fault.classes, fault.pass, fault.failures, fault.errno);
    eventually("the fault comes", async || disk.failed() > 0).await;

    if fault.failures == FOR_EVER {
        // Commits may go on where reads or what tidies up fail; those that do not are refused.
        let commits_fail = fault.classes & (WRITE | SYNC) != 0;
        eventually("it is told", async || !commits_fail || disk.failed() > 3).await;
        assert_eq!(
            asked(server.address, "/livez").await.0,
            200,
            "{fault:?}: the process is alive"
        );
    }
    if !fault.killed {
        disk.mend();
        load.progress(20).await;
    }
    let failed = disk.failed();
    assert_may_be_sent_again(&load.refusals(), fault);
    server.kill();
    let acknowledged = load.abandon().await;
    assert_exactly_once(disk.path(), shape, &acknowledged).await;
    failed
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_lost_or_doubled_when_the_disk_fails_for_a_moment_or_for_good() {
    let faults = scaled(24, 600);
    let mut random = StdRng::seed_from_u64(11);
    let mut failed = 0;
    for _ in 0..faults / 4 {
        let drawn: [Fault; 4] = std::array::from_fn(|_| Fault::random(&mut random));
        let [a, b, c, d] = drawn.map(survives);
        let (a, b, c, d) = tokio::join!(a, b, c, d);
        failed += a + b + c + d;
    }
    println!("{faults} faults, {failed} failed calls, 0 lost, 0 double");
}

/// Posts batches until one is refused; returns how many were acknowledged, and what the refusal
/// says.
async fn post_until_refused(
    address: SocketAddr,
    disk: &Disk,
    calls: u64,
    errno: u64,
) -> (u64, String) {
    let url = format!("http://{address}/v1/environments/lane/transitions");
    let client = reqwest::Client::new();
    let transition =
        json!({"state": {"distance": 1, "held": 0}, "actions": {"robot": 0, "human": 0}});
    for sequence in 1.. {
        if sequence == 3 {
            disk.fail(WRITE | SYNC, calls, FOR_EVER, errno);
        }
        let body = json!({"producer": "p0", "sequence": sequence, "transitions": [transition]});
        let response = client
            .post(&url)
            .json(&body)
            .send()
            .await
            .expect("answered");
        let status = response.status().as_u16();
        let answer: Value = response.json().await.expect("JSON");
        if status != 200 {
            return (sequence - 1, answer["detail"].to_string());
        }
    }
    unreachable!("the disk fails for ever")
}

/// A commit that failed may still have committed, so a refusal may only say that nothing was
/// counted where that is certain.
#[tokio::test(flavor = "multi_thread")]
async fn a_refusal_that_says_that_nothing_was_counted_is_right() {
    let (mut certain, mut there) = (0, 0);
    for calls in 0..scaled(16, 60) {
        for errno in [EIO, ENOSPC] {
            let disk = Disk::new();
            let server = Server::run(disk.under(&mut Server::command(disk.path(), "127.0.0.1:0")))
                .expect("it starts");
            make_lane(server.address).await;
            let (acknowledged, refusal) =
                post_until_refused(server.address, &disk, calls, errno).await;
            server.kill();
            let held = read_held(disk.path(), 1).await.expect("it was made");
            let committed = held.committed[0];
            let is_certain = refusal.contains("nothing was counted");
            assert!(
                is_certain || refusal.contains("may have been counted"),
                "{refusal}"
            );
            let most = acknowledged + u64::from(!is_certain);
            assert!(
                (acknowledged..=most).contains(&committed),
                "{acknowledged}, then {committed}: {refusal}"
            );
            assert_eq!(transitions(&held.cells), committed, "a transition a batch");
            certain += u64::from(is_certain);
            there += committed - acknowledged;
        }
    }
    assert!(
        there > 0,
        "a commit that is reported as failed and is there was met"
    );
    println!("{certain} refusals were certain; {there} batches were there that nobody was told of");
}

/// The first start of this build on a database of yesterday: opening, migrating, checking.
#[tokio::test(flavor = "multi_thread")]
async fn a_start_on_a_failing_disk_ends_or_waits_and_the_next_one_is_as_if_nothing_was() {
    let fixture = Fixture::named("schema-1-af3f5d0");
    let whole = Disk::holding(&fixture.path());
    whole.count(CHANGES | READ);
    let server = settled(whole.under(&mut Server::command(whole.path(), "127.0.0.1:0")))
        .await
        .expect("it starts");
    let calls = whole.seen();
    server.kill();
    assert!(calls > 50, "{calls}");

    let step = (calls / scaled(16, calls)).max(1);
    for pass in (0..calls).step_by(step as usize) {
        let disk = Disk::holding(&fixture.path());
        let (failures, errno) = if (pass / step).is_multiple_of(2) {
            (1, EIO)
        } else {
            (FOR_EVER, ENOSPC)
        };
        disk.fail(CHANGES | READ, pass, failures, errno);
        match Server::run(disk.under(&mut Server::command(disk.path(), "127.0.0.1:0"))) {
            // One line that says what to do, and the code of what the caller has to mend.
            Err(status) => assert_eq!(status.code(), Some(2), "call {pass} with error {errno}"),
            Ok(server) => {
                assert_eq!(
                    asked(server.address, "/livez").await.0,
                    200,
                    "call {pass} with error {errno}"
                );
                server.kill();
            }
        }
        super::assert_as_told(&fixture, disk.path()).await;
    }
    println!("{calls} calls of a first start, every {step} failed");
}
