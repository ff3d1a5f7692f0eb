//! Folds of the journal into rows, and moves of what an earlier build counted: the process dies at
//! any step to the disk, or the disk fails there, or is full; and kills at random times under a
//! load that is folded all the time.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use nudge::domain::EnvironmentId;
use nudge::store::{Cursor, Options, Store};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use reqwest::Client;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::deaths::some_of;
use super::disk::{CHANGES, DEATH, Disk, EIO, ENOSPC, FOR_EVER};
use super::{asked, eventually, settled};
use crate::server::Server;
use crate::support::batches::{filled, schema, tally};
use crate::support::databases::{LEFT, compact_all, execute, number};
use crate::support::open;

/// Rows of sixteen states that are written: a fold of all of them takes some slices.
const ROWS: u32 = 3_000;

/// Rows that producers send to: so many that each fold of theirs takes some slices.
const MOST_ROWS: u32 = 40_000;

/// What an environment counted: visits of each place.
type Visits = BTreeMap<u32, u64>;

fn place(row: u32) -> u32 {
    16 * row + row % 3
}

/// A database with rows, and with counts that are to be put into them.
struct Prepared {
    directory: TempDir,
    visits: Visits,
}

impl Prepared {
    /// Makes one with a journal that has something for each row, and for some that are not there.
    async fn journaled() -> Self {
        let directory = TempDir::new().expect("a temporary directory");
        let mut prepared = Self {
            directory,
            visits: Visits::new(),
        };
        let path = prepared.path();
        prepared.count(1, 0..ROWS).await;
        compact_all(&path, Options::default()).await;
        prepared.count(2, 0..ROWS).await;
        prepared.count(3, ROWS - 500..ROWS + 500).await;
        prepared
    }

    /// Makes one that an earlier build left, but for the journal.
    async fn unmoved() -> Self {
        let mut prepared = Self::journaled().await;
        let path = prepared.path();
        compact_all(&path, Options::default()).await;
        prepared.put_into_old_tables().await;
        prepared.count(4, ROWS..ROWS + 500).await;
        prepared
    }

    fn path(&self) -> std::path::PathBuf {
        self.directory.path().join("nudge.db")
    }

    async fn count(&mut self, sequence: u64, rows: std::ops::Range<u32>) {
        let store = open(self.directory.path(), Options::default()).await;
        let name = "wide".parse().expect("a name");
        let id = match store.environment("wide") {
            Some(environment) => environment.id,
            None => {
                let made = store.create(&name, &schema(), &Default::default()).await;
                made.expect("made").id
            }
        };
        let batch = filled(id, "p0", sequence, rows.clone().map(place));
        store.commit(&[batch]).await.expect("a commit");
        store.close().await;
        rows.for_each(|row| *self.visits.entry(place(row)).or_default() += 1);
    }

    /// Writes what is in rows as the builds before did: a row a state, and a row a cell.
    async fn put_into_old_tables(&self) {
        let mut cells =
            String::from("insert into cells (state, segment, joint, n, entries) values ");
        let mut states = String::from("insert into states (id, environment, key) values ");
        for (id, (place, visits)) in (1..).zip(&self.visits) {
            let comma = if id == 1 { "" } else { ", " };
            states.push_str(&format!("{comma}({id}, 1, '{place}')"));
            cells.push_str(&format!("{comma}({id}, 1, 1, {visits}, {visits})"));
        }
        let rest = "delete from packed; update totals set unmoved = 1";
        let sql = format!("{states}; {cells}; {rest}");
        execute(&self.path(), sql.leak()).await;
    }
}

/// Starts a service that puts what is counted into rows from so many cells on.
fn command(directory: &Path, fold_cells: usize) -> std::process::Command {
    let mut command = Server::command(directory, "127.0.0.1:0");
    command.env("NUDGE_FOLD_CELLS", fold_cells.to_string());
    command
}

async fn left(directory: &Path) -> i64 {
    number(&directory.join("nudge.db"), LEFT).await
}

/// Returns whether a fold or a move has begun and not ended.
async fn is_half_way(directory: &Path) -> bool {
    let sql = "select (select count(*) from totals where fold_row is not null)
        + (select count(*) from totals where unmoved and exists (select 1 from packed))";
    number(&directory.join("nudge.db"), sql).await > 0
}

/// Checks that a database has counted just this, as it is and once all of it is in rows.
async fn assert_counted(directory: &Path, visits: &Visits) {
    let path = directory.join("nudge.db");
    for is_compacted in [false, true] {
        if is_compacted {
            compact_all(&path, Options::default()).await;
        }
        let store = open(directory, Options::default()).await;
        let audits = store.audit().await.expect("read");
        assert!(audits.iter().all(|audit| audit.is_sound()), "{audits:?}");
        let id = store.environment("wide").expect("it stays").id;
        let totals = store.totals(id).await.expect("totals");
        let sum: u64 = visits.values().sum();
        assert_eq!(
            (totals.transitions, totals.states, totals.cells),
            (sum, visits.len() as u64, visits.len() as u64)
        );
        let (mut found, mut cursor) = (Visits::new(), Cursor::default());
        loop {
            let page = store.scan(id, cursor, 1_000).await.expect("read");
            for state in &page {
                let n = state.counts.cells().iter().map(|cell| cell.tally.n).sum();
                found.insert(state.key.bins()[0], n);
            }
            match page.last() {
                Some(last) => cursor = last.cursor,
                None => break,
            }
        }
        assert!(found == *visits, "every transition once");
        store.close().await;
    }
}

/// Lets a service die at some steps of what it does with a database in the background.
async fn dies_at_any_step(what: &str, prepared: &Prepared) {
    let whole = Disk::holding(&prepared.path());
    whole.count(CHANGES);
    let server = settled(whole.under(&mut command(whole.path(), 1))).await;
    let server = server.expect("it starts");
    eventually("all is in rows", async || left(whole.path()).await == 0).await;
    let steps = whole.seen();
    server.kill();
    assert_counted(whole.path(), &prepared.visits).await;
    assert!(steps > 20, "{what}: {steps}");

    let (mut deaths, mut half_way) = (0, 0);
    for step in some_of(steps, 12) {
        let disk = Disk::holding(&prepared.path());
        for step in [step, step / 2] {
            disk.fail(CHANGES, step, FOR_EVER, DEATH);
            let started = settled(disk.under(&mut command(disk.path(), 1))).await;
            if let Some(mut server) = started {
                eventually("it dies or is done", async || {
                    server.ended_within(Duration::ZERO).await.is_some()
                        || left(disk.path()).await == 0
                })
                .await;
            }
            disk.mend();
            deaths += u64::from(disk.failed() > 0);
            half_way += u64::from(is_half_way(disk.path()).await);
        }
        assert_counted(disk.path(), &prepared.visits).await;
    }
    assert!(deaths > 8 && half_way > 0, "{what}: {deaths}, {half_way}");
    println!("{what}: {steps} steps, {deaths} deaths, {half_way} half way");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fold_that_is_killed_at_any_step_goes_on_at_the_next_start() {
    dies_at_any_step("a fold", &Prepared::journaled().await).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_move_that_is_killed_at_any_step_goes_on_at_the_next_start() {
    dies_at_any_step("a move", &Prepared::unmoved().await).await;
}

fn transitions(rows: impl Iterator<Item = u32>) -> Vec<Value> {
    rows.map(|row| json!({"state": {"place": place(row)}, "actions": {"robot": 0, "human": 1}}))
        .collect()
}

/// Sends a batch; returns whether it was acknowledged.
async fn send(address: SocketAddr, producer: &str, sequence: u64, rows: &[u32]) -> bool {
    let transitions = transitions(rows.iter().copied());
    let body = json!({"producer": producer, "sequence": sequence, "transitions": transitions});
    let url = format!("http://{address}/v1/environments/wide/transitions");
    let Ok(sent) = reqwest::Client::new().post(url).json(&body).send().await else {
        return false;
    };
    assert!(
        [200, 503].contains(&sent.status().as_u16()),
        "{}",
        sent.status()
    );
    sent.status() == 200
}

/// Sends it until it is.
async fn send_until_acknowledged(address: SocketAddr, producer: &str, sequence: u64, rows: &[u32]) {
    eventually("it is acknowledged", async || {
        send(address, producer, sequence, rows).await
    })
    .await;
}

/// The rows of the batch that lets the journal be folded.
const LAST: std::ops::Range<u32> = ROWS + 200..ROWS + 900;

/// Starts a service that will fold the journal once it has the last batch.
async fn waits_for_the_last(disk: &Disk) -> Server {
    let server = settled(disk.under(&mut command(disk.path(), 4_500))).await;
    server.expect("it starts")
}

/// Fails calls to the disk from the Nth after a batch is sent on, whose cells let the journal be
/// folded: its entry, the slices with their marker, the removal of entries; returns how many calls
/// failed.
async fn survives(prepared: &Prepared, pass: u64, failures: u64, errno: u64) -> u64 {
    let disk = Disk::holding(&prepared.path());
    let server = waits_for_the_last(&disk).await;
    let last: Vec<u32> = LAST.collect();
    disk.fail(CHANGES, pass, failures, errno);
    let sending = async {
        send_until_acknowledged(server.address, "last", 1, &last).await;
    };
    let mending = async {
        eventually("it fails or is done", async || {
            disk.failed() >= failures.min(3) || left(disk.path()).await == 0
        })
        .await;
        assert_eq!(asked(server.address, "/livez").await.0, 200);
        let (status, told) = asked(server.address, "/v1/environments/wide/states/16033").await;
        assert_eq!(status, 200, "what was counted is answered: {told}");
        disk.mend();
    };
    tokio::join!(sending, mending);
    let failed = disk.failed();
    eventually("all is in rows", async || left(disk.path()).await == 0).await;
    server.kill();
    let mut visits = prepared.visits.clone();
    LAST.for_each(|row| *visits.entry(place(row)).or_default() += 1);
    assert_counted(disk.path(), &visits).await;
    failed
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fold_on_a_failing_disk_is_as_if_nothing_was() {
    let prepared = Prepared::journaled().await;
    let whole = Disk::holding(&prepared.path());
    let server = waits_for_the_last(&whole).await;
    whole.count(CHANGES);
    send_until_acknowledged(server.address, "last", 1, &LAST.collect::<Vec<_>>()).await;
    eventually("all is in rows", async || left(whole.path()).await == 0).await;
    let calls = whole.seen();
    server.kill();
    assert!(calls > 10, "{calls}");

    let (mut failed, mut faults) = (0, 0);
    let steps: Vec<u64> = some_of(calls, 12).collect();
    for (at, steps) in steps.chunks(4).enumerate() {
        let fault = |step: &u64| {
            let failures = [1, 2, FOR_EVER][(at + *step as usize) % 3];
            let errno = [EIO, ENOSPC][*step as usize % 2];
            survives(&prepared, *step, failures, errno)
        };
        let survived = futures::future::join_all(steps.iter().map(fault)).await;
        faults += survived.len();
        failed += survived.iter().sum::<u64>();
    }
    assert!(failed as usize >= faults / 2, "{failed} of {faults}");
    println!("{calls} calls of a commit and a fold; {faults} faults, {failed} failed calls");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_is_full_in_a_fold_keeps_nobody_from_an_answer() {
    let prepared = Prepared::journaled().await;
    let mut half_way = 0;
    // From what the commit alone needs on.
    for kib in [24, 40, 60, 90] {
        let disk = Disk::holding(&prepared.path());
        let server = waits_for_the_last(&disk).await;
        let last: Vec<u32> = LAST.collect();
        disk.leave_room(kib << 10);
        let is_counted = send(server.address, "last", 1, &last).await;
        // It goes on failing: a fold that was begun waits.
        tokio::time::sleep(Duration::from_millis(300)).await;
        let (status, told) = asked(server.address, "/v1/environments/wide/states/16033").await;
        assert_eq!(status, 200, "{kib}: {told}");
        half_way += u64::from(is_counted && left(disk.path()).await > 0);
        disk.make_room();
        send_until_acknowledged(server.address, "last", 1, &last).await;
        send_until_acknowledged(server.address, "last", 2, &[7]).await;
        eventually("all is in rows but for the last", async || {
            left(disk.path()).await <= 1
        })
        .await;
        server.kill();
        let mut visits = prepared.visits.clone();
        LAST.chain([7])
            .for_each(|row| *visits.entry(place(row)).or_default() += 1);
        assert_counted(disk.path(), &visits).await;
    }
    assert!(half_way > 0, "a fold met the full disk");
}

/// A producer of batches that follow from its number and theirs.
struct Producer {
    number: u64,
    address: SocketAddr,
    acknowledged: AtomicU64,
}

/// Transitions of a batch.
const BATCH: usize = 900;

impl Producer {
    fn rows(&self, sequence: u64) -> Vec<u32> {
        let mut random = StdRng::seed_from_u64(self.number << 32 | sequence);
        (0..BATCH)
            .map(|_| random.random_range(0..MOST_ROWS))
            .collect()
    }

    fn name(&self) -> String {
        format!("p{}", self.number)
    }

    fn acknowledged(&self) -> u64 {
        self.acknowledged.load(Ordering::SeqCst)
    }

    /// Sends a batch. Every third has a transition without a place, which is rejected.
    async fn send(&self, client: &Client, sequence: u64) -> Option<Value> {
        // As text: values of so many members would take longer than the service does.
        let mut transitions = String::new();
        for row in self.rows(sequence) {
            let place = place(row);
            let _written = write!(
                transitions,
                r#"{{"state":{{"place":{place}}},"actions":{{"robot":0,"human":1}}}},"#
            );
        }
        match sequence.is_multiple_of(3) {
            true => transitions.push_str(r#"{"state":{},"actions":{}}"#),
            false => drop(transitions.pop()),
        }
        let name = self.name();
        let body = format!(
            r#"{{"producer":"{name}","sequence":{sequence},"transitions":[{transitions}]}}"#
        );
        let url = format!("http://{}/v1/environments/wide/transitions", self.address);
        let request = client.post(url).header("content-type", "application/json");
        let sent = request.body(body).send().await.ok()?;
        let status = sent.status().as_u16();
        assert!([200, 503].contains(&status), "{status}");
        match status {
            200 => sent.json().await.ok(),
            _ => None,
        }
    }

    async fn run(&self, over: &AtomicBool) {
        let client = Client::new();
        while !over.load(Ordering::SeqCst) {
            let sequence = self.acknowledged() + 1;
            if self.send(&client, sequence).await.is_some() {
                self.acknowledged.store(sequence, Ordering::SeqCst);
            } else {
                tokio::time::sleep(Duration::from_millis(2)).await;
            }
        }
    }

    /// Sends the last batches that were committed again: they were counted, and are told so with
    /// their receipts.
    async fn send_again(&self, committed: u64) {
        let client = Client::new();
        for sequence in committed.saturating_sub(12).max(1)..=committed {
            let receipt = self.send(&client, sequence).await.expect("an answer");
            let rejected = u64::from(sequence.is_multiple_of(3));
            assert_eq!(
                [&receipt["status"], &receipt["accepted"]],
                [&json!("duplicate"), &json!(BATCH)],
                "{receipt}"
            );
            assert_eq!(receipt["rejected_count"], json!(rejected), "{receipt}");
        }
    }
}

/// States that an earlier build counted, a row each; they are moved while the others are folded.
const OLD: i64 = 30_000;

/// Makes the environments `wide`, without counts, and `old`, with those of an earlier build.
async fn make_both(directory: &Path) -> EnvironmentId {
    let store = open(directory, Options::default()).await;
    let mut ids = Vec::new();
    for name in ["wide", "old"] {
        let name = name.parse().expect("a name");
        let made = store.create(&name, &schema(), &Default::default()).await;
        ids.push(made.expect("made").id);
    }
    // So that it has a segment.
    let first = filled(ids[1], "first", 1, std::iter::once(0));
    store.commit(&[first]).await.expect("a commit");
    store.close().await;
    let sql = format!(
        "create temp table place as with recursive place(at) as (
             select 1 union all select at + 1 from place where at < {OLD}) select at from place;
         insert into states (id, environment, key) select at, {id}, at from place;
         insert into cells (state, segment, joint, n, entries)
             select at, segments.id, at % 7, at, at / 2 from place, segments where environment = {id};
         update totals set unmoved = 1, transitions = transitions + {OLD} * ({OLD} + 1) / 2,
             states = states + {OLD}, cells = cells + {OLD} where environment = {id}",
        id = ids[1].0
    );
    execute(&directory.join("nudge.db"), sql.leak()).await;
    ids[0]
}

/// Checks that what the earlier build counted is there.
async fn assert_old_is_there(store: &dyn Store) {
    let id = store.environment("old").expect("it stays").id;
    let mut cursor = Cursor::default();
    let mut found = 0;
    loop {
        let page = store.scan(id, cursor, 1_000).await.expect("read");
        for state in &page {
            let (place, cells) = (u64::from(state.key.bins()[0]), state.counts.cells());
            found += 1;
            let expected = match place {
                0 => (1, tally(1, 1)),
                place => (place % 7, tally(place, place / 2)),
            };
            assert_eq!((cells[0].joint, cells[0].tally), expected, "{place}");
            assert_eq!(cells.len(), 1, "{place}");
        }
        match page.last() {
            Some(last) => cursor = last.cursor,
            None => break,
        }
    }
    assert_eq!(found, OLD + 1);
}

/// How many kills met what.
#[derive(Debug, Default)]
struct Met {
    /// A fold half way.
    folds: u64,
    /// The same, which an earlier kill had met already: a fold of a fold.
    again: u64,
    /// A move half way.
    moves: u64,
    /// The fold that the last kill met half way, or 0.
    last: i64,
}

impl Met {
    async fn note(&mut self, directory: &Path) {
        let path = directory.join("nudge.db");
        let fold = "select coalesce(max(folded), 0) from totals where fold_row is not null";
        let moves = "select count(*) from totals where unmoved and exists (
            select 1 from packed where id >> 44 = (select block from environments where name = 'old'))";
        let fold = number(&path, fold).await;
        self.folds += u64::from(fold > 0);
        self.again += u64::from(fold > 0 && fold == self.last);
        self.moves += number(&path, moves).await as u64;
        self.last = fold;
    }

    fn is_half_way(&self) -> bool {
        self.last > 0
    }

    fn enough(&self, kills: u64) -> bool {
        self.folds > kills / 20 && self.again > 0 && self.moves > 0
    }
}

/// Kills a service that folds all the time, at random times under load, and at first moves what an
/// earlier build counted.
#[tokio::test(flavor = "multi_thread")]
async fn nothing_is_lost_or_doubled_by_kills_in_folds_and_moves() {
    let kills = crate::kill::kills(300);
    let directory = TempDir::new().expect("a temporary directory");
    let id = make_both(directory.path()).await;
    let start = |listen: &str| {
        let mut command = Server::command(directory.path(), listen);
        Server::run(command.env("NUDGE_FOLD_CELLS", "4000")).expect("it starts")
    };
    let mut server = start("127.0.0.1:0");
    let address = server.address;
    let producer = |number| Producer {
        number,
        address,
        acknowledged: AtomicU64::new(0),
    };
    let producers: Vec<Arc<Producer>> = (0..2).map(producer).map(Arc::new).collect();
    let over = Arc::new(AtomicBool::new(false));
    let running: Vec<_> = producers
        .iter()
        .map(|producer| {
            let (producer, over) = (Arc::clone(producer), Arc::clone(&over));
            tokio::spawn(async move { producer.run(&over).await })
        })
        .collect();

    let all = || producers.iter().map(|one| one.acknowledged()).sum::<u64>();
    let mut random = StdRng::seed_from_u64(17);
    let mut met = Met::default();
    for kill in 0.. {
        // How fast this machine is decides what a kill meets: a few more where that was too little.
        if kill >= kills && (met.enough(kills) || kill >= 4 * kills) {
            break;
        }
        // Every other one meets what a start has to do: the fold that the last one has left.
        if kill % 2 == 0 {
            let before = all();
            eventually("there is a load", async || all() > before).await;
        }
        let longest = if met.is_half_way() { 4_000 } else { 40_000 };
        tokio::time::sleep(Duration::from_micros(random.random_range(0..longest))).await;
        server.kill();
        met.note(directory.path()).await;
        server = start(&address.to_string());
    }
    over.store(true, Ordering::SeqCst);
    for running in running {
        running.await.expect("no panic");
    }
    server.kill();

    let store = open(directory.path(), Options::default()).await;
    assert_old_is_there(&*store).await;
    let (mut visits, mut committed) = (Visits::new(), Vec::new());
    for producer in &producers {
        let name = producer.name().parse().expect("a producer id");
        let last = store.watermark(id, &name).await.expect("read").get();
        assert!(last >= producer.acknowledged(), "acknowledged and lost");
        for row in (1..=last).flat_map(|sequence| producer.rows(sequence)) {
            *visits.entry(place(row)).or_default() += 1;
        }
        committed.push(last);
    }
    store.close().await;
    drop(store);
    assert_counted(directory.path(), &visits).await;

    let server = start(&address.to_string());
    for (producer, committed) in producers.iter().zip(committed) {
        producer.send_again(committed).await;
    }
    server.kill();
    assert_counted(directory.path(), &visits).await;
    let transitions: u64 = visits.values().sum();
    println!("{kills} kills or more: {met:?}, {transitions} transitions, 0 lost, 0 double");
    assert!(met.enough(kills));
}
