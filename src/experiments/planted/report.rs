//! What was found, as plain data, JSON and CSV.

use serde_json::{Value, json};

use super::{Decision, Figure, Options, Target, World, arm_name, generator_name, targets};
use crate::experiments::findings::{self, Cells, Row};
use crate::experiments::seeds::Seeds;

/// Everything that was found.
pub type Findings = findings::Findings<World, Decision, Figure>;

/// The outcome of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// What was run.
    pub options: Options,
    /// What was found.
    pub findings: Findings,
}

impl Report {
    /// Returns every target beside what was measured.
    pub fn targets(&self) -> Vec<Target> {
        targets::targets(self)
    }

    /// Returns everything as JSON.
    pub fn json(&self) -> Value {
        let Options { seeds: Seeds { number, first }, states } = self.options;
        json!({
            "experiment": "planted",
            "revision": findings::REVISION,
            "parameters": {"seeds": number, "first_seed": first, "states": states},
            "targets": findings::objects(&self.targets()),
            "findings": findings::objects(&self.findings.0),
        })
    }
}

impl Cells for World {
    fn cells(&self) -> Row {
        vec![
            ("generator", generator_name(self.generator).into()),
            ("arm", arm_name(self.arm).into()),
            ("states", self.states.into()),
            ("dependent_percent", self.dependent.into()),
        ]
    }
}

findings::named!(Decision as "decision", Figure as "figure");
