//! A dot plot (SVG): panels beside and below each other, in each a row a method, in each row a dot
//! a mark with its spread over seeds.

use std::ops::Range;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::measures::Spread;

type Sheet<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Axes<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Trouble = DrawingAreaErrorKind<std::io::Error>;
type Drawn = Result<(), Trouble>;

/// Room above the panels for what they have in common, and left of them for the names of the rows.
const ABOVE: i32 = 74;
const LEFT: i32 = 118;

/// Okabe & Ito's blue and vermilion, which the colour-blind can tell apart, and a grey.
pub const BLUE: RGBColor = RGBColor(0, 114, 178);
/// The second colour.
pub const VERMILION: RGBColor = RGBColor(213, 94, 0);
/// The third colour.
pub const GREY: RGBColor = RGBColor(110, 110, 110);

/// What words are written in.
pub const INK: RGBColor = RGBColor(40, 40, 40);
/// What axes are ruled in.
pub const RULE: RGBColor = RGBColor(222, 222, 222);

/// The shape of a mark: no two look alike, so that nothing hangs on colour alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// A filled circle.
    Disc,
    /// A triangle.
    Triangle,
    /// An open circle.
    Ring,
}

/// A mark of every row: its shape, its colour and what it means.
pub type Mark<'a> = (Shape, RGBColor, &'a str);

/// One panel.
pub struct Panel {
    /// What is above it.
    pub caption: String,
    /// For each row from the top, a value for each mark.
    pub rows: Vec<Vec<Option<Spread>>>,
}

/// The whole plot.
pub struct Dots<'a> {
    /// What it shows.
    pub title: String,
    /// Its width and height in pixels.
    pub size: (u32, u32),
    /// The names of the rows, from the top.
    pub rows: &'a [&'a str],
    /// The marks of a row, from the top.
    pub marks: &'a [Mark<'a>],
    /// Where the dashed line is, and what it stands for.
    pub dashed: (f64, &'a str),
    /// What the horizontal axes show.
    pub range: Range<f64>,
    /// How many panels stand beside each other.
    pub beside: usize,
    /// The panels, row by row.
    pub panels: Vec<Panel>,
}

impl Dots<'_> {
    /// Returns it as SVG.
    pub fn svg(&self) -> String {
        let mut svg = String::new();
        self.draw(&SVGBackend::with_string(&mut svg, self.size).into_drawing_area())
            .expect("a text takes everything");
        svg
    }

    fn draw(&self, sheet: &Sheet<'_>) -> Drawn {
        sheet.fill(&WHITE)?;
        sheet.draw(&Text::new(
            self.title.as_str(),
            (16, 14),
            ("sans-serif", 17).into_font().color(&INK),
        ))?;
        self.legend(sheet)?;
        let below = self.panels.len().div_ceil(self.beside);
        let areas = sheet
            .margin(ABOVE, 0, LEFT, 0)
            .split_evenly((below, self.beside));

        for (at, (area, panel)) in areas.iter().zip(&self.panels).enumerate() {
            let axes = self.axes(area, &panel.caption)?;
            for (row, values) in panel.rows.iter().enumerate() {
                if at % self.beside == 0 {
                    let (_, y) = axes.backend_coord(&(self.range.start, self.height(row)));
                    sheet.draw(&Text::new(
                        self.rows[row],
                        (LEFT - 4, y),
                        words(HPos::Right),
                    ))?;
                }
                self.dots(sheet, values, |value, lane| {
                    axes.backend_coord(&(value, self.height(row) + lane))
                })?;
            }
        }

        sheet.present()
    }

    /// Draws a dot for each mark of a row, in a lane of its own.
    fn dots(
        &self,
        sheet: &Sheet<'_>,
        values: &[Option<Spread>],
        at: impl Fn(f64, f64) -> (i32, i32),
    ) -> Drawn {
        let middle = (self.marks.len() - 1) as f64 / 2.0;
        for (lane, ((shape, colour, _), value)) in self.marks.iter().zip(values).enumerate() {
            let Some(value) = value else { continue };
            let lane = 0.22 * (middle - lane as f64);
            let bar = within_sd(*value).map(|end| at(end, lane));
            sheet.draw(&PathElement::new(bar, colour.stroke_width(2)))?;
            mark(sheet, at(value.mean, lane), *shape, *colour)?;
        }
        Ok(())
    }

    /// The height at which a row's middle lies: the first row is the highest.
    fn height(&self, row: usize) -> f64 {
        (self.rows.len() - row) as f64 - 0.5
    }

    fn axes<'a, 'b>(&self, area: &'a Sheet<'b>, caption: &str) -> Result<Axes<'a, 'b>, Trouble> {
        let rows = self.rows.len() as f64;
        let mut axes = ChartBuilder::on(area)
            .caption(caption, ("sans-serif", 15).into_font().color(&INK))
            .margin_left(8)
            .margin_right(16)
            .x_label_area_size(30)
            .build_cartesian_2d(self.range.clone(), 0.0..rows)?;
        axes.configure_mesh()
            .disable_y_mesh()
            .disable_y_axis()
            .x_labels(6)
            .x_label_formatter(&|value| format!("{value:.1}"))
            .label_style(("sans-serif", 13).into_font().color(&INK))
            .bold_line_style(RULE)
            .light_line_style(TRANSPARENT)
            .axis_style(RULE)
            .draw()?;
        axes.draw_series(DashedLineSeries::new(
            [(self.dashed.0, 0.0), (self.dashed.0, rows)],
            4,
            4,
            INK.stroke_width(1),
        ))?;
        Ok(axes)
    }

    fn legend(&self, sheet: &Sheet<'_>) -> Drawn {
        let (mut x, y) = (LEFT + 8, 52);
        for (shape, colour, meaning) in self.marks {
            mark(sheet, (x, y), *shape, *colour)?;
            sheet.draw(&Text::new(*meaning, (x + 12, y), words(HPos::Left)))?;
            x += 52 + 6 * meaning.len() as i32;
        }
        sheet.draw(&Text::new(
            format!("dashed: {}", self.dashed.1),
            (x, y),
            words(HPos::Left),
        ))
    }
}

/// Returns the ends of a bar: no area, and nothing else that is shown here, is beyond 1.
pub fn within_sd(value: Spread) -> [f64; 2] {
    let sd = value.sd.unwrap_or(0.0);
    [value.mean - sd, (value.mean + sd).min(1.0)]
}

fn mark(sheet: &Sheet<'_>, at: (i32, i32), shape: Shape, colour: RGBColor) -> Drawn {
    match shape {
        Shape::Disc => sheet.draw(&Circle::new(at, 5, colour.filled())),
        Shape::Triangle => sheet.draw(&TriangleMarker::new(at, 6, colour.filled())),
        Shape::Ring => {
            sheet.draw(&Circle::new(at, 4, WHITE.filled()))?;
            sheet.draw(&Circle::new(at, 4, colour.stroke_width(2)))
        }
    }
}

fn words(side: HPos) -> TextStyle<'static> {
    ("sans-serif", 14)
        .into_font()
        .color(&INK)
        .pos(Pos::new(side, VPos::Center))
}
