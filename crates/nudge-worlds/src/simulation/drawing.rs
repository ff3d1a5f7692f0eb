//! A picture of one trial, in SVG: the walls, everybody's track, and where everybody is at one
//! instant, with the ellipse around the next step.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

use glam::{DVec2, dvec2};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::hallway::{Hallway, Protocol, Trial, walls};
use super::observation::ELLIPSE;
use super::{Pedestrian, Segment};
use nudge_core::error::Fault;

/// Okabe and Ito's colours, which the colour-blind can tell apart: to the right, to the left,
/// across.
const COLOURS: [(RGBColor, &str); 3] = [
    (RGBColor(0, 114, 178), "walks to the right"),
    (RGBColor(213, 94, 0), "walks to the left"),
    (RGBColor(0, 158, 115), "walks across"),
];
const INK: RGBColor = RGBColor(60, 60, 60);

/// The largest plot, in pixels.
const PLOT: DVec2 = dvec2(1_400.0, 800.0);

/// What stands around the plot, in pixels.
const LEFT: u32 = 64;
const RIGHT: u32 = 24;
const TOP: u32 = 72;
const BOTTOM: u32 = 56;
const MARGIN: u32 = 12;

/// Shown beyond the ends and the walls, in metres.
const BEYOND: f64 = 0.25;

type Sheet<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Draws the trial of that number at the record that is nearest to `at` seconds; unless told, at
/// the first one with the most pedestrians on the middle half of the hallway. Fails where the trial
/// has no such time.
pub fn svg(hallway: &Hallway, number: u32, at: Option<f64>) -> Result<String, Fault> {
    let records = records(hallway.trial(number)?);
    let now = match at {
        None => fullest(hallway.protocol(), &records),
        Some(at) => nearest(hallway.protocol(), &records, at)?,
    };
    let picture = Picture {
        protocol: hallway.protocol(),
        number,
        records,
        now,
    };
    let mut text = String::new();
    picture.draw(&mut text).expect("a text takes every drawing");
    Ok(text)
}

/// A trial from its first record to its last, with one of them to look at.
struct Picture<'a> {
    protocol: &'a Protocol,
    number: u32,
    records: Vec<Vec<Pedestrian>>,
    now: usize,
}

fn records(mut trial: Trial) -> Vec<Vec<Pedestrian>> {
    let mut records = vec![trial.pedestrians().to_vec()];
    while !trial.is_over() {
        trial.advance();
        records.push(trial.pedestrians().to_vec());
    }
    records
}

fn fullest(protocol: &Protocol, records: &[Vec<Pedestrian>]) -> usize {
    let middle = protocol.length / 4.0..=protocol.length * 3.0 / 4.0;
    let count = |record: &Vec<Pedestrian>| {
        record
            .iter()
            .filter(|one| middle.contains(&one.position.x))
            .count()
    };
    // Of equals the last is the greatest, and the first is wanted.
    (0..records.len())
        .rev()
        .max_by_key(|&record| count(&records[record]))
        .unwrap_or(0)
}

fn nearest(protocol: &Protocol, records: &[Vec<Pedestrian>], at: f64) -> Result<usize, Fault> {
    let last = (records.len() - 1) as f64;
    let record = (at / protocol.record_interval).round();
    if (0.0..=last).contains(&record) {
        return Ok(record as usize);
    }
    let end = last * protocol.record_interval;
    Err(Fault::new(
        "/at",
        format!("got {at}, expected a time within the trial, from 0 to {end:.1} s"),
    ))
}

impl Picture<'_> {
    fn draw(&self, text: &mut String) -> Drawn {
        let shown = dvec2(self.protocol.length, self.protocol.width) + 2.0 * BEYOND;
        // One scale for both axes: a metre is a metre.
        let plot = shown * (PLOT / shown).min_element();
        let size = (plot.x as u32 + LEFT + RIGHT, plot.y as u32 + TOP + BOTTOM);

        let sheet = SVGBackend::with_string(text, size).into_drawing_area();
        sheet.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&sheet)
            .margin_left(MARGIN)
            .margin_right(RIGHT)
            .margin_top(TOP)
            .margin_bottom(MARGIN)
            .x_label_area_size(BOTTOM - MARGIN)
            .y_label_area_size(LEFT - MARGIN)
            .build_cartesian_2d(-BEYOND..shown.x - BEYOND, -BEYOND..shown.y - BEYOND)?;

        axes(&mut chart)?;
        self.tracks(&mut chart)?;
        self.pedestrians(&mut chart)?;
        self.walls(&mut chart)?;
        self.title(&sheet)?;
        sheet.present()?;
        Ok(())
    }

    fn walls(&self, chart: &mut Chart) -> Drawn {
        let walls = walls(self.protocol);
        // A wall goes on beyond the picture, which shows where the hallway ends.
        let within = |point: DVec2| dvec2(point.x.clamp(0.0, self.protocol.length), point.y);
        let pieces = walls.iter().flat_map(|wall| &wall.pieces);
        let line =
            |piece: &Segment| line(&[within(piece.from), within(piece.to)], INK.stroke_width(4));
        chart.draw_series(pieces.map(line))?;
        Ok(())
    }

    /// Draws the way so far strongly and the way to come faintly.
    fn tracks(&self, chart: &mut Chart) -> Drawn {
        let (past, future) = (&self.records[..=self.now], &self.records[self.now..]);
        for (records, strength) in [(future, 0.18), (past, 0.6)] {
            let mut tracks: BTreeMap<u32, Vec<&Pedestrian>> = BTreeMap::new();
            records
                .iter()
                .flatten()
                .for_each(|one| tracks.entry(one.id).or_default().push(one));
            let track = |track: &Vec<&Pedestrian>| {
                let points: Vec<DVec2> = track.iter().map(|one| one.position).collect();
                line(&points, colour(track[0]).mix(strength).stroke_width(2))
            };
            chart.draw_series(tracks.values().map(track))?;
        }
        Ok(())
    }

    fn pedestrians(&self, chart: &mut Chart) -> Drawn {
        let now = &self.records[self.now];
        let outline = |one: &Pedestrian| {
            ellipse(
                one.position,
                self.protocol.model.next_step(one.velocity, one.direction),
            )
        };
        chart.draw_series(
            now.iter()
                .map(|one| Polygon::new(outline(one), colour(one).mix(0.10))),
        )?;

        let closed =
            |one: &Pedestrian| PathElement::new(outline(one), colour(one).mix(0.7).stroke_width(1));
        chart.draw_series(now.iter().map(closed))?;

        let dot = |one: &Pedestrian| {
            Circle::new((one.position.x, one.position.y), 6, colour(one).filled())
        };
        chart.draw_series(now.iter().map(dot))?;
        Ok(())
    }

    fn title(&self, sheet: &Sheet) -> Drawn {
        let Protocol {
            scenario,
            length,
            width,
            pedestrians,
            seed,
            record_interval,
            ..
        } = self.protocol;

        let time = self.now as f64 * record_interval;
        let title = format!(
            "Hallway {length} x {width} m, {scenario}, {pedestrians} pedestrians: seed {seed}, trial {} at {time:.1} s",
            self.number
        );

        let left = LEFT as i32;
        sheet.draw(&Text::new(title, (left, 10), font(20, HPos::Left)))?;
        let told = format!(
            "strong: the way so far; faint: the way to come; ellipse: b = {ELLIPSE} m around the next step"
        );
        sheet.draw(&Text::new(told, (left, 42), font(15, HPos::Left)))?;
        self.legend(sheet)
    }

    /// Tells the colours that occur, from the right edge to the left.
    fn legend(&self, sheet: &Sheet) -> Drawn {
        /// The width of an entry, in pixels.
        const ENTRY: i32 = 170;
        let present: BTreeSet<usize> = self.records.iter().flatten().map(kind).collect();
        let right = sheet.dim_in_pixel().0 as i32 - RIGHT as i32;
        for (i, kind) in (0..).zip(present.into_iter().rev()) {
            let ((colour, text), left) = (COLOURS[kind], right - ENTRY * (i + 1));
            sheet.draw(&PathElement::new(
                [(left, 51), (left + 24, 51)],
                colour.mix(0.6).stroke_width(2),
            ))?;
            sheet.draw(&Circle::new((left + 12, 51), 6, colour.filled()))?;
            sheet.draw(&Text::new(text, (left + 34, 42), font(15, HPos::Left)))?;
        }
        Ok(())
    }
}

fn axes(chart: &mut Chart) -> Drawn {
    chart
        .configure_mesh()
        .disable_mesh()
        .x_desc("x in m")
        .y_desc("y in m")
        .x_labels(21)
        .y_labels(7)
        .x_label_formatter(&|x| x.to_string())
        .y_label_formatter(&|y| y.to_string())
        .axis_desc_style(("sans-serif", 15, &INK))
        .label_style(("sans-serif", 14, &INK))
        .axis_style(INK.mix(0.4))
        .draw()?;
    Ok(())
}

/// Returns the points of the ellipse with foci at `position` and a step ahead of it.
fn ellipse(position: DVec2, step: DVec2) -> Vec<(f64, f64)> {
    const POINTS: u32 = 72;
    let along = step.normalize_or(DVec2::X);
    let semi_major = ELLIPSE.hypot(step.length() / 2.0);
    let point = |i| {
        let on_circle = DVec2::from_angle(TAU * f64::from(i) / f64::from(POINTS));
        let point = position + step / 2.0 + along.rotate(on_circle * dvec2(semi_major, ELLIPSE));
        (point.x, point.y)
    };
    (0..=POINTS).map(point).collect()
}

fn line(points: &[DVec2], style: ShapeStyle) -> PathElement<(f64, f64)> {
    PathElement::new(
        points
            .iter()
            .map(|point| (point.x, point.y))
            .collect::<Vec<_>>(),
        style,
    )
}

fn font(size: u32, anchor: HPos) -> TextStyle<'static> {
    ("sans-serif", size)
        .into_font()
        .color(&INK)
        .pos(Pos::new(anchor, VPos::Top))
}

fn colour(pedestrian: &Pedestrian) -> RGBColor {
    COLOURS[kind(pedestrian)].0
}

/// Returns which of the [`COLOURS`] somebody has.
fn kind(pedestrian: &Pedestrian) -> usize {
    match pedestrian.direction {
        DVec2::X => 0,
        DVec2::NEG_X => 1,
        _ => 2,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hallway() -> Hallway {
        Hallway::try_from(Protocol {
            seed: 7,
            ..Protocol::default()
        })
        .expect("sound")
    }

    #[test]
    fn a_picture_shows_everybody_at_the_time_that_is_told() {
        let svg = svg(&hallway(), 3, Some(2.05)).expect("within the trial");
        assert!(
            svg.contains(
                "Hallway 20 x 4 m, counter-flow, 10 pedestrians: seed 7, trial 3 at 2.0 s"
            ),
            "{svg}"
        );
        // A dot each, and one for each of the two colours of the legend.
        assert_eq!(svg.matches("<circle").count(), 10 + 2);
        assert_eq!(svg.matches("<polygon").count(), 10, "an ellipse each");
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    }

    #[test]
    fn a_time_outside_the_trial_is_refused() {
        for at in [-1.0, 61.0, f64::NAN] {
            let fault = svg(&hallway(), 1, Some(at)).expect_err("outside");
            assert!(
                fault
                    .to_string()
                    .starts_with(&format!("/at: got {at}, expected a time within the trial")),
                "{fault}"
            );
        }
    }

    #[test]
    fn an_ellipse_goes_around_the_step_at_its_distance() {
        let step = dvec2(1.8, 2.4);
        for (x, y) in ellipse(dvec2(3.0, 1.0), step) {
            let b = crate::simulation::semi_minor_axis(dvec2(x, y) - dvec2(3.0, 1.0), step);
            assert!((b - ELLIPSE).abs() < 1e-9, "{b}");
        }
    }
}
