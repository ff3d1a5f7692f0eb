//! Acceptance targets: what must be shown in worlds of segments, beside what was.

use super::{Figure, Options, Within, World};
use crate::experiments::findings::{self, Bound};
use crate::experiments::planted::targets::CALLS;
use crate::simulation::planted::segments::{Dependence, Differ};

/// Everything that was found.
pub type Findings = findings::Findings<World, Within, Figure>;

/// A figure, where it has to lie and where it does.
pub type Target = findings::Target<World, Within, Figure>;

/// Visits from which a state is seen often.
const OFTEN: usize = 150;

/// The most of a list that is false: what was promised, and half as much by chance, for lists have
/// a few hundred states.
const MOST_FALSE: f64 = 0.075;

/// What knowing about segments may cost where they do not matter.
const COST: f64 = 0.005;

/// Returns every target beside what was measured. Where a figure is of states that a world has none
/// of, nothing was to be shown.
pub(super) fn targets(options: &Options, findings: &Findings) -> Vec<Target> {
    let targets = |world: World| {
        let bounds = bounds(&world)
            .into_iter()
            .chain(recall_as_pooled(findings, &world));
        bounds.filter_map(move |bound| target(findings, world, bound))
    };
    options.worlds().into_iter().flat_map(targets).collect()
}

fn target(findings: &Findings, world: World, (figure, bound): (Figure, Bound)) -> Option<Target> {
    let measured = findings.find(&world, Within::JUDGED, figure)?.mean;
    let told = is_told(findings, &world, figure);
    told.then_some(Target {
        world,
        method: Within::JUDGED,
        figure,
        bound,
        measured: Some(measured),
    })
}

/// Returns whether a figure says something: what is false among the established only where they are
/// enough over all seeds.
fn is_told(findings: &Findings, world: &World, figure: Figure) -> bool {
    if figure != Figure::FalselyEstablished {
        return true;
    }
    let established = findings.find(world, Within::JUDGED, Figure::Established);
    established.is_some_and(|number| (number.mean * number.seeds as f64).round() >= CALLS)
}

/// Where the figures of a world have to lie; means over three seeds and more of 200 states.
fn bounds(world: &World) -> Vec<(Figure, Bound)> {
    if world.drawn.dependence == Dependence::Nowhere {
        // Whatever is listed is false: nothing, but by chance.
        return vec![
            (Figure::EstablishedIfIndependent, Bound::AtMost(0.01)),
            (Figure::Listed, Bound::AtMost(1.0)),
            (Figure::ListedByP, Bound::AtMost(1.0)),
        ];
    }

    let often = world.visits >= OFTEN;
    let varied = world.drawn.differ != Differ::Neither;
    let of = |wanted: bool, figure, bound| wanted.then_some((figure, bound));
    let covered = if often { 0.75 } else { 0.85 };
    let shared = world.drawn.dependence == Dependence::Shared;
    let in_one = often && world.drawn.dependence == Dependence::InOne;
    let bounds = [
        of(true, Figure::FalselyEstablished, Bound::AtMost(0.03)),
        of(shared, Figure::Covered, Bound::AtLeast(covered)),
        of(in_one, Figure::Recall, Bound::AtLeast(0.43)),
        of(
            in_one && varied,
            Figure::ExcludedIfDependent,
            Bound::AtMost(0.10),
        ),
        of(true, Figure::FalselyListed, Bound::AtMost(MOST_FALSE)),
        of(true, Figure::FalselyListedByP, Bound::AtMost(MOST_FALSE)),
    ];

    bounds.into_iter().flatten().collect()
}

/// Returns how much must be found where segments do not matter: what is found without them, nearly.
fn recall_as_pooled(findings: &Findings, world: &World) -> Option<(Figure, Bound)> {
    if Within::JUDGED == Within::Pooled || world.drawn.differ != Differ::Neither {
        return None;
    }
    let pooled = findings.find(world, Within::Pooled, Figure::Recall)?.mean;
    Some((Figure::Recall, Bound::AtLeast(pooled - COST)))
}
