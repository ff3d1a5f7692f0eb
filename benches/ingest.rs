//! Durable ingest through gRPC beside a sink that decodes and drops, and beside a plain loop of
//! prepared upserts.
//!
//! `cargo bench --bench ingest`, or `cargo bench --bench ingest -- hot` for one of them.

#![allow(missing_docs)]

mod support;

use std::time::{Duration, Instant};

use nudge::api::proto;
use nudge::api::proto::ingest_service_client::IngestServiceClient;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqliteSynchronous};
use sqlx::{Connection, SqliteConnection};
use support::sink::sink;
use support::{
    ACTIONS, BATCH, Service, batches, channel, columns, make_lagged_world, make_world, median,
    observed, packed, process, pump, pump_every, quantile, report, runtime, start_binary, state,
    wanted,
};

const ROUNDS: usize = 5;
const HOT_BATCHES: u64 = 4_000;
const FAMILY_BATCHES: u64 = 1_000;
const TRACK_BATCHES: u64 = 2_000;
const UNIFORM_BATCHES: u64 = 1_000;
const LATENCY_BATCHES: u64 = 20_000;

fn main() {
    runtime().block_on(async {
        if wanted("hot") {
            hot().await;
        }
        if wanted("families") {
            families(6, "(target >= 0.12)").await;
            families(12, "(target >= 0.06)").await;
        }
        if wanted("tracks") {
            tracks(100).await;
            tracks(1_000).await;
        }
        if wanted("uniform") {
            uniform().await;
        }
        if wanted("memory") {
            memory().await;
        }
        if wanted("latency") {
            latency("8,000 hot cells", 223).await;
            latency("a million states", 1_000_000).await;
        }
    });
}

fn per_second(batches: u64, took: Duration) -> f64 {
    (batches * BATCH as u64) as f64 / took.as_secs_f64()
}

/// 8,000 hot cells: 223 states of 36 joint actions, as bytes and as packed floats.
async fn hot() {
    let load = batches(223, 64, 1);
    let floats: Vec<proto::Columns> = load.iter().map(packed).collect();
    hot_as("bytes", &load, "(target >= 0.7)").await;
    if wanted("floats") {
        hot_as("packed floats", &floats, "").await;
    }
}

/// The sink decodes the same form.
async fn hot_as(form: &str, load: &[proto::Columns], target: &str) {
    let (sink, service) = (sink().await, Service::start().await);
    make_world(service.address, "world", ACTIONS).await;
    pump(service.address, "world", "p", load, 200).await;
    let (mut durable, mut dropped) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        dropped.push(per_second(
            HOT_BATCHES,
            pump(sink, "world", "p", load, HOT_BATCHES).await,
        ));
        durable.push(per_second(
            HOT_BATCHES,
            pump(service.address, "world", "p", load, HOT_BATCHES).await,
        ));
    }
    service.stop().await;
    let (durable, dropped) = (median(durable), median(dropped));
    report(
        &format!("durable ingest, 8,000 hot cells, {form}"),
        durable,
        "decode and drop",
        dropped,
        "transitions/s",
        target,
    );
}

/// 8,000 hot cells with both agents' actions at so many lags beside them, uniformly, beside the same
/// load without outcomes.
async fn families(lags: u32, target: &str) {
    let outcomes = 2 * lags as usize;
    let plain = batches(223, 64, 1);
    let mut random = <rand::rngs::StdRng as rand::SeedableRng>::seed_from_u64(7);
    let load: Vec<proto::Columns> = plain
        .iter()
        .map(|batch| observed(batch, outcomes, &mut random))
        .collect();

    let service = Service::start().await;
    make_world(service.address, "plain", ACTIONS).await;
    let lags: Vec<u32> = (1..=lags).collect();
    make_lagged_world(service.address, "lagged", &lags).await;
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        without.push(per_second(
            HOT_BATCHES,
            pump(service.address, "plain", "p", &plain, HOT_BATCHES).await,
        ));
        with.push(per_second(
            FAMILY_BATCHES,
            pump(service.address, "lagged", "p", &load, FAMILY_BATCHES).await,
        ));
    }
    service.stop().await;
    report(
        &format!("durable ingest, 8,000 hot cells, {outcomes} outcomes"),
        median(with),
        "without outcomes",
        median(without),
        "transitions/s",
        target,
    );
}

/// 8,000 hot cells of so many games at once, whose entries are left to the service, beside the same
/// load without tracks.
async fn tracks(games: usize) {
    let plain = batches(223, 64, 1);
    let of_games = |batch: &proto::Columns| proto::Columns {
        tracks: (0..BATCH).map(|at| (at % games) as u64).collect(),
        ..batch.clone()
    };
    let load: Vec<proto::Columns> = plain.iter().map(of_games).collect();

    let service = Service::start().await;
    for world in ["plain", "tracks"] {
        make_world(service.address, world, ACTIONS).await;
        pump(service.address, world, "p", &plain, 200).await;
    }
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        for (world, load, speeds) in [
            ("plain", &plain, &mut without),
            ("tracks", &load, &mut with),
        ] {
            let took = pump(service.address, world, "p", load, TRACK_BATCHES).await;
            speeds.push(per_second(TRACK_BATCHES, took));
        }
    }
    service.stop().await;
    report(
        &format!("durable ingest, 8,000 hot cells, steps of {games} tracks"),
        median(with),
        "without tracks",
        median(without),
        "transitions/s",
        "",
    );
}

/// A million states, uniformly.
async fn uniform() {
    let load = batches(1_000_000, UNIFORM_BATCHES as usize, 2);
    let service = Service::start().await;
    make_world(service.address, "world", ACTIONS).await;
    let durable = per_second(
        UNIFORM_BATCHES,
        pump(service.address, "world", "p", &load, UNIFORM_BATCHES).await,
    );
    service.stop().await;
    let dropped = per_second(
        UNIFORM_BATCHES,
        pump(sink().await, "world", "p", &load, UNIFORM_BATCHES).await,
    );
    let plain = plain_upserts(UNIFORM_BATCHES).await;
    report(
        "durable ingest, a million states",
        durable,
        "decode and drop",
        dropped,
        "transitions/s",
        "",
    );
    report(
        "durable ingest, a million states",
        durable,
        "prepared upserts, 10,000 a transaction",
        plain,
        "transitions/s",
        "",
    );
}

/// One prepared upsert a transition into a bare table, 10,000 a transaction, WAL and FULL.
async fn plain_upserts(batches: u64) -> f64 {
    let directory = tempfile::TempDir::new().expect("a temporary directory");
    let options = SqliteConnectOptions::new()
        .filename(directory.path().join("plain.db"))
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full);
    let mut connection = SqliteConnection::connect_with(&options)
        .await
        .expect("a database");
    let table = "create table cells (state integer, joint integer, n integer, primary key (state, joint)) without rowid";
    sqlx::query(table)
        .execute(&mut connection)
        .await
        .expect("a table");
    let mut random = <rand::rngs::StdRng as rand::SeedableRng>::seed_from_u64(3);
    let started = Instant::now();
    for _ in 0..batches * BATCH as u64 / 10_000 {
        let mut transaction = connection.begin().await.expect("a transaction");
        for _ in 0..10_000 {
            let upsert = "insert into cells values (?, ?, 1) on conflict do update set n = n + 1";
            let number = rand::RngExt::random_range(&mut random, 0..1_000_000_i64);
            let joint = rand::RngExt::random_range(&mut random, 0..i64::from(ACTIONS * ACTIONS));
            sqlx::query(upsert)
                .bind(number)
                .bind(joint)
                .execute(&mut *transaction)
                .await
                .expect("counted");
        }
        transaction.commit().await.expect("committed");
    }
    per_second(batches, started.elapsed())
}

/// How long a batch waits for its acknowledgement where batches come at half the rate that they may,
/// folds included.
async fn latency(load: &str, states: u32) {
    let batches = batches(states, 500, 4);
    let service = Service::start().await;
    make_world(service.address, "world", ACTIONS).await;
    let full = pump(service.address, "world", "p", &batches, LATENCY_BATCHES).await;
    let interval = full * 2 / LATENCY_BATCHES as u32;

    let client = IngestServiceClient::new(channel(service.address).await);
    let paced = pump_every(client, "world", "p", &batches, LATENCY_BATCHES, interval);
    let mut waited = paced.await;
    service.stop().await;
    // What full speed has left to be folded is caught up with first.
    waited.drain(..waited.len() / 3);
    println!(
        "acknowledgement at half load ({:.1} M/s), {load}: p50 {:.1} ms (target <= 10), p99 {:.1} ms (target <= 60)",
        per_second(LATENCY_BATCHES, full) / 2e6,
        quantile(&mut waited, 0.5).as_secs_f64() * 1e3,
        quantile(&mut waited, 0.99).as_secs_f64() * 1e3,
    );
}

/// Resident memory of the real binary while a million distinct cells come in.
async fn memory() {
    let directory = tempfile::TempDir::new().expect("a temporary directory");
    let (mut child, address) = start_binary(directory.path());
    make_world(address, "world", ACTIONS).await;
    let distinct: Vec<proto::Columns> = (0..1_000).map(distinct).collect();
    pump(address, "world", "p", &distinct, 1_000).await;
    let of = |name: &str| process::field(&child, "status", name) as f64 / 1024.0;
    println!(
        "a million distinct cells: {:.0} MiB resident, {:.0} MiB at the peak (target < 150 MB)",
        of("VmRSS:"),
        of("VmHWM:")
    );
    child.kill().expect("running");
    child.wait().expect("killed");
}

/// The `i`th thousand of a million different states.
fn distinct(i: u32) -> proto::Columns {
    let first = i * BATCH as u32;
    // The first batch that is sent has the number 1.
    let states = (first..first + BATCH as u32).flat_map(state).collect();
    columns(states, vec![1.0; 2 * BATCH])
}
