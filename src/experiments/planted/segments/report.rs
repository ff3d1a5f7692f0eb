//! Results in stratified worlds (segments), as plain data, JSON and CSV.

use serde_json::{Value, json};

use super::targets::{self, Findings, Target};
use super::{Figure, Options, Within, World};
use crate::experiments::findings::{self, Cells, ExperimentDesign, Row};
use crate::experiments::seeds::Seeds;

/// The outcome of the experiment.
pub type Report = findings::Report<Options, World, Within, Figure>;

impl ExperimentDesign<World, Within, Figure> for Options {
    const EXPERIMENT: &'static str = "planted-segments";

    fn parameters(&self) -> Value {
        let Options {
            seeds: Seeds { number, first },
            states,
            worlds,
        } = self;
        let worlds: Vec<&str> = worlds.iter().map(|world| world.name).collect();
        json!({"seeds": number, "first_seed": first, "states": states, "worlds": worlds})
    }

    fn targets(&self, findings: &Findings) -> Vec<Target> {
        targets::targets(self, findings)
    }
}

impl Cells for World {
    fn cells(&self) -> Row {
        vec![
            ("world", self.drawn.name.into()),
            ("segments", self.drawn.segments.into()),
            ("visits", self.visits.into()),
            ("states", self.states.into()),
        ]
    }
}

findings::named!(Within as "within", Figure as "figure");
