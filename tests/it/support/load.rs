//! A load generator: producers that keep a service busy, and know what it owes them: the batches
//! that they send are always the same, so what must be counted follows from how far each of them
//! is.

use std::collections::{BTreeMap, HashMap};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bytes::Bytes;
use nudge::api::proto::environment_service_client::EnvironmentServiceClient;
use nudge::api::proto::ingest_service_client::IngestServiceClient;
use nudge::api::proto::{self, ingest_request, ingest_response};
use nudge::domain::{Presence, Values};
use nudge::store::{Cursor, Options, SqliteStore, Store};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use tokio::task::JoinHandle;

use super::{RawStream, channel, hello, lane_schema, reason};

/// Visits by state, segment, the number of a family and a cell of it.
pub type Cells = BTreeMap<(String, String, u32, u64), u64>;

/// What producers send.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Transitions of a batch.
    pub rows: usize,
    /// Different batches of a producer, which then begins again.
    pub contents: u64,
    /// Segments, taken in turn: the more, the more pages change.
    pub segments: u64,
    /// The most batches of a stream without acknowledgement.
    pub in_flight: u64,
    /// Whether the human is absent now and then, and what is observed later is sent.
    pub observed: bool,
}

impl Shape {
    /// Small batches, many on the way.
    pub const SMALL: Self = Self {
        rows: 40,
        contents: 64,
        segments: 8,
        in_flight: 32,
        observed: true,
    };
}

/// How a producer speaks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Voice {
    /// A gRPC stream.
    Stream,
    /// A gRPC stream of a producer that forgets its id at every reconnect: the watermark cannot
    /// help.
    Forgetful,
    /// A REST call a batch.
    Rest,
}

/// What a batch holds, and what it counts.
struct Content {
    columns: proto::Columns,
    segment: String,
    cells: Cells,
}

impl Content {
    fn new(shape: Shape, producer: u64, number: u64) -> Self {
        let mut random = StdRng::seed_from_u64(producer << 32 | number);
        let segment = format!("t{}", number % shape.segments);
        let mut columns = proto::Columns {
            count: shape.rows as u32,
            ..Default::default()
        };
        // By number first: names of a million rows would take longer than what is tested.
        let mut counted = BTreeMap::new();
        let mut count = |state: (usize, u32), family: u32, cell: u32| {
            *counted.entry((state, family, cell)).or_default() += 1;
        };
        let (mut acted, mut outcomes, mut seen) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..shape.rows {
            let state = (
                random.random_range(0..4_usize),
                random.random_range(0..2_u32),
            );
            let (robot, human) = (random.random_range(0..2_u32), random.random_range(0..3_u32));
            let distance = [0.1, 0.6, 0.8, 2.0][state.0];
            columns.states.extend([distance, state.1 as f32]);

            let absent = shape.observed && random.random_range(0..8) == 0;
            let letter = if absent { 3 } else { human };
            columns
                .actions
                .extend([robot as f32, if absent { 0.0 } else { human as f32 }]);
            acted.extend([true, !absent]);
            count(state, 0, robot * 4 + letter);

            // What the human does one and two steps later, and what is in the pot then.
            let values = [3, 3, 2];
            let later = values.map(|values| random.random_range(0..=values));
            let has = [0, 1, 2].map(|at| later[at] < values[at]);
            for (value, has) in later.iter().zip(has) {
                outcomes.push(if has { *value as f32 } else { 0.0 });
                seen.push(has);
            }
            if !shape.observed {
                continue;
            }
            if has[0] {
                count(state, 1, (robot * 4 + letter) * 3 + later[0]);
            }
            if has[1] {
                // Beside the action one step later, or the absence that is known by its lack.
                let before = if has[0] { later[0] } else { 3 };
                count(state, 2, (robot * 4 + before) * 3 + later[1]);
            }
            if has[2] {
                count(state, 3, (robot * 4 + letter) * 2 + later[2]);
            }
        }
        if shape.observed {
            columns.actions_present = Presence::of(acted).bits().clone();
            columns.outcomes_le = Values::from(outcomes).into_le_bytes();
            columns.outcomes_present = Presence::of(seen).bits().clone();
        }

        let named = |(((distance, held), family, cell), n)| {
            let key = format!("{distance}.{held}");
            ((key, segment.clone(), family, u64::from(cell)), n)
        };
        let cells = counted.into_iter().map(named).collect();
        Self {
            columns,
            segment,
            cells,
        }
    }

    fn batch(&self, sequence: u64) -> proto::Batch {
        let transitions = Some(proto::batch::Transitions::Columns(self.columns.clone()));
        proto::Batch {
            sequence,
            segment: self.segment.clone(),
            transitions,
        }
    }

    fn json(&self, producer: &str, sequence: u64) -> Value {
        let columns = &self.columns;
        let rows = columns.states.chunks(2).zip(columns.actions.chunks(2));
        let outcomes = Values::from_le(columns.outcomes_le.clone()).expect("whole");
        let bits = |bits: &Bytes, slots: usize| {
            let slots = slots * columns.count as usize;
            Presence::from_bits(bits.clone(), slots).expect("as many")
        };
        let acted = bits(&columns.actions_present, 2);
        let seen = bits(&columns.outcomes_present, 3);
        let transition = |(at, (state, actions)): (usize, (&[f32], &[f32]))| {
            let human = acted.has(2 * at + 1).then_some(actions[1] as u32);
            let mut observed = serde_json::Map::new();
            for (slot, name) in ["human@1", "human@2", "pot"].into_iter().enumerate() {
                if !outcomes.is_empty() && seen.has(3 * at + slot) {
                    let value = outcomes.at(3 * at + slot, 1).next();
                    observed.insert(name.into(), json!(value.expect("there") as u32));
                }
            }
            json!({
                "state": {"distance": state[0], "held": state[1] as u32},
                "actions": {"robot": actions[0] as u32, "human": human},
                "outcomes": observed,
            })
        };
        let transitions: Vec<Value> = rows.enumerate().map(transition).collect();
        json!({"producer": producer, "sequence": sequence, "segment": self.segment, "transitions": transitions})
    }
}

/// The different batches of one producer.
struct Contents(Vec<Content>);

impl Contents {
    fn of_producer(shape: Shape, producer: u64) -> Self {
        Self(
            (0..shape.contents)
                .map(|number| Content::new(shape, producer, number))
                .collect(),
        )
    }

    fn at(&self, sequence: u64) -> &Content {
        &self.0[(sequence % self.0.len() as u64) as usize]
    }
}

/// Returns what must be counted where each producer was committed so far.
pub fn expected(shape: Shape, committed: &[u64]) -> Cells {
    let mut expected = Cells::new();
    for (producer, committed) in (0..).zip(committed) {
        let contents = Contents::of_producer(shape, producer);
        for (number, content) in (0..).zip(&contents.0) {
            // Sequences begin at 1.
            let times = committed / shape.contents
                + u64::from((1..=committed % shape.contents).contains(&number));
            for (cell, n) in content.cells.iter().filter(|_| times > 0) {
                *expected.entry(cell.clone()).or_default() += n * times;
            }
        }
    }
    expected
}

/// Makes the environment that producers send to: the lane, whose human may be absent, with what is
/// observed later.
pub async fn make_lane(address: SocketAddr) {
    let mut client =
        EnvironmentServiceClient::new(channel(address).await.expect("the server listens"));
    let mut schema = lane_schema();
    schema.agents[1].may_be_absent = true;
    let pot = schema.state[1].clone();
    let action = |lag| proto::Outcome {
        agent: "human".into(),
        lag,
        ..proto::Outcome::default()
    };
    let pot = proto::Outcome {
        name: "pot".into(),
        lag: 1,
        value: vec![pot],
        ..proto::Outcome::default()
    };
    schema.outcomes = vec![action(1), action(2), pot];
    let request = proto::ApplyEnvironmentRequest {
        name: "lane".into(),
        schema: Some(schema),
        rule: None,
        derived: None,
    };
    client.apply_environment(request).await.expect("valid");
}

/// What producers share.
struct Shared {
    address: SocketAddr,
    shape: Shape,
    stop: AtomicBool,
    /// How far each producer is known to be.
    acknowledged: Vec<AtomicU64>,
    /// How often which refusal came.
    refusals: Mutex<HashMap<String, u64>>,
    /// What watches each acknowledgement: the producer, and how far it is.
    told: Box<dyn Fn(usize, u64) + Send + Sync>,
}

impl Shared {
    fn stopping(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    fn acknowledged(&self, producer: u64) -> u64 {
        self.acknowledged[producer as usize].load(Ordering::SeqCst)
    }

    fn acknowledge(&self, producer: u64, sequence: u64) {
        self.acknowledged[producer as usize].store(sequence, Ordering::SeqCst);
        (self.told)(producer as usize, sequence);
    }

    fn refused(&self, refusal: String) {
        *self
            .refusals
            .lock()
            .expect("no panic")
            .entry(refusal)
            .or_default() += 1;
    }
}

/// Producers at work. Dropped, they stop where they are.
pub struct Load {
    shared: Arc<Shared>,
    tasks: Vec<JoinHandle<()>>,
}

impl Load {
    /// Starts producers, a voice each.
    pub fn start(address: SocketAddr, shape: Shape, voices: &[Voice]) -> Self {
        Self::observed(address, shape, voices, |_, _| ())
    }

    /// Starts producers whose acknowledgements are watched.
    pub fn observed(
        address: SocketAddr,
        shape: Shape,
        voices: &[Voice],
        told: impl Fn(usize, u64) + Send + Sync + 'static,
    ) -> Self {
        let shared = Arc::new(Shared {
            address,
            shape,
            stop: AtomicBool::new(false),
            acknowledged: voices.iter().map(|_| AtomicU64::new(0)).collect(),
            refusals: Mutex::default(),
            told: Box::new(told),
        });
        let producer =
            |(number, voice): (u64, &Voice)| tokio::spawn(run(shared.clone(), number, *voice));
        let tasks = (0..).zip(voices).map(producer).collect();
        Self { shared, tasks }
    }

    /// Returns how far each producer is known to be.
    pub fn acknowledged(&self) -> Vec<u64> {
        self.shared
            .acknowledged
            .iter()
            .map(|known| known.load(Ordering::SeqCst))
            .collect()
    }

    /// Returns how often which refusal came, and forgets them.
    pub fn refusals(&self) -> HashMap<String, u64> {
        std::mem::take(&mut self.shared.refusals.lock().expect("no panic"))
    }

    /// Waits until so many more batches are acknowledged.
    pub async fn progress(&self, batches: u64) {
        let so_far = || self.acknowledged().iter().sum::<u64>();
        let goal = so_far() + batches;
        let late = Instant::now() + Duration::from_secs(60);
        while so_far() < goal {
            assert!(
                Instant::now() < late,
                "no progress in a minute: {:?} {:?}",
                self.acknowledged(),
                self.refusals()
            );
            assert!(
                self.tasks.iter().all(|task| !task.is_finished()),
                "a producer gave up"
            );
            tokio::time::sleep(Duration::from_millis(1)).await;
        }
    }

    /// Waits until everything that was sent is acknowledged, and returns how far each producer is.
    pub async fn finish(mut self) -> Vec<u64> {
        self.shared.stop.store(true, Ordering::SeqCst);
        for task in self.tasks.drain(..) {
            let ended = tokio::time::timeout(Duration::from_secs(60), task).await;
            ended
                .expect("what was sent is answered")
                .expect("no producer panics");
        }
        self.acknowledged()
    }

    /// Leaves what is on the way alone, and returns how far each producer knows to be.
    pub async fn abandon(mut self) -> Vec<u64> {
        for task in self.tasks.drain(..) {
            task.abort();
            if let Err(error) = task.await {
                assert!(
                    error.is_cancelled(),
                    "a producer saw what must not be: {error}"
                );
            }
        }
        self.acknowledged()
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
    }
}

async fn run(shared: Arc<Shared>, producer: u64, voice: Voice) {
    let contents = Contents::of_producer(shared.shape, producer);
    for connection in 1_u64.. {
        // A broken conversation leaves batches of which nobody knows; only one that ended well says
        // how far this producer is.
        let ended = match voice {
            Voice::Rest => post(&shared, producer, &contents).await,
            Voice::Stream => stream(&shared, producer, &contents, &format!("p{producer}"), 0).await,
            Voice::Forgetful => {
                let name = format!("p{producer}-{connection}");
                stream(
                    &shared,
                    producer,
                    &contents,
                    &name,
                    shared.acknowledged(producer),
                )
                .await
            }
        };
        match ended {
            Ok(()) => return,
            Err(refusal) => shared.refused(refusal),
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

fn worded(status: &tonic::Status) -> String {
    format!(
        "{:?} {}: {}",
        status.code(),
        reason(status),
        status.message()
    )
}

/// Sends until the connection breaks or the load stops. A producer numbers its batches from 1 under
/// the name that it gives; `offset` maps those numbers to this load's own.
async fn stream(
    shared: &Shared,
    producer: u64,
    contents: &Contents,
    name: &str,
    offset: u64,
) -> Result<(), String> {
    let channel = channel(shared.address)
        .await
        .map_err(|error| format!("no connection: {error}"))?;
    let opened = RawStream::open(IngestServiceClient::new(channel), hello(name)).await;
    let (welcome, stream) = opened.map_err(|status| worded(&status))?;
    let known = shared.acknowledged(producer);
    let committed = welcome.committed_sequence + offset;
    assert!(
        committed >= known,
        "acknowledged {known} and forgot it: {committed}"
    );
    shared.acknowledge(producer, committed);

    let (requests, mut responses) = stream.split();
    let mut next = committed + 1;
    while !shared.stopping() || next > shared.acknowledged(producer) + 1 {
        while next <= shared.acknowledged(producer) + shared.shape.in_flight && !shared.stopping() {
            let message = Some(ingest_request::Message::Batch(
                contents.at(next).batch(next - offset),
            ));
            // Where nobody reads any more, the answer says why.
            let _ = requests.send(proto::IngestRequest { message }).await;
            next += 1;
        }
        if next == shared.acknowledged(producer) + 1 {
            continue;
        }
        let response = responses
            .message()
            .await
            .map_err(|status| worded(&status))?;
        match response.ok_or("the stream ended")?.message {
            Some(ingest_response::Message::Acknowledgement(told)) => {
                shared.acknowledge(producer, told.committed_sequence + offset);
            }
            other => panic!("expected an acknowledgement, got {other:?}"),
        }
    }
    Ok(())
}

/// Posts a batch after the other until one is refused or the load stops.
async fn post(shared: &Shared, producer: u64, contents: &Contents) -> Result<(), String> {
    let url = format!("http://{}/v1/environments/lane/transitions", shared.address);
    let client = reqwest::Client::new();
    while !shared.stopping() {
        let sequence = shared.acknowledged(producer) + 1;
        let body = contents
            .at(sequence)
            .json(&format!("p{producer}"), sequence);
        let response = client
            .post(&url)
            .json(&body)
            .send()
            .await
            .map_err(|error| format!("no answer: {error}"))?;
        let status = response.status().as_u16();
        let answer: Value = response
            .json()
            .await
            .map_err(|error| format!("half an answer: {error}"))?;
        if status != 200 {
            return Err(format!(
                "{status} {}: {}",
                answer["reason"], answer["detail"]
            ));
        }
        assert_eq!(answer["accepted"], shared.shape.rows, "{answer}");
        shared.acknowledge(producer, sequence);
    }
    Ok(())
}

/// What a database holds of the lane.
pub struct Held {
    /// How far each producer is.
    pub committed: Vec<u64>,
    /// What was counted.
    pub cells: Cells,
}

/// Reads a database as a start of the service does, and audits it; nothing where the lane is not
/// there.
pub async fn read_held(directory: &Path, producers: usize) -> Option<Held> {
    let opened = SqliteStore::open(&directory.join("nudge.db"), Options::default()).await;
    let store = opened.expect("what a fault left can be opened");
    let environment = store.environment("lane")?;
    let audits = store.audit().await.expect("read");
    assert!(audits.iter().all(|audit| audit.is_sound()), "{audits:?}");

    let mut committed = Vec::new();
    for producer in 0..producers {
        let name = format!("p{producer}").parse().expect("a producer id");
        committed.push(
            store
                .watermark(environment.id, &name)
                .await
                .expect("read")
                .get(),
        );
    }
    let segments: HashMap<_, _> = store
        .segments(environment.id)
        .await
        .expect("read")
        .into_iter()
        .collect();
    let mut cells = Cells::new();
    for state in store
        .scan(environment.id, Cursor::default(), 1_000)
        .await
        .expect("read")
    {
        for family in environment.schema.families() {
            for cell in state.counts.of_family(family) {
                let segment = segments[&cell.segment]
                    .as_ref()
                    .map_or(String::new(), ToString::to_string);
                let key = (state.key.to_string(), segment, family.number(), cell.joint);
                cells.insert(key, cell.tally.n);
            }
        }
    }
    store.close().await;
    Some(Held { committed, cells })
}

/// Checks that a database holds everything that was acknowledged, and each batch once or not at
/// all; returns how many transitions it holds.
pub async fn assert_exactly_once(directory: &Path, shape: Shape, acknowledged: &[u64]) -> u64 {
    let held = read_held(directory, acknowledged.len())
        .await
        .expect("an environment that was made stays");
    for (producer, (committed, acknowledged)) in held.committed.iter().zip(acknowledged).enumerate()
    {
        assert!(
            committed >= acknowledged,
            "p{producer}: {acknowledged} were acknowledged, {committed} are there"
        );
    }
    assert_eq!(
        held.cells,
        expected(shape, &held.committed),
        "every batch once: {:?}",
        held.committed
    );
    transitions(&held.cells)
}

/// Returns how many transitions cells are of: those of outcomes say some of them again.
pub fn transitions(cells: &Cells) -> u64 {
    let joint = cells.iter().filter(|((.., family, _), _)| *family == 0);
    joint.map(|(_, n)| n).sum()
}
