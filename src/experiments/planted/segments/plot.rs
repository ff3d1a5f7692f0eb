//! The plot: how often dependence is established that is not there, world by world.

use super::{Figure, Report, VISITS, Within, World};
use crate::experiments::dots::{BLUE, Dots, Mark, Panel, Shape, VERMILION};
use crate::simulation::planted::segments as drawn;

/// What stands for each number of visits.
const MARKS: [Mark<'_>; 2] = [
    (Shape::Disc, BLUE, "30 visits a state"),
    (Shape::Triangle, VERMILION, "150 visits"),
];

/// The heights of a row and of everything else, in pixels.
const ROW: u32 = 24;
const REST: u32 = 150;

/// Draws the report as SVG.
pub fn plot(report: &Report) -> String {
    let worlds = &report.options.worlds;
    let rows: Vec<&str> = worlds.iter().map(|world| world.name).collect();
    Dots {
        title: format!(
            "Which independent states are called dependent? Mean and sd over {}",
            report.options.seeds
        ),
        size: (760, REST + ROW * rows.len() as u32),
        rows: &rows,
        marks: &MARKS,
        dashed: (0.01, "one in a hundred"),
        range: -0.03..1.0,
        beside: 1,
        panels: vec![panel(report, worlds)],
    }
    .svg()
}

fn panel(report: &Report, worlds: &[drawn::World]) -> Panel {
    let share = |drawn: drawn::World, visits| {
        let world = World {
            drawn,
            visits,
            states: report.options.states,
        };
        report
            .findings
            .find(&world, Within::JUDGED, Figure::EstablishedIfIndependent)
    };
    let row = |drawn: &drawn::World| VISITS.map(|visits| share(*drawn, visits)).to_vec();
    let caption = format!("share of independent states, {}", Within::JUDGED.as_str());

    Panel {
        caption,
        rows: worlds.iter().map(row).collect(),
    }
}
