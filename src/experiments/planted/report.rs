//! What was found, as plain data, JSON and CSV.

use serde_json::{Value, json};

use super::targets::{self, Findings, Target};
use super::{Decision, Figure, Options, World, arm_name, generator_name};
use crate::experiments::findings::{self, Cells, Plan, Row};
use crate::experiments::seeds::Seeds;

/// The outcome of the experiment.
pub type Report = findings::Report<Options, World, Decision, Figure>;

impl Plan<World, Decision, Figure> for Options {
    const EXPERIMENT: &'static str = "planted";

    fn parameters(&self) -> Value {
        let Options {
            seeds: Seeds { number, first },
            states,
        } = self;
        json!({"seeds": number, "first_seed": first, "states": states})
    }

    fn targets(&self, findings: &Findings) -> Vec<Target> {
        targets::targets(self, findings)
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
