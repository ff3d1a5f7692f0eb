//! Durable ingest of a uniform load into databases that grow: at every size its rate beside a sink
//! that decodes and drops the same load, what it writes, and the memory and disk that it takes; then
//! how long the next start takes after kill -9.
//!
//! `cargo bench --bench sizes`, or `cargo bench --bench sizes -- 10000000` to stop at so many cells.
//! The service is the real binary, so memory and bytes written are its own.

#![allow(missing_docs)]

mod support;

use std::net::SocketAddr;
use std::path::Path;
use std::process::Child;
use std::time::{Duration, Instant};

use support::sink::sink;
use support::{
    ACTIONS, BATCH, batches, make_world, median, process, pump, runtime, start_binary_with,
};
use tempfile::TempDir;

/// A million transitions a round.
const ROUND: u64 = 1_000;
/// Cells at which figures are printed, and the states that the load falls into until then.
const SIZES: [(u64, u32); 4] = [
    (100_000, 1_000_000),
    (1_000_000, 1_000_000),
    (10_000_000, 1_000_000),
    (50_000_000, 2_000_000),
];
/// Rounds after which it is asked how many cells there are.
const ASKED: u64 = 4;
/// Rounds of which the median is printed.
const LAST: usize = 3;
/// So that no quota is in the way.
const MOST_CELLS: &str = "1000000000";

fn main() {
    let last = std::env::args()
        .filter_map(|argument| argument.parse().ok())
        .next();
    runtime().block_on(grow(last.unwrap_or(u64::MAX)));
}

async fn grow(last: u64) {
    let directory = TempDir::new().expect("a temporary directory");
    let (mut child, mut address) = start(directory.path());
    make_world(address, "world", ACTIONS).await;
    let sink = sink().await;
    let (mut rounds, mut sent) = (0, 0_u64);
    for (cells, states) in SIZES.into_iter().filter(|(cells, _)| *cells <= last) {
        let (mut durable, mut dropped) = (Vec::new(), Vec::new());
        let written = bytes_written(&child);
        let before = sent;
        // Asked now and then: to count what is in the journal alone is work.
        while rounds % ASKED != 0 || stored(address).await < cells {
            rounds += 1;
            // Small databases are passed in less than a round.
            let how_many = if cells < 1_000_000 { 50 } else { ROUND };
            let load = batches(states, how_many as usize, rounds);
            durable.push(rate(
                how_many,
                pump(address, "world", "p", &load, how_many).await,
            ));
            if durable.len() % 8 == 1 {
                dropped.push(rate(
                    how_many,
                    pump(sink, "world", "p", &load, how_many).await,
                ));
            }
            sent += how_many * BATCH as u64;
        }
        durable.drain(..durable.len().saturating_sub(LAST));
        let (durable, dropped) = (median(durable), median(dropped));
        let bytes = (bytes_written(&child) - written) as f64 / (sent - before) as f64;
        let size = std::fs::metadata(directory.path().join("nudge.db"))
            .expect("a database")
            .len();
        println!(
            "{cells} cells: {durable:.0} transitions/s beside {dropped:.0} (decode and drop): ratio {:.3}; \
             {bytes:.0} bytes written a transition, {:.1} on disk a cell, {:.0} MiB resident",
            durable / dropped,
            size as f64 / stored(address).await as f64,
            resident(&child),
        );
    }

    child.kill().expect("running");
    child.wait().expect("killed");
    let started = Instant::now();
    (child, address) = start(directory.path());
    println!(
        "ready {:.2} s after a start that follows kill -9",
        ready(address, started).await.as_secs_f64()
    );
    child.kill().expect("running");
    child.wait().expect("killed");
}

fn start(data: &Path) -> (Child, SocketAddr) {
    start_binary_with(data, &["--max-cells", MOST_CELLS])
}

fn rate(batches: u64, took: Duration) -> f64 {
    (batches * BATCH as u64) as f64 / took.as_secs_f64()
}

async fn stored(address: SocketAddr) -> u64 {
    metric(address, "nudge_cells").await
}

async fn metric(address: SocketAddr, name: &str) -> u64 {
    let text = get(address, "/metrics").await;
    let line = text.lines().find(|line| line.starts_with(name));
    let number = line.and_then(|line| line.rsplit(' ').next()?.parse::<f64>().ok());
    number.expect("a gauge of cells") as u64
}

async fn ready(address: SocketAddr, started: Instant) -> Duration {
    while !get(address, "/readyz").await.contains("200 OK") {}
    started.elapsed()
}

async fn get(address: SocketAddr, path: &str) -> String {
    support::http::get_text(address, path).await
}

fn bytes_written(child: &Child) -> u64 {
    process::field(child, "io", "write_bytes:")
}

fn resident(child: &Child) -> f64 {
    process::field(child, "status", "VmRSS:") as f64 / 1024.0
}
