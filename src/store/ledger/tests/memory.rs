//! A database in memory that carries the rule out: plain maps, and no opinion of its own.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use async_trait::async_trait;

use crate::domain::{EnvironmentId, Sequence, Tally};
use crate::store::ledger::{
    Books, CellAt, Kept, Ledger, Ledgers, Named, Numbered, Opened, Opening, Outcome, Quotas, RowId,
    StateName, StoredProducer, last_dropped,
};

pub(super) const HALLWAY: EnvironmentId = EnvironmentId(1);
pub(super) const KITCHEN: EnvironmentId = EnvironmentId(2);

/// How an environment answers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Answer {
    Open,
    ReadOnly,
}

/// What is stored, and how much was asked of it.
#[derive(Debug, Clone)]
pub(super) struct Database {
    pub(super) quotas: Quotas,
    /// Environments that are not here are gone.
    pub(super) answers: BTreeMap<EnvironmentId, Answer>,
    pub(super) worlds: BTreeMap<EnvironmentId, World>,
    /// Cells that were looked up.
    pub(super) cells_asked: usize,
}

/// One environment.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct World {
    pub(super) producers: BTreeMap<String, Producer>,
    pub(super) segments: BTreeMap<String, i64>,
    /// By state, segment, the number of a family and the family's cell.
    pub(super) cells: BTreeMap<(String, String, u32, u64), Tally>,
    pub(super) transitions: u64,
}

/// One producer.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Producer {
    pub(super) id: i64,
    pub(super) sequence: u64,
    pub(super) owner: Option<String>,
    pub(super) kept: BTreeMap<u64, Kept>,
}

impl Default for Database {
    fn default() -> Self {
        Self {
            quotas: Quotas::default(),
            answers: BTreeMap::from([(HALLWAY, Answer::Open)]),
            worlds: BTreeMap::new(),
            cells_asked: 0,
        }
    }
}

impl Database {
    /// Commits batches as a database does: open, decide, write.
    pub(super) fn commit(&mut self, batches: &[Numbered]) -> Vec<Outcome> {
        let quotas = self.quotas;
        let Ok(mut ledgers) = at_once(Ledgers::open(self, quotas, batches));
        let mut outcomes = Vec::new();
        for batch in batches {
            let Ok(outcome) = at_once(ledgers.decide(self, batch));
            outcomes.push(outcome);
        }
        for ledger in ledgers.into_accepted() {
            self.worlds
                .entry(ledger.environment)
                .or_default()
                .write(ledger);
        }
        outcomes
    }

    pub(super) fn world(&self, environment: EnvironmentId) -> &World {
        &self.worlds[&environment]
    }

    pub(super) fn producer(&self, name: &str) -> &Producer {
        &self.world(HALLWAY).producers[name]
    }

    /// Moves a producer's watermark, as if it had sent so many.
    pub(super) fn set_watermark(&mut self, name: &str, sequence: u64) {
        self.change(name, |producer| producer.sequence = sequence);
    }

    /// Spoils the receipt of a batch.
    pub(super) fn lose_receipt(&mut self, name: &str, sequence: u64) {
        let lose = |kept: &mut Kept| kept.receipt = None;
        self.change(name, |producer| {
            producer.kept.entry(sequence).and_modify(lose);
        });
    }

    fn change(&mut self, name: &str, change: impl FnOnce(&mut Producer)) {
        let world = self.worlds.get_mut(&HALLWAY).expect("something is stored");
        change(world.producers.get_mut(name).expect("it is stored"));
    }
}

/// Polls once: the rule itself waits for nothing, and neither does memory.
fn at_once<T>(future: impl Future<Output = T>) -> T {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(done) => done,
        Poll::Pending => panic!("the rule waits for something else than its books"),
    }
}

impl World {
    fn write(&mut self, mut ledger: Ledger<'_>) {
        for (name, account) in ledger.advanced() {
            let next_id = self.producers.len() as i64 + 1;
            let producer = self.producers.entry(name.to_owned()).or_default();
            match account.id() {
                Some(id) => assert_eq!(id.0, producer.id),
                None => assert_eq!(
                    (
                        std::mem::replace(&mut producer.id, next_id),
                        producer.sequence
                    ),
                    (0, 0)
                ),
            }
            assert_eq!(account.before().get(), producer.sequence);
            producer.sequence = account.last().get();
            producer.owner = account.owner().map(str::to_owned);
            for batch in account.accepted() {
                let kept = Kept {
                    digest: batch.digest,
                    receipt: Some(batch.receipt.clone()),
                };
                producer.kept.insert(batch.sequence.get(), kept);
            }
            let dropped = last_dropped(account.last()).get();
            producer.kept.retain(|sequence, _| *sequence > dropped);
        }

        self.transitions += ledger.merged.transitions();
        assert_eq!(ledger.revision(), self.transitions);
        let (listed, segments) = (
            ledger.merged.listed().to_vec(),
            ledger.merged.segments().to_vec(),
        );
        for label in &segments {
            let next_id = self.segments.len() as i64 + 1;
            let id = *self.segments.entry((*label).to_owned()).or_insert(next_id);
            assert!(ledger.segment(label).is_none_or(|known| known.0 == id));
        }
        for ((state, segment, family, joint), tally) in ledger.merged.tallies() {
            let state = match listed.get(state as usize) {
                Some(key) => key.to_string(),
                None => state.to_string(),
            };
            let segment = segments[segment as usize].to_owned();
            self.cells
                .entry((state, segment, family, joint))
                .or_insert(Tally::EMPTY)
                .add(tally);
        }
    }

    fn open(&self, named: &Named<'_>) -> Opened {
        let producer = |name: &&str| {
            let producer = self.producers.get(*name)?;
            let stored = StoredProducer {
                id: RowId(producer.id),
                sequence: Sequence::from_stored(producer.sequence as i64),
                owner: producer.owner.clone(),
            };
            Some(((*name).to_owned(), stored))
        };
        let segment =
            |label: &&str| Some(((*label).to_owned(), RowId(*self.segments.get(*label)?)));
        Opened {
            transitions: self.transitions,
            cells: self.cells.len() as u64,
            producers: named.producers.iter().filter_map(producer).collect(),
            segments: named.segments.iter().filter_map(segment).collect(),
        }
    }

    fn has(&self, cell: &CellAt<'_>) -> bool {
        self.segments.iter().any(|(label, id)| {
            let state = match cell.state {
                StateName::Rank(rank) => rank.to_string(),
                StateName::Key(key) => key.to_string(),
            };
            let name = (state, label.clone(), cell.family.number(), cell.joint);
            *id == cell.segment.0 && self.cells.contains_key(&name)
        })
    }
}

#[async_trait]
impl Books for Database {
    type Error = Infallible;

    async fn open(
        &mut self,
        environment: EnvironmentId,
        named: &Named<'_>,
    ) -> Result<Opening, Infallible> {
        Ok(match self.answers.get(&environment) {
            None => Opening::Gone,
            Some(Answer::ReadOnly) => Opening::ReadOnly,
            Some(Answer::Open) => {
                Opening::Open(self.worlds.entry(environment).or_default().open(named))
            }
        })
    }

    async fn count_producers(&mut self, environment: EnvironmentId) -> Result<u64, Infallible> {
        Ok(self.world(environment).producers.len() as u64)
    }

    async fn count_segments(&mut self, environment: EnvironmentId) -> Result<u64, Infallible> {
        Ok(self.world(environment).segments.len() as u64)
    }

    async fn count_cells(
        &mut self,
        environment: EnvironmentId,
        cells: &[CellAt<'_>],
    ) -> Result<u64, Infallible> {
        self.cells_asked += cells.len();
        let world = self.world(environment);
        Ok(cells.iter().filter(|cell| world.has(cell)).count() as u64)
    }

    async fn kept(
        &mut self,
        environment: EnvironmentId,
        producer: RowId,
        sequence: Sequence,
    ) -> Result<Kept, Infallible> {
        let world = self.world(environment);
        let mut producers = world.producers.values();
        let producer = producers.find(|known| known.id == producer.0);
        let kept = producer.and_then(|producer| producer.kept.get(&sequence.get()));
        Ok(kept.expect("the rule asks for what is kept").clone())
    }
}
