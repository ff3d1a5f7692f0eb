//! The plot: how well each decision tells states with influence from others, beside the arms in which there is less to go by, or nothing.

use std::ops::Range;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Decision, Figure, Finding, Report, generator_name};
use crate::experiments::measures::Spread;
use crate::simulation::planted::{Arm, Generator};

type Sheet<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Panel<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Trouble = DrawingAreaErrorKind<std::io::Error>;
type Drawn = Result<(), Trouble>;

const SIZE: (u32, u32) = (1_140, 430);

/// Room above the panels for what they have in common, and left of them for the names of the decisions.
const ABOVE: i32 = 74;
const LEFT: i32 = 118;

/// Decisions with a score, from the top.
const ROWS: [Decision; 5] =
    [Decision::PlugIn, Decision::Excess, Decision::Nsb, Decision::Permutation, Decision::SpikeAndSlab];

/// The arms of a row from the top, each with a colour (Okabe & Ito's, which the colour-blind can tell apart), a mark and words.
const ARMS: [(Arm, RGBColor, &str); 3] = [
    (Arm::Plain, RGBColor(0, 114, 178), "as drawn"),
    (Arm::LeakFree, RGBColor(213, 94, 0), "margins give nothing away"),
    (Arm::Shuffled, RGBColor(110, 110, 110), "the other's actions shuffled: nothing to find"),
];

const INK: RGBColor = RGBColor(40, 40, 40);
const RULE: RGBColor = RGBColor(222, 222, 222);

/// Draws the report as SVG.
pub fn plot(report: &Report) -> String {
    let mut svg = String::new();
    draw(report, &SVGBackend::with_string(&mut svg, SIZE).into_drawing_area()).expect("a text takes everything");
    svg
}

fn draw(report: &Report, sheet: &Sheet<'_>) -> Drawn {
    sheet.fill(&WHITE)?;
    let title = format!(
        "Which states have influence? Area under the ROC curve, mean and sd over {}",
        report.options.seeds_told()
    );
    sheet.draw(&Text::new(title, (16, 14), ("sans-serif", 17).into_font().color(&INK)))?;
    legend(sheet)?;
    let panels = sheet.margin(ABOVE, 0, LEFT, 0).split_evenly((1, Generator::ALL.len()));
    let areas = areas(report);
    for (panel, generator) in panels.iter().zip(Generator::ALL) {
        let panel = axes(panel, generator, areas.clone())?;
        for (row, decision) in ROWS.into_iter().enumerate() {
            if generator == Generator::ALL[0] {
                let (_, y) = panel.backend_coord(&(areas.start, height(row)));
                sheet.draw(&Text::new(decision.as_str(), (LEFT - 4, y), words(HPos::Right)))?;
            }
            let at = |area, lane| panel.backend_coord(&(area, height(row) + 0.22 * (1.0 - lane as f64)));
            dots(report, sheet, generator, decision, at)?;
        }
    }
    sheet.present()
}

/// Draws a dot for each arm of a decision, in a lane of its own.
fn dots(
    report: &Report,
    sheet: &Sheet<'_>,
    generator: Generator,
    decision: Decision,
    at: impl Fn(f64, usize) -> (i32, i32),
) -> Drawn {
    for (lane, (arm, colour, _)) in ARMS.into_iter().enumerate() {
        let world = report.options.compared(generator, arm);
        let Some(area) = report.find(&world, decision, Figure::AucPlanted) else { continue };
        let bar = within_sd(area).map(|end| at(end, lane));
        sheet.draw(&PathElement::new(bar, colour.stroke_width(2)))?;
        mark(sheet, at(area.mean, lane), arm, colour)?;
    }
    Ok(())
}

/// Returns what is shown: chance, 1, and a little below the lowest of all.
fn areas(report: &Report) -> Range<f64> {
    let compared = |finding: &&Finding| finding.world.states == report.options.states;
    let areas = report.findings.iter().filter(compared).filter(|finding| finding.figure == Figure::AucPlanted);
    let lowest = areas.map(|finding| within_sd(finding.spread)[0]).fold(0.5, f64::min);
    lowest - 0.03..1.0
}

/// Returns the ends of the bar: no area is beyond 1.
fn within_sd(area: Spread) -> [f64; 2] {
    let sd = area.sd.unwrap_or(0.0);
    [area.mean - sd, (area.mean + sd).min(1.0)]
}

/// The height at which a row's middle lies: the first row is the highest.
fn height(row: usize) -> f64 {
    (ROWS.len() - row) as f64 - 0.5
}

fn axes<'a, 'b>(sheet: &'a Sheet<'b>, generator: Generator, areas: Range<f64>) -> Result<Panel<'a, 'b>, Trouble> {
    let letters = generator.alphabet().rows;
    let caption = format!("{}: {letters} x {letters} actions", generator_name(generator));
    let mut chart = ChartBuilder::on(sheet)
        .caption(caption, ("sans-serif", 15).into_font().color(&INK))
        .margin_left(8)
        .margin_right(16)
        .x_label_area_size(30)
        .build_cartesian_2d(areas, 0.0..ROWS.len() as f64)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .x_labels(6)
        .x_label_formatter(&|area| format!("{area:.1}"))
        .label_style(("sans-serif", 13).into_font().color(&INK))
        .bold_line_style(RULE)
        .light_line_style(TRANSPARENT)
        .axis_style(RULE)
        .draw()?;
    let chance = [(0.5, 0.0), (0.5, ROWS.len() as f64)];
    chart.draw_series(DashedLineSeries::new(chance, 4, 4, INK.stroke_width(1)))?;
    Ok(chart)
}

fn legend(sheet: &Sheet<'_>) -> Drawn {
    let (mut x, y) = (LEFT + 8, 52);
    for (arm, colour, meaning) in ARMS {
        mark(sheet, (x, y), arm, colour)?;
        sheet.draw(&Text::new(meaning, (x + 12, y), words(HPos::Left)))?;
        x += 52 + 6 * meaning.len() as i32;
    }
    sheet.draw(&Text::new("dashed: chance", (x, y), words(HPos::Left)))
}

/// Draws an arm's mark: each has a shape of its own, so that nothing hangs on colour alone.
fn mark(sheet: &Sheet<'_>, at: (i32, i32), arm: Arm, colour: RGBColor) -> Drawn {
    match arm {
        Arm::Plain => sheet.draw(&Circle::new(at, 5, colour.filled())),
        Arm::LeakFree => sheet.draw(&TriangleMarker::new(at, 6, colour.filled())),
        Arm::Shuffled => {
            sheet.draw(&Circle::new(at, 4, WHITE.filled()))?;
            sheet.draw(&Circle::new(at, 4, colour.stroke_width(2)))
        }
    }
}

fn words(side: HPos) -> TextStyle<'static> {
    ("sans-serif", 14).into_font().color(&INK).pos(Pos::new(side, VPos::Center))
}
