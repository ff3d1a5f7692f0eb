//! The plot of lag profiles (SVG): the excess of each lag over the band in which it would lie under
//! independence.

use std::ops::Range;

use plotters::prelude::*;

use super::dots::{BLUE, GREY, VERMILION};

/// Width and height in pixels, and the room of a caption.
const SIZE: (u32, u32) = (720, 400);
const CAPTION: u32 = 18;

/// What is left free above and below what is drawn.
const MARGIN: f64 = 0.1;

type Trouble = DrawingAreaErrorKind<std::io::Error>;

/// One pair's profile.
pub struct Curve {
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

fn draw(title: &str, unit: &str, curves: &[Curve], svg: &mut String) -> Result<(), Trouble> {
    let sheet = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    sheet.fill(&WHITE)?;
    let (lags, excess) = (lags(curves), excess(curves));
    let mut chart = ChartBuilder::on(&sheet)
        .caption(title, ("sans-serif", CAPTION))
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(64)
        .build_cartesian_2d(lags, excess)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(WHITE)
        .x_labels(16)
        .x_label_formatter(&whole)
        .x_desc("steps from the ego's action to the other's")
        .y_desc(format!("excess over independence ({unit})"))
        .draw()?;

    for (curve, colour) in curves.iter().zip([BLUE, VERMILION]) {
        let band = band(curve);
        chart.draw_series([Polygon::new(band, GREY.mix(0.2))])?;
        let points = curve.points.iter();
        let line: Vec<(f64, f64)> = points
            .map(|(lag, excess, _)| (f64::from(*lag), *excess))
            .collect();
        chart.draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?;
        chart.draw_series(
            line.into_iter()
                .map(|at| Circle::new(at, 4, colour.filled())),
        )?;
    }
    sheet.present()
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
    const FURTHER: f64 = 0.15;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_is_drawn_over_its_band() {
        let points = vec![(0, -0.001, [-0.003, 0.003]), (6, 0.0117, [-0.004, 0.004])];
        let svg = plot("kitchen", "nats", &[Curve { points }]);
        assert_eq!(svg.matches("<circle").count(), 2);
        assert_eq!(svg.matches("<polygon").count(), 1);
        assert!(svg.contains("kitchen") && svg.contains("independence (nats)"));
    }

    #[test]
    fn nothing_and_a_single_lag_are_drawn() {
        let alone = Curve {
            points: vec![(3, 0.0, [0.0, 0.0])],
        };
        assert!(plot("nothing", "bits", &[]).ends_with("</svg>\n"));
        assert_eq!(plot("one", "bits", &[alone]).matches("<circle").count(), 1);
    }
}
