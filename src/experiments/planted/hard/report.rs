//! Results in hard worlds, as plain data and JSON.

use serde_json::{Value, json};

use super::{Options, name, targets};
use crate::experiments::findings::{self, ExperimentDesign};
use crate::experiments::planted::{Figure, Findings, Method, Target, World};
use crate::experiments::seeds::Seeds;

/// The outcome of the experiment.
pub type Report = findings::Report<Options, World, Method, Figure>;

impl ExperimentDesign<World, Method, Figure> for Options {
    const EXPERIMENT: &'static str = "planted-hard";

    fn parameters(&self) -> Value {
        let Options {
            seeds: Seeds { number, first },
            states,
            worlds,
        } = self;
        let worlds: Vec<&str> = worlds.iter().map(name).collect();
        json!({"seeds": number, "first_seed": first, "states": states, "worlds": worlds})
    }

    fn targets(&self, findings: &Findings) -> Vec<Target> {
        targets::targets(self, findings)
    }
}
