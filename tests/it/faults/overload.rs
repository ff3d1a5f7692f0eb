//! Ten times as much on the way as the service lets wait: memory is bounded, nothing is lost or
//! counted twice, and in the long form, whose build is a release, those who ask are answered in
//! time.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use tokio::runtime::Builder;
use tokio::task::JoinHandle;

use super::process::{assert_memory_is_bounded, most_memory_mib};
use super::{long, scaled};
use crate::server::Server;
use crate::support::load::{Load, Shape, Voice, assert_exactly_once, make_lane};

/// 40 of them with 8 on the way are 3.2 million transitions; 512,000 may wait.
const SHAPE: Shape = Shape {
    rows: 10_000,
    contents: 2,
    segments: 2,
    in_flight: 8,
    observed: true,
};
const STREAMS: usize = 40;
const POSTERS: usize = 8;

const MOST_QUERY_P99: Duration = Duration::from_millis(100);
const MOST_LIVEZ_P99: Duration = Duration::from_millis(50);

/// Asks again and again until then, and returns how long each answer took. On a thread and a
/// connection of its own: what is measured is the service, and not how long one waits behind the
/// producers in this process.
fn asking(
    address: SocketAddr,
    path: fn(u64) -> String,
    until: Instant,
) -> JoinHandle<Vec<Duration>> {
    tokio::task::spawn_blocking(move || {
        let runtime = Builder::new_current_thread()
            .enable_all()
            .build()
            .expect("a runtime");
        runtime.block_on(ask_until(address, path, until))
    })
}

async fn ask_until(address: SocketAddr, path: fn(u64) -> String, until: Instant) -> Vec<Duration> {
    let client = reqwest::Client::new();
    let mut took = Vec::new();
    while Instant::now() < until {
        let began = Instant::now();
        let url = format!("http://{address}{}", path(took.len() as u64));
        let answer = client.get(url).send().await.expect("answered");
        assert_eq!(answer.status().as_u16(), 200);
        answer.bytes().await.expect("whole");
        took.push(began.elapsed());
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    took
}

fn query(number: u64) -> String {
    format!(
        "/v1/environments/lane/influence?key={}.{}",
        number % 4,
        number % 2
    )
}

fn livez(_: u64) -> String {
    "/livez".into()
}

/// Returns the time within which 99 of 100 came.
fn p99(mut took: Vec<Duration>) -> Duration {
    took.sort_unstable();
    took[(took.len() - 1) * 99 / 100]
}

#[tokio::test(flavor = "multi_thread")]
async fn ten_times_the_load_is_slowed_down_and_not_lost() {
    let directory = TempDir::new().expect("a temporary directory");
    let mut server = Server::start(directory.path(), "127.0.0.1:0");
    make_lane(server.address).await;
    let voices = [
        [Voice::Stream; STREAMS].as_slice(),
        [Voice::Rest; POSTERS].as_slice(),
    ]
    .concat();
    let load = Load::start(server.address, SHAPE, &voices);
    load.progress(8).await;

    let until = Instant::now() + Duration::from_secs(scaled(3, 120));
    let queries: Vec<_> = (0..4)
        .map(|_| asking(server.address, query, until))
        .collect();
    let livez = asking(server.address, livez, until);
    let livez = p99(livez.await.expect("no panic"));
    let mut took = Vec::new();
    for asked in queries {
        took.extend(asked.await.expect("no panic"));
    }
    let (asked, query) = (took.len(), p99(took));
    let memory = most_memory_mib(server.pid());
    println!("{asked} queries, p99 {query:?}, livez p99 {livez:?}, {memory} MiB at most");
    assert_memory_is_bounded(server.pid());
    if long() {
        assert!(
            query <= MOST_QUERY_P99,
            "queries: p99 {query:?}, expected {MOST_QUERY_P99:?}"
        );
        assert!(
            livez <= MOST_LIVEZ_P99,
            "livez: p99 {livez:?}, expected {MOST_LIVEZ_P99:?}"
        );
    }

    let refusals = load.refusals();
    for refusal in refusals.keys() {
        assert!(
            refusal.starts_with("503 "),
            "a stream is slowed down, a call may be sent again: {refusal}"
        );
    }
    let (refused, posted) = (
        refusals.values().sum::<u64>(),
        load.acknowledged()[STREAMS..].iter().sum::<u64>(),
    );
    // Of a build without optimisation those who post are too slow to be refused.
    assert!(
        !long() || posted >= refused,
        "who posts has a share: {posted} batches got through, {refused} were refused"
    );
    println!(
        "refused {refusals:?}; streams and posters were {:?} far",
        load.acknowledged()
    );

    // In the midst of it.
    server.ask_to_stop();
    let ended = server.ended_within(Duration::from_secs(10)).await;
    assert!(ended.is_some_and(|status| status.success()), "{ended:?}");
    let acknowledged = load.abandon().await;
    let transitions = assert_exactly_once(directory.path(), SHAPE, &acknowledged).await;
    println!("{transitions} transitions, 0 lost, 0 double");
}
