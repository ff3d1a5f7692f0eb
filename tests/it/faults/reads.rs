//! A read of the disk fails (EIO), which SQLite tells as it tells a damaged page: once it is met by
//! nobody, and no environment is taken for damaged for longer than it lasts.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};

use super::disk::{Disk, EIO, FOR_EVER, READ};
use super::{asked, eventually, scaled, settled};
use crate::server::Server;
use crate::support::load::make_lane;

/// Producers, each with a batch of its own segment: so many that their tables have some pages.
const PRODUCERS: u64 = 60;

const LANE: &str = "/v1/environments/lane";

/// Posts one transition, and returns the status and the answer.
async fn post(address: SocketAddr, producer: &str, sequence: u64) -> (u16, Value) {
    let transition = json!({
        "state": {"distance": sequence % 3, "held": 0}, "actions": {"robot": 0, "human": 0},
    });
    let body = json!({
        "producer": producer, "sequence": sequence, "segment": producer, "transitions": [transition],
    });
    let url = format!("http://{address}{LANE}/transitions");
    let sent = reqwest::Client::new().post(url).json(&body).send().await;
    let response = sent.expect("answered");
    let status = response.status().as_u16();
    (status, response.json().await.expect("JSON"))
}

/// Fills a database, half of it in rows and half in the journal, and returns where it is.
async fn filled() -> Disk {
    let disk = Disk::new();
    for (server, producers) in [
        (
            Server::folding(disk.path(), "127.0.0.1:0"),
            0..PRODUCERS / 2,
        ),
        (
            Server::command(disk.path(), "127.0.0.1:0"),
            PRODUCERS / 2..PRODUCERS,
        ),
    ] {
        let mut server = server;
        let server = settled(&mut server).await.expect("it starts");
        make_lane(server.address).await;
        for producer in producers {
            for sequence in 1..=20 {
                let posted = post(server.address, &format!("p{producer}"), sequence).await;
                assert_eq!(posted.0, 200, "{}", posted.1);
            }
        }
        assert_eq!(server.terminate(), Some(0));
    }
    disk
}

/// Asks everything that reads, and counts a batch of a known producer; returns what was refused.
async fn used(address: SocketAddr, round: u64) -> Vec<String> {
    let mut refused = Vec::new();
    for path in [
        "",
        "/states",
        "/states/0.0",
        "/influence?key=0.0",
        "/summary",
        "/models",
    ] {
        let (status, told) = asked(address, &format!("{LANE}{path}")).await;
        if status != 200 {
            refused.push(format!("{path}: {status} {told}"));
        }
    }
    let producer = format!("p{}", round % PRODUCERS);
    let (status, told) = post(address, &producer, 21).await;
    if status != 200 {
        refused.push(format!("transitions: {status} {told}"));
    }
    refused
}

async fn read_only(address: SocketAddr) -> Value {
    asked(address, "/readyz?verbose").await.1["read_only"].clone()
}

fn server_on(disk: &Disk) -> Result<Server, std::process::ExitStatus> {
    Server::run(disk.under(&mut Server::command(disk.path(), "127.0.0.1:0")))
}

/// Returns how many reads there are until everything was asked.
async fn reads(database: &Path) -> u64 {
    let disk = Disk::holding(database);
    disk.count(READ);
    let server = server_on(&disk).expect("it starts");
    assert_eq!(used(server.address, 0).await, [""; 0]);
    eventually("all is read", async || {
        asked(server.address, "/readyz?verbose").await.1["background"] == json!("idle")
    })
    .await;
    disk.seen()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_read_that_fails_once_is_met_by_nobody() {
    let sound = filled().await;
    let database = sound.path().join("nudge.db");
    let reads = reads(&database).await;
    let step = (reads / scaled(24, reads)).max(1);
    let (mut failed, mut started) = (0, 0);
    for pass in (0..reads).step_by(step as usize) {
        let disk = Disk::holding(&database);
        disk.fail(READ, pass, 1, EIO);
        // A start that cannot read ends with a line that says so.
        let Ok(server) = server_on(&disk) else {
            continue;
        };
        started += 1;
        assert_eq!(used(server.address, pass).await, [""; 0], "read {pass}");
        assert_eq!(read_only(server.address).await, Value::Null, "read {pass}");
        failed += disk.failed();
        server.kill();
    }
    println!("{reads} reads, {started} starts, {failed} of which met one that failed");
    assert!(failed > 5, "{failed}");
}

#[tokio::test(flavor = "multi_thread")]
async fn reads_that_fail_for_a_while_seal_nothing_for_longer() {
    let sound = filled().await;
    let database = sound.path().join("nudge.db");
    let reads = reads(&database).await;
    let step = (reads / scaled(8, 60)).max(1);
    let (mut failed, mut sealed) = (0, 0);
    for pass in (0..reads).step_by(step as usize) {
        let disk = Disk::holding(&database);
        disk.fail(READ, pass, FOR_EVER, EIO);
        let Ok(server) = server_on(&disk) else {
            continue;
        };
        // Whatever is refused meanwhile.
        used(server.address, pass).await;
        tokio::time::sleep(Duration::from_millis(100)).await;
        failed += disk.failed();
        sealed += u32::from(read_only(server.address).await != Value::Null);

        disk.mend();
        eventually("it takes batches again", async || {
            used(server.address, pass).await.is_empty()
                && read_only(server.address).await == Value::Null
        })
        .await;
        server.kill();
    }
    println!("{failed} reads failed, {sealed} times the environment was sealed");
    assert!(failed > 0 && sealed > 0, "{failed}, {sealed}");
}
