//! The plot: how well each method tells states with influence from others, beside the arms in
//! which there is less to go by, or nothing.

use std::ops::Range;

use super::{Figure, Method, Report, World, generator_name};
use crate::experiments::dots::{BLUE, Dots, GREY, Mark, Panel, Shape, VERMILION, within_sd};
use crate::experiments::findings::Finding;
use crate::simulation::planted::{Arm, Generator};

/// Decisions with a score, from the top.
const ROWS: [Method; 5] = [
    Method::PlugIn,
    Method::Excess,
    Method::Nsb,
    Method::Permutation,
    Method::SpikeAndSlab,
];

/// The arms of a row, from the top.
const ARMS: [Arm; 3] = [Arm::Plain, Arm::LeakFree, Arm::Shuffled];

/// What stands for each of them.
const MARKS: [Mark<'_>; 3] = [
    (Shape::Disc, BLUE, "as drawn"),
    (Shape::Triangle, VERMILION, "margins give nothing away"),
    (
        Shape::Ring,
        GREY,
        "the other's actions shuffled: nothing to find",
    ),
];

/// Draws the report as SVG.
pub fn plot(report: &Report) -> String {
    let seeds = report.options.seeds;
    Dots {
        title: format!(
            "Which states have influence? Area under the ROC curve, mean and sd over {seeds}"
        ),
        size: (1_140, 430),
        rows: &ROWS.map(Method::as_str),
        marks: &MARKS,
        dashed: (0.5, "chance"),
        range: areas(report),
        beside: Generator::USUAL.len(),
        panels: Generator::USUAL
            .map(|generator| panel(report, generator))
            .into(),
    }
    .svg()
}

fn panel(report: &Report, generator: Generator) -> Panel {
    let letters = generator.alphabet().rows;
    let area = |method, arm| {
        report.findings.find(
            &report.options.compared(generator, arm),
            method,
            Figure::AucPlanted,
        )
    };
    Panel {
        caption: format!(
            "{}: {letters} x {letters} actions",
            generator_name(generator)
        ),
        rows: ROWS
            .map(|method| ARMS.map(|arm| area(method, arm)).to_vec())
            .to_vec(),
    }
}

/// Returns what is shown: chance, 1, and a little below the lowest of all.
fn areas(report: &Report) -> Range<f64> {
    let compared =
        |finding: &&Finding<World, Method, Figure>| finding.world.states == report.options.states;
    let areas = report
        .findings
        .0
        .iter()
        .filter(compared)
        .filter(|finding| finding.figure == Figure::AucPlanted);

    let lowest = areas
        .map(|finding| within_sd(finding.spread)[0])
        .fold(0.5, f64::min);
    lowest - 0.03..1.0
}
