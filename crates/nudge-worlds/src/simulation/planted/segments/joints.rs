//! The joint distribution of both agents' actions in each segment of a state.

use rand::RngExt;
use rand_pcg::Pcg64;

use super::habits::{drifting, opposite};
use super::world::{Dependence, Differ, World};
use crate::simulation::planted::joint::{Pull, dirichlet, joint, pulled, pulls};

impl World {
    /// Draws in which segments of a state the other responds to the ego.
    pub(super) fn dependent_segments(&self, is_dependent: bool, rng: &mut Pcg64) -> Vec<usize> {
        match self.dependence {
            _ if !is_dependent => Vec::new(),
            Dependence::Nowhere => Vec::new(),
            Dependence::InOne => vec![rng.random_range(0..self.segments)],
            Dependence::Shared | Dependence::Differing => (0..self.segments).collect(),
        }
    }

    /// Draws the joint distribution of each segment of a state, rows first.
    pub(super) fn joints(&self, dependent: &[usize], rng: &mut Pcg64) -> Vec<Vec<Vec<f64>>> {
        let [rows, columns] =
            [self.alphabet.rows, self.alphabet.columns].map(|letters| letters as usize);
        let egos = self.habits(matches!(self.differ, Differ::Ego | Differ::Both), rows, rng);
        let others = self.habits(
            matches!(self.differ, Differ::Other | Differ::Both),
            columns,
            rng,
        );

        let mut responses = || match self.dependence {
            Dependence::InOne => answers(rows, columns, rng),
            _ => pulls(rows, columns, rng.random_range(2..=rows), rng),
        };
        let shared = responses();
        let mut responses_in = |segment: usize| match self.dependence {
            _ if !dependent.contains(&segment) => Vec::new(),
            Dependence::Differing => responses(),
            _ => shared.clone(),
        };
        let in_segment = |segment: usize| {
            joint(
                &egos[segment],
                &pulled(rows, &others[segment], &responses_in(segment)),
            )
        };
        (0..self.segments).map(in_segment).collect()
    }

    /// Draws the habits of one agent in each segment of a state.
    fn habits(&self, differ: bool, letters: usize, rng: &mut Pcg64) -> Vec<Vec<f64>> {
        match self.differ {
            Differ::Opposite => opposite(self.segments, letters, rng),
            Differ::Drift => drifting(self.segments, letters, rng),
            _ if differ => (0..self.segments)
                .map(|_| dirichlet(1.0, letters, rng))
                .collect(),
            _ => vec![dirichlet(1.0, letters, rng); self.segments],
        }
    }
}

/// Draws a response to every one of the ego's actions, which the other always follows.
fn answers(rows: usize, columns: usize, rng: &mut Pcg64) -> Vec<Pull> {
    (0..rows)
        .map(|action| Pull {
            action,
            share: 1.0,
            response: dirichlet(0.1, columns, rng),
        })
        .collect()
}
