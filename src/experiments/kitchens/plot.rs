//! The plot: how well each method finds influence in states that were never counted.

use super::{Figure, Method, Report, World};
use crate::experiments::dots::{BLUE, Dots, Mark, Panel, Shape, VERMILION};

/// The figures of a row, from the top.
const FIGURES: [Figure; 2] = [Figure::Auroc, Figure::F1];

/// What stands for each of them.
const MARKS: [Mark<'_>; 2] = [
    (Shape::Disc, BLUE, "area under the ROC curve"),
    (
        Shape::Triangle,
        VERMILION,
        "F1 of what is called at P >= 0.5",
    ),
];

/// The height of a row of panels, in pixels.
const HEIGHT: u32 = 300;

/// Draws the report as SVG.
pub fn plot(report: &Report) -> String {
    let layouts = report.options.layouts.len() as u32;
    Dots {
        title: format!(
            "Influence in states that were never counted, mean and sd over {}",
            report.options.seeds
        ),
        size: (1_140, 74 + HEIGHT * layouts),
        rows: &Method::ALL.map(Method::as_str),
        marks: &MARKS,
        dashed: (0.5, "chance, for the area"),
        range: 0.0..1.0,
        beside: report.options.response_models.len(),
        panels: report
            .worlds
            .iter()
            .map(|(world, _)| panel(report, world))
            .collect(),
    }
    .svg()
}

fn panel(report: &Report, world: &World) -> Panel {
    let row = |method| {
        FIGURES
            .map(|figure| report.findings.find(world, method, figure))
            .to_vec()
    };
    Panel {
        caption: format!(
            "{}: {}",
            world.layout.as_str(),
            world.response_model.as_str().replace('_', " ")
        ),
        rows: Method::ALL.map(row).to_vec(),
    }
}
