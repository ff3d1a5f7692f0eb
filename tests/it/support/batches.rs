//! Short ways to say what a test sends to a store.

use std::cell::Cell;

use nudge::domain::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft};
use nudge::domain::{
    Acknowledged, Digest, EnvironmentId, Increment, Receipt, Schema, SchemaDraft, Sequence,
    StateKey, States, Tally,
};
use nudge::store::{Numbered, Outcome, Refusal};

thread_local! {
    /// Whether the states of this thread's test are too many to be numbered by their ranks.
    static IS_HUGE: Cell<bool> = const { Cell::new(false) };
    /// Whether this thread's test observes outcomes.
    static IS_OBSERVED: Cell<bool> = const { Cell::new(false) };
}

/// Outcomes of [`schema`] where they are observed: a name, and how many values it has.
pub const OUTCOMES: [(&str, u64); 3] = [("pot", 3), ("pan", 1), ("lid", 256)];

/// Lets [`schema`] have outcomes, and every cell of a batch be observed with most of them, for all
/// of this test, which has to stay on its thread.
pub fn of_outcomes(observed: bool) {
    IS_OBSERVED.set(observed);
}

/// Returns whether outcomes are observed.
pub fn observes() -> bool {
    IS_OBSERVED.get()
}

/// Returns the cell of an outcome's family that a joint action is observed with: each outcome is
/// missing now and then.
pub fn observed(outcome: usize, joint: u64) -> Option<u64> {
    let values = OUTCOMES[outcome].1;
    let is_missing = !observes() || (joint + outcome as u64) % 5 == 4;
    let cell = joint.checked_mul(values)? + joint % values;
    (!is_missing).then_some(cell)
}

/// Lets [`schema`] and [`state`] be of more states than can be numbered by their ranks, for all of
/// this test, which has to stay on its thread.
pub fn of_too_many_states() {
    IS_HUGE.set(true);
}

/// The largest value of a feature.
const LARGEST: i64 = 1 << 20;

/// Returns a schema of one wide state feature and two agents with 1,024 actions each.
pub fn schema() -> Schema {
    schema_of(&[("robot", 1_024), ("human", 1_024)])
}

/// Returns a schema of one wide state feature and agents with so many actions each.
pub fn schema_of(agents: &[(&str, i64)]) -> Schema {
    let feature = |name: &str, max| FeatureDraft {
        name: name.into(),
        unit: None,
        kinds: vec![KindDraft::Integer(0, max)],
    };
    let agent = |(name, actions): &(&str, i64)| AgentDraft {
        name: (*name).into(),
        action: vec![feature("move", actions - 1)],
        ..AgentDraft::default()
    };
    let mut state = vec![feature("place", LARGEST)];
    if IS_HUGE.get() {
        state.extend([feature("height", LARGEST), feature("depth", LARGEST)]);
    }
    let outcome = |(name, values): &(&str, u64)| OutcomeDraft {
        name: (*name).into(),
        lag: Some(1),
        value: vec![feature("is", *values as i64 - 1)],
        ..OutcomeDraft::default()
    };
    let outcomes = OUTCOMES.iter().filter(|_| observes());
    let draft = SchemaDraft {
        state,
        agents: agents.iter().map(agent).collect(),
        outcomes: outcomes.map(outcome).collect(),
        ..SchemaDraft::default()
    };
    Schema::try_from(&draft).expect("valid")
}

/// Returns the key of a state of [`schema`].
pub fn state_at(place: u32) -> StateKey {
    match IS_HUGE.get() {
        true => StateKey::new(&[place, place % 3, LARGEST as u32]),
        false => StateKey::new(&[place]),
    }
}

/// Returns visits whose entries are all known.
pub fn tally(n: u64, entries: u64) -> Tally {
    Tally {
        n,
        entries: Some(entries),
    }
}

/// A batch in the making.
pub struct Sending(Numbered);

/// Begins an empty batch.
pub fn batch(environment: EnvironmentId, producer: &str, sequence: u64) -> Sending {
    Sending(Numbered {
        environment,
        producer: producer.parse().expect("a producer id"),
        owner: None,
        sequence: Sequence::new(sequence).expect("a sequence"),
        digest: Digest([sequence as u8; 32]),
        worded: None,
        increment: Increment::default(),
        receipt: Receipt::default(),
    })
}

/// Returns a batch of a transition in each place, of the joint action 1.
pub fn filled(
    environment: EnvironmentId,
    producer: &str,
    sequence: u64,
    places: impl Iterator<Item = u32>,
) -> Numbered {
    let mut batch = batch(environment, producer, sequence).done();
    let increment = &mut batch.increment;
    for place in places {
        let number = number(increment, place);
        increment.cells.push((number, 1, tally(1, 1)));
        add_observed(increment, 1);
    }
    increment.transitions = increment.cells.len() as u64;
    batch.receipt.accepted = increment.transitions;
    batch
}

/// Adds what is observed with the last cell, which is of this joint action.
fn add_observed(increment: &mut Increment, joint: u64) {
    for outcome in 0..OUTCOMES.len() {
        if let Some(cell) = observed(outcome, joint) {
            increment.outcomes.resize(OUTCOMES.len(), Vec::new());
            let column = &mut increment.outcomes[outcome];
            column.resize(increment.cells.len() - 1, Increment::MISSING);
            column.push(cell);
        }
    }
}

/// Returns the number by which an increment names a state: its rank, or where there are too many
/// for ranks its position among those that are listed.
pub fn number(increment: &mut Increment, place: u32) -> u64 {
    if !IS_HUGE.get() {
        // The rank of a state of one feature.
        return u64::from(place);
    }

    let mut listed = increment.states.listed().to_vec();
    let key = state_at(place);
    let at = listed.iter().position(|listed| *listed == key);
    let at = at.unwrap_or_else(|| {
        listed.push(key);
        listed.len() - 1
    });
    increment.states = States::Listed(listed);
    at as u64
}

impl Sending {
    /// Adds a cell; each of them once.
    pub fn cell(mut self, place: u32, joint: u64, tally: Tally) -> Self {
        let increment = &mut self.0.increment;
        let number = number(increment, place);
        increment.cells.push((number, joint, tally));
        add_observed(increment, joint);
        increment.transitions = increment.transitions.saturating_add(tally.n);
        self.0.receipt.accepted = increment.transitions;
        self
    }

    /// Names the segment.
    pub fn segment(mut self, label: &str) -> Self {
        self.0.increment.segment = Some(label.parse().expect("a label"));
        self
    }

    /// Tells the content from that of another batch with the same number.
    pub fn content(mut self, byte: u8) -> Self {
        self.0.digest = Digest([byte; 32]);
        self
    }

    /// Returns the batch.
    pub fn done(self) -> Numbered {
        self.0
    }
}

/// Returns the outcome of a batch that is counted.
pub fn applied(batch: &Numbered) -> Outcome {
    Outcome::Acknowledged(Acknowledged::Applied(batch.receipt.clone()))
}

/// Returns the outcome of a batch that was counted before.
pub fn duplicate(batch: &Numbered) -> Outcome {
    Outcome::Acknowledged(Acknowledged::Duplicate(batch.receipt.clone()))
}

/// Returns the outcome of a batch that was counted so long ago that nobody knows its content.
pub fn unverified() -> Outcome {
    Outcome::Acknowledged(Acknowledged::Unverified)
}

/// Returns the outcome of a batch whose number is ahead.
pub fn out_of_order(expected: u64) -> Outcome {
    Outcome::Refused(Refusal::OutOfOrder {
        expected: Sequence::new(expected).expect("a sequence"),
    })
}

/// Returns the outcome of a batch that a quota has no room for.
pub fn over_quota(what: &'static str, limit: u64) -> Outcome {
    Outcome::Refused(Refusal::Quota { what, limit })
}
