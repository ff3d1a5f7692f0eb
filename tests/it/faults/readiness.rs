//! Ready means that a commit would succeed: a disk that is full or fails makes the service not
//! ready, under load and idle, and it says why in words.

use std::fs::File;
use std::net::SocketAddr;
use std::time::Duration;

use serde_json::Value;

use super::disk::{Disk, EIO, ENOSPC, FOR_EVER, SYNC, WRITE};
use super::{asked, eventually_within};
use crate::server::Server;
use crate::support::lane_json;
use crate::support::load::{Load, Shape, Voice, assert_exactly_once, make_lane};

const VOICES: [Voice; 4] = [Voice::Stream, Voice::Stream, Voice::Rest, Voice::Rest];

/// How soon it is known: after the next commit, or, where nobody sends, after a small write of the
/// service's own.
const KNOWN: Duration = Duration::from_secs(15);

/// What is wrong with a disk, and the word that tells it.
#[derive(Clone, Copy, Debug)]
enum DiskFault {
    Full,
    FailingSync,
    FailingWrite,
    NoRoomToWrite,
}

const DISK_FAULTS: [DiskFault; 4] = [
    DiskFault::Full,
    DiskFault::FailingSync,
    DiskFault::FailingWrite,
    DiskFault::NoRoomToWrite,
];

impl DiskFault {
    fn begin(self, disk: &Disk) {
        match self {
            Self::Full => disk.leave_room(0),
            Self::FailingSync => disk.fail(SYNC, 0, FOR_EVER, EIO),
            Self::FailingWrite => disk.fail(WRITE, 0, FOR_EVER, EIO),
            Self::NoRoomToWrite => disk.fail(WRITE, 0, FOR_EVER, ENOSPC),
        }
    }

    fn end(self, disk: &Disk) {
        disk.make_room();
        disk.mend();
    }

    fn is_told_by(self, text: &str) -> bool {
        match self {
            Self::Full | Self::NoRoomToWrite => text.contains("full"),
            // Which words there are for it is not fixed, but "ok" is none.
            Self::FailingSync | Self::FailingWrite => !text.contains("\"database\":\"ok\""),
        }
    }
}

async fn readiness(address: SocketAddr) -> (u16, String) {
    let (status, checks) = asked(address, "/readyz?verbose").await;
    (status, checks.to_string())
}

async fn assert_becomes_ready(address: SocketAddr, fault: DiskFault) {
    let what = format!("ready again after {fault:?}, without a restart");
    eventually_within(KNOWN, &what, async || readiness(address).await.0 == 200).await;
}

/// Waits until a service says that it is not ready, and why.
async fn assert_says_why(address: SocketAddr, fault: DiskFault) {
    let mut told = String::new();
    let late = std::time::Instant::now() + KNOWN;
    loop {
        let (status, text) = readiness(address).await;
        if status == 503 && fault.is_told_by(&text) {
            return;
        }
        told = if told.is_empty() || status == 503 {
            format!("{status} {text}")
        } else {
            told
        };
        assert!(
            std::time::Instant::now() < late,
            "{fault:?}: not ready in {KNOWN:?}, but {told}"
        );
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn under_load_readiness_follows_the_commits() {
    for fault in DISK_FAULTS {
        let disk = Disk::new();
        let server = Server::run(disk.under(&mut Server::command(disk.path(), "127.0.0.1:0")))
            .expect("it starts");
        make_lane(server.address).await;
        let load = Load::start(server.address, Shape::SMALL, &VOICES);
        load.progress(20).await;
        fault.begin(&disk);
        assert_says_why(server.address, fault).await;
        fault.end(&disk);
        assert_becomes_ready(server.address, fault).await;
        load.progress(20).await;
        let acknowledged = load.finish().await;
        server.kill();
        assert_exactly_once(disk.path(), Shape::SMALL, &acknowledged).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idle_service_finds_out_by_itself() {
    for fault in DISK_FAULTS {
        let disk = Disk::new();
        let server = Server::run(disk.under(&mut Server::command(disk.path(), "127.0.0.1:0")))
            .expect("it starts");
        make_lane(server.address).await;
        fault.begin(&disk);
        assert_says_why(server.address, fault).await;
        fault.end(&disk);
        assert_becomes_ready(server.address, fault).await;
        server.kill();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_is_named_in_refusals_and_does_not_fill_the_log() {
    let disk = Disk::new();
    let log = disk.beside("stderr");
    let mut command = Server::command(disk.path(), "127.0.0.1:0");
    command.stderr(File::create(&log).expect("a file"));
    let server = Server::run(disk.under(&mut command)).expect("it starts");
    make_lane(server.address).await;
    let load = Load::start(server.address, Shape::SMALL, &VOICES);
    load.progress(20).await;
    disk.leave_room(0);

    let (mut by_face, mut refused) = ([None, None], 0);
    eventually_within(KNOWN, "500 refusals", async || {
        for (refusal, times) in load.refusals() {
            refused += times;
            let face = usize::from(refusal.starts_with("503 "));
            by_face[face] = Some(refusal);
        }
        refused > 500
    })
    .await;
    for refusal in by_face {
        let refusal = refusal.expect("both faces refuse");
        assert!(
            refusal.contains("nothing was counted") && refusal.contains("full"),
            "{refusal}"
        );
    }

    let url = format!("http://{}/v1/environments/other", server.address);
    let made = reqwest::Client::new()
        .put(url)
        .json(&lane_json())
        .send()
        .await
        .expect("answered");
    let status = made.status().as_u16();
    let problem: Value = made.json().await.expect("JSON");
    assert_eq!(status, 503, "{problem}");
    assert!(
        !problem.to_string().contains("batch"),
        "there was no batch: {problem}"
    );

    let lines = std::fs::read_to_string(&log)
        .expect("a log")
        .lines()
        .count();
    assert!(lines < 100, "{lines} lines of log for {refused} refusals");
    server.kill();
    let acknowledged = load.abandon().await;
    assert_exactly_once(disk.path(), Shape::SMALL, &acknowledged).await;
}
