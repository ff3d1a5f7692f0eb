//! Acceptance targets: what must be shown in hard worlds, beside what was.

use super::{METHOD, Options};
use crate::experiments::findings::Bound;
use crate::experiments::planted::targets::{RIGHT, is_told};
use crate::experiments::planted::{Figure, Findings, Target, World};
use crate::simulation::planted::Generator;

/// Returns every target beside what was measured. Where a figure is of states that a world has none
/// of, nothing was to be shown.
pub(super) fn targets(options: &Options, findings: &Findings) -> Vec<Target> {
    let targets = |world: World| {
        bounds(world.generator)
            .into_iter()
            .filter_map(move |bound| target(findings, world, bound))
    };
    options.worlds().into_iter().flat_map(targets).collect()
}

fn target(findings: &Findings, world: World, (figure, bound): (Figure, Bound)) -> Option<Target> {
    let measured = findings.find(&world, METHOD, figure)?.mean;
    let told = is_told(findings, &world, METHOD, figure);
    told.then_some(Target {
        world,
        method: METHOD,
        figure,
        bound,
        measured: Some(measured),
    })
}

/// Where the figures of a world have to lie; means over ten seeds and more.
fn bounds(generator: Generator) -> Vec<(Figure, Bound)> {
    let error = most_error(generator).map(|most| (Figure::Rmse, Bound::AtMost(most)));
    let [covered, excluded] = [least_covered(generator), most_excluded(generator)];

    // Evidence does not tell segments apart: where their habits differ, the pooled counts do depend
    // on each other.
    let established = (generator != Generator::Segments)
        .then_some((Figure::EstablishedIfIndependent, Bound::AtMost(0.01)));
    let everywhere = [
        (Figure::CoverageDependent, Bound::AtLeast(covered)),
        (Figure::ExcludedIfDependent, Bound::AtMost(excluded)),
        (Figure::Precision, Bound::AtLeast(RIGHT)),
        (Figure::DecidedByMany, Bound::AtLeast(0.99)),
        (Figure::WrongByMany, Bound::AtMost(0.01)),
        (Figure::UndecidedByFew, Bound::AtLeast(0.99)),
    ];

    error
        .into_iter()
        .chain(established)
        .chain(everywhere)
        .collect()
}

/// Returns the largest error: a tenth above that of a prototype on the same kinds of worlds, where
/// it was measured.
fn most_error(generator: Generator) -> Option<f64> {
    match generator {
        Generator::TwoByTwo => Some(0.048),
        Generator::ThreeByTwentyFive => Some(0.196),
        Generator::Rare => Some(0.036),
        Generator::EpsilonGreedy => Some(0.069),
        Generator::Stay95 => Some(0.026),
        Generator::Stay25 => Some(0.066),
        Generator::Copy(6) => Some(0.384),
        Generator::Answer64 => Some(0.352),
        Generator::Weak(25) => Some(0.0055),
        Generator::Weak(64) => Some(0.0066),
        _ => None,
    }
}

/// Returns how often the 90 % interval of a dependent state holds the truth, at least.
fn least_covered(generator: Generator) -> f64 {
    match generator {
        Generator::Copy(_) | Generator::Answer64 => 0.87,
        Generator::Weak(25) => 0.85,
        Generator::Weak(64) => 0.78,
        _ => 0.90,
    }
}

/// Returns the largest share of dependent states whose dependence is excluded.
fn most_excluded(generator: Generator) -> f64 {
    if generator == Generator::Rare {
        0.10
    } else {
        0.03
    }
}
