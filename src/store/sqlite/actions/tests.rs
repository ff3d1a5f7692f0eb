//! Every order in which commits, a load and looks can interleave, played on a pretended database of
//! one environment.

use proptest::prelude::*;

use super::*;
use crate::domain::SchemaDraft;
use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

const ENVIRONMENT: EnvironmentId = EnvironmentId(1);
const OTHER: EnvironmentId = EnvironmentId(2);
const ACTIONS: u64 = 3;

/// What happens next. Whatever needs several steps can have anything in between.
#[derive(Debug, Clone)]
enum Step {
    /// A transaction becomes visible in the database: a joint action was taken so many times.
    Commit(u64, u64),
    /// Memory is told of it, and the commit returns.
    Apply,
    /// Another environment's commit, from beginning to end.
    Elsewhere,
    /// A load is announced, if none is under way.
    Announce,
    /// Its snapshot is taken.
    Snapshot,
    /// Its revision is known.
    KnowRevision,
    /// It gives what it read.
    Finish,
    /// It fails, or nobody waits for it any more.
    Abandon,
    /// The outcome of the commit is unknown.
    Suspend,
    /// It is settled: the commit took effect, or not.
    Resume(bool),
    /// Somebody looks what is kept.
    Look,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        6 => (0..ACTIONS * ACTIONS, 1_u64..4).prop_map(|(joint, n)| Step::Commit(joint, n)),
        6 => Just(Step::Apply),
        1 => Just(Step::Elsewhere),
        5 => Just(Step::Announce),
        5 => Just(Step::Snapshot),
        5 => Just(Step::KnowRevision),
        5 => Just(Step::Finish),
        1 => Just(Step::Abandon),
        1 => Just(Step::Suspend),
        2 => any::<bool>().prop_map(Step::Resume),
        5 => Just(Step::Look),
    ];
    prop::collection::vec(step, 0..120)
}

fn schema() -> Schema {
    let feature = |name: &str| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, ACTIONS as i64 - 1)],
    };
    let agent = |name: &str| AgentDraft {
        name: name.into(),
        action: vec![feature("move")],
        ..AgentDraft::default()
    };
    let draft = SchemaDraft {
        state: vec![feature("place")],
        agents: vec![agent("robot"), agent("human")],
        ..SchemaDraft::default()
    };
    Schema::try_from(&draft).expect("valid")
}

fn tally(n: u64) -> Tally {
    Tally {
        n,
        entries: Some(n),
    }
}

struct Running<'a> {
    load: Load<'a>,
    /// The least that its answer must have.
    acknowledged: u64,
    snapshot: Option<ActionTotals>,
    is_known: bool,
}

/// A database, its memory, and one load.
struct Play<'a> {
    memory: &'a ActionsMemory,
    committed: ActionTotals,
    acknowledged: u64,
    pending: Option<(u64, u64)>,
    /// A commit whose outcome is unknown.
    lost: Option<(u64, u64)>,
    suspended: bool,
    running: Option<Running<'a>>,
    /// How often totals were kept and found.
    found: u64,
}

impl<'a> Play<'a> {
    fn new(memory: &'a ActionsMemory) -> Self {
        memory.resume();
        let committed = ActionTotals::new(&schema());
        Self {
            memory,
            committed,
            acknowledged: 0,
            pending: None,
            lost: None,
            suspended: false,
            running: None,
            found: 0,
        }
    }

    fn step(&mut self, step: &Step) {
        match step {
            Step::Commit(joint, n) if self.pending.is_none() && !self.suspended => {
                self.committed.add(*joint, tally(*n));
                self.pending = Some((*joint, *n));
            }
            Step::Commit(..) => {}
            Step::Apply => self.apply(),
            Step::Elsewhere => {
                self.memory
                    .apply(OTHER, 1_000, std::iter::once((Family::JOINT, 0, tally(7))))
            }
            Step::Announce => self.announce(),
            Step::Snapshot => self.snapshot(),
            Step::KnowRevision => self.know_revision(),
            Step::Finish => self.finish(),
            Step::Abandon => self.running = None,
            Step::Suspend if !self.suspended => {
                self.memory.suspend();
                // One that is visible took effect; another may do so late.
                self.lost = if self.pending.take().is_some() {
                    None
                } else {
                    Some((4, 2))
                };
                self.suspended = true;
            }
            Step::Suspend => {}
            Step::Resume(took_effect) => self.resume(*took_effect),
            Step::Look => self.look(),
        }
    }

    fn apply(&mut self) {
        if let Some((joint, n)) = self.pending.take() {
            self.memory.apply(
                ENVIRONMENT,
                self.committed.revision,
                std::iter::once((Family::JOINT, joint, tally(n))),
            );
            self.acknowledged = self.committed.revision;
        }
    }

    fn announce(&mut self) {
        if self.running.is_none() && self.memory.get(ENVIRONMENT).is_none() {
            let turn = self.memory.turn.try_lock().expect("nobody else loads");
            let load = self.memory.announce(turn, ENVIRONMENT);
            let acknowledged = self.acknowledged;
            self.running = Some(Running {
                load,
                acknowledged,
                snapshot: None,
                is_known: false,
            });
        }
    }

    fn snapshot(&mut self) {
        if let Some(running) = &mut self.running {
            running
                .snapshot
                .get_or_insert_with(|| self.committed.clone());
        }
    }

    fn know_revision(&mut self) {
        let Some(running) = &mut self.running else {
            return;
        };
        let Some(snapshot) = running.snapshot.as_ref().filter(|_| !running.is_known) else {
            return;
        };
        running.load.snapshot_taken(&schema(), snapshot.revision);
        running.is_known = true;
    }

    fn finish(&mut self) {
        let Some(running) = self.running.take_if(|running| running.is_known) else {
            return;
        };
        let told = running
            .load
            .finish(running.snapshot.expect("its revision is known"));
        assert!(
            told.revision >= running.acknowledged,
            "an acknowledged batch is missing"
        );
        assert_is_of_its_revision(&told, &self.committed);
        self.look();
    }

    fn resume(&mut self, took_effect: bool) {
        if !self.suspended {
            return;
        }
        if let Some((joint, n)) = self.lost.take().filter(|_| took_effect) {
            self.committed.add(joint, tally(n));
        }
        self.memory.resume();
        self.acknowledged = self.committed.revision;
        self.suspended = false;
    }

    fn look(&mut self) {
        let Some(kept) = self.memory.get(ENVIRONMENT) else {
            return;
        };
        assert!(
            !self.suspended,
            "kept although nobody knows what was committed"
        );
        assert!(
            kept.revision >= self.acknowledged,
            "an acknowledged batch is missing"
        );
        assert_is_of_its_revision(&kept, &self.committed);
        if kept.revision == self.committed.revision {
            assert_eq!(*kept, self.committed);
        }
        self.found += 1;
    }
}

/// What is told is neither more nor less than its revision says.
fn assert_is_of_its_revision(told: &ActionTotals, committed: &ActionTotals) {
    assert!(
        told.revision <= committed.revision,
        "more than was committed"
    );
    for agent in [0, 1] {
        assert_eq!(told.draws(agent).iter().sum::<u64>(), told.revision);
        assert!(
            told.draws(agent)
                .iter()
                .zip(committed.draws(agent))
                .all(|(told, most)| *told <= most)
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    #[test]
    fn no_order_of_events_misses_or_doubles_a_commit(steps in steps()) {
        let memory = ActionsMemory::default();
        let mut play = Play::new(&memory);
        steps.iter().for_each(|step| play.step(step));
        play.apply();
        play.look();
    }
}

/// The orders that each rule is there for, one by one; each ends with totals that are kept, or with
/// none.
#[test]
fn each_rule_is_needed() {
    use Step::*;
    let cases: [(&[Step], bool); 8] = [
        // In the snapshot, and memory is told before and after its revision is known.
        (
            &[
                Commit(1, 2),
                Announce,
                Snapshot,
                Apply,
                KnowRevision,
                Finish,
            ],
            true,
        ),
        (
            &[
                Commit(1, 2),
                Announce,
                Snapshot,
                KnowRevision,
                Apply,
                Finish,
            ],
            true,
        ),
        (
            &[
                Commit(1, 2),
                Announce,
                Snapshot,
                KnowRevision,
                Finish,
                Apply,
            ],
            true,
        ),
        // Not in the snapshot.
        (
            &[
                Announce,
                Snapshot,
                Commit(1, 2),
                Apply,
                KnowRevision,
                Commit(2, 1),
                Apply,
                Finish,
                Commit(2, 1),
            ],
            true,
        ),
        // Told between the announcement and the snapshot.
        (
            &[
                Announce,
                Commit(1, 2),
                Apply,
                Snapshot,
                Commit(2, 1),
                Apply,
                KnowRevision,
                Finish,
            ],
            true,
        ),
        // What was read before nobody knew what was committed.
        (
            &[
                Announce,
                Snapshot,
                Suspend,
                Resume(true),
                KnowRevision,
                Finish,
            ],
            false,
        ),
        // What was read meanwhile.
        (
            &[
                Suspend,
                Announce,
                Snapshot,
                KnowRevision,
                Resume(true),
                Commit(1, 1),
                Apply,
                Finish,
            ],
            false,
        ),
        (
            &[
                Announce,
                Snapshot,
                KnowRevision,
                Abandon,
                Commit(1, 1),
                Apply,
            ],
            false,
        ),
    ];
    for (steps, is_kept) in cases {
        let memory = ActionsMemory::default();
        let mut play = Play::new(&memory);
        steps.iter().for_each(|step| play.step(step));
        play.apply();
        play.look();
        assert_eq!(memory.get(ENVIRONMENT).is_some(), is_kept, "{steps:?}");
        assert_eq!(play.found > 0, is_kept, "{steps:?}");
        drop(play);
        assert!(memory.inner().loading.is_none());
    }
}

fn loaded(memory: &ActionsMemory, environment: EnvironmentId) {
    let load = memory.announce(
        memory.turn.try_lock().expect("nobody else loads"),
        environment,
    );
    load.snapshot_taken(&schema(), 0);
    load.finish(ActionTotals::new(&schema()));
}

#[test]
fn an_environment_that_is_gone_is_forgotten_while_it_is_loaded_too() {
    let memory = ActionsMemory::default();
    memory.resume();
    loaded(&memory, ENVIRONMENT);
    loaded(&memory, OTHER);
    memory.forget(ENVIRONMENT);
    assert_eq!(
        [ENVIRONMENT, OTHER].map(|of| memory.get(of).is_some()),
        [false, true]
    );

    let load = memory.announce(
        memory.turn.try_lock().expect("nobody else loads"),
        ENVIRONMENT,
    );
    load.snapshot_taken(&schema(), 0);
    memory.forget(ENVIRONMENT);
    load.finish(ActionTotals::new(&schema()));
    assert!(memory.get(ENVIRONMENT).is_none());
}

#[test]
fn what_was_asked_longest_ago_makes_room() {
    let memory = ActionsMemory::default();
    memory.resume();
    (0..=KEPT.get() as i64).for_each(|id| loaded(&memory, EnvironmentId(id)));
    assert_eq!(
        [0, 1, KEPT.get() as i64].map(|id| memory.get(EnvironmentId(id)).is_some()),
        [false, true, true]
    );
}

#[test]
fn what_was_told_does_not_change() {
    let memory = ActionsMemory::default();
    memory.resume();
    loaded(&memory, ENVIRONMENT);
    let told = memory.get(ENVIRONMENT).expect("kept");
    memory.apply(
        ENVIRONMENT,
        2,
        std::iter::once((Family::JOINT, 4, tally(2))),
    );
    assert_eq!(
        (
            told.revision,
            memory.get(ENVIRONMENT).expect("kept").draws(1)
        ),
        (0, vec![0, 2, 0])
    );
}
