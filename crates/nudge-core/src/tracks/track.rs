//! Steps of one track, held back until what follows them is known (lagged outcomes).

use std::collections::VecDeque;
use std::ops::Range;

use super::EntryRule;
use crate::domain::{Agent, Entry, Outcome, Record, Schema, StateKey};

/// One step of a game, as it happened.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Step {
    /// One value a state feature.
    pub state: Vec<f32>,
    /// One value an action feature; those of an agent that did not act are not looked at.
    pub actions: Vec<f32>,
    /// Which agents acted, a flag each; empty where all did.
    pub acts: Vec<bool>,
    /// What is observed at this step of outcomes that are no agent's action: one value a feature of
    /// each of them, in the schema's order. It is the outcome of the step that was its lag earlier.
    /// Empty where none is.
    pub observed: Vec<f32>,
    /// Which of these outcomes are observed, a flag each; empty where all are, or none has a value.
    pub is_observed: Vec<bool>,
}

impl Step {
    /// Makes a step in which all agents acted, and in which no other outcome is observed.
    pub fn new(state: Vec<f32>, actions: Vec<f32>) -> Self {
        Self {
            state,
            actions,
            ..Self::default()
        }
    }

    /// Says which agents acted, a flag each.
    pub fn acting(self, acts: Vec<bool>) -> Self {
        Self { acts, ..self }
    }

    /// Says what is observed of outcomes that are no agent's action.
    pub fn observing(self, observed: Vec<f32>) -> Self {
        Self { observed, ..self }
    }
}

/// Follows one track, the consecutive steps of one game or of one pair: fills in the outcomes of
/// each step from those that follow it, and says which steps count as entries of their state (see
/// [`EntryRule`]).
///
/// Steps are given in order, and come out in order as transitions, each as soon as its greatest lag
/// is over: so as many as that are held back. Where the environment has no outcomes, each comes out
/// at once. Take a new `Track` for every game. What is held back and not asked for by
/// [`end`](Self::end) is lost, at most [`held_back`](Self::held_back) steps.
#[derive(Debug, Clone)]
pub struct Track {
    schema: Schema,
    sources: Sources,
    rule: EntryRule<StateKey>,
    /// Whether each step is a decision, whatever the one before it was.
    are_rounds: bool,
    /// The steps that are held back, the oldest first.
    held: VecDeque<Held>,
}

/// Where the values of outcomes are found, in steps to come.
#[derive(Debug, Clone)]
struct Sources {
    /// In the schema's order.
    outcomes: Vec<Source>,
    /// The greatest lag.
    most: usize,
    /// Values of all outcomes.
    width: usize,
}

#[derive(Debug, Clone)]
struct Source {
    lag: usize,
    /// The agent whose action it is.
    agent: Option<usize>,
    /// Among the outcomes that are no action, its position.
    slot: usize,
    /// The values in the step's actions, or in what is observed of it.
    values: Range<usize>,
}

/// A step that is held back.
#[derive(Debug, Clone)]
struct Held {
    step: Step,
    key: Option<StateKey>,
    /// The action of each agent, none where it is absent or has a value without a bin.
    actions: Vec<Option<u64>>,
    /// Whether the service will reject it.
    is_misfit: bool,
}

impl Track {
    /// Begins a track in an environment of that schema.
    pub fn new(schema: &Schema) -> Self {
        Self {
            schema: schema.clone(),
            sources: Sources::of_schema(schema),
            rule: EntryRule::new(schema.agents().iter().map(Agent::actions)),
            are_rounds: false,
            held: VecDeque::new(),
        }
    }

    /// Begins a track of rounds, in each of which all agents decide anew, as in a repeated game:
    /// every one of them counts as an entry.
    pub fn of_rounds(schema: &Schema) -> Self {
        Self {
            are_rounds: true,
            ..Self::new(schema)
        }
    }

    /// Takes the next step, and returns the transition that is released by it: the step itself where
    /// there are no outcomes, else the one that was the greatest lag earlier.
    pub fn step(&mut self, step: Step) -> Option<Record> {
        self.held.push_back(Held::new(step, &self.schema));
        if self.held.len() > self.sources.most {
            self.release()
        } else {
            None
        }
    }

    /// Passes over steps that were not observed: releases all that were held back, with what is
    /// known. The next step enters its state; which actions agents hold is not forgotten.
    pub fn gap(&mut self) -> Vec<Record> {
        let released = std::iter::from_fn(|| self.release()).collect();
        self.rule.gap();
        released
    }

    /// Ends the track, and returns all that were held back, with what is known.
    pub fn end(mut self) -> Vec<Record> {
        self.gap()
    }

    /// Returns how many steps are held back: at most the greatest lag of the environment.
    pub fn held_back(&self) -> usize {
        self.held.len()
    }

    /// Releases the oldest step that is held back.
    fn release(&mut self) -> Option<Record> {
        let oldest = self.held.front()?;
        let (outcomes, present) = self.sources.outcomes_of(&self.held);
        let entry = if self.are_rounds {
            Entry::Entered
        } else if oldest.is_misfit {
            // The service will reject it: the step after it comes from somewhere else.
            self.rule.gap();
            Entry::Entered
        } else {
            // Whoever is observed later takes part: what it does then is counted with this step.
            let later = |agent| {
                let sources = self.sources.outcomes.iter().zip(&present);
                sources
                    .into_iter()
                    .any(|(of, there)| *there && of.agent == Some(agent))
            };
            let key = oldest.key.as_ref().expect("what fits has a key");
            let acts = &oldest.actions;
            self.rule
                .entry_of(key, acts, |agent| acts[agent].is_some() || later(agent))
        };

        let Held { step, .. } = self.held.pop_front()?;
        let is_observed = present.iter().any(|there| *there);
        let is_all = present.iter().all(|there| *there);
        Some(Record {
            actions_present: step.acts,
            outcomes: if is_observed { outcomes } else { Vec::new() },
            outcomes_present: if is_observed && !is_all {
                present
            } else {
                Vec::new()
            },
            entry,
            ..Record::new(step.state, step.actions)
        })
    }
}

impl Sources {
    fn of_schema(schema: &Schema) -> Self {
        let actions = action_values(schema);
        let (mut slot, mut observed) = (0, 0);
        let source = |outcome: &Outcome| {
            let values = match outcome.agent {
                Some(agent) => actions[agent].clone(),
                None => observed..observed + outcome.value.len(),
            };
            let source = Source {
                lag: outcome.lag as usize,
                agent: outcome.agent,
                slot,
                values,
            };
            if outcome.agent.is_none() {
                (slot, observed) = (slot + 1, source.values.end);
            }
            source
        };
        let outcomes: Vec<Source> = schema.outcomes().iter().map(source).collect();

        Self {
            most: outcomes.iter().map(|source| source.lag).max().unwrap_or(0),
            width: outcomes.iter().map(|source| source.values.len()).sum(),
            outcomes,
        }
    }

    /// Returns the values of the outcomes of the first of some steps, zeros where one is missing,
    /// and which are there.
    fn outcomes_of(&self, steps: &VecDeque<Held>) -> (Vec<f32>, Vec<bool>) {
        let mut values = Vec::with_capacity(self.width);
        let mut present = Vec::with_capacity(self.outcomes.len());
        for source in &self.outcomes {
            let found = steps.get(source.lag).and_then(|step| source.found(step));
            present.push(found.is_some());
            match found {
                Some(found) => values.extend(found),
                None => values.resize(values.len() + source.values.len(), 0.0),
            }
        }
        (values, present)
    }
}

impl Source {
    /// Returns the value that a step has, where it has one.
    fn found<'a>(&self, held: &'a Held) -> Option<&'a [f32]> {
        match self.agent {
            Some(agent) => {
                held.actions[agent]?;
                held.step.actions.get(self.values.clone())
            }
            None => {
                let is_there = held.step.is_observed.get(self.slot).copied();
                is_there
                    .unwrap_or(true)
                    .then(|| held.step.observed.get(self.values.clone()))?
            }
        }
    }
}

impl Held {
    fn new(step: Step, schema: &Schema) -> Self {
        let key = schema.key_of_values(&step.state).ok();
        let mut is_misfit = key.is_none();

        let mut first = 0;
        let mut action = |(at, agent): (usize, &Agent)| {
            let values = first..first + agent.action.len();
            first = values.end;
            if !step.acts.get(at).copied().unwrap_or(true) {
                return None;
            }
            let action = step
                .actions
                .get(values)
                .and_then(|values| index(agent, values));
            is_misfit |= action.is_none();
            action
        };
        let actions = schema
            .agents()
            .iter()
            .enumerate()
            .map(&mut action)
            .collect();

        Self {
            step,
            key,
            actions,
            is_misfit,
        }
    }
}

/// Returns which of a step's action values are whose, in the order of the agents.
pub(super) fn action_values(schema: &Schema) -> Vec<Range<usize>> {
    let mut first = 0;
    let values = |agent: &Agent| {
        let values = first..first + agent.action.len();
        first = values.end;
        values
    };
    schema.agents().iter().map(values).collect()
}

/// Returns the action of these values; `None` where one has no bin.
fn index(agent: &Agent, values: &[f32]) -> Option<u64> {
    let mut features = agent.action.iter().zip(values);
    features.try_fold(0, |action, (feature, value)| {
        let bin = feature.kind.bin(*value).ok()?;
        Some(action * u64::from(feature.kind.bins()) + u64::from(bin))
    })
}

#[cfg(test)]
mod tests;
