//! Delivery report: what became of everything that a command sent, by environment.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::Failure;
use super::output::{Table, count, print, print_json};
use crate::client::{Rejected, Totals};

/// What became of everything, by environment.
#[derive(Default)]
pub(super) struct Report {
    environments: BTreeMap<String, Totals>,
}

impl Report {
    /// Adds what became of a part.
    pub(super) fn add(&mut self, environment: String, part: Totals) {
        let totals = self.environments.entry(environment).or_default();
        totals.sent += part.sent;
        totals.accepted += part.accepted;
        totals.resumed += part.resumed;
        totals.rejected += part.rejected;
        totals.rejected_batches += part.rejected_batches;
        totals.unverified += part.unverified;
        totals.rejections.extend(part.rejections);
    }

    /// Prints the figures. Transitions that were rejected, or of which nobody can tell, make the
    /// command fail, after everything else was counted.
    pub(super) fn print(&self, as_json: bool) -> Result<(), Failure> {
        if as_json {
            print_json(&self.json())?
        } else {
            print(&self.table())?
        }
        let faults: Vec<String> = self
            .environments
            .iter()
            .flat_map(|(name, totals)| faults(name, totals))
            .collect();
        if faults.is_empty() {
            Ok(())
        } else {
            Err(Failure::refused_for(faults))
        }
    }

    /// Returns the figures as a table.
    pub(super) fn table(&self) -> String {
        let mut table = Table::new(&[
            "environment",
            "transitions",
            "accepted",
            "resumed",
            "rejected",
        ]);

        for (name, totals) in &self.environments {
            table.row(row(name, figures(totals)));
        }

        let sum = |sum: [u64; 4], totals| std::array::from_fn(|i| sum[i] + figures(totals)[i]);
        table.row(row("all", self.environments.values().fold([0; 4], sum)));
        table.render("")
    }

    fn json(&self) -> Value {
        let environments: Vec<Value> = self
            .environments
            .iter()
            .map(|(name, totals)| environment_json(name, totals))
            .collect();
        json!({ "environments": environments })
    }
}

fn row(name: &str, figures: [u64; 4]) -> Vec<String> {
    std::iter::once(name.to_owned())
        .chain(figures.map(count))
        .collect()
}

fn environment_json(name: &str, totals: &Totals) -> Value {
    let [transitions, accepted, resumed, rejected] = figures(totals);
    let rejections: Vec<Value> = totals.rejections.iter().map(rejection).collect();
    json!({
        "environment": name, "transitions": transitions, "accepted": accepted, "resumed": resumed,
        "rejected_count": rejected, "rejected": rejections, "rejected_batches": totals.rejected_batches,
        "unverified": totals.unverified,
    })
}

/// Says what of an environment was not counted, or may not have been: a line each.
fn faults(environment: &str, totals: &Totals) -> Vec<String> {
    let mut faults = Vec::new();
    if let Some(Rejected {
        position,
        field,
        reason,
        ..
    }) = totals.rejections.first()
    {
        let batches = match totals.rejected_batches {
            0 => String::new(),
            1 => ", and of 1 batch all".to_owned(),
            batches => format!(", and of {} batches all", count(batches)),
        };
        faults.push(format!(
            "transitions were rejected{batches}; the first in `{environment}` is number {position}, {field}: {reason}"
        ));
    }
    if totals.unverified > 0 {
        faults.push(format!(
            "{} transitions in `{environment}` are unverified: their numbers were used so long ago that nobody can tell whether they were counted; \
             send what is new under another producer id",
            count(totals.unverified)
        ));
    }
    faults
}

fn figures(totals: &Totals) -> [u64; 4] {
    [
        totals.sent,
        totals.accepted,
        totals.resumed,
        totals.rejected,
    ]
}

fn rejection(rejected: &Rejected) -> Value {
    json!({ "position": rejected.position, "field": rejected.field, "reason": rejected.reason })
}
