//! What was found, as plain data, JSON and CSV.

use serde_json::{Value, json};

use super::targets::{self, Bound, Target};
use super::{Decision, Figure, Options, World, arm_name, generator_name};
use crate::experiments::measures::Spread;

/// A figure of a decision in a world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Finding {
    /// The world.
    pub world: World,
    /// The decision.
    pub decision: Decision,
    /// The figure.
    pub figure: Figure,
    /// Its values over the seeds.
    pub spread: Spread,
}

/// The outcome of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// What was run.
    pub options: Options,
    /// World after world, decision after decision.
    pub findings: Vec<Finding>,
}

impl Report {
    /// The version of the program that it was made with.
    pub const REVISION: &str = env!("CARGO_PKG_VERSION");

    /// Returns a figure over the seeds, where it is defined.
    pub fn find(&self, world: &World, decision: Decision, figure: Figure) -> Option<Spread> {
        let is_it =
            |finding: &&Finding| (finding.world, finding.decision, finding.figure) == (*world, decision, figure);
        self.findings.iter().find(is_it).map(|finding| finding.spread)
    }

    /// Returns every target beside what was measured.
    pub fn targets(&self) -> Vec<Target> {
        targets::targets(self)
    }

    /// Returns everything as JSON.
    pub fn json(&self) -> Value {
        let Options { seeds, first_seed, states } = self.options;
        let object = |cells: Vec<(&str, Value)>| {
            Value::Object(cells.into_iter().map(|(name, cell)| (name.to_owned(), cell)).collect())
        };
        json!({
            "experiment": "planted",
            "revision": Self::REVISION,
            "parameters": {"seeds": seeds, "first_seed": first_seed, "states": states},
            "targets": self.targets().iter().map(|target| object(target.cells())).collect::<Vec<_>>(),
            "findings": self.findings.iter().map(|finding| object(finding.cells())).collect::<Vec<_>>(),
        })
    }

    /// Returns the findings as CSV, one a line.
    pub fn csv(&self) -> String {
        let mut writer = csv::Writer::from_writer(Vec::new());
        for (i, finding) in self.findings.iter().enumerate() {
            let cells = finding.cells();
            if i == 0 {
                writer.write_record(cells.iter().map(|(name, _)| *name)).expect("memory takes everything");
            }
            writer.write_record(cells.iter().map(|(_, cell)| text(cell))).expect("lines are equally long");
        }
        let bytes = writer.into_inner().expect("memory takes everything");
        String::from_utf8(bytes).expect("text was written")
    }
}

impl World {
    fn cells(&self) -> Vec<(&'static str, Value)> {
        vec![
            ("generator", generator_name(self.generator).into()),
            ("arm", arm_name(self.arm).into()),
            ("states", self.states.into()),
            ("dependent_percent", self.dependent.into()),
        ]
    }
}

impl Finding {
    fn cells(&self) -> Vec<(&'static str, Value)> {
        let Spread { mean, sd, seeds } = self.spread;
        let mut cells = self.world.cells();
        cells.extend([
            ("decision", self.decision.as_str().into()),
            ("figure", self.figure.as_str().into()),
            ("mean", mean.into()),
            ("sd", sd.into()),
            ("seeds", seeds.into()),
        ]);
        cells
    }
}

impl Target {
    fn cells(&self) -> Vec<(&'static str, Value)> {
        let (bound, at) = match self.bound {
            Bound::AtLeast(at) => ("at_least", at),
            Bound::AtMost(at) => ("at_most", at),
        };
        let mut cells = self.world.cells();
        cells.extend([
            ("decision", self.decision.as_str().into()),
            ("figure", self.figure.as_str().into()),
            (bound, at.into()),
            ("mean", self.measured.into()),
            ("met", self.is_met().into()),
        ]);
        cells
    }
}

fn text(cell: &Value) -> String {
    match cell {
        Value::String(text) => text.clone(),
        Value::Null => String::new(),
        other => other.to_string(),
    }
}
