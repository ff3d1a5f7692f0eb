//! Tracks left to the service while everything goes wrong around them: streams that are cut, batches
//! that come again, producers that share numbers of tracks. A model of what docs/protocol.md says
//! tells which flags are to be counted.

use std::collections::HashMap;

use super::*;

/// The rule as the page has it, with nothing forgotten.
#[derive(Default)]
struct Model {
    last: Option<[u32; 2]>,
    counted: HashMap<[u32; 2], u64>,
    now: u64,
    /// Of each agent its action, and when it took it.
    agents: [(Option<u32>, u64); 2],
}

impl Model {
    fn step(&mut self, step: &Record) -> Entry {
        let acts = |agent: usize| step.actions_present.get(agent).copied().unwrap_or(true);
        for (at, (action, changed)) in self.agents.iter_mut().enumerate() {
            let taken = Some(step.actions[at] as u32);
            if acts(at) && taken != *action {
                (*action, *changed) = (taken, self.now);
            }
        }

        let key = [(step.state[0] > 1.0) as u32, step.state[1] as u32];
        let renewed = self.counted.get(&key).is_none_or(|counted| {
            let acting = (0..2).filter(|at| acts(*at));
            acting
                .map(|at| self.agents[at].1)
                .all(|changed| changed > *counted)
        });
        let flag = match step.entry {
            Entry::Unknown if self.last != Some(key) && renewed => Entry::Entered,
            Entry::Unknown => Entry::Stayed,
            told => told,
        };
        if flag == Entry::Entered {
            self.counted.insert(key, self.now);
        }
        (self.last, self.now) = (Some(key), self.now + 1);
        flag
    }
}

/// What a stream knows of its tracks.
#[derive(Default)]
struct Followed(HashMap<u64, Model>);

impl Followed {
    /// Returns the steps of a batch with the flags that are counted, without those that are rejected.
    fn flagged(&mut self, batch: &[Record]) -> Vec<Record> {
        let mut flagged = Vec::new();
        for step in batch {
            let track = step.track.expect("every step has one");
            if step.state[0].is_nan() {
                if let Some(model) = self.0.get_mut(&track) {
                    model.last = None;
                }
                continue;
            }
            flagged.push(Record {
                entry: self.0.entry(track).or_default().step(step),
                track: None,
                ..step.clone()
            });
        }
        flagged
    }
}

/// Makes the batches of a producer: steps of four tracks, whose agents hold what they do, where the
/// human is away, a value has no bin and a flag is sent now and then. Some have no steps at all.
fn made(batches: usize, random: &mut StdRng) -> Vec<Vec<Record>> {
    let mut games = [[0.1, 0.0, 0.0, 0.0]; 4];
    let batch = |_| {
        let steps = random.random_range(0..9_usize).saturating_sub(1);
        let step = |_| {
            let game = random.random_range(0..games.len());
            let now = &mut games[game];
            if random.random_bool(0.5) {
                now[0] = [0.1, 2.0][random.random_range(0..2)];
                now[1] = random.random_range(0..2) as f32;
            }
            for (action, of) in [(2, 2), (3, 3)] {
                if random.random_bool(0.3) {
                    now[action] = random.random_range(0..of) as f32;
                }
            }
            let [distance, held, robot, human] = *now;
            let is_misfit = random.random_bool(0.05);
            let state = vec![if is_misfit { f32::NAN } else { distance }, held];
            Record {
                actions_present: vec![true, random.random_bool(0.8)],
                entry: match random.random_range(0..20) {
                    0 => Entry::Entered,
                    1 => Entry::Stayed,
                    _ => Entry::Unknown,
                },
                track: Some(game as u64),
                ..Record::new(state, vec![robot, human])
            }
        };
        (0..steps).map(step).collect()
    };
    (0..batches).map(batch).collect()
}

fn numbered(batches: &[Vec<Record>], sequence: usize) -> proto::Batch {
    proto::Batch {
        sequence: sequence as u64,
        transitions: Some(rows_of(&batches[sequence - 1])),
        ..proto::Batch::default()
    }
}

/// A producer: its batches, the receipts so far, and what is to be counted of each that was.
struct Sender {
    name: &'static str,
    batches: Vec<Vec<Record>>,
    receipts: HashMap<u64, (u64, u64)>,
    counted: Vec<Record>,
    /// Batches that were sent on the last stream in order, the number of the first that was new to it,
    /// and what it knew of their tracks.
    pending: Vec<(usize, Vec<Record>)>,
}

impl Sender {
    fn new(name: &'static str, random: &mut StdRng) -> Self {
        Self {
            name,
            batches: made(120, random),
            receipts: HashMap::new(),
            counted: Vec::new(),
            pending: Vec::new(),
        }
    }

    /// Takes what the resume point says was counted of the last stream.
    fn settle(&mut self, committed: usize) {
        for (sequence, flagged) in std::mem::take(&mut self.pending) {
            if sequence <= committed {
                self.counted.extend(flagged);
            }
        }
    }

    /// Every receipt of a batch says the same.
    fn check(&mut self, receipts: &[proto::Receipt]) {
        for receipt in receipts {
            let told = (receipt.accepted, receipt.rejected_count);
            let first = self.receipts.entry(receipt.sequence).or_insert(told);
            assert_eq!(told, *first, "{} {}", self.name, receipt.sequence);
        }
    }

    /// Opens a stream, sends some batches again and some anew, and is cut or not. Returns whether all
    /// was sent before.
    async fn stream(&mut self, told: &Told, random: &mut StdRng) -> bool {
        let hello = proto::Hello {
            environment: "attacked".into(),
            ..hello(self.name)
        };
        let opened = RawStream::open(told.app.ingest().await, hello).await;
        let (welcome, stream) = opened.expect("welcome");
        let committed = welcome.committed_sequence as usize;
        self.settle(committed);
        if committed == self.batches.len() {
            return true;
        }

        // What was counted and is sent again at the beginning shows the stream where its tracks are.
        let mut followed = Followed::default();
        let first = committed.saturating_sub(random.random_range(0..4)).max(1);
        let last = (committed + random.random_range(0..20)).min(self.batches.len());
        for sequence in first..=last {
            let sent = stream.send(numbered(&self.batches, sequence)).await;
            sent.expect("open");
            let flagged = followed.flagged(&self.batches[sequence - 1]);
            if sequence > committed {
                self.pending.push((sequence, flagged));
            }
            if random.random_bool(0.2) {
                // In the midst of it that changes nothing.
                let again = random.random_range(first..=sequence);
                let sent = stream.send(numbered(&self.batches, again)).await;
                sent.expect("open");
            }
        }
        if random.random_bool(0.5) {
            let (receipts, end) = stream.finish().await;
            assert_eq!(end.code(), tonic::Code::Ok, "{end}");
            self.check(&receipts);
        }
        false
    }

    /// Counts the next batch by a call of its own, which knows no tracks but its own.
    async fn call(&mut self, told: &Told) {
        let hello = proto::Hello {
            environment: "attacked".into(),
            ..hello(self.name)
        };
        let opened = RawStream::open(told.app.ingest().await, hello).await;
        let committed = opened.expect("welcome").0.committed_sequence as usize;
        self.settle(committed);
        if committed == self.batches.len() {
            return;
        }
        for _ in 0..2 {
            let request = proto::WriteRequest {
                environment: "attacked".into(),
                producer: self.name.into(),
                batch: Some(numbered(&self.batches, committed + 1)),
                ..proto::WriteRequest::default()
            };
            let answer = told.app.ingest().await.write(request).await;
            let receipt = answer.expect("valid").into_inner().receipt;
            self.check(&[receipt.expect("there")]);
        }
        let flagged = Followed::default().flagged(&self.batches[committed]);
        self.counted.extend(flagged);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whatever_becomes_of_streams_each_step_counts_once_with_the_flag_that_the_page_says() {
    let mut random = StdRng::seed_from_u64(23);
    for round in 0..crate::faults::scaled(3, 60) {
        let told = Told::start().await;
        told.make("attacked").await;
        told.make("flagged").await;
        let mut senders = ["a", "b"].map(|name| Sender::new(name, &mut random));
        let mut done = [false; 2];
        while done != [true; 2] {
            let at = random.random_range(0..2);
            if random.random_bool(0.2) {
                senders[at].call(&told).await;
            } else {
                done[at] = senders[at].stream(&told, &mut random).await;
            }
        }

        let flagged: Vec<Record> = senders.iter().flat_map(|one| one.counted.clone()).collect();
        told.stream("flagged", batches(&flagged, BATCH, rows_of))
            .await;
        let (counted, expected) = (
            told.counted("attacked").await,
            told.counted("flagged").await,
        );
        let (visits, drawn) = entries(&expected);
        let drawn = drawn.expect("all are flagged");
        assert!(
            visits > 500 && drawn > 100 && drawn < visits,
            "{drawn} of {visits}"
        );
        assert_eq!(counted, expected, "round {round}");
    }
}

/// A new number with each step, and tracks of which as much as may be is remembered.
#[tokio::test(flavor = "multi_thread")]
async fn a_number_of_a_track_for_each_step_takes_no_memory_to_speak_of() {
    const STEPS: usize = 10_000;
    const BATCHES: u64 = 60;
    let directory = TempDir::new().expect("a temporary directory");
    let server = Server::start(directory.path(), "127.0.0.1:0");
    make_lane(server.address).await;
    let there = channel(server.address).await.expect("it listens");
    let batch = |sequence: u64| proto::Batch {
        sequence,
        transitions: Some(proto::batch::Transitions::Columns(proto::Columns {
            count: STEPS as u32,
            states: [0.1, 0.0].repeat(STEPS),
            actions: [0.0, 2.0].repeat(STEPS),
            tracks: (0..STEPS as u64).map(|at| sequence << 32 | at).collect(),
            ..proto::Columns::default()
        })),
        ..proto::Batch::default()
    };

    // What any load of this size takes, with a track of its own for each batch.
    let plain = (1..=BATCHES / 2).map(|sequence| {
        let mut batch = batch(sequence);
        if let Some(proto::batch::Transitions::Columns(columns)) = &mut batch.transitions {
            columns.tracks = vec![sequence; STEPS];
        }
        batch
    });
    sent(there.clone(), plain.collect()).await;
    let before = most_memory_mib(server.pid());
    sent(
        there.clone(),
        (BATCHES / 2 + 1..=BATCHES).map(batch).collect(),
    )
    .await;
    let after = most_memory_mib(server.pid());
    println!("{before} MiB with few tracks, {after} MiB with one a step");
    assert!(after <= before + 40, "{before} MiB, then {after} MiB");

    let steps = STEPS as u64 * BATCHES / 2;
    let [(visits, drawn), _] = near_and_far(there).await;
    assert_eq!((visits, drawn), (2 * steps, Some(steps + BATCHES / 2)));
    server.kill();
}
