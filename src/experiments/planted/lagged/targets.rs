//! Acceptance targets: what must be shown of lagged questions, beside what was.

use super::{Figure, Options, World, asked};
use crate::experiments::findings::{self, Bound};
use crate::simulation::planted::lagged::{Asked, Hold};

/// Everything that was found.
pub type Findings = findings::Findings<World, Asked, Figure>;

/// A figure, where it has to lie and where it does.
pub type Target = findings::Target<World, Asked, Figure>;

/// How much must be found at the planted lag.
const FOUND: Bound = Bound::AtLeast(0.9);

/// The most states that are called where nothing is to be found.
const CHANCE: Bound = Bound::AtMost(0.08);

/// The most that is called in the reverse direction.
const REVERSE: Bound = Bound::AtMost(0.05);

/// Returns every target beside what was measured.
pub(super) fn targets(options: &Options, findings: &Findings) -> Vec<Target> {
    let of_world = |world: World| {
        let asked = asked().into_iter();
        let bounds = asked.flat_map(move |asked| bounds(&world, asked));
        bounds.map(move |(asked, figure, bound)| Target {
            world,
            method: asked,
            figure,
            bound,
            measured: findings.find(&world, asked, figure).map(|of| of.mean),
        })
    };
    options.worlds().into_iter().flat_map(of_world).collect()
}

/// Where the figures of a question have to lie; means over five seeds and more of 40 states.
fn bounds(world: &World, asked: Asked) -> Vec<(Asked, Figure, Bound)> {
    let Asked { ego, lag } = asked;
    let with = |figures: &[(Figure, Bound)]| {
        let bounds = figures.iter();
        bounds
            .map(|(figure, bound)| (asked, *figure, *bound))
            .collect()
    };

    if !world.drawn.is_dependent() {
        let roams = world.drawn.roams.is_some();
        let significant = roams.then_some((Figure::Significant, CHANCE));
        let called = [(Figure::CalledOfAll, CHANCE)];
        return with(&called.into_iter().chain(significant).collect::<Vec<_>>());
    }

    let is_free = world.drawn.hold == Hold::Free;
    match (ego, world.drawn.lag == Some(lag)) {
        (0, true) if is_free => with(&[
            (Figure::Called, FOUND),
            (Figure::CalledFar, CHANCE),
            (Figure::Peak, FOUND),
        ]),
        (0, true) => with(&[(Figure::Called, FOUND), (Figure::Peak, FOUND)]),
        // Where agents hold their actions, neighbouring lags truly depend, and so does lag 0; and
        // the follower goes on in far states with what it copied in near ones.
        (0, false) if is_free => with(&[(Figure::CalledOfAll, CHANCE)]),
        (0, false) => Vec::new(),
        (_, _) if lag == 0 => Vec::new(),
        _ => with(&[(Figure::CalledOfAll, REVERSE)]),
    }
}
