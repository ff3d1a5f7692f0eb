//! The store against a model in memory: random commits, resends, restarts, folds of the journal that
//! anything may interrupt, environments that end and begin again, reads warm and cold.
//!
//! The model knows nothing of merging, caching or SQL: it keeps every batch it accepted and adds up
//! what is asked.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use nudge::domain::{ActionTotals, Digest, Environment, EnvironmentId, Family, Tally};
use nudge::store::{Cursor, Numbered, Outcome, Quotas, Refusal, Store, Totals};
use proptest::prelude::*;
use tokio::sync::oneshot;

use crate::support::batches::*;
use crate::support::databases::{Database, LEFT, SqliteFile, actions_by_scan, number};
use crate::support::raw::LONG;

const PLACES: u32 = 4;
/// Where they are: rows have sixteen neighbours, so the first two share one, and the third is in the
/// midst of [`wide`] ones.
const PLACED: [u32; PLACES as usize] = [0, 1, 16 * 1_200 + 3, 1 << 20];

/// So many further places have rows of their own: a fold of them takes some steps.
const WIDE: u64 = 2_500;

fn wide() -> impl Iterator<Item = u32> {
    (10..).map(|row| 16 * row).take(WIDE as usize)
}

const NAMES: [&str; 2] = ["hallway", "kitchen"];
const PRODUCERS: [&str; 3] = ["a", "b", "c"];
const SEGMENTS: [&str; 3] = ["", "train", "test"];
/// Small enough that a run meets each of them; there may be room for wide batches of one segment.
const QUOTAS: Quotas = Quotas {
    cells: 14,
    segments: 2,
    producers: 2,
    models: 256,
    environments: 1_000,
};

#[derive(Debug, Clone)]
enum Step {
    Commit(Vec<Send>),
    Reopen {
        clean: bool,
    },
    Remake {
        name: usize,
    },
    Read(Vec<u32>),
    /// Steps of what goes on in the background.
    Compact(usize),
    Sweep,
}

#[derive(Debug, Clone)]
struct Send {
    name: usize,
    producer: usize,
    /// How far from the number expected: 0 is the next one, -1 the last one again.
    off: i64,
    reuse: bool,
    segment: usize,
    cells: BTreeMap<(u32, u64), (u64, Option<u64>)>,
    /// Whether it counts a transition in each wide place too.
    is_wide: bool,
}

fn sends() -> impl Strategy<Value = Send> {
    let tally = (1_u64..4, prop::option::weighted(0.8, 0_u64..2));
    let cells = prop::collection::btree_map((0..PLACES, 0_u64..3), tally, 0..5);
    let off = prop_oneof![8 => Just(0_i64), 3 => -4_i64..0, 1 => 1_i64..4];
    (
        0..NAMES.len(),
        0..PRODUCERS.len(),
        off,
        prop::bool::weighted(0.1),
        0..SEGMENTS.len(),
        cells,
        prop::bool::weighted(0.1),
    )
        .prop_map(
            |(name, producer, off, reuse, segment, cells, is_wide)| Send {
                name,
                producer,
                off,
                reuse,
                segment,
                cells,
                is_wide,
            },
        )
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        8 => prop::collection::vec(sends(), 1..6).prop_map(Step::Commit),
        1 => any::<bool>().prop_map(|clean| Step::Reopen { clean }),
        1 => (0..NAMES.len()).prop_map(|name| Step::Remake { name }),
        4 => prop::collection::vec(0..PLACES, 1..4).prop_map(Step::Read),
        6 => (1_usize..4).prop_map(Step::Compact),
        1 => Just(Step::Sweep),
    ];
    prop::collection::vec(step, 1..30)
}

/// One environment of the model: every batch that was accepted, by producer, in order.
#[derive(Default)]
struct World {
    id: Option<EnvironmentId>,
    /// The most cells.
    quota: u64,
    accepted: BTreeMap<String, Vec<Numbered>>,
}

/// A place, a segment, the number of a family and a cell of it.
type CellName = (u32, String, u32, u64);

impl World {
    fn cells(&self) -> BTreeMap<CellName, Tally> {
        let mut cells = BTreeMap::new();
        self.accepted.values().flatten().for_each(|batch| {
            for (name, tally) in named(batch) {
                cells.entry(name).or_insert(Tally::EMPTY).add(tally);
            }
        });
        cells
    }

    /// Returns the segments of the wide batches.
    fn wide(&self) -> Vec<String> {
        let batches = self.accepted.values().flatten();
        batches
            .filter(|batch| is_wide(batch))
            .map(segment)
            .collect()
    }

    /// Returns how many cells there are.
    fn size(&self) -> u64 {
        let segments: BTreeSet<String> = self.wide().into_iter().collect();
        self.cells().len() as u64 + WIDE * segments.len() as u64
    }

    fn actions(&self) -> ActionTotals {
        let mut actions = ActionTotals::new(&schema());
        for _ in self.wide() {
            actions.add(WIDE_ACTION, tally(WIDE, WIDE));
        }
        for ((.., family, cell), tally) in self.cells() {
            match Family::from_number(family) {
                Family::JOINT => actions.add(cell, tally),
                family => actions.add_value(family, cell, tally),
            }
        }
        actions
    }

    fn decide(&mut self, batch: &Numbered) -> Outcome {
        let known = self.accepted.get(batch.producer.as_str());
        let last = known.map_or(0, Vec::len) as u64;
        match batch.sequence.get() {
            sequence if sequence > last + 1 => out_of_order(last + 1),
            sequence if sequence == last + 1 => self.count(batch),
            sequence => {
                let first = &known.expect("it has a last one")[sequence as usize - 1];
                if first.digest == batch.digest {
                    duplicate(first)
                } else {
                    Outcome::Refused(Refusal::Reused)
                }
            }
        }
    }

    fn count(&mut self, batch: &Numbered) -> Outcome {
        if !self.accepted.contains_key(batch.producer.as_str())
            && self.accepted.len() as u64 >= QUOTAS.producers
        {
            return over_quota("producers", QUOTAS.producers);
        }
        let before = self.cells();
        let segments = self.segments();
        let added = named(batch);
        let is_new_segment =
            !batch.increment.cells.is_empty() && !segments.contains(&segment(batch));
        if is_new_segment && segments.len() as u64 >= QUOTAS.segments {
            return over_quota("segments", QUOTAS.segments);
        }
        let fresh = added
            .iter()
            .filter(|(name, _)| !before.contains_key(name))
            .count() as u64;
        let is_new_wide = is_wide(batch) && !self.wide().contains(&segment(batch));
        if self.size() + fresh + WIDE * u64::from(is_new_wide) > self.quota {
            return over_quota("cells", self.quota);
        }
        self.accepted
            .entry(batch.producer.to_string())
            .or_default()
            .push(batch.clone());
        applied(batch)
    }

    fn segments(&self) -> BTreeSet<String> {
        let cells = self.cells().into_keys().map(|(_, segment, ..)| segment);
        cells.chain(self.wide()).collect()
    }

    fn totals(&self) -> Totals {
        let (cells, wide) = (self.cells(), self.wide());
        let states: BTreeSet<u32> = cells.keys().map(|(place, ..)| *place).collect();
        let joint = cells.iter().filter(|((.., family, _), _)| *family == 0);
        let visits: u64 = joint.map(|(_, tally)| tally.n).sum();
        Totals {
            transitions: visits + WIDE * wide.len() as u64,
            states: states.len() as u64 + WIDE * u64::from(!wide.is_empty()),
            cells: self.size(),
            segments: self.segments().len() as u64,
            producers: self.accepted.len() as u64,
        }
    }
}

/// The action that is counted in wide places.
const WIDE_ACTION: u64 = 1;

fn is_wide(batch: &Numbered) -> bool {
    batch.increment.cells.len() as u64 >= WIDE
}

fn segment(batch: &Numbered) -> String {
    let label = batch.increment.segment.as_ref();
    label.map_or(String::new(), ToString::to_string)
}

/// Returns the cells that are in places which are asked about.
fn named(batch: &Numbered) -> Vec<(CellName, Tally)> {
    let segment = segment(batch);
    // The rank of a state of one feature.
    let place = |rank: u64| PLACED.iter().position(|place| u64::from(*place) == rank);
    let mut named = Vec::new();
    for family in batch.increment.families() {
        let name = |(rank, cell, tally): (u64, u64, Tally)| {
            let name = (place(rank)? as u32, segment.clone(), family.number(), cell);
            Some((name, tally))
        };
        named.extend(batch.increment.of_family(family).filter_map(name));
    }
    named
}

/// The store and the model side by side.
struct Pair {
    file: SqliteFile,
    /// `None` only while it is opened again.
    open: Option<Arc<dyn Store>>,
    quotas: Quotas,
    worlds: [World; NAMES.len()],
    /// Makes the content of every batch different.
    sent: u64,
}

impl Pair {
    async fn new(cache_cells: usize, fold_from: usize, quotas: Quotas) -> Self {
        let mut file = SqliteFile::new();
        file.cache_cells = cache_cells;
        file.fold_from = fold_from;
        let store = file.open(quotas).await;
        let mut pair = Self {
            file,
            open: Some(store),
            quotas,
            worlds: Default::default(),
            sent: 0,
        };
        for name in 0..NAMES.len() {
            pair.make(name).await;
        }
        pair
    }

    async fn make(&mut self, name: usize) {
        let made = self
            .store()
            .create(
                &NAMES[name].parse().expect("a name"),
                &schema(),
                &Default::default(),
            )
            .await;
        self.worlds[name] = World {
            id: Some(made.expect("made").id),
            quota: self.quotas.cells,
            ..World::default()
        };
    }

    fn store(&self) -> &dyn Store {
        &**self.open.as_ref().expect("open between steps")
    }

    fn id(&self, name: usize) -> EnvironmentId {
        self.worlds[name].id.expect("made at the start")
    }

    async fn step(&mut self, step: &Step) {
        match step {
            Step::Commit(sends) => self.commit(sends).await,
            Step::Reopen { clean } => {
                if *clean {
                    self.store().close().await;
                }
                self.open = None;
                self.open = Some(self.file.open(self.quotas).await);
            }
            Step::Remake { name } => {
                self.store().delete(self.id(*name)).await.expect("removed");
                self.make(*name).await;
            }
            Step::Read(places) => self.compare_states(places).await,
            Step::Compact(steps) => self.compact(*steps).await,
            Step::Sweep => {
                if self.store().leftovers().environments > 0 {
                    self.store().sweep().await.expect("a step");
                }
            }
        }
    }

    /// Takes some steps, or, where they would begin only once there is more, waits for a moment and
    /// interrupts what there is wherever it stands.
    async fn compact(&self, steps: usize) {
        for _ in 0..steps {
            if self.file.fold_from > 1 {
                let patience = Duration::from_millis(7);
                let step = tokio::time::timeout(patience, self.store().compact()).await;
                step.unwrap_or(Ok(())).expect("a step");
            } else if number(&self.file.path(), LEFT).await > 0 {
                self.store().compact().await.expect("a step");
            }
        }
    }

    /// Numbers are chosen by what the model expects after the batches before, as producers do.
    async fn commit(&mut self, sends: &[Send]) {
        let mut batches = Vec::new();
        let mut expected = Vec::new();
        for send in sends {
            let batch = self.batch(send);
            expected.push(self.worlds[send.name].decide(&batch));
            batches.push(batch);
        }
        assert_eq!(
            self.store().commit(&batches).await.expect("a commit"),
            expected
        );
    }

    fn batch(&mut self, send: &Send) -> Numbered {
        let known = self.worlds[send.name]
            .accepted
            .get(PRODUCERS[send.producer]);
        let last = known.map_or(0, Vec::len) as i64;
        let sequence = (last + 1 + send.off).max(1);
        if let Some(first) = known
            .and_then(|known| known.get(sequence as usize - 1))
            .filter(|_| !send.reuse)
        {
            return first.clone();
        }
        self.sent += 1;
        let mut sending = batch(
            self.id(send.name),
            PRODUCERS[send.producer],
            sequence as u64,
        );
        for ((place, joint), (n, entries)) in &send.cells {
            let entries = entries.map(|entries| entries.min(*n));
            let place = PLACED[*place as usize];
            sending = sending.cell(place, *joint, Tally { n: *n, entries });
        }
        if send.segment > 0 {
            sending = sending.segment(SEGMENTS[send.segment]);
        }
        let mut batch = sending.done();
        if send.is_wide {
            add_wide(&mut batch);
        }
        batch.digest = Digest(*blake3::hash(&self.sent.to_le_bytes()).as_bytes());
        batch
    }

    async fn compare_states(&self, places: &[u32]) {
        for (name, world) in self.worlds.iter().enumerate() {
            let labels = self.labels(name).await;
            let keys: Vec<_> = places
                .iter()
                .map(|place| state_at(PLACED[*place as usize]))
                .collect();
            let found = self
                .store()
                .counts(self.id(name), &keys)
                .await
                .expect("counts");
            let cells = world.cells();
            for (place, found) in places.iter().zip(found) {
                let named = |family: Family, cell: &nudge::domain::Cell| {
                    let label = labels[&cell.segment.0].clone();
                    ((*place, label, family.number(), cell.joint), cell.tally)
                };
                let told = schema().families().flat_map(|family| {
                    let cells = found.counts.of_family(family).iter();
                    cells
                        .map(move |cell| named(family, cell))
                        .collect::<Vec<_>>()
                });
                let expected = cells.iter().filter(|((of, ..), _)| of == place);
                assert_eq!(
                    told.collect::<BTreeMap<_, _>>(),
                    expected.map(|(n, t)| (n.clone(), *t)).collect()
                );
                assert_eq!(found.revision, world.totals().transitions);
            }
            let environment = self.store().environment(NAMES[name]).expect("made");
            assert_eq!(
                *self.store().actions(&environment).await.expect("actions"),
                world.actions()
            );
        }
    }

    async fn labels(&self, name: usize) -> BTreeMap<i64, String> {
        let segments = self
            .store()
            .segments(self.id(name))
            .await
            .expect("segments");
        segments
            .into_iter()
            .map(|(id, label)| (id.0, label.map_or(String::new(), |l| l.to_string())))
            .collect()
    }

    async fn compare_all(&self) {
        self.compare_states(&(0..PLACES).collect::<Vec<_>>()).await;
        for (name, world) in self.worlds.iter().enumerate() {
            let id = self.id(name);
            assert_eq!(
                self.store().totals(id).await.expect("totals"),
                world.totals()
            );
            for producer in PRODUCERS {
                let last = world.accepted.get(producer).map_or(0, Vec::len) as u64;
                let found = self
                    .store()
                    .watermark(id, &producer.parse().expect("a producer"))
                    .await;
                assert_eq!(found.expect("a watermark").get(), last);
            }
            self.compare_scan(id, world).await;
        }
        assert!(
            self.store()
                .audit()
                .await
                .expect("an audit")
                .iter()
                .all(|audit| audit.is_sound())
        );
    }
}

impl Pair {
    /// Compares what a walk over all states finds, page by page.
    async fn compare_scan(&self, id: EnvironmentId, world: &World) {
        // Pages of one state, where there are few.
        let most = if world.wide().is_empty() { 1 } else { 700 };
        let (mut found, mut cursor) = (Totals::default(), Cursor::default());
        loop {
            let page = self.store().scan(id, cursor, most).await.expect("a page");
            for state in &page {
                let cells = state.counts.cells();
                found.states += 1;
                found.cells += state.counts.len() as u64;
                found.transitions += cells.iter().map(|cell| cell.tally.n).sum::<u64>();
            }
            match page.last() {
                Some(last) => cursor = last.cursor,
                None => break,
            }
        }
        let expected = Totals {
            segments: 0,
            producers: 0,
            ..world.totals()
        };
        assert_eq!(found, expected);
    }
}

/// Adds a transition in each wide place.
fn add_wide(batch: &mut Numbered) {
    let increment = &mut batch.increment;
    let cell = |place| (u64::from(place), WIDE_ACTION, tally(1, 1));
    increment.cells.extend(wide().map(cell));
    increment.transitions += WIDE;
    batch.receipt.accepted = increment.transitions;
}

/// Whether there is room for wide batches: quotas are met by small numbers too.
fn quotas() -> impl Strategy<Value = Quotas> {
    let with_room = Quotas {
        cells: QUOTAS.cells + WIDE,
        ..QUOTAS
    };
    prop_oneof![2 => Just(QUOTAS), 1 => Just(with_room)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn the_store_does_what_the_model_does(
        cache_cells in prop_oneof![Just(0), 1_usize..60],
        fold_from in prop_oneof![3 => Just(1_usize), 1 => 2_usize..20],
        quotas in quotas(),
        steps in steps(),
        is_observed: bool,
    ) {
        // A joint action is then up to four cells.
        let quotas = Quotas {
            cells: quotas.cells + if is_observed { 3 * QUOTAS.cells } else { 0 },
            ..quotas
        };
        of_outcomes(is_observed);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(async {
            let mut pair = Pair::new(cache_cells, fold_from, quotas).await;
            for step in &steps {
                pair.step(step).await;
            }
            pair.compare_all().await;
            pair.step(&Step::Reopen { clean: false }).await;
            pair.compare_all().await;
        });
    }
}

/// What is sent, and what readers must find while it is sent.
struct Traffic {
    store: Arc<dyn Store>,
    id: EnvironmentId,
    /// Visits of each state handed to the store, and those it acknowledged.
    sent: [AtomicU64; PLACES as usize],
    acknowledged: [AtomicU64; PLACES as usize],
    /// How often each reader has read.
    reads: [AtomicU64; READERS],
    over: AtomicBool,
}

/// Readers beside a writer, and how often each reads at least before it ends.
const READERS: usize = 4;
const ENOUGH: u64 = 10;

impl Traffic {
    async fn write(&self, commits: u64) {
        for sequence in 1..=commits {
            // Everybody has read something before the last half, however busy the machine is.
            if sequence == commits / 2 {
                let all = async {
                    while self.reads.iter().any(|reads| load(reads) < ENOUGH) {
                        tokio::task::yield_now().await;
                    }
                };
                tokio::time::timeout(LONG, all)
                    .await
                    .expect("all readers read");
            }
            let places = (0..PLACES).filter(|place| (sequence >> place) & 1 == 1);
            let one = |sending: Sending, place| sending.cell(place, sequence % 3, tally(1, 1));
            let next = places
                .clone()
                .fold(batch(self.id, "game", sequence), one)
                .done();
            places
                .clone()
                .for_each(|place| add(&self.sent[place as usize]));
            assert_eq!(
                self.store
                    .commit(std::slice::from_ref(&next))
                    .await
                    .expect("a commit"),
                [applied(&next)]
            );
            places.for_each(|place| add(&self.acknowledged[place as usize]));
        }
        self.over.store(true, Ordering::SeqCst);
    }

    /// Reads one state, or several, until the writer is done.
    async fn read_states(&self, reader: usize, places: Vec<u32>) {
        let keys: Vec<_> = places.iter().map(|place| state_at(*place)).collect();
        let mut seen = vec![(0, 0); places.len()];
        while !self.over.load(Ordering::SeqCst) {
            let before: Vec<u64> = places
                .iter()
                .map(|place| load(&self.acknowledged[*place as usize]))
                .collect();
            let found = self.store.counts(self.id, &keys).await.expect("counts");
            for (at, found) in found.iter().enumerate() {
                let visits = found
                    .counts
                    .cells()
                    .iter()
                    .map(|cell| cell.tally.n)
                    .sum::<u64>();
                assert!(
                    visits >= before[at],
                    "an acknowledged batch is missing: {visits} of {}",
                    before[at]
                );
                assert!(
                    visits <= load(&self.sent[places[at] as usize]),
                    "more than was sent"
                );
                assert!(
                    (visits, found.revision) >= seen[at] && found.revision >= seen[at].1,
                    "back in time"
                );
                seen[at] = (visits, found.revision);
            }
            add(&self.reads[reader]);
            // A read from the cache never waits, and would keep the other readers from their turn.
            tokio::task::yield_now().await;
        }
    }
}

fn add(number: &AtomicU64) {
    number.fetch_add(1, Ordering::SeqCst);
}

fn load(number: &AtomicU64) -> u64 {
    number.load(Ordering::SeqCst)
}

/// Runs one writer beside readers of overlapping states.
async fn readers_beside_a_writer(mut file: SqliteFile, cache_cells: usize) {
    file.cache_cells = cache_cells;
    let store = file.open(Quotas::default()).await;
    let id = store
        .create(
            &"hallway".parse().expect("a name"),
            &schema(),
            &Default::default(),
        )
        .await
        .expect("made")
        .id;
    let over = AtomicBool::new(false);
    let traffic = Arc::new(Traffic {
        store,
        id,
        sent: Default::default(),
        acknowledged: Default::default(),
        reads: Default::default(),
        over,
    });
    let places: [Vec<u32>; READERS] = [vec![0], vec![1, 2], vec![0, 1, 2, 3], vec![3]];
    let reading: Vec<_> = (0..)
        .zip(places)
        .map(|(reader, places)| {
            let traffic = Arc::clone(&traffic);
            tokio::spawn(async move { traffic.read_states(reader, places).await })
        })
        .collect();
    traffic.write(1_000).await;
    for reader in reading {
        reader.await.expect("no assertion failed");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn readers_never_see_a_state_go_back_with_a_warm_cache() {
    readers_beside_a_writer(SqliteFile::new(), 10_000).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn readers_never_see_a_state_go_back_with_hardly_a_cache() {
    readers_beside_a_writer(SqliteFile::new(), 20).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn readers_never_see_a_state_go_back_beside_folds() {
    readers_beside_a_writer(SqliteFile::compacted(), 0).await;
}

/// Asks for the actions until the writer is done, and says when it has had the first answer.
async fn ask(
    store: Arc<dyn Store>,
    environment: Arc<Environment>,
    acknowledged: Arc<AtomicU64>,
    last: u64,
    first: oneshot::Sender<()>,
) {
    let (mut first, mut seen) = (Some(first), 0);
    while seen < last {
        let before = load(&acknowledged);
        let actions = store.actions(&environment).await.expect("actions");
        assert!(
            actions.revision >= before.max(seen),
            "an acknowledged batch is missing, or back in time"
        );
        for agent in [0, 1] {
            assert_eq!(
                actions.draws(agent).iter().sum::<u64>(),
                actions.revision,
                "missed or doubled"
            );
        }
        seen = actions.revision;
        let _ = first.take().map(|first| first.send(()));
        tokio::task::yield_now().await;
    }
}

/// Each round opens the store anew, so that its first questions read every state while commits go
/// on.
#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn actions_are_read_while_commits_go_on() {
    const STATES: u32 = 4_000;
    const COMMITS: u64 = 60;
    let file = SqliteFile::new();
    let store = file.open(Quotas::default()).await;
    let made = store
        .create(
            &"hallway".parse().expect("a name"),
            &schema(),
            &Default::default(),
        )
        .await;
    let id = made.expect("made").id;
    let first = (0..STATES).fold(batch(id, "base", 1), |sending, place| {
        sending.cell(place, 5, tally(1, 1))
    });
    store.commit(&[first.done()]).await.expect("a commit");
    store.close().await;
    drop(store);

    for round in 0..6 {
        let store = file.open(Quotas::default()).await;
        let environment = store.environment("hallway").expect("made");
        let counted = u64::from(STATES) + round * COMMITS;
        let acknowledged = Arc::new(AtomicU64::new(counted));
        let (first, answered): (Vec<_>, Vec<_>) = (0..3).map(|_| oneshot::channel()).unzip();
        let asking: Vec<_> = first
            .into_iter()
            .map(|first| {
                let (store, environment) = (Arc::clone(&store), Arc::clone(&environment));
                tokio::spawn(ask(
                    store,
                    environment,
                    Arc::clone(&acknowledged),
                    counted + COMMITS,
                    first,
                ))
            })
            .collect();
        let mut answered = Some(answered);
        for sequence in round * COMMITS + 1..=(round + 1) * COMMITS {
            if sequence == (round + 1) * COMMITS {
                // Everybody has had an answer before the last commit, however busy the machine is,
                // and has another one after it.
                for answered in answered.take().into_iter().flatten() {
                    answered.await.expect("no assertion failed");
                }
            }
            let next = batch(id, "game", sequence)
                .cell(sequence as u32 % 7, sequence % 1_500, tally(1, 1))
                .done();
            assert_eq!(
                store
                    .commit(std::slice::from_ref(&next))
                    .await
                    .expect("a commit"),
                [applied(&next)]
            );
            add(&acknowledged);
        }
        for asking in asking {
            asking.await.expect("no assertion failed");
        }
        let expected = actions_by_scan(&*store, &environment).await;
        assert_eq!(
            *store.actions(&environment).await.expect("actions"),
            expected
        );
        store.close().await;
    }
}
