//! Results as plain data, JSON and CSV.

use serde_json::{Value, json};

use super::targets::{self, Findings, Target};
use super::{Figure, Method, Options, World, arm_name, generator_name};
use crate::experiments::findings::{self, Cells, ExperimentDesign, Row};
use crate::experiments::seeds::Seeds;

/// The outcome of the experiment.
pub type Report = findings::Report<Options, World, Method, Figure>;

impl ExperimentDesign<World, Method, Figure> for Options {
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

findings::named!(Method as "decision", Figure as "figure");
