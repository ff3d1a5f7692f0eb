//! Acceptance targets: what the experiment must show, beside what it did.

use super::{Figure, Method, ResponseModel, World};
use crate::experiments::findings::{self, Bound};

/// Everything that was found.
pub type Findings = findings::Findings<World, Method, Figure>;

/// A figure, where it has to lie and where it does.
pub type Target = findings::Target<World, Method, Figure>;

/// Where the other yields; means over five seeds and more.
const YIELDING: [(Method, Figure, Bound); 2] = [
    (Method::Joint, Figure::Auroc, Bound::AtLeast(0.98)),
    (Method::Joint, Figure::F1, Bound::AtLeast(0.85)),
];

/// Everywhere: where nothing depends on anything, no state is called, whatever the seed.
const NOTHING: (Method, Figure, Bound) = (Method::Shuffled, Figure::Called, Bound::AtMost(0.0));

/// Returns every target beside what was measured.
pub(super) fn targets(worlds: impl Iterator<Item = World>, findings: &Findings) -> Vec<Target> {
    let of = |world: World| {
        let yielding = YIELDING
            .into_iter()
            .filter(move |_| world.response_model == ResponseModel::Yield);
        yielding
            .chain([NOTHING])
            .map(move |(method, figure, bound)| {
                let measured = findings
                    .find(&world, method, figure)
                    .map(|spread| spread.mean);
                Target {
                    world,
                    method,
                    figure,
                    bound,
                    measured,
                }
            })
    };
    worlds.flat_map(of).collect()
}
