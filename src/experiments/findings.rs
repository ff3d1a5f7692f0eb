//! Results of experiments: figures of methods in worlds over seeds, where they have to lie, and
//! both as JSON and CSV.

use serde_json::{Value, json};

use super::measures::Spread;

/// The version of the program that findings are made with.
pub const REVISION: &str = env!("CARGO_PKG_VERSION");

/// The cells of a row, each with its title.
pub type Row = Vec<(&'static str, Value)>;

/// Names itself in the cells of a row.
pub trait Cells {
    /// Returns the cells.
    fn cells(&self) -> Row;
}

/// Lets what has a name stand in a row under a title.
macro_rules! named {
    ($($type:ty as $title:literal),*) => {
        $(impl Cells for $type {
            fn cells(&self) -> Row {
                vec![($title, self.as_str().into())]
            }
        })*
    };
}
pub(super) use named;

/// The figures of some methods for one seed; `None` where one is not defined.
pub type Measured<D, F> = Vec<(D, F, Option<f64>)>;

/// A result: a figure of a method in a world, over seeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finding<W, D, F> {
    /// The world.
    pub world: W,
    /// The method.
    pub method: D,
    /// The figure.
    pub figure: F,
    /// Its values over the seeds.
    pub spread: Spread,
}

/// The results of an experiment: world after world, method after method.
#[derive(Debug, Clone, PartialEq)]
pub struct Findings<W, D, F>(pub Vec<Finding<W, D, F>>);

impl<W: PartialEq, D: PartialEq, F: PartialEq> Findings<W, D, F> {
    /// Returns a figure over the seeds, where it is defined.
    pub fn find(&self, world: &W, method: D, figure: F) -> Option<Spread> {
        let is_it = |finding: &&Finding<W, D, F>| {
            finding.world == *world && finding.method == method && finding.figure == figure
        };
        self.0.iter().find(is_it).map(|finding| finding.spread)
    }
}

impl<W: Cells, D: Cells, F: Cells> Findings<W, D, F> {
    /// Returns them as CSV, one a line.
    pub fn csv(&self) -> String {
        csv(&self.0)
    }
}

/// Returns the figures of a world over its seeds; one that is defined for no seed is left out.
pub fn over_seeds<W: Copy, D: Copy, F: Copy>(
    world: W,
    of_seeds: &[Measured<D, F>],
) -> Vec<Finding<W, D, F>> {
    let measured = of_seeds.first().into_iter().flatten().enumerate();
    let finding = |(at, (method, figure, _)): (usize, &(D, F, Option<f64>))| {
        let values: Vec<f64> = of_seeds
            .iter()
            .filter_map(|measured| measured[at].2)
            .collect();
        Some(Finding {
            world,
            method: *method,
            figure: *figure,
            spread: Spread::of_values(&values)?,
        })
    };
    measured.filter_map(finding).collect()
}

impl<W: Cells, D: Cells, F: Cells> Cells for Finding<W, D, F> {
    fn cells(&self) -> Row {
        let Spread { mean, sd, seeds } = self.spread;
        let named = [self.world.cells(), self.method.cells(), self.figure.cells()].concat();
        [
            named,
            vec![
                ("mean", mean.into()),
                ("sd", sd.into()),
                ("seeds", seeds.into()),
            ],
        ]
        .concat()
    }
}

/// A bound on a figure: where it has to lie.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bound {
    /// At this or above.
    AtLeast(f64),
    /// At this or below.
    AtMost(f64),
}

impl Bound {
    /// Returns whether a figure lies there.
    pub fn holds(self, figure: f64) -> bool {
        match self {
            Self::AtLeast(bound) => figure >= bound,
            Self::AtMost(bound) => figure <= bound,
        }
    }
}

/// An acceptance target: a figure, where it has to lie and where it does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target<W, D, F> {
    /// Of which world.
    pub world: W,
    /// Of which method.
    pub method: D,
    /// Which figure.
    pub figure: F,
    /// Where it has to lie.
    pub bound: Bound,
    /// Its mean over the seeds, where it is defined.
    pub measured: Option<f64>,
}

impl<W, D, F> Target<W, D, F> {
    /// Returns whether it is met.
    pub fn is_met(&self) -> bool {
        self.measured
            .is_some_and(|measured| self.bound.holds(measured))
    }
}

impl<W: Cells, D: Cells, F: Cells> Cells for Target<W, D, F> {
    fn cells(&self) -> Row {
        let (bound, at) = match self.bound {
            Bound::AtLeast(at) => ("at_least", at),
            Bound::AtMost(at) => ("at_most", at),
        };
        let named = [self.world.cells(), self.method.cells(), self.figure.cells()].concat();
        [
            named,
            vec![
                (bound, at.into()),
                ("mean", self.measured.into()),
                ("met", self.is_met().into()),
            ],
        ]
        .concat()
    }
}

/// The design of an experiment: its parameters, and its targets.
pub trait ExperimentDesign<W, D, F> {
    /// The name of the experiment.
    const EXPERIMENT: &'static str;

    /// Returns its parameters as a JSON object.
    fn parameters(&self) -> Value;

    /// Returns every target that there is something to judge by, beside what was measured.
    fn targets(&self, findings: &Findings<W, D, F>) -> Vec<Target<W, D, F>>;
}

/// The outcome of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Report<P, W, D, F> {
    /// What was run.
    pub options: P,
    /// What was found.
    pub findings: Findings<W, D, F>,
}

impl<P: ExperimentDesign<W, D, F>, W: Cells, D: Cells, F: Cells> Report<P, W, D, F> {
    /// Returns every target beside what was measured.
    pub fn targets(&self) -> Vec<Target<W, D, F>> {
        self.options.targets(&self.findings)
    }

    /// Returns everything as JSON.
    pub fn json(&self) -> Value {
        json!({
            "experiment": P::EXPERIMENT,
            "revision": REVISION,
            "parameters": self.options.parameters(),
            "targets": objects(&self.targets()),
            "findings": objects(&self.findings.0),
        })
    }
}

/// Returns rows as JSON objects.
pub fn objects<'a, T: Cells + 'a>(rows: impl IntoIterator<Item = &'a T>) -> Value {
    rows.into_iter().map(object).collect()
}

fn object(row: &impl Cells) -> Value {
    row.cells()
        .into_iter()
        .map(|(name, cell)| (name.to_owned(), cell))
        .collect()
}

/// Returns rows as CSV, one a line, under the titles of the first.
fn csv<'a, T: Cells + 'a>(rows: impl IntoIterator<Item = &'a T>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for (i, row) in rows.into_iter().enumerate() {
        let cells = row.cells();
        if i == 0 {
            writer
                .write_record(cells.iter().map(|(name, _)| *name))
                .expect("memory takes everything");
        }
        writer
            .write_record(cells.iter().map(|(_, cell)| text(cell)))
            .expect("lines are equally long");
    }

    let bytes = writer.into_inner().expect("memory takes everything");
    String::from_utf8(bytes).expect("text was written")
}

fn text(cell: &Value) -> String {
    match cell {
        Value::String(text) => text.clone(),
        Value::Null => String::new(),
        other => other.to_string(),
    }
}
