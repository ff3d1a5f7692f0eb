//! Whose influence on whom.

use super::draft::PairDraft;
use super::{Cell, Counts, Family, Schema, SegmentId};
use crate::error::Fault;
use crate::information::Alphabet;

/// Whose influence on whom, with whose actions held fixed: positions of agents, all different.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Pair {
    /// The agent whose influence is asked about.
    pub ego: usize,
    /// The agent that may be influenced.
    pub other: usize,
    /// Agents whose actions are held fixed, in the environment's order.
    pub given: Vec<usize>,
    /// The outcome that is asked about in the place of the other's action now: its action at a lag.
    /// What it did one step before that is then held fixed too, as far as that is an outcome; else
    /// what it does now.
    pub later: Option<usize>,
}

impl Pair {
    /// Makes that of the actions of one tick.
    pub fn new(ego: usize, other: usize, given: Vec<usize>) -> Self {
        Self {
            ego,
            other,
            given,
            later: None,
        }
    }

    /// Returns the same with the other's action at a lag; 0 for its action now. `None` where that is
    /// no outcome.
    pub fn at_lag(&self, schema: &Schema, lag: u32) -> Option<Self> {
        let later = match lag {
            0 => None,
            lag => Some(schema.action_at(self.other, lag)?),
        };
        Some(Self {
            later,
            ..self.clone()
        })
    }

    /// Returns the family whose cells tell of it.
    pub fn family(&self) -> Family {
        self.later.map_or(Family::JOINT, Family::of_outcome)
    }

    /// Returns whether anything is held fixed.
    pub fn is_conditional(&self) -> bool {
        !self.given.is_empty() || self.later.is_some()
    }

    /// Returns whether a cell of its family tells of it: whether both acted.
    #[inline]
    pub fn is_told_by(&self, schema: &Schema, cell: &Cell) -> bool {
        if !schema.may_lack_actions() {
            return true;
        }
        let (joint, _) = schema.split(self.family(), cell.joint);
        let acted =
            |agent: usize| schema.action_of(joint, agent) != schema.agents()[agent].absence();
        // A later action is in the family's cells only where it was taken.
        acted(self.ego) && (self.later.is_some() || acted(self.other))
    }

    /// Returns the actions of ego and other in a cell that tells of them.
    #[inline]
    pub fn actions(&self, schema: &Schema, cell: &Cell) -> (u64, u64) {
        let (joint, later) = schema.split(self.family(), cell.joint);
        let other = match self.later {
            Some(_) => later,
            None => schema.action_of(joint, self.other),
        };
        (schema.action_of(joint, self.ego), other)
    }

    /// Returns the number of the stratum that a cell is in: what is held fixed, in order.
    pub fn stratum(&self, schema: &Schema, cell: &Cell) -> u64 {
        let (joint, _) = schema.split(self.family(), cell.joint);
        let own = self.later.map(|_| self.other);
        let fixed = self.given.iter().copied().chain(own);
        fixed.fold(0, |stratum, agent| {
            let letters = schema.agents()[agent].letters();
            stratum * letters + schema.action_of(joint, agent)
        })
    }

    /// Returns how many actions the two have; rows for the ego.
    pub fn alphabet(&self, schema: &Schema) -> Alphabet {
        let [rows, columns] = [self.ego, self.other].map(|agent| schema.agents()[agent].actions());
        Alphabet { rows, columns }
    }

    /// Finds the agents that are named, or lists every fault.
    pub fn named(schema: &Schema, draft: &PairDraft) -> Result<Self, Vec<Fault>> {
        pair(schema, draft)
    }

    /// Returns every pair of agents, the earlier as the ego.
    pub fn every(schema: &Schema) -> Vec<Self> {
        let agents = schema.agents().len();
        let later = |ego| (ego + 1..agents).map(move |other| Self::new(ego, other, Vec::new()));
        (0..agents).flat_map(later).collect()
    }

    /// Returns the pair that can have the most mutual information, of equal ones the first.
    pub fn widest(schema: &Schema) -> Self {
        let by_reach = |pair: &Self| {
            let Alphabet { rows, columns } = pair.alphabet(schema);
            std::cmp::Reverse(rows.min(columns))
        };
        Self::every(schema)
            .into_iter()
            .min_by_key(by_reach)
            .expect("an environment has two agents at least")
    }

    /// Returns the same pair with the earlier agent as the ego: mutual information is symmetric,
    /// and so is what is fitted to it. One with a later action has its direction.
    pub fn undirected(&self) -> Self {
        if self.later.is_some() {
            return self.clone();
        }
        Self {
            ego: self.ego.min(self.other),
            other: self.ego.max(self.other),
            given: self.given.clone(),
            later: None,
        }
    }
}

impl Counts {
    /// Returns the cells that tell of a pair, of the segments named, or of all.
    pub fn of_pair<'a>(
        &'a self,
        schema: &'a Schema,
        pair: &'a Pair,
        segments: Option<&'a [SegmentId]>,
    ) -> impl Iterator<Item = &'a Cell> + Clone {
        let cells = self.of_family_and_segments(pair.family(), segments);
        cells.filter(move |cell| pair.is_told_by(schema, cell))
    }
}

fn pair(schema: &Schema, draft: &PairDraft) -> Result<Pair, Vec<Fault>> {
    let mut faults = Vec::new();
    let mut agent = |pointer: String, name: &str| {
        let found = schema.agent(name);
        if found.is_none() {
            let names: Vec<&str> = schema
                .agents()
                .iter()
                .map(|agent| agent.name.as_str())
                .collect();
            faults.push(Fault::new(
                pointer,
                format!(
                    "unknown agent {name:?}, expected one of {}",
                    names.join(", ")
                ),
            ));
        }
        found
    };

    // The first two agents by default; where one of them is named, the absent one is the other of
    // the two.
    let (first, second) = (
        schema.agents()[0].name.as_str(),
        schema.agents()[1].name.as_str(),
    );
    let opposite = |named: &Option<String>, usual, instead| {
        if named.as_deref() == Some(usual) {
            instead
        } else {
            usual
        }
    };

    let ego = agent(
        "/ego".into(),
        draft
            .ego
            .as_deref()
            .unwrap_or(opposite(&draft.other, first, second)),
    );
    let other = agent(
        "/other".into(),
        draft
            .other
            .as_deref()
            .unwrap_or(opposite(&draft.ego, second, first)),
    );

    let named = draft.given.iter().enumerate();
    let mut given: Vec<usize> = named
        .filter_map(|(i, name)| agent(format!("/given/{i}"), name))
        .collect();

    if let (Some(ego), Some(other)) = (ego, other) {
        if ego == other {
            let name = &schema.agents()[ego].name;
            faults.push(Fault::new(
                "/other",
                format!("got {name}, which is the ego too; expected another agent"),
            ));
        }

        for (i, agent) in given.iter().enumerate() {
            if *agent == ego || *agent == other || given[..i].contains(agent) {
                let name = &schema.agents()[*agent].name;
                faults.push(Fault::new(
                    format!("/given/{i}"),
                    format!("got {name}, expected neither ego nor other nor twice"),
                ));
            }
        }

        given.sort_unstable();
        if faults.is_empty() {
            return Ok(Pair::new(ego, other, given));
        }
    }
    Err(faults)
}
