//! Power cuts: what was synced is on the disk, and of what was written since, any part: none, some
//! writes, some sectors of some writes.
//!
//! The shim writes down every write and every sync of one run; each cut of it is then a moment of
//! that record. Of the acknowledgements it is known how long the record was when they came. So one
//! run is cut at hundreds of moments, and at each of them everything that was acknowledged must be
//! there. The control reads the same record as if SQLite ran with `synchronous=NORMAL`, which does
//! not wait for the journal at a commit: it must lose.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use tempfile::TempDir;

use super::disk::Disk;
use super::scaled;
use crate::server::Server;
use crate::support::load::{Load, Shape, Voice, expected, make_lane, read_held};

const VOICES: [Voice; 4] = [Voice::Stream, Voice::Stream, Voice::Stream, Voice::Rest];

/// Many pages a commit and many commits, so that the journal is moved into the database during a
/// run.
const SHAPE: Shape = Shape {
    rows: 20,
    contents: 64,
    segments: 64,
    in_flight: 1,
    observed: true,
};

const DATABASE: &str = "nudge.db";
const JOURNAL: &str = "nudge.db-wal";

/// Something that reached the disk, or asked that it should.
struct Record {
    /// How long the log was then.
    at: u64,
    name: String,
    change: Change,
}

#[derive(Clone)]
enum Change {
    Write(usize, Vec<u8>),
    Truncate(usize),
    Sync,
    Unlink,
}

/// Reads a log. The last record may be half there.
fn records(log: &[u8]) -> Vec<Record> {
    let mut records = Vec::new();
    let mut rest = log;
    while let Some(record) = record(&mut rest) {
        let at = (log.len() - rest.len()) as u64;
        records.push(Record { at, ..record });
    }
    records
}

fn record(rest: &mut &[u8]) -> Option<Record> {
    let mut take = |length: usize| rest.split_off(..length);
    let (letter, length) = (take(1)?[0], take(1)?[0]);
    let name = String::from_utf8(take(length.into())?.to_vec()).expect("a name");
    let mut number = || Some(u64::from_le_bytes(take(8)?.try_into().expect("8 bytes")) as usize);
    let (offset, length) = (number()?, number()?);
    let change = match letter {
        b'w' => Change::Write(offset, take(length)?.to_vec()),
        b't' => Change::Truncate(length),
        b's' => Change::Sync,
        b'u' => Change::Unlink,
        other => panic!("no record begins with {other}"),
    };
    Some(Record {
        at: 0,
        name,
        change,
    })
}

/// A file as a power cut may find it.
#[derive(Clone, Default)]
struct OnDisk {
    /// As it was at its last sync.
    synced: Vec<u8>,
    /// What was done to it since.
    since: Vec<Change>,
}

impl OnDisk {
    fn sync(&mut self) {
        for change in self.since.drain(..) {
            change.apply(&mut self.synced, |_| true);
        }
    }

    /// Returns what is found after a cut: of what was not synced any part may be there.
    fn after_cut(&self, random: &mut StdRng) -> Vec<u8> {
        // Nothing, whole writes, blocks, sectors, everything.
        let (unit, share) = match random.random_range(0..5) {
            0 => (usize::MAX, 0.0),
            1 => (usize::MAX, random.random()),
            2 => (4_096, random.random()),
            3 => (512, random.random()),
            _ => (usize::MAX, 1.0),
        };
        let mut found = self.synced.clone();
        for change in &self.since {
            let whole = random.random_bool(share);
            let mut sectors = BTreeMap::new();
            change.apply(&mut found, |at| match unit {
                usize::MAX => whole,
                unit => *sectors
                    .entry(at / unit)
                    .or_insert_with(|| random.random_bool(share)),
            });
        }
        found
    }
}

impl Change {
    /// Changes a file, or those bytes of it that `reached` says.
    fn apply(&self, file: &mut Vec<u8>, mut reached: impl FnMut(usize) -> bool) {
        match self {
            Self::Write(offset, bytes) => {
                for (start, sector) in sectors(*offset, bytes).filter(|(start, _)| reached(*start))
                {
                    let end = start + sector.len();
                    file.resize(file.len().max(end), 0);
                    file[start..end].copy_from_slice(sector);
                }
            }
            Self::Truncate(length) if reached(*length) => file.resize(*length, 0),
            Self::Truncate(_) | Self::Sync | Self::Unlink => {}
        }
    }
}

/// Cuts bytes at the borders of sectors.
fn sectors(offset: usize, bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    const SECTOR: usize = 512;
    let first = bytes.len().min(SECTOR - offset % SECTOR);
    let (first, rest) = bytes.split_at(first);
    let rest = rest
        .chunks(SECTOR)
        .scan(offset + first.len(), |at, sector| {
            let start = *at;
            *at += sector.len();
            Some((start, sector))
        });
    std::iter::once((offset, first)).chain(rest)
}

/// How SQLite is read to have run.
#[derive(Clone, Copy, PartialEq)]
enum Synchronous {
    /// As it did: each commit waits for the journal.
    Full,
    /// The journal is synced before it is moved into the database, and when it begins anew.
    Normal,
}

/// A run of the service, as the disk saw it.
struct Run {
    records: Vec<Record>,
    /// How long the log was once the environment was there.
    made: u64,
    /// How long the log was when a producer was told how far it is.
    told: Vec<(u64, usize, u64)>,
}

impl Run {
    async fn new(batches: u64) -> Self {
        let disk = Disk::new();
        let mut command = Server::folding(disk.path(), "127.0.0.1:0");
        let server = Server::run(disk.recording_under(&mut command)).expect("it starts");
        make_lane(server.address).await;
        let length = {
            let log = disk.log();
            move || log.metadata().expect("a log").len()
        };
        let made = length();
        let told = Arc::new(Mutex::new(Vec::new()));
        let keep = {
            let told = told.clone();
            move |producer, sequence| {
                told.lock()
                    .expect("no panic")
                    .push((length(), producer, sequence))
            }
        };
        let load = Load::observed(server.address, SHAPE, &VOICES, keep);
        load.progress(batches).await;
        server.kill();
        load.abandon().await;
        let records = records(&std::fs::read(disk.log()).expect("a log"));
        let told = std::mem::take(&mut *told.lock().expect("no panic"));
        Self {
            records,
            made,
            told,
        }
    }

    /// Returns how far each producer had been told to be at that moment.
    fn acknowledged(&self, at: u64) -> Vec<u64> {
        let mut acknowledged = vec![0; VOICES.len()];
        for (_, producer, sequence) in self.told.iter().filter(|(then, ..)| *then <= at) {
            acknowledged[*producer] = acknowledged[*producer].max(*sequence);
        }
        acknowledged
    }

    /// Returns whether a sync would have been there.
    fn is_synced(&self, at: usize, synchronous: Synchronous) -> bool {
        if synchronous == Synchronous::Full || self.records[at].name != JOURNAL {
            return true;
        }
        // Other threads sync the directory in between.
        let is_content = |record: &&Record| [DATABASE, JOURNAL].contains(&record.name.as_str());
        let before = self.records[..at].iter().rfind(is_content);
        let after = self.records[at + 1..].iter().find(is_content);
        let (Some(before), Some(after)) = (before, after) else {
            return true;
        };
        let moved = after.name == DATABASE;
        let begun = before.name == JOURNAL && matches!(before.change, Change::Write(0, _));
        moved || begun
    }

    /// Cuts the power at so many moments, and gives each to `found`: what was there, and how far
    /// producers had been told to be.
    async fn cut(
        &self,
        cuts: u64,
        synchronous: Synchronous,
        mut found: impl AsyncFnMut(&Path, Vec<u64>),
    ) {
        let mut random = StdRng::seed_from_u64(23);
        let first = self
            .records
            .iter()
            .position(|record| record.at >= self.made)
            .expect("it was made");
        let mut moments: Vec<usize> = (0..cuts)
            .map(|_| random.random_range(first..self.records.len()))
            .collect();
        moments.sort_unstable();
        let mut moments = moments.into_iter().peekable();
        let mut files: BTreeMap<&str, OnDisk> = BTreeMap::new();
        for (number, record) in self.records.iter().enumerate() {
            match &record.change {
                Change::Sync if !self.is_synced(number, synchronous) => {}
                Change::Sync => files.entry(&record.name).or_default().sync(),
                Change::Unlink => drop(files.remove(record.name.as_str())),
                change => files
                    .entry(&record.name)
                    .or_default()
                    .since
                    .push(change.clone()),
            }
            while moments.next_if_eq(&number).is_some() {
                let directory = after_cut(&files, &mut random);
                found(directory.path(), self.acknowledged(record.at)).await;
            }
        }
    }
}

fn after_cut(files: &BTreeMap<&str, OnDisk>, random: &mut StdRng) -> TempDir {
    let directory = TempDir::new().expect("a temporary directory");
    // What is shared between processes is made anew, and the directory itself has no bytes.
    for (name, file) in files
        .iter()
        .filter(|(name, _)| !name.is_empty() && !name.ends_with("-shm"))
    {
        std::fs::write(directory.path().join(name), file.after_cut(random)).expect("written");
    }
    directory
}

/// Returns whether something that was acknowledged is missing. What is there must be whole batches,
/// each once.
async fn has_lost(directory: &Path, acknowledged: &[u64]) -> bool {
    // The environment was acknowledged too.
    let Some(held) = read_held(directory, VOICES.len()).await else {
        return true;
    };
    assert_eq!(
        held.cells,
        expected(SHAPE, &held.committed),
        "every batch once: {:?}",
        held.committed
    );
    held.committed
        .iter()
        .zip(acknowledged)
        .any(|(committed, acknowledged)| committed < acknowledged)
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_acknowledged_is_lost_in_a_power_cut_and_synchronous_normal_would_lose_it() {
    let run = Run::new(scaled(1_200, 10_000)).await;
    let moved = run
        .records
        .iter()
        .filter(|record| record.name == DATABASE && record.at > run.made)
        .count();
    assert!(
        moved > 0,
        "the journal was moved into the database under load"
    );

    let (cuts, mut acknowledged_batches) = (scaled(60, 2_000), 0);
    run.cut(cuts, Synchronous::Full, async |directory, acknowledged| {
        acknowledged_batches += acknowledged.iter().sum::<u64>();
        assert!(
            !has_lost(directory, &acknowledged).await,
            "{acknowledged:?} were acknowledged"
        );
    })
    .await;
    assert!(
        acknowledged_batches > cuts,
        "there was a load: {acknowledged_batches}"
    );

    let (controls, mut lost) = (scaled(20, 200), 0);
    run.cut(
        controls,
        Synchronous::Normal,
        async |directory, acknowledged| {
            lost += u64::from(has_lost(directory, &acknowledged).await);
        },
    )
    .await;
    assert!(lost > 0, "the control must lose: {controls} cuts");
    println!("{cuts} power cuts, 0 lost; with synchronous=normal {lost} of {controls}");
}
