//! Producers against a service that breaks streams, acknowledges late and says things twice:
//! nothing is lost and nothing is doubled.

use std::time::Duration;

use nudge::api::proto::BatchStatus;
use nudge::client::{ClientError, Connection, Producer, ProducerBuilder, Step, Totals, Track};
use nudge::domain::draft::{AgentDraft, FeatureDraft, KindDraft};
use nudge::domain::{Entry, Record, SchemaDraft};
use nudge::error::ErrorKind;
use tokio::net::TcpListener;
use tokio::task::JoinSet;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::Status;

use crate::fake::{CALM, Fake, Mood, WILD};
use crate::proxy::Proxy;

/// Longer than anything here takes on a busy machine.
const LONG: Duration = Duration::from_secs(60);

/// One whole number, which the tests use to tell transitions apart.
fn counter() -> SchemaDraft {
    let feature = |name: &str, max| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, max)],
    };
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature("move", 1)],
        ..AgentDraft::default()
    };
    SchemaDraft {
        state: vec![feature("x", 1 << 24)],
        agents: vec![agent("a"), agent("b")],
        ..SchemaDraft::default()
    }
}

fn transition(x: f32) -> Record {
    Record {
        entry: Entry::Entered,
        ..Record::new(vec![x], vec![0.0, 1.0])
    }
}

async fn start(mood: Mood, seed: u64) -> (Fake, ProducerBuilder) {
    let fake = Fake::start(mood, seed).await;
    fake.describe("counter", counter());
    let builder = builder(&fake.address.to_string()).await;
    (fake, builder)
}

async fn builder(address: &str) -> ProducerBuilder {
    Connection::open(address)
        .await
        .expect("it listens")
        .producer("counter", "game-7")
}

async fn send(producer: &mut Producer, range: std::ops::Range<u32>) -> Result<(), ClientError> {
    for x in range {
        producer.send(transition(x as f32)).await?;
    }
    Ok(())
}

fn assert_counted_once(fake: &Fake, transitions: u32) {
    let expected: Vec<f32> = (0..transitions).map(|x| x as f32).collect();
    assert!(
        fake.memory().values == expected,
        "lost, doubled or out of order"
    );
}

fn assert_all_accounted_for(totals: &Totals, transitions: u32) {
    assert_eq!(totals.sent, u64::from(transitions));
    assert_eq!(
        totals.sent,
        totals.accepted + totals.rejected + totals.resumed + totals.unverified,
        "{totals:?}"
    );
}

#[tokio::test]
async fn a_calm_service_counts_everything_it_is_sent() {
    let (fake, builder) = start(CALM, 0).await;
    let mut producer = builder.open().await.expect("known");
    send(&mut producer, 0..10_500).await.expect("taken");
    let totals = producer.close().await.expect("acknowledged");
    assert_eq!((totals.accepted, totals.last_sequence), (10_500, 11));
    assert_counted_once(&fake, 10_500);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn broken_streams_lose_and_double_nothing() {
    let mut storms: JoinSet<()> = (0..20).map(a_storm).collect();
    while let Some(storm) = storms.join_next().await {
        storm.expect("nothing lost, nothing doubled");
    }
}

async fn a_storm(seed: u64) {
    let (fake, builder) = start(WILD, seed).await;
    let mut producer = builder
        .batch_size(20)
        .outbox(12)
        .open()
        .await
        .expect("known");
    send(&mut producer, 0..1_000).await.expect("taken");
    producer.flush().await.expect("acknowledged");
    send(&mut producer, 1_000..2_000).await.expect("taken");
    let totals = producer.close().await.expect("acknowledged");
    assert_counted_once(&fake, 2_000);
    assert_all_accounted_for(&totals, 2_000);
    let memory = fake.memory();
    assert!(memory.hellos.len() > 1, "streams were broken");
    assert!(
        memory
            .hellos
            .iter()
            .all(|hello| hello.environment_uid == "uid-counter")
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn cut_connections_lose_and_double_nothing() {
    let (fake, _) = start(CALM, 0).await;
    let proxy = Proxy::start(fake.address, Some(Duration::from_millis(60)), 7).await;
    let connection = loop {
        // The proxy may cut this one too.
        if let Ok(connection) = Connection::open(&proxy.address).await
            && connection.environment("counter").await.is_ok()
        {
            break connection;
        }
    };
    let mut producer = loop {
        if let Ok(producer) = connection
            .producer("counter", "game-7")
            .batch_size(50)
            .open()
            .await
        {
            break producer;
        }
    };
    for part in 0..20 {
        send(&mut producer, part * 500..(part + 1) * 500)
            .await
            .expect("taken");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    let totals = producer.close().await.expect("acknowledged");
    assert_counted_once(&fake, 10_000);
    assert_all_accounted_for(&totals, 10_000);
    assert!(fake.memory().hellos.len() > 2, "connections were cut");
}

#[tokio::test]
async fn time_closes_a_batch_too() {
    let (fake, builder) = start(CALM, 0).await;
    let mut producer = builder
        .max_delay(Duration::from_millis(20))
        .open()
        .await
        .expect("known");
    send(&mut producer, 0..3).await.expect("taken");
    let counted = async {
        while fake.memory().values.len() < 3 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(LONG, counted)
        .await
        .expect("without a flush");
}

#[tokio::test]
async fn a_full_outbox_holds_the_sender_back() {
    let (fake, builder) = start(
        Mood {
            silent: true,
            window: 2,
            ..CALM
        },
        0,
    )
    .await;
    let mut producer = builder
        .batch_size(10)
        .outbox(3)
        .open()
        .await
        .expect("known");
    let sending = send(&mut producer, 0..100_000);
    tokio::time::timeout(Duration::from_millis(300), sending)
        .await
        .expect_err("nothing is acknowledged");
    assert_eq!(fake.memory().batches.len(), 2, "the window");
}

#[tokio::test]
async fn segments_close_batches() {
    let (fake, builder) = start(CALM, 0).await;
    let mut producer = builder.replay().open().await.expect("known");
    for (segment, range) in [
        (None, 0..2),
        (Some("trial-1"), 2..5),
        (Some("trial-2"), 5..6),
    ] {
        producer.segment(segment).await.expect("a label");
        send(&mut producer, range).await.expect("taken");
    }
    assert!(matches!(
        producer.segment(Some("a\nb")).await,
        Err(ClientError::Invalid(_))
    ));
    producer.close().await.expect("acknowledged");
    let batches: Vec<_> = fake
        .memory()
        .batches
        .iter()
        .map(|(_, _, segment, len)| (segment.clone(), *len))
        .collect();
    assert_eq!(
        batches,
        [
            (String::new(), 2),
            ("trial-1".into(), 3),
            ("trial-2".into(), 1)
        ]
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_replay_goes_on_where_it_was_interrupted() {
    for seed in 0..10 {
        let (fake, builder) = start(WILD, seed).await;
        let builder = builder.batch_size(30).replay();
        let mut first = builder.clone().open().await.expect("known");
        send(&mut first, 0..777).await.expect("taken");
        drop(first);
        let mut second = builder.clone().open().await.expect("known");
        send(&mut second, 0..1_000).await.expect("taken");
        let totals = second.close().await.expect("acknowledged");
        assert_counted_once(&fake, 1_000);
        assert_all_accounted_for(&totals, 1_000);
        let mut third = builder.open().await.expect("known");
        send(&mut third, 0..1_000).await.expect("taken");
        let totals = third.close().await.expect("nothing to wait for");
        assert_eq!((totals.resumed, totals.accepted), (1_000, 0));
        assert_counted_once(&fake, 1_000);
    }
}

#[tokio::test]
async fn another_source_under_the_same_id_is_noticed() {
    let (_fake, builder) = start(CALM, 0).await;
    let builder = builder.batch_size(10).replay();
    for (transitions, is_right) in [(100, true), (50, false)] {
        let mut producer = builder.clone().open().await.expect("known");
        send(&mut producer, 0..transitions).await.expect("taken");
        assert_eq!(producer.close().await.is_ok(), is_right);
    }
}

#[tokio::test]
async fn a_live_producer_that_restarts_numbers_on() {
    let (fake, builder) = start(CALM, 0).await;
    for (range, resume_point) in [(0..25, 0), (25..60, 3)] {
        let mut producer = builder
            .clone()
            .batch_size(10)
            .max_delay(LONG)
            .open()
            .await
            .expect("known");
        assert_eq!(producer.resume_point(), resume_point);
        send(&mut producer, range).await.expect("taken");
        producer.close().await.expect("acknowledged");
    }
    assert_counted_once(&fake, 60);
}

#[tokio::test]
async fn a_refusal_reaches_the_sender_in_the_words_of_the_service() {
    let refusals = [
        (Status::invalid_argument("undecodable"), ErrorKind::Invalid),
        (
            Status::not_found("unknown environment `counter`"),
            ErrorKind::NotFound,
        ),
        (Status::failed_precondition("fenced"), ErrorKind::Conflict),
        (Status::resource_exhausted("quota"), ErrorKind::Quota),
        (
            Status::already_exists("another schema"),
            ErrorKind::AlreadyExists,
        ),
        (Status::out_of_range("too large"), ErrorKind::TooLarge),
    ];
    for (status, kind) in refusals {
        let (fake, builder) = start(CALM, 0).await;
        fake.memory().refuse = Some((3, status.clone()));
        let mut producer = builder.batch_size(10).open().await.expect("known");
        let sent = send(&mut producer, 0..20).await;
        sent.expect("the third batch is refused");
        let error = match send(&mut producer, 20..40).await {
            Ok(()) => producer.flush().await.expect_err("refused"),
            Err(error) => error,
        };
        assert_eq!(
            (error.kind(), error.to_string()),
            (kind, status.message().to_owned())
        );
        assert_eq!(
            producer.send(transition(0.0)).await,
            Err(error),
            "and again"
        );
        assert_counted_once(&fake, 20);
    }
}

#[tokio::test]
async fn rejected_transitions_are_told_by_position() {
    let (fake, builder) = start(CALM, 0).await;
    let mut producer = builder.batch_size(2).open().await.expect("known");
    for x in [0.0, 1.0, 2.0, -1.0, 3.0] {
        producer.send(transition(x)).await.expect("taken");
    }
    let totals = producer.close().await.expect("acknowledged");
    assert_eq!((totals.accepted, totals.rejected), (4, 1));
    assert_eq!(
        (
            totals.rejections[0].position,
            totals.rejections[0].field.as_str()
        ),
        (3, "/state/x")
    );
    assert_counted_once(&fake, 4);
}

#[tokio::test]
async fn batches_of_which_nothing_counts_are_told_apart() {
    for (status, expected) in [
        (BatchStatus::Rejected, [0, 5, 3, 0]),
        (BatchStatus::Unverified, [0, 0, 0, 5]),
    ] {
        let (fake, builder) = start(CALM, 0).await;
        fake.memory().instead = Some(status);
        let mut producer = builder.batch_size(2).open().await.expect("known");
        send(&mut producer, 0..5).await.expect("taken");
        let totals = producer.close().await.expect("acknowledged");
        assert_all_accounted_for(&totals, 5);
        let told = [
            totals.accepted,
            totals.rejected,
            totals.rejected_batches,
            totals.unverified,
        ];
        assert_eq!(told, expected, "{status:?}");
        assert_eq!(totals.duplicates, 0);
    }
}

#[tokio::test]
async fn a_transition_of_another_shape_harms_nothing_else() {
    let (fake, builder) = start(CALM, 0).await;
    let mut producer = builder.open().await.expect("known");
    producer.send(transition(0.0)).await.expect("taken");
    let wrong = Record {
        state: vec![1.0, 2.0],
        ..transition(0.0)
    };
    let error = producer.send(wrong).await.expect_err("two values");
    assert_eq!(error.to_string(), "got 2 state values, expected 1");
    producer.send(transition(1.0)).await.expect("taken");
    producer.close().await.expect("acknowledged");
    assert_counted_once(&fake, 2);
}

#[tokio::test]
async fn a_smaller_limit_of_the_service_is_heeded() {
    let (fake, builder) = start(
        Mood {
            max_batch_transitions: 7,
            ..CALM
        },
        0,
    )
    .await;
    let error = builder
        .clone()
        .replay()
        .open()
        .await
        .expect_err("batches of a replay do not depend on the service");
    assert_eq!(error.kind(), ErrorKind::Invalid);
    let mut producer = builder.open().await.expect("known");
    send(&mut producer, 0..20).await.expect("taken");
    producer.close().await.expect("acknowledged");
    assert!(fake.memory().batches.iter().all(|(_, _, _, len)| *len <= 7));
    assert_counted_once(&fake, 20);
}

#[tokio::test]
async fn a_service_that_stays_away_is_given_up() {
    let (fake, _) = start(CALM, 0).await;
    let proxy = Proxy::start(fake.address, None, 0).await;
    let mut producer = builder(&proxy.address)
        .await
        .retry_for(Duration::from_millis(200))
        .open()
        .await
        .expect("known");
    proxy.set_up(false);
    send(&mut producer, 0..10).await.expect("taken");
    let error = producer.flush().await.expect_err("nobody there");
    assert!(matches!(error, ClientError::GaveUp { .. }), "{error}");
    assert_eq!(error.kind(), ErrorKind::Unavailable);
}

#[tokio::test]
async fn a_service_that_comes_back_gets_what_waited() {
    let (fake, _) = start(CALM, 0).await;
    let proxy = Proxy::start(fake.address, None, 0).await;
    let mut producer = builder(&proxy.address)
        .await
        .retry_for_ever()
        .batch_size(10)
        .open()
        .await
        .expect("known");
    send(&mut producer, 0..55).await.expect("taken");
    proxy.set_up(false);
    send(&mut producer, 55..155).await.expect("there is room");
    tokio::time::sleep(Duration::from_millis(300)).await;
    proxy.set_up(true);
    producer.close().await.expect("acknowledged");
    assert_counted_once(&fake, 155);
}

#[tokio::test]
async fn an_idle_producer_outlives_a_long_absence() {
    let (fake, _) = start(CALM, 0).await;
    let proxy = Proxy::start(fake.address, None, 0).await;
    let builder = builder(&proxy.address).await;
    let mut producer = builder
        .retry_for(Duration::from_millis(700))
        .open()
        .await
        .expect("known");
    proxy.set_up(false);
    tokio::time::sleep(Duration::from_millis(1_000)).await;
    send(&mut producer, 0..10).await.expect("taken");
    proxy.set_up(true);
    producer
        .close()
        .await
        .expect("the clock ran only while something waited");
    assert_counted_once(&fake, 10);
}

#[tokio::test]
async fn an_unknown_environment_is_told_at_once() {
    let fake = Fake::start(CALM, 0).await;
    let error = builder(&fake.address.to_string())
        .await
        .open()
        .await
        .expect_err("not described");
    assert_eq!(
        (error.kind(), error.to_string()),
        (ErrorKind::NotFound, "unknown environment `counter`".into())
    );
}

#[tokio::test]
async fn a_bad_address_says_what_is_wrong() {
    let free = TcpListener::bind("127.0.0.1:0")
        .await
        .expect("a port")
        .local_addr()
        .expect("bound");
    let error = Connection::open(&free.to_string())
        .await
        .expect_err("nobody listens");
    assert!(matches!(error, ClientError::Unreachable { .. }), "{error}");
    assert!(
        error
            .to_string()
            .starts_with(&format!("nobody listens at http://{free} (")),
        "{error}"
    );
    assert!(matches!(
        Connection::open("ftp://localhost").await,
        Err(ClientError::Address { .. })
    ));
    assert!(matches!(
        Connection::open("not an address").await,
        Err(ClientError::Address { .. })
    ));
}

#[tokio::test]
async fn what_listens_may_be_no_nudge() {
    let web = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = web.local_addr().expect("bound").to_string();
    tokio::spawn(async move { axum::serve(web, axum::Router::new()).await });
    let error = Connection::open(&address).await.expect_err("a web server");
    assert!(matches!(error, ClientError::NotNudge { .. }), "{error:?}");

    let other = TcpListener::bind("127.0.0.1:0").await.expect("a port");
    let address = other.local_addr().expect("bound").to_string();
    let (_, health) = tonic_health::server::health_reporter();
    let server = tonic::transport::Server::builder().add_service(health);
    tokio::spawn(server.serve_with_incoming(TcpListenerStream::new(other)));
    let error = Connection::open(&address)
        .await
        .expect_err("another service");
    assert!(error.to_string().contains("is no Nudge"), "{error}");
}

/// The counter's environment with lags of both agents.
fn lagged(lags: &[i64]) -> SchemaDraft {
    SchemaDraft {
        lags: lags.to_vec(),
        ..counter()
    }
}

/// What both agents do at a step.
fn moves(x: u32) -> [f32; 2] {
    [x / 2 % 2, x / 3 % 2].map(|action| action as f32)
}

async fn steps(
    producer: &mut Producer,
    track: &mut Track,
    range: std::ops::Range<u32>,
) -> Result<(), ClientError> {
    for x in range {
        let step = Step::new(vec![x as f32], moves(x).to_vec());
        producer.step(track, step).await?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn tracks_outlive_the_streams_that_they_are_sent_on() {
    for seed in 0..5 {
        let fake = Fake::start(WILD, seed).await;
        fake.describe("counter", lagged(&[1, 3]));
        let builder = builder(&fake.address.to_string()).await;
        let builder = builder.batch_size(20).outbox(12).step_within(LONG);
        let mut producer = builder.open().await.expect("known");

        let mut track = producer.track();
        steps(&mut producer, &mut track, 0..400)
            .await
            .expect("taken");
        let totals = producer.flush().await.expect("acknowledged");
        assert_eq!((totals.sent, totals.held_back, totals.dropped), (397, 3, 0));

        steps(&mut producer, &mut track, 400..1_000)
            .await
            .expect("taken");
        producer.end(track).await.expect("taken");
        let totals = producer.close().await.expect("acknowledged");
        assert_eq!((totals.held_back, totals.dropped), (0, 0));
        assert_counted_once(&fake, 1_000);
        assert_all_accounted_for(&totals, 1_000);

        // a@1, a@3, b@1, b@3; zeros where the track is over.
        let at = |x: u32, agent: usize| if x < 1_000 { moves(x)[agent] } else { 0.0 };
        let of = |x: u32| [at(x + 1, 0), at(x + 3, 0), at(x + 1, 1), at(x + 3, 1)];
        let expected: Vec<f32> = (0..1_000).flat_map(of).collect();
        assert!(
            fake.memory().outcomes == expected,
            "outcomes of another step"
        );
        assert!(fake.memory().hellos.len() > 1, "streams were broken");
    }
}

#[tokio::test]
async fn a_tick_waits_no_longer_than_it_may_and_what_is_dropped_is_told() {
    let mood = Mood {
        silent: true,
        window: 2,
        ..CALM
    };
    let (_fake, builder) = start(mood, 0).await;
    let builder = builder.batch_size(10).outbox(3);
    let builder = builder.step_within(Duration::from_millis(2));
    let mut producer = builder.open().await.expect("known");

    let mut track = producer.track();
    let began = std::time::Instant::now();
    steps(&mut producer, &mut track, 0..1_500)
        .await
        .expect("no error");
    let dropped = producer.dropped();
    assert!((300..1_500).contains(&dropped), "{dropped} of 1500");
    let late = began.elapsed() / dropped as u32;
    assert!(late < Duration::from_millis(100), "{late:?} a tick");
}

#[tokio::test]
async fn what_tracks_hold_back_is_told_and_what_is_never_ended_is_lost() {
    let fake = Fake::start(CALM, 0).await;
    fake.describe("counter", lagged(&[4]));
    let builder = builder(&fake.address.to_string()).await;
    let mut producer = builder.step_within(LONG).open().await.expect("known");

    let mut tracks: Vec<Track> = (0..100).map(|_| producer.track()).collect();
    for track in &mut tracks {
        steps(&mut producer, track, 0..6).await.expect("taken");
    }
    assert_eq!(producer.held_back(), 400);

    let wrong = Step::new(vec![1.0, 2.0], vec![0.0, 1.0]);
    let error = producer.step(&mut tracks[0], wrong).await;
    let error = error.expect_err("two state values").to_string();
    assert_eq!(error, "got 2 state values, expected 1");
    let wrong = Step::new(vec![1.0], vec![0.0, 1.0]).acting(vec![true]);
    assert!(
        producer.step(&mut tracks[0], wrong).await.is_err(),
        "two agents"
    );
    let wrong = Step::new(vec![1.0], vec![0.0, 1.0]).observing(vec![1.0]);
    assert!(
        producer.step(&mut tracks[0], wrong).await.is_err(),
        "no such outcome"
    );

    producer.gap(&mut tracks[0]).await.expect("taken");
    producer
        .end(tracks.pop().expect("a hundred"))
        .await
        .expect("taken");
    drop(tracks.pop());
    let totals = producer.close().await.expect("acknowledged");
    assert_eq!((totals.sent, totals.held_back), (208, 392), "{totals:?}");
    assert_eq!(fake.memory().values.len(), 208);
}
