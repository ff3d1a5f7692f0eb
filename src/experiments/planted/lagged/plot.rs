//! The plot: the share of near states that are called at each lag, world by world (profiles).

use super::{Figure, MOST_LAG, Report, World};
use crate::experiments::dots::{BLUE, Dots, Mark, Panel, Shape, VERMILION};
use crate::simulation::planted::lagged::Asked;

/// What stands for each direction.
const MARKS: [Mark<'_>; 2] = [
    (Shape::Disc, BLUE, "leader to follower"),
    (Shape::Triangle, VERMILION, "follower to leader"),
];

/// The width of a panel, the heights of a row and of everything above a panel, in pixels.
const PANEL: u32 = 300;
const ROW: u32 = 22;
const REST: u32 = 110;

/// Panels beside each other.
const BESIDE: usize = 3;

/// Draws the report as SVG.
pub fn plot(report: &Report) -> String {
    let worlds = report.options.worlds();
    let rows: Vec<String> = (0..=MOST_LAG).map(|lag| format!("lag {lag}")).collect();
    let rows: Vec<&str> = rows.iter().map(String::as_str).collect();
    let below = worlds.len().div_ceil(BESIDE) as u32;
    Dots {
        title: format!(
            "How much later does the follower copy? States called, mean and sd over {}",
            report.options.seeds
        ),
        size: (
            120 + PANEL * BESIDE as u32,
            80 + below * (REST + ROW * rows.len() as u32),
        ),
        rows: &rows,
        marks: &MARKS,
        dashed: (0.9, "nine in ten"),
        range: -0.05..1.05,
        beside: BESIDE,
        panels: worlds.iter().map(|world| panel(report, world)).collect(),
    }
    .svg()
}

fn panel(report: &Report, world: &World) -> Panel {
    let called = |ego, lag| {
        report
            .findings
            .find(world, Asked { ego, lag }, Figure::Called)
    };
    let row = |lag| [0, 1].map(|ego| called(ego, lag)).to_vec();
    Panel {
        caption: world.drawn.name.to_owned(),
        rows: (0..=MOST_LAG).map(row).collect(),
    }
}
