//! The plot of lag profiles (SVG): the excess of each lag over the band in which it would lie under
//! independence, one direction or both. What lies outside its band is filled, so that nothing hangs
//! on colour alone.

use std::ops::Range;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::dots::{BLUE, GREY, INK, RULE, VERMILION};

/// Width and height in pixels, and the room above for the title and what the marks mean.
const SIZE: (u32, u32) = (760, 420);
const ABOVE: u32 = 76;
const LEFT: i32 = 20;

/// What is left free above and below what is drawn.
const MARGIN: f64 = 0.1;

/// How much a band covers.
const FAINT: f64 = 0.12;

type Sheet<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Axes<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Trouble = DrawingAreaErrorKind<std::io::Error>;
type Drawn = Result<(), Trouble>;

/// One pair's profile.
pub struct Curve {
    /// Whose action it is of, and on whom: what its marks mean.
    pub name: String,
    /// The lag, its excess, and where that would lie under independence.
    pub points: Vec<(u32, f64, [f64; 2])>,
}

/// Draws profiles of the same unit, at most two that can be told apart.
pub fn plot(title: &str, unit: &str, curves: &[Curve]) -> String {
    let mut svg = String::new();
    let drawn = draw(title, unit, curves, &mut svg);
    drawn.expect("a string takes all that is written to it");
    svg
}

fn draw(title: &str, unit: &str, curves: &[Curve], svg: &mut String) -> Drawn {
    let sheet = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    sheet.fill(&WHITE)?;
    let (above, below) = sheet.split_vertically(ABOVE);
    above.draw(&Text::new(
        title,
        (LEFT, 24),
        words(18).pos(Pos::new(HPos::Left, VPos::Center)),
    ))?;
    legend(&above, curves)?;

    let mut axes = axes(&below, unit, curves)?;
    for curve in curves {
        axes.draw_series([Polygon::new(band(curve), GREY.mix(FAINT))])?;
    }
    let (first, last) = (lags(curves).start, lags(curves).end);
    axes.draw_series(LineSeries::new(
        [(first, 0.0), (last, 0.0)],
        INK.stroke_width(1),
    ))?;
    for ((curve, colour), shape) in curves.iter().zip(COLOURS).zip(SHAPES) {
        let line = curve.points.iter().map(at);
        axes.draw_series(LineSeries::new(line, colour.stroke_width(2)))?;
        for point in &curve.points {
            let place = axes.backend_coord(&at(point));
            mark(&sheet, place, shape, colour, is_outside(point))?;
        }
    }
    sheet.present()
}

/// The colours of the first and the second curve, and the shapes of their marks.
const COLOURS: [RGBColor; 2] = [VERMILION, BLUE];
const SHAPES: [Shape; 2] = [Shape::Disc, Shape::Square];

/// The shape of a mark.
#[derive(Clone, Copy)]
enum Shape {
    Disc,
    Square,
}

fn axes<'a, 'b>(
    area: &'a Sheet<'b>,
    unit: &str,
    curves: &[Curve],
) -> Result<Axes<'a, 'b>, Trouble> {
    let decimals = decimals(&excess(curves));
    let mut axes = ChartBuilder::on(area)
        .margin_left(12)
        .margin_right(20)
        .margin_bottom(8)
        .x_label_area_size(46)
        .y_label_area_size(76)
        .build_cartesian_2d(lags(curves), excess(curves))?;
    axes.configure_mesh()
        .disable_x_mesh()
        .bold_line_style(RULE)
        .light_line_style(TRANSPARENT)
        .axis_style(RULE)
        .x_labels(16)
        .y_labels(7)
        .x_label_formatter(&whole)
        .y_label_formatter(&|excess| format!("{excess:.decimals$}"))
        .label_style(words(14))
        .axis_desc_style(words(15))
        .x_desc("lag: steps from the one's action to the other's")
        .y_desc(format!("excess over independence ({unit})"))
        .draw()?;
    Ok(axes)
}

/// Says what the marks of each curve mean, and what a band is.
fn legend(area: &Sheet<'_>, curves: &[Curve]) -> Drawn {
    const HEIGHT: i32 = 54;
    let said = |text: &str, x: i32| {
        let style = words(15).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(text.to_owned(), (x, HEIGHT), style))
    };
    let mut x = LEFT + 14;
    for ((curve, colour), shape) in curves.iter().zip(COLOURS).zip(SHAPES) {
        let line = [(x - 12, HEIGHT), (x + 12, HEIGHT)];
        area.draw(&PathElement::new(line, colour.stroke_width(2)))?;
        mark(area, (x, HEIGHT), shape, colour, true)?;
        said(&curve.name, x + 20)?;
        x += 58 + 8 * curve.name.chars().count() as i32;
    }
    let swatch = [(x - 14, HEIGHT - 8), (x + 10, HEIGHT + 8)];
    area.draw(&Rectangle::new(swatch, GREY.mix(FAINT).filled()))?;
    said("95 % of chance; filled marks lie outside", x + 20)
}

/// Draws a mark: filled where it says something, else hollow.
fn mark(
    sheet: &Sheet<'_>,
    at: (i32, i32),
    shape: Shape,
    colour: RGBColor,
    is_filled: bool,
) -> Drawn {
    let inside = if is_filled { colour } else { WHITE }.filled();
    let edge = colour.stroke_width(2);
    match shape {
        Shape::Disc => {
            sheet.draw(&Circle::new(at, 5, inside))?;
            sheet.draw(&Circle::new(at, 5, edge))
        }
        Shape::Square => {
            let corners = [(at.0 - 4, at.1 - 4), (at.0 + 4, at.1 + 4)];
            sheet.draw(&Rectangle::new(corners, inside))?;
            sheet.draw(&Rectangle::new(corners, edge))
        }
    }
}

fn words(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

fn at((lag, excess, _): &(u32, f64, [f64; 2])) -> (f64, f64) {
    (f64::from(*lag), *excess)
}

fn is_outside((_, excess, [lower, upper]): &(u32, f64, [f64; 2])) -> bool {
    excess < lower || excess > upper
}

/// Returns a whole lag, and nothing between them.
fn whole(lag: &f64) -> String {
    let is_whole = (lag - lag.round()).abs() < 1e-6;
    if is_whole {
        format!("{}", lag.round() as i64)
    } else {
        String::new()
    }
}

/// Returns the corners of the band: forth along its lower ends and back along its upper ones, and a
/// little further than the first and the last lag, so that there is something to see of one.
fn band(curve: &Curve) -> Vec<(f64, f64)> {
    const FURTHER: f64 = 0.3;
    let end = |which: usize| {
        let points = curve
            .points
            .iter()
            .map(move |(lag, _, ends)| (f64::from(*lag), ends[which]));
        let mut points: Vec<(f64, f64)> = points.collect();
        if let (Some(first), Some(last)) = (points.first().copied(), points.last().copied()) {
            points.insert(0, (first.0 - FURTHER, first.1));
            points.push((last.0 + FURTHER, last.1));
        }
        points
    };
    end(0).into_iter().chain(end(1).into_iter().rev()).collect()
}

fn lags(curves: &[Curve]) -> Range<f64> {
    let lags = curves
        .iter()
        .flat_map(|curve| &curve.points)
        .map(|(lag, ..)| *lag);
    let (first, last) = (lags.clone().min().unwrap_or(0), lags.max().unwrap_or(0));
    f64::from(first) - 0.3..f64::from(last) + 0.3
}

fn excess(curves: &[Curve]) -> Range<f64> {
    let points = curves.iter().flat_map(|curve| &curve.points);
    let ends = points.flat_map(|(_, excess, [lower, upper])| [*excess, *lower, *upper, 0.0]);
    let lowest = ends.clone().fold(0.0, f64::min);
    let highest = ends.fold(f64::MIN_POSITIVE, f64::max);
    let free = MARGIN * (highest - lowest);
    lowest - free..highest + free
}

/// Returns how many decimals tell a fifth of a range apart.
fn decimals(range: &Range<f64>) -> usize {
    let fifth = (range.end - range.start) / 5.0;
    (-fifth.log10()).ceil().clamp(0.0, 9.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(name: &str, points: &[(u32, f64, [f64; 2])]) -> Curve {
        Curve {
            name: name.into(),
            points: points.to_vec(),
        }
    }

    #[test]
    fn profiles_are_drawn_over_their_bands_and_what_is_outside_is_filled() {
        let points = [(0, -0.001, [-0.003, 0.003]), (6, 0.0117, [-0.004, 0.004])];
        let svg = plot("kitchen", "nats", &[curve("cook to waiter", &points)]);
        // A mark is its inside and its edge; one more says what it means.
        assert_eq!(svg.matches("<circle").count(), 2 * (points.len() + 1));
        assert_eq!(svg.matches("<polygon").count(), 1);
        let hollow = svg
            .lines()
            .filter(|line| line.contains("<circle") && line.contains("fill=\"#FFFFFF\""));
        assert_eq!(hollow.count(), 1);
        for said in ["kitchen", "independence (nats)", "cook to waiter"] {
            assert!(svg.contains(said), "{said}");
        }

        let both = [curve("there", &points), curve("back", &points)];
        let svg = plot("kitchen", "nats", &both);
        assert_eq!(svg.matches("<polygon").count(), 2);
        assert!(svg.contains("there") && svg.contains("back"));
    }

    #[test]
    fn nothing_and_a_single_lag_are_drawn() {
        let alone = curve("one", &[(3, 0.0, [0.0, 0.0])]);
        assert!(plot("nothing", "bits", &[]).ends_with("</svg>\n"));
        assert!(plot("one", "bits", &[alone]).contains("<circle"));
    }
}
