//! Stratified worlds: what evidence makes of states whose visits come in segments, where habits may
//! differ between them.
//!
//! Everything else here asks a service. This asks the evidence by itself, so that ways to treat
//! segments can be held to the same targets before a question can name them: [`Within`] lists the
//! ways, [`Engine`] is what each of them must answer.

mod engine;
mod figure;
mod options;
mod plot;
mod report;
mod targets;

pub use engine::{Engine, Pooled, Said, Within};
pub use figure::{Case, Figure, measure};
pub use options::{FDR, Options, VISITS, World, named};
pub use plot::plot;
pub use report::Report;
pub use targets::{Findings, Target};

use rayon::prelude::*;

use crate::experiments::findings;
use crate::information::{Table, p_value, smallest_p};
use crate::simulation::planted::segments as drawn;

/// Permutations for every state, and for those that may be listed then.
const PERMUTATIONS: [u64; 2] = [199, 1_999];

/// Runs the experiment; `done` is called after each world of each seed.
pub fn run(options: &Options, mut done: impl FnMut()) -> Report {
    let mut of_world = |world: World| {
        let mut of_seed = |seed| {
            let measured = world.measured(seed);
            done();
            measured
        };
        let of_seeds: Vec<Measured> = options.seeds.iter().map(&mut of_seed).collect();
        findings::over_seeds(world, &of_seeds)
    };
    let findings = options
        .worlds()
        .into_iter()
        .flat_map(&mut of_world)
        .collect();
    Report {
        options: options.clone(),
        findings: findings::Findings(findings),
    }
}

type Measured = findings::Measured<Within, Figure>;

impl World {
    /// Draws the world and measures what is said of it in each way.
    fn measured(&self, seed: u64) -> Measured {
        let usual = drawn::Options::default();
        let states = drawn::states(
            &self.drawn,
            &drawn::Options {
                states: self.states,
                visits: self.visits,
                seed,
                ..usual
            },
        );
        let cut: Vec<Vec<Table>> = states.iter().map(drawn::State::cut).collect();
        let p_values: Vec<Option<f64>> = cut
            .par_iter()
            .enumerate()
            .map(|(at, cut)| tested(cut, at as u64))
            .collect();

        let measured = |within: Within| {
            let said = within.ask(self.drawn.alphabet, &cut);
            let case = |((state, said), p_value): ((&drawn::State, Said), &Option<f64>)| Case {
                information: state.information,
                said,
                p_value: *p_value,
            };
            let cases: Vec<Case> = states.iter().zip(said).zip(&p_values).map(case).collect();
            measure(&cases)
                .into_iter()
                .map(move |(figure, value)| (within, figure, value))
        };
        Within::ALL.into_iter().flat_map(measured).collect()
    }
}

/// Returns the p-value of independence within segments; `None` where no counts at these margins
/// could be listed (Tarone 1990).
fn tested(cut: &[Table], seed: u64) -> Option<f64> {
    let p_value = |permutations| p_value(cut, permutations, seed).p_value;
    (smallest_p(cut) <= FDR).then(|| {
        let first = p_value(PERMUTATIONS[0]);
        if first <= FDR {
            p_value(PERMUTATIONS[1])
        } else {
            first
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::planted::segments::WORLDS;

    fn world(name: &str, visits: usize) -> World {
        World {
            drawn: named(name).expect("a world"),
            visits,
            states: 120,
        }
    }

    fn figure(world: World, figure: Figure) -> f64 {
        let measured = world.measured(1);
        let found = measured
            .into_iter()
            .find(|(within, of, _)| (*within, *of) == (Within::Pooled, figure));
        found.and_then(|(.., value)| value).expect("defined")
    }

    #[test]
    fn pooled_evidence_is_fooled_by_opposite_habits() {
        assert!(figure(world("opposite", 150), Figure::EstablishedIfIndependent) > 0.5);
        assert!(figure(world("opposite", 150), Figure::Listed) > 60.0);
        assert_eq!(figure(world("opposite", 150), Figure::ListedByP), 0.0);
    }

    #[test]
    fn pooled_evidence_is_right_where_segments_do_not_matter() {
        assert!(figure(world("alike", 150), Figure::EstablishedIfIndependent) <= 0.01);
        assert!(figure(world("alike-some", 150), Figure::Recall) > 0.5);
        assert!(figure(world("alike-some", 150), Figure::Covered) > 0.8);
    }

    #[test]
    fn every_world_is_seen_rarely_and_often() {
        let worlds = Options::default().worlds();
        assert_eq!(worlds.len(), VISITS.len() * WORLDS.len());
        for world in WORLDS {
            let visits: Vec<usize> = worlds
                .iter()
                .filter(|of| of.drawn == world)
                .map(|of| of.visits)
                .collect();
            assert_eq!(visits, VISITS);
        }
    }

    #[test]
    fn what_cannot_pass_is_not_tested() {
        let single = Table::from_counts([(0, 0, 1)]);
        assert_eq!(tested(&vec![single; 300], 1), None);
        let copied = Table::from_counts([(0, 0, 9), (1, 1, 9)]);
        assert!(tested(&[copied], 1).is_some_and(|p| p < 0.001));
    }
}
