//! Every order in which commits, loads and looks can interleave, played on a pretended database of
//! three states.

use proptest::prelude::*;

use super::*;
use crate::domain::{SegmentId, Tally};

const ENVIRONMENT: EnvironmentId = EnvironmentId(1);
const STATES: usize = 3;

/// What happens next. Whatever needs two steps can have anything in between.
#[derive(Debug, Clone)]
enum Step {
    /// A transaction becomes visible in the database; it visits these states.
    Commit([bool; STATES]),
    /// The cache is told of it, and the commit returns.
    Apply,
    /// A reader finds nothing cached of a state, and takes its snapshot.
    BeginLoad(usize),
    /// The oldest load that began gives its counts to the cache.
    FinishLoad,
    /// The youngest one does.
    FinishLastLoad,
    /// A reader looks a state up.
    Look(usize),
    /// The outcome of the commit is unknown.
    Suspend,
    /// It is settled.
    Resume,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        3 => any::<[bool; STATES]>().prop_map(Step::Commit),
        4 => Just(Step::Apply),
        6 => (0..STATES).prop_map(Step::BeginLoad),
        3 => Just(Step::FinishLoad),
        3 => Just(Step::FinishLastLoad),
        6 => (0..STATES).prop_map(Step::Look),
        1 => Just(Step::Suspend),
        1 => Just(Step::Resume),
    ];
    prop::collection::vec(step, 0..120)
}

struct Load {
    state: usize,
    epoch: Epoch,
    visits: u64,
    revision: u64,
}

/// A database, its cache, and what its readers have seen.
struct Play {
    cache: CountsCache,
    visits: [u64; STATES],
    acknowledged: [u64; STATES],
    seen: [u64; STATES],
    pending: Option<[bool; STATES]>,
    suspended: bool,
    loads: Vec<Load>,
}

fn key(state: usize) -> StateKey {
    StateKey::new(&[state as u32])
}

fn cell(n: u64) -> Cell {
    Cell {
        joint: 0,
        segment: SegmentId(1),
        tally: Tally { n, entries: None },
    }
}

fn visits(counts: &Counts) -> u64 {
    counts.cells().iter().map(|cell| cell.tally.n).sum()
}

impl Play {
    fn new(capacity: usize) -> Self {
        let cache = CountsCache::new(capacity);
        cache.resume();
        let nothing = [0; STATES];
        Self {
            cache,
            visits: nothing,
            acknowledged: nothing,
            seen: nothing,
            pending: None,
            suspended: false,
            loads: vec![],
        }
    }

    fn step(&mut self, step: &Step) {
        match step {
            Step::Commit(states) => self.commit(states),
            Step::Apply => self.apply(),
            Step::BeginLoad(state) => self.begin_load(*state),
            Step::FinishLoad => self.finish_load(0),
            Step::FinishLastLoad => self.finish_load(self.loads.len().saturating_sub(1)),
            Step::Look(state) => self.look(*state),
            Step::Suspend => {
                self.cache.suspend();
                (self.pending, self.suspended) = (None, true);
            }
            Step::Resume => {
                if self.suspended {
                    self.cache.resume();
                }
                self.suspended = false;
            }
        }
    }

    /// Commits come one at a time, and none while the outcome of one is unknown.
    fn commit(&mut self, states: &[bool; STATES]) {
        if self.pending.is_none() && !self.suspended && states.contains(&true) {
            (0..STATES).for_each(|state| self.visits[state] += u64::from(states[state]));
            self.pending = Some(*states);
        }
    }

    fn apply(&mut self) {
        if let Some(states) = self.pending.take() {
            let added = (0..STATES).filter(|state| states[*state]);
            self.cache.apply(
                ENVIRONMENT,
                self.visits.iter().sum(),
                added.map(|state| (state as u64, (Family::JOINT, cell(1)))),
                |state| key(state as usize),
            );
            self.acknowledged = self.visits;
        }
    }

    fn begin_load(&mut self, state: usize) {
        let (found, epoch) = self.cache.get(ENVIRONMENT, &[key(state)]);
        if found[0].is_none() {
            let (visits, revision) = (self.visits[state], self.visits.iter().sum());
            self.loads.push(Load {
                state,
                epoch,
                visits,
                revision,
            });
        }
    }

    fn finish_load(&mut self, at: usize) {
        if at < self.loads.len() {
            let Load {
                state,
                epoch,
                visits,
                revision,
            } = self.loads.remove(at);
            let cells = if visits == 0 {
                vec![]
            } else {
                vec![cell(visits)]
            };
            let loaded = (key(state), Arc::new(Counts::new(cells)));
            self.cache
                .insert(ENVIRONMENT, epoch, revision, std::iter::once(loaded));
            self.seen[state] = self.seen[state].max(visits);
        }
    }

    fn look(&mut self, state: usize) {
        let (found, _) = self.cache.get(ENVIRONMENT, &[key(state)]);
        let Some(found) = &found[0] else { return };
        let visits = visits(&found.counts);
        assert!(
            visits >= self.acknowledged[state],
            "an acknowledged batch is missing"
        );
        assert!(visits >= self.seen[state], "the state went back in time");
        assert!(visits <= self.visits[state], "something was counted twice");
        assert!(
            found.revision >= self.acknowledged.iter().sum()
                && found.revision <= self.visits.iter().sum()
        );
        self.seen[state] = visits;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn no_order_of_events_serves_stale_or_doubled_counts(capacity in 0_usize..40, steps in steps()) {
        let mut play = Play::new(capacity);
        steps.iter().for_each(|step| play.step(step));
        for state in 0..STATES {
            play.look(state);
        }
    }
}

/// The orders that each rule is there for, one by one.
#[test]
fn each_rule_is_needed() {
    use Step::*;
    const FIRST: [bool; STATES] = [true, false, false];
    let cases: [&[Step]; 4] = [
        // Loaded after COMMIT and before `apply`: has the delta already.
        &[Commit(FIRST), BeginLoad(0), FinishLoad, Apply, Look(0)],
        // Loaded before COMMIT, given after `apply`: the delta has passed.
        &[BeginLoad(0), Commit(FIRST), Apply, FinishLoad, Look(0)],
        // Two loads across a COMMIT, the older one given last.
        &[
            BeginLoad(0),
            Commit(FIRST),
            BeginLoad(0),
            FinishLastLoad,
            FinishLoad,
            Look(0),
            Apply,
            Look(0),
        ],
        // A load from before the cache was emptied.
        &[
            BeginLoad(0),
            Commit(FIRST),
            Suspend,
            Resume,
            FinishLoad,
            Look(0),
        ],
    ];
    for steps in cases {
        let mut play = Play::new(100);
        steps.iter().for_each(|step| play.step(step));
    }
}

#[test]
fn what_was_used_longest_ago_makes_room() {
    let cache = CountsCache::new(3 * (STATE_WEIGHT + 1));
    cache.resume();
    let load = |state: usize| {
        let (_, epoch) = cache.get(ENVIRONMENT, &[]);
        cache.insert(
            ENVIRONMENT,
            epoch,
            9,
            std::iter::once((key(state), Arc::new(Counts::new(vec![cell(1)])))),
        );
    };
    let is_cached = |state: usize| cache.get(ENVIRONMENT, &[key(state)]).0[0].is_some();
    (0..3).for_each(load);
    assert!(is_cached(0));
    load(3);
    assert_eq!([0, 1, 2, 3].map(is_cached), [true, false, true, true]);
    cache.forget(ENVIRONMENT);
    assert_eq!([0, 1, 2, 3].map(is_cached), [false; 4]);
    assert_eq!(cache.inner().weight, 0);
}
