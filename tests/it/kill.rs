//! Kill -9 of the real binary, at random times, under a stream load: nothing that was acknowledged is lost, nothing is counted twice.
//!
//! `NUDGE_KILLS=2000 cargo test kill` kills more often. The control forgets its producer id at every reconnect, as if there were no watermark, and
//! must show doubles: a test that cannot see them would prove nothing.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use nudge::api::proto::environment_service_client::EnvironmentServiceClient;
use nudge::api::proto::influence_service_client::InfluenceServiceClient;
use nudge::api::proto::ingest_service_client::IngestServiceClient;
use nudge::api::proto::{self, ingest_request, ingest_response};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tempfile::TempDir;

use crate::server::Server;
use crate::support::{RawStream, channel, hello, lane_schema};

const PRODUCERS: u64 = 4;
const ROWS: usize = 40;
const IN_FLIGHT: usize = 32;

fn kills() -> u64 {
    std::env::var("NUDGE_KILLS").ok().and_then(|kills| kills.parse().ok()).unwrap_or(60)
}

/// The batch that a producer sends under a number: always the same.
fn batch(producer: u64, sequence: u64) -> (proto::Batch, BTreeMap<(String, u64, u64), u64>) {
    let mut random = StdRng::seed_from_u64(producer << 32 | sequence);
    let mut counted = BTreeMap::new();
    let mut columns = proto::Columns { count: ROWS as u32, ..Default::default() };
    for _ in 0..ROWS {
        let (distance, held) = (random.random_range(0..4_u32), random.random_range(0..2_u32));
        let (robot, human) = (random.random_range(0..2_u32), random.random_range(0..3_u32));
        columns.states.extend([[0.1, 0.6, 0.8, 2.0][distance as usize], held as f32]);
        columns.actions.extend([robot as f32, human as f32]);
        *counted.entry((format!("{distance}.{held}"), u64::from(robot), u64::from(human))).or_default() += 1;
    }
    let transitions = Some(proto::batch::Transitions::Columns(columns));
    (proto::Batch { sequence, segment: String::new(), transitions }, counted)
}

/// How a producer names itself when it connects.
#[derive(Clone, Copy, PartialEq)]
enum Identity {
    Stable,
    /// Forgotten at every reconnect: the watermark cannot help.
    Forgotten,
}

/// What one producer knows: every batch up to `acknowledged` was acknowledged.
struct Load {
    producer: u64,
    identity: Identity,
    acknowledged: u64,
    connections: u64,
}

impl Load {
    async fn run(mut self, address: SocketAddr, stop: Arc<AtomicBool>, progress: Arc<AtomicU64>) -> u64 {
        // A broken conversation leaves batches of which nobody knows; only one that ended well says how far this producer is.
        while self.converse(address, &stop, &progress).await.is_none() {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        self.acknowledged
    }

    /// Sends until the connection breaks or the load stops, and takes the receipts.
    async fn converse(&mut self, address: SocketAddr, stop: &AtomicBool, progress: &AtomicU64) -> Option<()> {
        let client = IngestServiceClient::new(channel(address).await.ok()?);
        self.connections += 1;
        let name = match self.identity {
            Identity::Stable => format!("p{}", self.producer),
            Identity::Forgotten => format!("p{}-{}", self.producer, self.connections),
        };
        let (welcome, stream) = RawStream::open(client, hello(&name)).await.ok()?;
        // Batches are numbered from 1 for each identity; `offset` maps those numbers to this load's own.
        let offset = if self.identity == Identity::Stable { 0 } else { self.acknowledged };
        let committed = welcome.committed_sequence + offset;
        assert!(committed >= self.acknowledged, "acknowledged {} and forgot it: {committed}", self.acknowledged);
        self.acknowledged = committed;
        let (requests, mut responses) = stream.split();
        let mut next = self.acknowledged + 1;
        while !stop.load(Ordering::Relaxed) || next > self.acknowledged + 1 {
            while next <= self.acknowledged + IN_FLIGHT as u64 && !stop.load(Ordering::Relaxed) {
                let (mut batch, _) = batch(self.producer, next);
                batch.sequence -= offset;
                let message = Some(ingest_request::Message::Batch(batch));
                requests.send(proto::IngestRequest { message }).await.ok()?;
                next += 1;
            }
            let response = responses.message().await.ok()??;
            let Some(ingest_response::Message::Acknowledgement(told)) = response.message else {
                panic!("{response:?}")
            };
            self.acknowledged = told.committed_sequence + offset;
            progress.fetch_add(told.receipts.len() as u64, Ordering::Relaxed);
        }
        Some(())
    }
}

/// What a run of kills left behind.
struct Aftermath {
    /// Counted by the service.
    counted: BTreeMap<(String, u64, u64), u64>,
    /// Sent and acknowledged, or known committed.
    expected: BTreeMap<(String, u64, u64), u64>,
}

async fn run(identity: Identity, kills: u64) -> Aftermath {
    let directory = TempDir::new().expect("a temporary directory");
    let mut server = Server::start(directory.path(), "127.0.0.1:0");
    let address = server.address;
    make_lane(address).await;
    let (stop, progress) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let loads: Vec<_> = (0..PRODUCERS)
        .map(|producer| Load { producer, identity, acknowledged: 0, connections: 0 })
        .map(|load| tokio::spawn(load.run(address, stop.clone(), progress.clone())))
        .collect();
    let mut random = StdRng::seed_from_u64(7);
    for _ in 0..kills {
        // A kill counts only under load: wait until something was acknowledged, then for a random moment of the work.
        let before = progress.load(Ordering::Relaxed);
        while progress.load(Ordering::Relaxed) == before {
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
        tokio::time::sleep(Duration::from_micros(random.random_range(0..30_000))).await;
        server.kill();
        server = Server::start(directory.path(), &address.to_string());
    }
    stop.store(true, Ordering::Relaxed);
    let mut expected = BTreeMap::new();
    for (producer, load) in (0..).zip(loads) {
        let acknowledged = load.await.expect("a load ends");
        for sequence in 1..=acknowledged {
            batch(producer, sequence).1.into_iter().for_each(|(cell, n)| *expected.entry(cell).or_default() += n);
        }
    }
    let counted = counted(address).await;
    server.kill();
    Aftermath { counted, expected }
}

async fn make_lane(address: SocketAddr) {
    let mut client = EnvironmentServiceClient::new(channel(address).await.expect("the server listens"));
    let request = proto::ApplyEnvironmentRequest { name: "lane".into(), schema: Some(lane_schema()), rule: None };
    client.apply_environment(request).await.expect("valid");
}

async fn counted(address: SocketAddr) -> BTreeMap<(String, u64, u64), u64> {
    let mut client = InfluenceServiceClient::new(channel(address).await.expect("the server listens"));
    let mut counted = BTreeMap::new();
    for key in (0..4).flat_map(|distance| (0..2).map(move |held| format!("{distance}.{held}"))) {
        let request = proto::GetStateRequest { environment: "lane".into(), key: key.clone() };
        let state = client.get_state(request).await.expect("a valid key").into_inner();
        for cell in state.cells {
            counted.insert((key.clone(), cell.actions[0], cell.actions[1]), cell.n);
        }
    }
    counted
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_lost_or_doubled_by_kills() {
    let kills = kills();
    let aftermath = run(Identity::Stable, kills).await;
    let transitions: u64 = aftermath.expected.values().sum();
    assert!(transitions > kills * ROWS as u64, "there was a load: {transitions} transitions");
    assert_eq!(aftermath.counted, aftermath.expected);
    println!("{kills} kills, {transitions} transitions, 0 lost, 0 double");
}

#[tokio::test(flavor = "multi_thread")]
async fn without_the_watermark_kills_show_doubles() {
    // More kills than the run needs: one double is enough, and each kill under load makes one likely.
    let aftermath = run(Identity::Forgotten, 40).await;
    let (counted, expected): (u64, u64) = (aftermath.counted.values().sum(), aftermath.expected.values().sum());
    assert!(counted > expected, "the control must double: {counted} counted, {expected} sent");
    println!("control: {} doubled", counted - expected);
}
