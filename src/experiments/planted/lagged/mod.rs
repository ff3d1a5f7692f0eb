//! Leaders and followers (lagged, directed dependence): what evidence makes of an agent that copies
//! another some steps later, at every lag and in both directions, where actions are held and where
//! they are not.
//!
//! The evidence is asked by itself, given the other's own action the step before it is observed
//! (transfer entropy's form), on as many draws of each state at every lag.

mod figure;
mod options;
mod plot;
mod report;
mod targets;

pub use figure::{Case, Figure};
pub use options::{DRAWS, MOST_LAG, Options, World, asked, named};
pub use plot::plot;
pub use report::Report;
pub use targets::{Findings, Target};

use rayon::prelude::*;

use crate::evidence::{Fitter, Prior, Uses};
use crate::experiments::findings;
use crate::information::{Alphabet, Table, p_value};
use crate::simulation::planted::lagged::{Asked, Counted, Draws, Tracks};

/// Permutations of a test.
const PERMUTATIONS: u64 = 199;

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

type Measured = findings::Measured<Asked, Figure>;

impl World {
    /// Draws the world and measures what is said of it at each lag in both directions.
    fn measured(&self, seed: u64) -> Measured {
        let counted = self.counted(Draws::Renewed, seed);
        // What it was before entries had to be drawn anew is told where states are come by often.
        let entered = self.drawn.roams.map(|_| self.counted(Draws::Entered, seed));

        let cases: Vec<Vec<Case>> = asked()
            .par_iter()
            .map(|asked| self.cases(&counted, entered.as_ref(), *asked))
            .collect();
        figure::measure(&asked(), &cases)
    }

    fn counted(&self, draws: Draws, seed: u64) -> Counted {
        let options = self.options(seed);
        let tracks = Tracks::new(self.drawn, options);
        Counted::of_tracks(tracks, &options, draws, [DRAWS, MOST_LAG])
    }

    fn cases(&self, counted: &Counted, entered: Option<&Counted>, asked: Asked) -> Vec<Case> {
        let letters = self.options(0).letters as u64;
        let tables: Vec<Vec<Table>> = (0..self.states)
            .map(|state| counted.tables(state, asked))
            .collect();
        let prior = fitted(letters, &tables);
        let tested = |tables: &[Table], state: usize| p_value(tables, PERMUTATIONS, state as u64);

        let case = |(state, tables): (usize, &Vec<Table>)| Case {
            is_near: state < self.near(),
            dependent: prior.dependent(tables),
            p_value: tested(tables, state).p_value,
            p_value_entered: entered
                .map(|entered| tested(&entered.tables(state, asked), state).p_value),
            excess: figure::excess_of(tables),
        };
        tables.iter().enumerate().map(case).collect()
    }
}

/// Fits the prior of all states, each by its tables of one action held fixed each.
fn fitted(letters: u64, states: &[Vec<Table>]) -> Prior {
    let alphabet = Alphabet {
        rows: letters,
        columns: letters,
    };
    let mut uses = Uses::new(alphabet);
    states.iter().for_each(|state| uses.add(state));
    let mut fitter = Fitter::new(alphabet, &uses);
    states.iter().for_each(|state| fitter.add(state));
    Prior::new(&fitter.fit())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::experiments::findings::Bound;
    use crate::experiments::seeds::Seeds;

    fn figure(measured: &Measured, ego: usize, lag: usize, figure: Figure) -> f64 {
        let found = measured
            .iter()
            .find(|(asked, of, _)| (*asked, *of) == (Asked { ego, lag }, figure));
        found.and_then(|(.., value)| *value).expect("defined")
    }

    fn measured(name: &str) -> Measured {
        World {
            drawn: named(name).expect("a world"),
            states: 20,
        }
        .measured(101)
    }

    #[test]
    fn a_copy_is_found_at_its_lag_and_nowhere_else() {
        let measured = measured("copy3");
        assert!(figure(&measured, 0, 3, Figure::Called) >= 0.9);
        for Asked { ego, lag } in asked() {
            let expected = if (ego, lag) == (0, 3) { 1.0 } else { 0.0 };
            assert_eq!(
                figure(&measured, ego, lag, Figure::CalledFar),
                0.0,
                "{ego} {lag}"
            );
            assert_eq!(
                figure(&measured, ego, lag, Figure::Called),
                expected,
                "{ego} {lag}"
            );
        }
        assert_eq!(figure(&measured, 0, 3, Figure::Peak), 1.0);
        assert_eq!(figure(&measured, 0, 4, Figure::Peak), 0.0);
    }

    /// Few states, so that what may be called by chance is bounded over all lags together.
    #[test]
    fn every_kind_of_world_is_within_its_bounds() {
        let names = ["copy1", "copy1-hold3", "none-hold3", "copy3-shuffled"];
        let report = run(
            &Options {
                seeds: Seeds {
                    number: 1,
                    first: 101,
                },
                states: 10,
                worlds: names.map(|name| named(name).expect("a world")).into(),
            },
            || (),
        );

        let mut bounded: BTreeMap<_, (Bound, Vec<f64>)> = BTreeMap::new();
        for target in report.targets() {
            let of = (
                target.world.drawn.name,
                target.method.ego,
                target.figure.as_str(),
            );
            let (_, measured) = bounded.entry(of).or_insert((target.bound, Vec::new()));
            measured.push(target.measured.expect("defined"));
        }
        for name in names {
            assert!(bounded.keys().any(|(world, ..)| *world == name), "{name}");
        }
        for (of, (bound, measured)) in bounded {
            let mean = measured.iter().sum::<f64>() / measured.len() as f64;
            assert!(bound.holds(mean), "{of:?}: {mean}, expected {bound:?}");
        }
    }

    #[test]
    fn actions_that_are_held_make_nothing_of_nothing() {
        let measured = measured("none-kept90-here");
        for Asked { ego, lag } in asked() {
            assert!(
                figure(&measured, ego, lag, Figure::CalledOfAll) <= 0.08,
                "{ego} {lag}"
            );
        }
        let lags = asked().into_iter();
        let significant =
            lags.map(|asked| figure(&measured, asked.ego, asked.lag, Figure::Significant));
        let significant = significant.sum::<f64>() / asked().len() as f64;
        assert!(significant <= 0.08, "{significant}");

        let before = figure(&measured, 0, 0, Figure::SignificantIfEntered);
        assert!(before >= 0.7, "{before} as it was before");
    }
}
