//! What was found in hard worlds, as plain data and JSON.

use serde_json::{Value, json};

use super::{Options, name, targets};
use crate::experiments::findings;
use crate::experiments::planted::{Findings, Target};
use crate::experiments::seeds::Seeds;

/// The outcome of the experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// What was run.
    pub options: Options,
    /// What was found.
    pub findings: Findings,
}

impl Report {
    /// Returns every target that there are states to judge by, beside what was measured.
    pub fn targets(&self) -> Vec<Target> {
        targets::targets(self)
    }

    /// Returns everything as JSON.
    pub fn json(&self) -> Value {
        let Options { seeds: Seeds { number, first }, states, worlds } = &self.options;
        let worlds: Vec<&str> = worlds.iter().map(name).collect();
        json!({
            "experiment": "planted-hard",
            "revision": findings::REVISION,
            "parameters": {"seeds": number, "first_seed": first, "states": states, "worlds": worlds},
            "targets": findings::objects(&self.targets()),
            "findings": findings::objects(&self.findings.0),
        })
    }
}
