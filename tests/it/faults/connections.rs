//! Hundreds or thousands of connections that keep the service waiting: nobody else waits with them, and at SIGTERM it is gone in time, with nothing
//! lost.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::crowd::{Crowd, Manner, SLOW};
use super::process::{assert_may_open, assert_memory_is_bounded};
use super::{asked, eventually, scaled};
use crate::server::Server;
use crate::support::load::{Load, Shape, Voice, assert_exactly_once, make_lane};

/// What help promises of SIGTERM.
const STOPPED: Duration = Duration::from_secs(10);

const VOICES: [Voice; 6] = [Voice::Stream, Voice::Stream, Voice::Stream, Voice::Stream, Voice::Rest, Voice::Rest];

/// Sees that others are served.
async fn assert_serves(address: SocketAddr, load: &Load) {
    load.progress(50).await;
    for path in ["/livez", "/v1/environments/lane/influence?key=0.0"] {
        // Where there are more connections than the service takes, one has to wait until a silent one is closed.
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
    crowd.join(server.address, Manner::Silent, silent).await;
    for manner in SLOW {
        crowd.join(server.address, manner, slow).await;
    }
    assert_serves(server.address, &load).await;
    assert_memory_is_bounded(server.pid());

    server.ask_to_stop();
    let ended = server.ended_within(STOPPED).await;
    assert!(ended.is_some_and(|status| status.success()), "{} waited with it: {ended:?}", crowd.open());
    let acknowledged = load.abandon().await;
    let transitions = assert_exactly_once(directory.path(), Shape::SMALL, &acknowledged).await;
    println!("{silent} silent connections, {slow} of each slow kind, {transitions} transitions, 0 lost, 0 double");
}

/// Which manners are ended by the service, and when: first byte, preface and headers have 10 seconds, a REST request and an idle connection 30.
const ENDED: [(Manner, Duration); 6] = [
    (Manner::Silent, Duration::from_secs(10)),
    (Manner::HalfPreface, Duration::from_secs(10)),
    (Manner::Headers, Duration::from_secs(10)),
    (Manner::EndlessHeaders, Duration::from_secs(10)),
    (Manner::Body, Duration::from_secs(30)),
    (Manner::DeafHttp2, Duration::from_secs(30)),
];

#[tokio::test(flavor = "multi_thread")]
async fn who_keeps_the_service_waiting_is_let_go() {
    const SLACK: Duration = Duration::from_secs(5);
    let directory = TempDir::new().expect("a temporary directory");
    let server = Server::start(directory.path(), "127.0.0.1:0");
    make_lane(server.address).await;
    let most = Duration::from_secs(scaled(10, 30));
    let mut crowds = Vec::new();
    for (manner, limit) in ENDED.into_iter().filter(|(_, limit)| *limit <= most) {
        let mut crowd = Crowd::default();
        crowd.join(server.address, manner, scaled(10, 100)).await;
        crowds.push((manner, limit, crowd));
    }
    let began = Instant::now();
    let mut stayed = Vec::new();
    for (manner, limit, crowd) in crowds {
        while crowd.open() > 0 && began.elapsed() < limit + SLACK {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        if crowd.open() > 0 {
            stayed.push(format!("{} {manner:?} after {limit:?}", crowd.open()));
        }
    }
    assert!(stayed.is_empty(), "still open: {stayed:?}");
    server.kill();
}
