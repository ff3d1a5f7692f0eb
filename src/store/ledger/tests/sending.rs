//! Short ways to say what is sent.

use crate::domain::{Digest, EnvironmentId, Increment, Receipt, Sequence, StateKey, States, Tally};
use crate::store::ledger::Numbered;

use super::memory::{HALLWAY, KITCHEN};

/// Returns visits whose entries are all known.
pub(super) fn tally(n: u64, entries: u64) -> Tally {
    Tally {
        n,
        entries: Some(entries),
    }
}

/// A batch in the making.
#[derive(Clone)]
pub(super) struct Sending(Numbered);

/// Begins an empty batch.
pub(super) fn batch(producer: &str, sequence: u64) -> Sending {
    Sending(Numbered {
        environment: HALLWAY,
        producer: producer.parse().expect("a producer id"),
        owner: None,
        sequence: Sequence::new(sequence).expect("a sequence"),
        digest: Digest([sequence as u8; 32]),
        worded: None,
        increment: Increment::default(),
        receipt: Receipt::default(),
    })
}

impl Sending {
    /// Adds a cell of a state.
    pub(super) fn cell(mut self, place: u32, joint: u64, tally: Tally) -> Self {
        let key = StateKey::new(&[place]);
        let mut states = self.0.increment.states.listed().to_vec();
        let known = states.iter().position(|known| *known == key);
        let at = known.unwrap_or_else(|| {
            states.push(key);
            states.len() - 1
        });
        self.0.increment.states = States::Listed(states);
        self.again(at as u64, joint, tally)
    }

    /// Adds a cell of the state at that position.
    pub(super) fn again(mut self, at: u64, joint: u64, tally: Tally) -> Self {
        let increment = &mut self.0.increment;
        increment.cells.push((at, joint, tally));
        increment.transitions = increment.transitions.saturating_add(tally.n);
        self.0.receipt.accepted = increment.transitions;
        self
    }

    /// Adds the cell of an outcome's family that was observed with the last cell.
    pub(super) fn outcome(mut self, family: u32, cell: u64) -> Self {
        let increment = &mut self.0.increment;
        let outcomes = &mut increment.outcomes;
        outcomes.resize(outcomes.len().max(family as usize), Vec::new());
        let column = &mut outcomes[family as usize - 1];
        column.resize(increment.cells.len() - 1, Increment::MISSING);
        column.push(cell);
        self
    }

    /// Adds a cell whose entries are not known.
    pub(super) fn unknown(self, place: u32, joint: u64, n: u64) -> Self {
        self.cell(place, joint, Tally { n, entries: None })
    }

    /// Says which environment it is for.
    pub(super) fn environment(mut self, environment: EnvironmentId) -> Self {
        self.0.environment = environment;
        self
    }

    /// Says whose key speaks for the producer.
    pub(super) fn owner(mut self, name: &str) -> Self {
        self.0.owner = Some(name.parse().expect("a name"));
        self
    }

    /// Names the segment.
    pub(super) fn segment(mut self, label: &str) -> Self {
        self.0.increment.segment = Some(label.parse().expect("a label"));
        self
    }

    /// Tells the content from that of another batch with the same number.
    pub(super) fn content(mut self, byte: u8) -> Self {
        self.0.digest = Digest([byte; 32]);
        self
    }

    /// Returns the batch. States of the kitchen have ranks, those of the hallway are listed.
    pub(super) fn done(mut self) -> Numbered {
        if self.0.environment == KITCHEN {
            let increment = &mut self.0.increment;
            let listed = std::mem::take(&mut increment.states);
            let rank = |at: u64| u64::from(listed.listed()[at as usize].bins()[0]);
            let cells = increment.cells.iter_mut();
            cells.for_each(|(state, ..)| *state = rank(*state));
        }
        self.0
    }
}
