//! What the experiment must show, beside what it did.

use super::{Decision, Figure, Report, World};
use crate::simulation::planted::{Arm, Generator};

/// Where a figure has to lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// At this or above.
    AtLeast(f64),
    /// At this or below.
    AtMost(f64),
}

impl Bound {
    /// Returns whether a figure lies there.
    pub fn holds(self, figure: f64) -> bool {
        match self {
            Self::AtLeast(bound) => figure >= bound,
            Self::AtMost(bound) => figure <= bound,
        }
    }
}

/// A figure, where it has to lie and where it does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Of which world.
    pub world: World,
    /// Of which decision.
    pub decision: Decision,
    /// Which figure.
    pub figure: Figure,
    /// Where it has to lie.
    pub bound: Bound,
    /// Its mean over the seeds, where it is defined.
    pub measured: Option<f64>,
}

impl Target {
    /// Returns whether it is met.
    pub fn is_met(&self) -> bool {
        self.measured.is_some_and(|measured| self.bound.holds(measured))
    }
}

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
        Generator::ALL.into_iter().zip(bounds).map(move |(generator, at)| {
            let world = report.options.compared(generator, Arm::Plain);
            let measured = report.find(&world, decision, figure).map(|spread| spread.mean);
            Target { world, decision, figure, bound: bound(at), measured }
        })
    };
    TARGETS.into_iter().flat_map(of).collect()
}
