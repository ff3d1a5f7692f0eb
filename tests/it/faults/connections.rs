//! Hundreds or thousands of connections that keep the service waiting: nobody else waits with them,
//! and at SIGTERM it is gone in time, with nothing lost.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use nudge::api::proto::ingest_service_client::IngestServiceClient;
use serde_json::json;
use tempfile::TempDir;
use tokio::task::JoinSet;

use super::crowd::{Crowd, SLOW, SlowClient};
use super::process::{assert_may_open, assert_memory_is_bounded};
use super::{asked, eventually, scaled, wide};
use crate::server::Server;
use crate::support::load::{Load, Shape, Voice, assert_exactly_once, make_lane};
use crate::support::{RawStream, channel, hello};

/// What help promises of SIGTERM.
const STOPPED: Duration = Duration::from_secs(10);

const VOICES: [Voice; 6] = [
    Voice::Stream,
    Voice::Stream,
    Voice::Stream,
    Voice::Stream,
    Voice::Rest,
    Voice::Rest,
];

/// Sees that others are served.
async fn assert_serves(address: SocketAddr, load: &Load) {
    load.progress(50).await;
    for path in ["/livez", "/v1/environments/lane/influence?key=0.0"] {
        // Where there are more connections than the service takes, one has to wait until a silent
        // one is closed.
        eventually(path, async || asked(address, path).await.0 == 200).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_crowd_that_waits_keeps_nobody_away_and_delays_no_end() {
    let (silent, slow) = (scaled(300, 5_000), scaled(8, 50));
    assert_may_open(silent + 7 * slow + 500);
    let directory = TempDir::new().expect("a temporary directory");
    let mut server = Server::start(directory.path(), "127.0.0.1:0");
    make_lane(server.address).await;
    let load = Load::start(server.address, Shape::SMALL, &VOICES);
    load.progress(20).await;

    let mut crowd = Crowd::default();
    crowd.join(server.address, SlowClient::Silent, silent).await;
    for client in SLOW {
        crowd.join(server.address, client, slow).await;
    }
    assert_serves(server.address, &load).await;
    assert_memory_is_bounded(server.pid());

    server.ask_to_stop();
    let ended = server.ended_within(STOPPED).await;
    assert!(
        ended.is_some_and(|status| status.success()),
        "{} waited with it: {ended:?}",
        crowd.open()
    );
    let acknowledged = load.abandon().await;
    let transitions = assert_exactly_once(directory.path(), Shape::SMALL, &acknowledged).await;
    println!(
        "{silent} silent connections, {slow} of each slow kind, {transitions} transitions, 0 lost, 0 double"
    );
}

/// Which slow clients are ended by the service, and when: first byte, preface and headers have 10
/// seconds, a REST request and an idle connection 30.
const ENDED: [(SlowClient, Duration); 6] = [
    (SlowClient::Silent, Duration::from_secs(10)),
    (SlowClient::HalfPreface, Duration::from_secs(10)),
    (SlowClient::Headers, Duration::from_secs(10)),
    (SlowClient::EndlessHeaders, Duration::from_secs(10)),
    (SlowClient::Body, Duration::from_secs(30)),
    (SlowClient::DeafHttp2, Duration::from_secs(30)),
];

#[tokio::test(flavor = "multi_thread")]
async fn who_keeps_the_service_waiting_is_let_go() {
    const SLACK: Duration = Duration::from_secs(5);
    let directory = TempDir::new().expect("a temporary directory");
    let server = Server::start(directory.path(), "127.0.0.1:0");
    make_lane(server.address).await;
    let most = Duration::from_secs(scaled(10, 30));
    let mut crowds = Vec::new();
    for (client, limit) in ENDED.into_iter().filter(|(_, limit)| *limit <= most) {
        let mut crowd = Crowd::default();
        crowd.join(server.address, client, scaled(10, 100)).await;
        crowds.push((client, limit, crowd));
    }
    let began = Instant::now();
    let mut stayed = Vec::new();
    for (client, limit, crowd) in crowds {
        while crowd.open() > 0 && began.elapsed() < limit + SLACK {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        if crowd.open() > 0 {
            stayed.push(format!("{} {client:?} after {limit:?}", crowd.open()));
        }
    }
    assert!(stayed.is_empty(), "still open: {stayed:?}");
    server.kill();
}

/// Opens streams that say hello, and nothing more.
async fn idle_streams(address: SocketAddr, streams: u64) -> Vec<RawStream> {
    let mut open = Vec::new();
    for number in 0..streams {
        let client = IngestServiceClient::new(channel(address).await.expect("the server listens"));
        open.push(
            RawStream::open(client, hello(&format!("idle-{number}")))
                .await
                .expect("a welcome")
                .1,
        );
    }
    open
}

/// Asks for the full answer of every state of the wide environment, and does not wait for it.
fn ask_slowly(address: SocketAddr, questions: u64) -> JoinSet<()> {
    let keys: Vec<String> = (0..wide::STATES).map(|place| place.to_string()).collect();
    let body = json!({"keys": keys, "view": "full"});
    let mut asked = JoinSet::new();
    for _ in 0..questions {
        let url = format!("http://{address}/v1/environments/wide/influence");
        let question = reqwest::Client::new().post(url).json(&body);
        asked.spawn(async move { drop(question.send().await) });
    }
    asked
}

#[tokio::test(flavor = "multi_thread")]
async fn slow_questions_and_open_streams_delay_no_end() {
    let (streams, questions) = (scaled(60, 500), scaled(12, 60));
    assert_may_open(2 * streams + 500);
    let directory = TempDir::new().expect("a temporary directory");
    let mut server = Server::start(directory.path(), "127.0.0.1:0");
    make_lane(server.address).await;
    wide::make(server.address).await;
    wide::fill(server.address).await;
    let load = Load::start(server.address, Shape::SMALL, &VOICES);
    let idle = idle_streams(server.address, streams).await;
    let slow = ask_slowly(server.address, questions);
    // They are at work once the producers have been answered beside them.
    load.progress(20).await;

    server.ask_to_stop();
    let ended = server.ended_within(STOPPED).await;
    assert!(
        ended.is_some_and(|status| status.success()),
        "not within {STOPPED:?}: {ended:?}"
    );
    drop((idle, slow));
    let acknowledged = load.abandon().await;
    assert_exactly_once(directory.path(), Shape::SMALL, &acknowledged).await;
}
