//! What the experiment must show, beside what it did.

use super::{Decision, Figure, Manner, World};
use crate::experiments::findings::{self, Bound};

/// Everything that was found.
pub type Findings = findings::Findings<World, Decision, Figure>;

/// A figure, where it has to lie and where it does.
pub type Target = findings::Target<World, Decision, Figure>;

/// Where the other yields; means over five seeds and more.
const YIELDING: [(Decision, Figure, Bound); 2] = [
    (Decision::Joint, Figure::Auroc, Bound::AtLeast(0.98)),
    (Decision::Joint, Figure::F1, Bound::AtLeast(0.85)),
];

/// Everywhere: where nothing depends on anything, no state is called, whatever the seed.
const NOTHING: (Decision, Figure, Bound) = (Decision::Shuffled, Figure::Called, Bound::AtMost(0.0));

/// Returns every target beside what was measured.
pub(super) fn targets(worlds: impl Iterator<Item = World>, findings: &Findings) -> Vec<Target> {
    let of = |world: World| {
        let yielding = YIELDING
            .into_iter()
            .filter(move |_| world.manner == Manner::Yield);
        yielding
            .chain([NOTHING])
            .map(move |(decision, figure, bound)| {
                let measured = findings
                    .find(&world, decision, figure)
                    .map(|spread| spread.mean);
                Target {
                    world,
                    decision,
                    figure,
                    bound,
                    measured,
                }
            })
    };
    worlds.flat_map(of).collect()
}
