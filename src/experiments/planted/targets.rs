//! What the experiment must show, beside what it did.

use super::{Decision, Figure, Report, World};
use crate::experiments::findings::{self, Bound};
use crate::simulation::planted::{Arm, Generator};

/// A figure, where it has to lie and where it does.
pub type Target = findings::Target<World, Decision, Figure>;

type Bounds = (Decision, Figure, fn(f64) -> Bound, [f64; 3]);

/// For G1, G2 and G3: 2,500 states of which 30 % have influence, seen between once and 500 times; means over ten seeds and more.
const TARGETS: [Bounds; 6] = [
    (Decision::SpikeAndSlab, Figure::AucPlanted, Bound::AtLeast, [0.84, 0.91, 0.88]),
    (Decision::SpikeAndSlab, Figure::F1, Bound::AtLeast, [0.43, 0.63, 0.50]),
    (Decision::SpikeAndSlab, Figure::Rmse, Bound::AtMost, [0.14, 0.20, 0.16]),
    (Decision::SpikeAndSlab, Figure::Coverage, Bound::AtLeast, [0.90; 3]),
    (Decision::SpikeAndSlab, Figure::CoverageDependent, Bound::AtLeast, [0.90; 3]),
    (Decision::Permutation, Figure::FalseAlarms, Bound::AtMost, [0.052; 3]),
];

/// Returns every target beside what was measured.
pub(super) fn targets(report: &Report) -> Vec<Target> {
    let of = |(decision, figure, bound, bounds): Bounds| {
        Generator::USUAL.into_iter().zip(bounds).map(move |(generator, at)| {
            let world = report.options.compared(generator, Arm::Plain);
            let measured = report.findings.find(&world, decision, figure).map(|spread| spread.mean);
            Target { world, decision, figure, bound: bound(at), measured }
        })
    };
    TARGETS.into_iter().flat_map(of).collect()
}
