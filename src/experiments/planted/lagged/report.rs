//! Results of lagged questions, as plain data, JSON and CSV.

use serde_json::{Value, json};

use super::targets::{self, Findings, Target};
use super::{Figure, Options, World};
use crate::experiments::findings::{self, Cells, ExperimentDesign, Row};
use crate::experiments::seeds::Seeds;
use crate::simulation::planted::lagged::{Asked, Hold};

/// The outcome of the experiment.
pub type Report = findings::Report<Options, World, Asked, Figure>;

impl ExperimentDesign<World, Asked, Figure> for Options {
    const EXPERIMENT: &'static str = "planted-lagged";

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
        let held = match self.drawn.hold {
            Hold::Free => "free".to_owned(),
            Hold::Steps(steps) => format!("{steps} steps"),
            Hold::Kept(percent) => format!("{percent} %"),
        };
        vec![
            ("world", self.drawn.name.into()),
            ("planted_lag", self.drawn.lag.into()),
            ("held", held.into()),
            ("states", self.states.into()),
        ]
    }
}

impl Cells for Asked {
    fn cells(&self) -> Row {
        let ego = ["leader", "follower"][self.ego];
        vec![("ego", ego.into()), ("lag", self.lag.into())]
    }
}

findings::named!(Figure as "figure");
