//! Acceptance targets: what the experiment must show, beside what it did.

use super::{Figure, Method, Options, World};
use crate::experiments::findings::{self, Bound};
use crate::simulation::planted::{Arm, Generator};

/// Everything that was found.
pub type Findings = findings::Findings<World, Method, Figure>;

/// A figure, where it has to lie and where it does.
pub type Target = findings::Target<World, Method, Figure>;

/// The share of `influences` that is right, at least: a quarter may be wrong.
pub(super) const RIGHT: f64 = 0.75;

/// So many calls, over all seeds, make a share of them.
pub(super) const CALLS: f64 = 20.0;

type Bounds = (Method, Figure, fn(f64) -> Bound, [f64; 3]);

/// For G1, G2 and G3: 2,500 states of which 30 % have influence, seen between once and 500 times;
/// means over ten seeds and more.
const TARGETS: [Bounds; 7] = [
    (
        Method::SpikeAndSlab,
        Figure::AucPlanted,
        Bound::AtLeast,
        [0.84, 0.91, 0.88],
    ),
    (
        Method::SpikeAndSlab,
        Figure::F1,
        Bound::AtLeast,
        [0.43, 0.63, 0.50],
    ),
    (
        Method::SpikeAndSlab,
        Figure::Rmse,
        Bound::AtMost,
        [0.139, 0.196, 0.154],
    ),
    (
        Method::SpikeAndSlab,
        Figure::Coverage,
        Bound::AtLeast,
        [0.90; 3],
    ),
    (
        Method::SpikeAndSlab,
        Figure::CoverageDependent,
        Bound::AtLeast,
        [0.90; 3],
    ),
    (
        Method::SpikeAndSlab,
        Figure::Precision,
        Bound::AtLeast,
        [RIGHT; 3],
    ),
    (
        Method::Permutation,
        Figure::FalseAlarms,
        Bound::AtMost,
        [0.052; 3],
    ),
];

/// Returns every target beside what was measured; that of precision only where enough is called to
/// tell.
pub(super) fn targets(options: &Options, findings: &Findings) -> Vec<Target> {
    let of = |(method, figure, bound, bounds): Bounds| {
        Generator::USUAL
            .into_iter()
            .zip(bounds)
            .filter_map(move |(generator, at)| {
                let world = options.compared(generator, Arm::Plain);
                let measured = findings
                    .find(&world, method, figure)
                    .map(|spread| spread.mean);
                let told = is_told(findings, &world, method, figure);
                told.then_some(Target {
                    world,
                    method,
                    figure,
                    bound: bound(at),
                    measured,
                })
            })
    };
    TARGETS.into_iter().flat_map(of).collect()
}

/// Returns whether a figure says something: precision only where enough was called over all seeds.
pub(super) fn is_told(findings: &Findings, world: &World, method: Method, figure: Figure) -> bool {
    if figure != Figure::Precision {
        return true;
    }
    let called = findings.find(world, method, Figure::Called);
    called.is_some_and(|share| {
        (share.mean * world.states as f64 * share.seeds as f64).round() >= CALLS
    })
}
