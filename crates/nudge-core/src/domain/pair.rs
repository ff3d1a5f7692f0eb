//! Whose influence on whom.

use super::Schema;
use super::draft::PairDraft;
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
}

impl Pair {
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
        let later = |ego| {
            (ego + 1..agents).map(move |other| Self {
                ego,
                other,
                given: Vec::new(),
            })
        };
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
    /// and so is what is fitted to it.
    pub fn undirected(&self) -> Self {
        Self {
            ego: self.ego.min(self.other),
            other: self.ego.max(self.other),
            given: self.given.clone(),
        }
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
            return Ok(Pair { ego, other, given });
        }
    }
    Err(faults)
}
