//! The ground truth of a world: real visits, and what both players do in each state by design.

use std::collections::BTreeMap;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::ResponseModel;
use super::policy::{ACTIONS, Policy};
use super::visits::{Situation, Visits};
use crate::domain::{Record, Rule, SchemaDraft};
use crate::simulation::planted::information;

/// The ground truth of a state.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// As the environment takes it.
    pub values: Vec<f32>,
    /// What the ego does.
    pub ego: Policy,
    /// What the other does after each of the ego's actions.
    pub responses: [Policy; ACTIONS],
    /// Whether the other answers the ego.
    pub is_answered: bool,
    /// Mutual information of their actions, in nats.
    pub information: f64,
}

/// Actions of the ego and of the other.
pub type Actions = [usize; 2];

/// A world with its ground truth.
pub struct Scene {
    /// How its states and actions are described.
    pub schema: SchemaDraft,
    /// Every state of the recordings.
    pub states: Vec<State>,
    /// The states of the training games, step after step, as far as they are counted.
    pub train: Vec<usize>,
    /// The states that only the test games have, each with its time steps there: what is asked
    /// about.
    pub unseen: Vec<(usize, usize)>,
}

impl Scene {
    /// Makes the scene of visits of which so many steps are counted. What is unseen does not depend
    /// on that.
    pub fn of_visits(visits: &Visits, response_model: ResponseModel, steps: Option<usize>) -> Self {
        let states = visits
            .situations
            .iter()
            .map(|situation| planted_state(situation, visits, response_model))
            .collect();

        let mut unseen: BTreeMap<usize, usize> = BTreeMap::new();
        visits
            .test
            .iter()
            .for_each(|state| *unseen.entry(*state).or_default() += 1);

        for state in &visits.train {
            unseen.remove(state);
        }

        let train = visits
            .train
            .iter()
            .copied()
            .take(steps.unwrap_or(usize::MAX))
            .collect();

        Self {
            schema: visits.schema.clone(),
            states,
            train,
            unseen: unseen.into_iter().collect(),
        }
    }

    /// Draws the actions of every step of the training games.
    pub fn draw(&self, seed: u64) -> Vec<Actions> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut step = |at: &usize| {
            let State { ego, responses, .. } = &self.states[*at];
            let action = pick(ego, &mut random);
            [action, pick(&responses[action], &mut random)]
        };
        self.train.iter().map(&mut step).collect()
    }

    /// Returns the same with the other's actions shuffled within each state: every habit stays, and
    /// nothing depends on anything.
    pub fn shuffled(&self, drawn: &[Actions], seed: u64) -> Vec<Actions> {
        let mut random = Pcg64::seed_from_u64(!seed);
        let mut steps: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        self.train
            .iter()
            .enumerate()
            .for_each(|(step, state)| steps.entry(*state).or_default().push(step));
        let mut shuffled = drawn.to_vec();
        for steps in steps.into_values() {
            let mut others: Vec<usize> = steps.iter().map(|step| drawn[*step][1]).collect();
            others.shuffle(&mut random);
            steps
                .into_iter()
                .zip(others)
                .for_each(|(step, other)| shuffled[step][1] = other);
        }

        shuffled
    }

    /// Returns the steps of the training games with these actions. They have no entry flags:
    /// actions are drawn anew in each step, so that every step is a draw of its own, however long a
    /// stay lasts.
    pub fn records(&self, actions: &[Actions]) -> Vec<Record> {
        let record = |(state, actions): (&usize, &Actions)| {
            Record::new(
                self.states[*state].values.clone(),
                actions.map(|action| action as f32).to_vec(),
            )
        };
        self.train.iter().zip(actions).map(record).collect()
    }

    /// Returns the values of the unseen states.
    pub fn asked(&self) -> Vec<Vec<f32>> {
        self.unseen
            .iter()
            .map(|(state, _)| self.states[*state].values.clone())
            .collect()
    }
}

impl State {
    /// Returns whether mutual information is what the default rule calls influence.
    pub fn is_strong(&self) -> bool {
        self.information > Rule::default().threshold_nats()
    }
}

fn planted_state(situation: &Situation, visits: &Visits, response_model: ResponseModel) -> State {
    let Situation { values, players } = situation;
    let [ego, other] = [0, 1].map(|player| visits.habits[player].policy(&players[player]));
    let responses = response_model.responses(players, &other);
    let joint: Vec<Vec<f64>> = ego
        .iter()
        .zip(responses)
        .map(|(p, row)| row.map(|q| p * q).to_vec())
        .collect();

    let is_answered = response_model.is_answered(players);
    State {
        values: values.clone(),
        ego,
        responses,
        is_answered,
        information: information(&joint),
    }
}

fn pick(policy: &Policy, random: &mut Pcg64) -> usize {
    let mut left = random.random::<f64>();
    let here = |share: &f64| {
        left -= share;
        left < 0.0
    };
    policy.iter().position(here).unwrap_or(ACTIONS - 1)
}

#[cfg(test)]
mod tests;
