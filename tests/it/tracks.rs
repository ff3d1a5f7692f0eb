//! Entries that the service says, for senders that tell only which track a transition is a step of:
//! the same as the client's tracks say, on every face, whatever becomes of the stream.

use std::collections::BTreeMap;
use std::sync::Arc;

use bytes::Bytes;
use nudge::api::proto::influence_service_client::InfluenceServiceClient;
use nudge::api::proto::ingest_service_client::IngestServiceClient;
use nudge::api::proto::{self, BatchStatus};
use nudge::client::{Connection, Step, Track};
use nudge::domain::{Entry, Family, Presence, Record, Schema, StateKey, Tally, Values};
use nudge::store::{Options, Store};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use tempfile::TempDir;
use tonic::transport::Channel;

use crate::faults::process::most_memory_mib;
use crate::server::Server;
use crate::support::load::make_lane;
use crate::support::{RawStream, TestApp, channel, hello, lane_json, open, row, rows};

mod attacks;

/// The greatest batch: more transitions than are discretised at once.
const BATCH: usize = 70;

/// By a state's key, the number of a family, and a cell of it.
type Counted = BTreeMap<(String, u32, u64), Tally>;

/// A service, and its store.
struct Told {
    app: TestApp,
    store: Arc<dyn Store>,
}

impl Told {
    async fn start() -> Self {
        let directory = Arc::new(TempDir::new().expect("a temporary directory"));
        let store = open(directory.path(), Options::default()).await;
        let app = TestApp::with(directory, store.clone()).await;
        Self { app, store }
    }

    /// Makes a lane whose human may be absent, with what each does one and two steps later.
    async fn make(&self, name: &str) -> Schema {
        let mut lane = lane_json();
        lane["agents"][1]["may_be_absent"] = json!(true);
        lane["lags"] = json!([1, 2]);
        let path = format!("/v1/environments/{name}");
        let made = self.app.rest("PUT", &path, Some(&lane)).await;
        assert_eq!(made.0, 201, "{}", made.1);
        self.store.environment(name).expect("made").schema.clone()
    }

    /// Returns all that was counted, by state, family and cell.
    async fn counted(&self, name: &str) -> Counted {
        let environment = self.store.environment(name).expect("made");
        let keys: Vec<StateKey> = (0..8).map(|at| StateKey::new(&[at / 2, at % 2])).collect();
        let counts = self.store.counts(environment.id, &keys).await;
        let states = keys.iter().zip(counts.expect("counts"));
        let cells = states.flat_map(|(key, state)| {
            let of = |family| {
                let cells = state.counts.of_family(Family::from_number(family)).iter();
                let cells = cells.map(|cell| ((key.to_string(), family, cell.joint), cell.tally));
                cells.collect::<Vec<_>>()
            };
            (0..5).flat_map(of).collect::<Vec<_>>()
        });
        cells.collect()
    }

    /// Sends batches by a stream, and expects that all are counted.
    async fn stream(&self, name: &str, batches: Vec<proto::Batch>) {
        let hello = proto::Hello {
            environment: name.into(),
            ..hello("p")
        };
        let opened = RawStream::open(self.app.ingest().await, hello).await;
        let (_, stream) = opened.expect("welcome");
        let sent = batches.len();
        for batch in batches {
            stream.send(batch).await.expect("open");
        }
        let (receipts, end) = stream.finish().await;
        assert_eq!((receipts.len(), end.code()), (sent, tonic::Code::Ok));
    }
}

/// Plays some games at a time, whose agents hold what they do, where the human is away now and
/// then, and in which a value has no bin now and then. Returns what tracks of the client release,
/// each with the number of its game.
fn played(schema: &Schema) -> Vec<Record> {
    const GAMES: [u64; 3] = [0, 7, u64::MAX];
    const STEPS: usize = 200;
    let mut random = StdRng::seed_from_u64(17);
    let mut tracks = GAMES.map(|_| Track::new(schema));
    let mut now = [[0.1, 0.0, 0.0, 0.0]; 3];

    let mut released = Vec::new();
    for _ in 0..STEPS {
        for ((game, track), now) in GAMES.iter().zip(&mut tracks).zip(&mut now) {
            move_on(now, &mut random);
            let [mut distance, held, robot, human] = *now;
            if random.random_bool(0.1) {
                distance = f32::NAN;
            }
            let step = Step::new(vec![distance, held], vec![robot, human]);
            let step = step.acting(vec![true, random.random_bool(0.85)]);
            released.extend(track.step(step).map(|record| of_game(*game, record)));
        }
    }
    for (game, track) in GAMES.iter().zip(tracks) {
        released.extend(track.end().into_iter().map(|record| of_game(*game, record)));
    }
    released
}

/// Moves a game one step on: distance and held, and what robot and human do.
fn move_on([distance, held, robot, human]: &mut [f32; 4], random: &mut StdRng) {
    if random.random_bool(0.4) {
        *distance = [0.1, 0.6, 0.8, 2.0][random.random_range(0..4)];
        *held = random.random_range(0..2) as f32;
    }
    for (action, of) in [(robot, 2), (human, 3)] {
        if random.random_bool(0.3) {
            *action = random.random_range(0..of) as f32;
        }
    }
}

fn of_game(game: u64, record: Record) -> Record {
    Record {
        track: Some(game),
        ..record
    }
}

/// Returns the same without flags.
fn bare(records: &[Record]) -> Vec<Record> {
    let bare = |record: &Record| Record {
        entry: Entry::Unknown,
        ..record.clone()
    };
    records.iter().map(bare).collect()
}

/// Returns the same with the flags that were made, and without tracks.
fn flagged(records: &[Record]) -> Vec<Record> {
    let flagged = |record: &Record| Record {
        track: None,
        ..record.clone()
    };
    records.iter().map(flagged).collect()
}

fn bits(flags: &[bool]) -> Bytes {
    Presence::of(flags.to_vec()).bits().clone()
}

fn rows_of(records: &[Record]) -> proto::batch::Transitions {
    let row = |record: &Record| proto::Transition {
        state: record.state.clone(),
        actions: record.actions.clone(),
        entry: record.entry as i32,
        outcomes: record.outcomes.clone(),
        actions_present: bits(&record.actions_present),
        outcomes_present: bits(&record.outcomes_present),
        track: record.track,
        ..proto::Transition::default()
    };
    let transitions = records.iter().map(row).collect();
    proto::batch::Transitions::Rows(proto::Rows { transitions })
}

fn columns_of(records: &[Record]) -> proto::batch::Transitions {
    let all = |flags: &[bool], slots| match flags.is_empty() {
        true => vec![true; slots],
        false => flags.to_vec(),
    };
    let (mut acted, mut seen, mut outcomes) = (Vec::new(), Vec::new(), Vec::new());
    for record in records {
        acted.extend(all(&record.actions_present, 2));
        let is_observed = !record.outcomes.is_empty();
        seen.extend(match is_observed {
            true => all(&record.outcomes_present, 4),
            false => vec![false; 4],
        });
        outcomes.extend(match is_observed {
            true => record.outcomes.clone(),
            false => vec![0.0; 4],
        });
    }
    proto::batch::Transitions::Columns(proto::Columns {
        count: records.len() as u32,
        states: records.iter().flat_map(|one| one.state.clone()).collect(),
        actions: records.iter().flat_map(|one| one.actions.clone()).collect(),
        actions_present: bits(&acted),
        outcomes_le: Values::from(outcomes).into_le_bytes(),
        outcomes_present: bits(&seen),
        entries: records.iter().map(|one| one.entry as i32).collect(),
        tracks: records.iter().filter_map(|one| one.track).collect(),
        ..proto::Columns::default()
    })
}

fn json_of(record: &Record) -> Value {
    let has = |flags: &[bool], at: usize| flags.get(at).copied().unwrap_or(true);
    let acts = has(&record.actions_present, 1);
    let mut told = json!({
        "state": {"distance": record.state[0], "held": record.state[1]},
        "actions": {"robot": record.actions[0], "human": acts.then(|| record.actions[1])},
        "track": record.track,
    });
    if record.state[0].is_nan() {
        // JSON has no word for it: what stands there has no bin either.
        told["state"]["distance"] = json!("far");
    }
    let names = ["robot@1", "robot@2", "human@1", "human@2"];
    for (at, name) in names.iter().enumerate() {
        if !record.outcomes.is_empty() && has(&record.outcomes_present, at) {
            told["outcomes"][name] = json!(record.outcomes[at]);
        }
    }
    told
}

fn batches(
    records: &[Record],
    size: usize,
    form: fn(&[Record]) -> proto::batch::Transitions,
) -> Vec<proto::Batch> {
    let numbered = (1..).zip(records.chunks(size));
    let batch = |(sequence, records)| proto::Batch {
        sequence,
        transitions: Some(form(records)),
        ..proto::Batch::default()
    };
    numbered.map(batch).collect()
}

/// Returns the visits, and the entries where every one of them says.
fn entries(counted: &Counted) -> (u64, Option<u64>) {
    let joint = counted.iter().filter(|((_, family, _), _)| *family == 0);
    let tallies: Vec<Tally> = joint.map(|(_, tally)| *tally).collect();
    let visits = tallies.iter().map(|tally| tally.n).sum();
    (visits, tallies.iter().map(|tally| tally.entries).sum())
}

#[tokio::test]
async fn bare_steps_with_tracks_count_as_the_client_flags_them() {
    let told = Told::start().await;
    let schema = told.make("flagged").await;
    let records = played(&schema);
    let bare = bare(&records);

    let expected = {
        let batches = batches(&flagged(&records), BATCH, columns_of);
        told.stream("flagged", batches).await;
        told.counted("flagged").await
    };
    let (visits, drawn) = entries(&expected);
    let drawn = drawn.expect("all are flagged");
    let misfits = records.iter().filter(|one| one.state[0].is_nan()).count() as u64;
    assert_eq!(visits + misfits, records.len() as u64);
    assert!(
        misfits > 10 && drawn > 100 && drawn < visits / 2,
        "{drawn} of {visits}"
    );

    for (name, size, form) in [
        ("rows", BATCH, rows_of as fn(&[Record]) -> _),
        ("rows-1", 1, rows_of),
        ("columns", BATCH, columns_of),
        ("columns-1", 3, columns_of),
    ] {
        told.make(name).await;
        told.stream(name, batches(&bare, size, form)).await;
        assert!(told.counted(name).await == expected, "{}", name);
    }

    told.make("client").await;
    let connection = Connection::open(&told.app.address.to_string()).await;
    let producer = connection.expect("it listens").producer("client", "p");
    let mut producer = producer.batch_size(BATCH).open().await.expect("open");
    for record in bare.clone() {
        producer.send(record).await.expect("sent");
    }
    let totals = producer.close().await.expect("acknowledged");
    assert_eq!((totals.accepted, totals.rejected), (visits, misfits));
    assert!(told.counted("client").await == expected, "{}", "client");

    // In one call each, for a call knows no tracks but its own.
    told.make("write").await;
    let request = proto::WriteRequest {
        environment: "write".into(),
        producer: "p".into(),
        batch: batches(&bare, bare.len(), columns_of).pop(),
        ..proto::WriteRequest::default()
    };
    told.app.ingest().await.write(request).await.expect("valid");
    assert!(told.counted("write").await == expected, "{}", "write");

    told.make("rest").await;
    let transitions: Vec<Value> = bare.iter().map(json_of).collect();
    let body = json!({"producer": "p", "sequence": 1, "transitions": transitions});
    let path = "/v1/environments/rest/transitions";
    let (status, receipt) = told.app.rest("POST", path, Some(&body)).await;
    assert_eq!(
        (status, &receipt["accepted"]),
        (200, &json!(visits)),
        "{receipt}"
    );
    assert!(told.counted("rest").await == expected, "{}", "rest");

    told.make("lines").await;
    let lines: Vec<String> = transitions.iter().map(Value::to_string).collect();
    let path = "/v1/environments/lines/transitions?producer=p&sequence=1";
    let request = reqwest::Client::new().post(told.app.url(path));
    let request = request.header("content-type", "application/x-ndjson");
    let answer = request.body(lines.join("\n")).send().await;
    assert_eq!(answer.expect("answered").status(), 200);
    assert!(told.counted("lines").await == expected, "{}", "lines");
}

#[tokio::test]
async fn without_tracks_nothing_is_said_of_entries() {
    let told = Told::start().await;
    let schema = told.make("lane").await;
    let untracked = flagged(&bare(&played(&schema)));
    told.stream("lane", batches(&untracked, BATCH, columns_of))
        .await;
    let (visits, drawn) = entries(&told.counted("lane").await);
    assert!(visits > 500 && drawn.is_none());
}

/// Two tracks whose agents never change what they do go to and fro between two states: of each, one
/// entry counts.
fn held(sequence: u64) -> proto::Batch {
    let step = |at: [f32; 2], track| proto::Transition {
        track: Some(track),
        ..row(at, [0.0, 2.0])
    };
    let (near, far) = ([0.1, 0.0], [2.0, 0.0]);
    let steps = [
        (near, 3),
        (near, 4),
        (far, 3),
        (far, 4),
        (near, 3),
        (far, 3),
    ];
    rows(sequence, steps.map(|(at, track)| step(at, track)).to_vec())
}

/// Returns visits and entries of both states.
async fn near_and_far(channel: Channel) -> [(u64, Option<u64>); 2] {
    let mut client = InfluenceServiceClient::new(channel);
    let mut told = [(0, Some(0)); 2];
    for (told, key) in told.iter_mut().zip(["0.0", "3.0"]) {
        let request = proto::GetStateRequest {
            environment: "lane".into(),
            key: key.into(),
        };
        let state = client.get_state(request).await.expect("a valid key");
        let cells = state.into_inner().cells;
        let visits = cells.iter().map(|cell| cell.n).sum();
        *told = (visits, cells.iter().map(|cell| cell.entries).sum());
    }
    told
}

/// Sends batches by a stream of its own, and returns what became of each.
async fn sent(channel: Channel, batches: Vec<proto::Batch>) -> Vec<BatchStatus> {
    let client = IngestServiceClient::new(channel);
    let (_, stream) = RawStream::open(client, hello("p")).await.expect("welcome");
    for batch in batches {
        stream.send(batch).await.expect("open");
    }
    let (receipts, end) = stream.finish().await;
    assert_eq!(end.code(), tonic::Code::Ok, "{end}");
    receipts.iter().map(proto::Receipt::status).collect()
}

#[tokio::test]
async fn a_later_stream_begins_tracks_anew_and_one_stream_goes_on() {
    use BatchStatus::{Applied, Duplicate};
    let anew = |streams: u64, batches: u64| [(3 * batches, Some(2 * streams)); 2];
    for (streams, statuses, expected) in [
        (vec![vec![1, 2, 3]], vec![Applied; 3], anew(1, 3)),
        // Cut in the middle, each state of each track counts once more.
        (vec![vec![1, 2], vec![3]], vec![Applied; 3], anew(2, 3)),
        // What is sent again, and was counted, tells a later stream where its tracks are.
        (
            vec![vec![1, 2], vec![2, 3]],
            vec![Applied, Applied, Duplicate, Applied],
            anew(1, 3),
        ),
        // And the same stream nothing that it does not know.
        (
            vec![vec![1, 1, 2, 1, 3]],
            vec![Applied, Duplicate, Applied, Duplicate, Applied],
            anew(1, 3),
        ),
    ] {
        let app = TestApp::start().await;
        app.lane().await;
        let mut told = Vec::new();
        for stream in &streams {
            let batches = stream.iter().map(|sequence| held(*sequence)).collect();
            told.extend(sent(app.channel().await, batches).await);
        }
        assert_eq!(told, statuses, "{streams:?}");
        let counted = near_and_far(app.channel().await).await;
        assert_eq!(counted, expected, "{streams:?}");
    }
}

#[tokio::test]
async fn calls_know_no_tracks_but_their_own() {
    let app = TestApp::start().await;
    app.lane().await;
    for sequence in 1..=3 {
        let request = proto::WriteRequest {
            environment: "lane".into(),
            producer: "p".into(),
            batch: Some(held(sequence)),
            ..proto::WriteRequest::default()
        };
        app.ingest().await.write(request).await.expect("valid");
    }
    let counted = near_and_far(app.channel().await).await;
    assert_eq!(counted, [(9, Some(6)); 2]);
}

#[tokio::test]
async fn a_duplicate_on_a_stream_does_not_take_its_tracks_back() {
    let app = TestApp::start().await;
    app.lane().await;
    let both = |sequence, actions| {
        let step = |at: [f32; 2]| proto::Transition {
            track: Some(0),
            ..row(at, actions)
        };
        rows(sequence, vec![step([0.1, 0.0]), step([2.0, 0.0])])
    };
    let (first, second) = (|at| both(at, [0.0, 2.0]), |at| both(at, [1.0, 1.0]));
    // Were the first taken for a step after the second, both agents would have changed since.
    let batches = vec![first(1), second(2), first(1), second(3)];
    sent(app.channel().await, batches).await;
    let counted = near_and_far(app.channel().await).await;
    assert_eq!(counted, [(3, Some(2)); 2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_was_killed_begins_tracks_anew() {
    let directory = TempDir::new().expect("a temporary directory");
    let server = Server::start(directory.path(), "127.0.0.1:0");
    make_lane(server.address).await;
    let there = channel(server.address).await.expect("it listens");
    let (_, mut stream) = RawStream::open(IngestServiceClient::new(there), hello("p"))
        .await
        .expect("welcome");
    stream.send(held(1)).await.expect("open");
    stream.acknowledged().await.expect("committed");
    server.kill();

    let server = Server::start(directory.path(), "127.0.0.1:0");
    let there = channel(server.address).await.expect("it listens");
    let statuses = sent(there.clone(), vec![held(2), held(3)]).await;
    assert_eq!(statuses, [BatchStatus::Applied; 2]);
    assert_eq!(near_and_far(there.clone()).await, [(9, Some(4)); 2]);

    // All of it again is nothing but duplicates.
    let statuses = sent(there.clone(), (1..=3).map(held).collect()).await;
    assert_eq!(statuses, [BatchStatus::Duplicate; 3]);
    assert_eq!(near_and_far(there).await, [(9, Some(4)); 2]);
    server.kill();
}

#[tokio::test]
async fn tracks_that_do_not_fit_are_told_by_pointer() {
    let app = TestApp::start().await;
    app.lane().await;
    let write = async |transitions| {
        let request = proto::WriteRequest {
            environment: "lane".into(),
            producer: "p".into(),
            batch: Some(proto::Batch {
                sequence: 1,
                transitions: Some(transitions),
                ..proto::Batch::default()
            }),
            ..proto::WriteRequest::default()
        };
        app.ingest().await.write(request).await
    };

    for tracks in [vec![1], vec![1; 3]] {
        let got = tracks.len();
        let columns = proto::Columns {
            count: 2,
            states: vec![0.1, 0.0, 0.1, 0.0],
            actions: vec![0.0; 4],
            tracks,
            ..proto::Columns::default()
        };
        let refused = write(proto::batch::Transitions::Columns(columns)).await;
        let refused = refused.expect_err("another length");
        assert_eq!(refused.code(), tonic::Code::InvalidArgument);
        let told = format!("/columns/tracks: got {got} values, expected 2 for 2 transitions");
        assert!(refused.message().contains(&told), "{}", refused.message());
    }

    let merged = proto::Transition {
        track: Some(1),
        count: Some(2),
        ..row([0.1, 0.0], [0.0, 0.0])
    };
    let rows = proto::Rows {
        transitions: vec![merged],
    };
    let told = write(proto::batch::Transitions::Rows(rows)).await;
    let receipt = told.expect("a batch").into_inner().receipt.expect("there");
    assert_eq!(receipt.status(), BatchStatus::Rejected);
    assert_eq!(receipt.rejected[0].field, "/count");

    let transition = |track: Value, count: u64| {
        json!({
            "state": {"distance": 0.1, "held": 0}, "actions": {"robot": 0, "human": 0},
            "track": track, "count": count,
        })
    };
    let transitions = [
        transition(json!(-1), 1),
        transition(json!(0.5), 1),
        transition(json!("7"), 1),
        transition(json!(7), 2),
        transition(json!(null), 2),
    ];
    let body = json!({"producer": "p", "sequence": 2, "transitions": transitions});
    let path = "/v1/environments/lane/transitions";
    let (status, receipt) = app.rest("POST", path, Some(&body)).await;
    assert_eq!(
        (status, &receipt["accepted"]),
        (200, &json!(1)),
        "{receipt}"
    );
    let rejected = receipt["rejected"].as_array().expect("some").iter();
    let fields: Vec<&Value> = rejected.map(|one| &one["field"]).collect();
    assert_eq!(fields, ["/track", "/track", "/track", "/count"]);
}
