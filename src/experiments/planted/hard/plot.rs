//! The plot: how often the 90 % interval holds the truth, world by world.

use super::{METHOD, Report, name};
use crate::experiments::dots::{BLUE, Dots, Mark, Panel, Shape, VERMILION, within_sd};
use crate::experiments::planted::{Figure, World};

/// The figures of a row, from the top.
const FIGURES: [Figure; 2] = [Figure::Coverage, Figure::CoverageDependent];

/// What stands for each of them.
const MARKS: [Mark<'_>; 2] = [
    (Shape::Disc, BLUE, "all states"),
    (Shape::Triangle, VERMILION, "dependent states"),
];

/// The heights of a row and of everything else, in pixels.
const ROW: u32 = 32;
const REST: u32 = 150;

/// Draws the report as SVG.
pub fn plot(report: &Report) -> String {
    let worlds = report.options.worlds();
    let rows: Vec<&str> = worlds.iter().map(name).collect();
    Dots {
        title: format!(
            "Does the 90 % interval hold the truth? Mean and sd over {}",
            report.options.seeds
        ),
        size: (760, REST + ROW * rows.len() as u32),
        rows: &rows,
        marks: &MARKS,
        dashed: (0.9, "nine times in ten"),
        range: lowest(report) - 0.03..1.0,
        beside: 1,
        panels: vec![panel(report, &worlds)],
    }
    .svg()
}

fn panel(report: &Report, worlds: &[World]) -> Panel {
    let row = |world: &World| {
        FIGURES
            .map(|figure| report.findings.find(world, METHOD, figure))
            .to_vec()
    };
    Panel {
        caption: "share of states".into(),
        rows: worlds.iter().map(row).collect(),
    }
}

/// Returns the lowest end of all bars, or one half if that is lower.
fn lowest(report: &Report) -> f64 {
    let shown = report
        .findings
        .0
        .iter()
        .filter(|finding| FIGURES.contains(&finding.figure));
    shown
        .map(|finding| within_sd(finding.spread)[0])
        .fold(0.5, f64::min)
}
