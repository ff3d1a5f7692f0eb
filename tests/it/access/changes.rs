//! Keys that change, streams that are open meanwhile, whose producers are, and rates.

use std::time::{Duration, Instant};

use nudge::api::proto;
use nudge::client::{Connection, Options, Secret, Step, Track};
use tonic::Code;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;

use super::wire::{Asked, Face, Wire};
use super::{Guarded, bearer, key, keys};
use crate::support::{RawStream, hello, reason, row, rows};

/// How soon a change acts.
const SOON: Duration = Duration::from_secs(1);

type Keyed = InterceptedService<Channel, nudge::client::Bearer>;

async fn connection(guarded: &Guarded, key: &Secret) -> Connection {
    let options = Options::default().key(key.clone());
    Connection::open_with(&guarded.app.address.to_string(), &options)
        .await
        .expect("let in")
}

async fn ingest(
    guarded: &Guarded,
    key: &Secret,
) -> proto::ingest_service_client::IngestServiceClient<Keyed> {
    connection(guarded, key).await.ingest()
}

fn one(sequence: u64) -> proto::Batch {
    rows(sequence, vec![row([0.6, 0.0], [0.0, 0.0])])
}

fn write(producer: &str, sequence: u64) -> proto::WriteRequest {
    let (environment, producer, batch) = ("lane".into(), producer.into(), Some(one(sequence)));
    proto::WriteRequest {
        environment,
        producer,
        batch,
        ..Default::default()
    }
}

#[tokio::test]
async fn an_open_stream_ends_with_its_key() {
    let (first, line) = key("game ingest,read");
    let digest = first.digest();
    for (change, code, told) in [
        (String::new(), Code::Unauthenticated, "UNAUTHENTICATED"),
        (
            format!("other {digest} ingest"),
            Code::Unauthenticated,
            "UNAUTHENTICATED",
        ),
        (
            format!("game {digest} read"),
            Code::PermissionDenied,
            "SCOPE_MISSING",
        ),
        (
            format!("game {digest} ingest environments=kitchen"),
            Code::PermissionDenied,
            "ENVIRONMENT_FORBIDDEN",
        ),
    ] {
        let guarded = Guarded::start(&[&line]).await;
        let (_, mut stream) = RawStream::open(ingest(&guarded, &first).await, hello("p"))
            .await
            .expect("let in");
        stream.send(one(1)).await.expect("open");
        stream.acknowledged().await.expect("counted");

        // A reload that leaves the key as it is leaves the stream.
        guarded.ring.replace(keys(&[&line, "", "# a comment"]));
        stream.send(one(2)).await.expect("open");
        stream.acknowledged().await.expect("counted");

        let changed = Instant::now();
        guarded.ring.replace(keys(&[&change]));
        let end = stream.acknowledged().await.expect_err("ended");
        assert_eq!(
            (end.code(), reason(&end).as_str()),
            (code, told),
            "{change}"
        );
        assert!(changed.elapsed() < SOON, "{:?}", changed.elapsed());
        let again = Wire::new(&guarded.app);
        let get = Asked {
            face: Face::Rest,
            name: "POST /v1/environments/{environment}/transitions".into(),
        };
        let answer = again
            .ask(&get, "lane", &[("authorization", &bearer(&first))])
            .await;
        assert_eq!(
            answer.status == 401,
            change.is_empty(),
            "{change}: {answer:?}"
        );
    }
}

#[tokio::test]
async fn producers_belong_to_the_name_of_a_key() {
    let (first, one_line) = key("game ingest,read");
    let (second, next_line) = key("game ingest");
    let (other, other_line) = key("other ingest");
    let guarded = Guarded::start(&[&one_line, &other_line]).await;

    // One from before keys belongs to the first that speaks for it.
    let environment = guarded.app.app.environments.find("lane").expect("there");
    let before = nudge::api::grpc::batch(&environment.schema, one(1)).expect("right");
    guarded
        .app
        .app
        .ingest
        .write(&environment, "old".parse().expect("an id"), before)
        .await
        .expect("counted");

    let (mut theirs, mut others) = (
        ingest(&guarded, &first).await,
        ingest(&guarded, &other).await,
    );
    theirs.write(write("p", 1)).await.expect("counted");
    theirs.write(write("old", 2)).await.expect("counted");
    for producer in ["p", "old"] {
        let refused = others
            .write(write(producer, 9))
            .await
            .expect_err("another's");
        assert_eq!(
            (refused.code(), reason(&refused).as_str()),
            (Code::PermissionDenied, "PRODUCER_FORBIDDEN")
        );
        assert!(
            refused.message().contains(&format!("`{producer}`")),
            "{}",
            refused.message()
        );
        let refused = others
            .write(write(producer, 1))
            .await
            .expect_err("a duplicate of another's");
        assert_eq!(refused.code(), Code::PermissionDenied);
    }

    // A hello of another key does not fence the stream, whether something of it is stored or not.
    for producer in ["p", "new"] {
        let (welcome, mut stream) = RawStream::open(theirs.clone(), hello(producer))
            .await
            .expect("its own");
        let Err(refused) = RawStream::open(others.clone(), hello(producer)).await else {
            panic!("another's")
        };
        assert_eq!(reason(&refused), "PRODUCER_FORBIDDEN");
        stream
            .send(one(welcome.committed_sequence + 1))
            .await
            .expect("open");
        stream.acknowledged().await.expect("it goes on");
    }

    // Over REST too.
    let wire = Wire::new(&guarded.app);
    let body = serde_json::json!({"producer": "p", "sequence": 3, "transitions": []});
    let post = |key: &Secret| {
        let request =
            reqwest::Client::new().post(guarded.app.url("/v1/environments/lane/transitions"));
        request
            .header("authorization", bearer(key))
            .json(&body)
            .send()
    };
    let refused = post(&other).await.expect("answered");
    assert_eq!(refused.status(), 403);
    let told: serde_json::Value = refused.json().await.expect("JSON");
    assert_eq!(
        (&told["reason"], &told["producer"]),
        (&"PRODUCER_FORBIDDEN".into(), &"p".into())
    );
    drop(wire);

    // Another key of the name goes on, also after a restart without keys in between.
    guarded.ring.replace(keys(&[&next_line, &other_line]));
    ingest(&guarded, &second)
        .await
        .write(write("p", 3))
        .await
        .expect("the name's");
    let refused = theirs.write(write("p", 4)).await.expect_err("withdrawn");
    assert_eq!(refused.code(), Code::Unauthenticated);
    let owner = guarded
        .app
        .app
        .store
        .owner(environment.id, &"p".parse().expect("an id"))
        .await
        .expect("read");
    assert_eq!(owner.map(|name| name.to_string()), Some("game".into()));
    let batch = nudge::api::grpc::batch(&environment.schema, one(4)).expect("right");
    guarded
        .app
        .app
        .ingest
        .write(&environment, "p".parse().expect("an id"), batch)
        .await
        .expect("nobody needs a key");
}

#[tokio::test]
async fn a_stream_that_waits_for_its_rate_ends_with_its_key_too() {
    let (key, line) = key("game ingest,read rate=4/m");
    let guarded = Guarded::start(&[&line]).await;
    // A probe and a hello: two are left, and the next comes in 15 seconds, for which no stream
    // waits.
    let (_, mut stream) = RawStream::open(ingest(&guarded, &key).await, hello("p"))
        .await
        .expect("let in");
    for sequence in 1..=3 {
        stream.send(one(sequence)).await.expect("open");
    }
    let mut counted = 0;
    let end = loop {
        match stream.acknowledged().await {
            Ok(told) => counted += told.receipts.len(),
            Err(end) => break end,
        }
    };
    assert_eq!(
        (counted, end.code(), reason(&end).as_str()),
        (2, Code::ResourceExhausted, "RATE_EXCEEDED")
    );

    let line = line.replace("4/m", "1/s");
    guarded.ring.replace(keys(&[&line]));
    tokio::time::sleep(Duration::from_millis(1_100)).await;
    let client = ingest(&guarded, &key);
    let mut client = tokio::time::timeout(Duration::from_secs(5), client)
        .await
        .expect("let in");
    tokio::time::sleep(Duration::from_millis(1_100)).await;
    let (_, mut stream) = RawStream::open(client.clone(), hello("p"))
        .await
        .expect("let in");
    for sequence in 3..=9 {
        stream.send(one(sequence)).await.expect("open");
    }
    let changed = Instant::now();
    guarded.ring.replace(keys(&[]));
    let end = loop {
        if let Err(end) = stream.acknowledged().await {
            break end;
        }
    };
    assert_eq!(
        (end.code(), changed.elapsed() < SOON),
        (Code::Unauthenticated, true),
        "{end:?}"
    );
    client.write(write("p", 9)).await.expect_err("withdrawn");
}

#[tokio::test]
async fn a_rate_is_told_with_the_time_to_wait() {
    let (slow, line) = key("slow read,ingest rate=2/h");
    let guarded = Guarded::start(&[&line]).await;
    let (wire, slow) = (Wire::new(&guarded.app), bearer(&slow));
    let headers = [("authorization", slow.as_slice())];
    let list = Asked {
        face: Face::Rest,
        name: "GET /v1/environments".into(),
    };
    for _ in 0..2 {
        assert!(wire.ask(&list, "", &headers).await.is_let_in());
    }
    let refused = wire.ask(&list, "", &headers).await;
    assert_eq!(
        (refused.status, refused.reason.as_str()),
        (429, "RATE_EXCEEDED")
    );
    let wait: u64 = refused.headers["retry-after"]
        .to_str()
        .expect("text")
        .parse()
        .expect("seconds");
    assert!((1_000..=1_801).contains(&wait), "{wait}");
    let call = Asked {
        face: Face::Grpc,
        name: "/nudge.v1.EnvironmentService/ListEnvironments".into(),
    };
    let refused = wire.ask(&call, "", &headers).await;
    assert_eq!(
        (refused.status, refused.reason.as_str()),
        (429, "RATE_EXCEEDED")
    );
    let status = tonic::Status::from_header_map(&refused.headers).expect("a status");
    let retry = tonic_types::StatusExt::get_details_retry_info(&status)
        .expect("when")
        .retry_delay;
    assert!(retry.is_some_and(|wait| wait > SOON), "{retry:?}");
}

#[tokio::test]
async fn the_client_waits_for_its_rate_and_goes_on() {
    let (steady, line) = key("steady read,ingest rate=4/s");
    let guarded = Guarded::start(&[&line]).await;
    let began = Instant::now();
    let connection = connection(&guarded, &steady).await;
    let mut producer = connection
        .producer("lane", "p")
        .batch_size(1)
        .open()
        .await
        .expect("opened");
    let mut track = Track::new(producer.schema());
    for _ in 0..12 {
        producer
            .send(
                track
                    .step(Step::new(vec![0.6, 0.0], vec![0.0, 0.0]))
                    .expect("no outcomes"),
            )
            .await
            .expect("taken");
    }
    let totals = producer.close().await.expect("all of them");
    assert_eq!(totals.accepted, 12);
    for _ in 0..6 {
        connection
            .environment("lane")
            .await
            .expect("sooner or later");
    }
    for _ in 0..6 {
        super::changes::connection(&guarded, &steady).await;
    }
    // A probe, a look, a stream, twelve batches, six looks and six probes are 27, and 4 may come at
    // once.
    assert!(
        began.elapsed() >= Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
}

#[tokio::test]
async fn a_key_that_may_only_send_finds_what_another_made() {
    let (key, line) = key("game ingest");
    let guarded = Guarded::start(&[&line]).await;
    let connection = connection(&guarded, &key).await;
    let schema = nudge::domain::SchemaDraft::from(crate::support::lane_schema());
    connection
        .apply("lane", &schema)
        .await
        .expect("it is as described");
    let mut other = schema.clone();
    other.agents.pop();
    connection
        .apply("lane", &other)
        .await
        .expect_err("it is not");
    connection
        .apply("street", &schema)
        .await
        .expect_err("it is not there");
}
