//! What became of everything that a command sent, by environment.

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
        totals.rejections.extend(part.rejections);
    }

    /// Prints the figures. Rejected transitions make the command fail, after everything else was counted.
    pub(super) fn print(&self, as_json: bool) -> Result<(), Failure> {
        if as_json {
            print_json(&self.json())?
        } else {
            print(&self.table())?
        }
        match self.environments.iter().find_map(|(name, totals)| Some((name, totals.rejections.first()?))) {
            None => Ok(()),
            Some((name, first)) => {
                let (position, field, reason) = (first.position, &first.field, &first.reason);
                let message =
                    format!("transitions were rejected; the first in `{name}` is number {position}, {field}: {reason}");
                Err(Failure::refused(message))
            }
        }
    }

    /// Returns the figures as a table.
    pub(super) fn table(&self) -> String {
        let mut table = Table::new(&["environment", "transitions", "accepted", "resumed", "rejected"]);
        let row = |name: &str, figures: [u64; 4]| {
            std::iter::once(name.to_owned()).chain(figures.map(count)).collect::<Vec<_>>()
        };
        for (name, totals) in &self.environments {
            table.row(row(name, figures(totals)));
        }
        let sum = |sum: [u64; 4], totals| std::array::from_fn(|i| sum[i] + figures(totals)[i]);
        table.row(row("all", self.environments.values().fold([0; 4], sum)));
        table.render("")
    }

    fn json(&self) -> Value {
        let environment = |(name, totals): (&String, &Totals)| {
            let [transitions, accepted, resumed, rejected] = figures(totals);
            let rejections: Vec<Value> = totals.rejections.iter().map(rejection).collect();
            json!({
                "environment": name, "transitions": transitions, "accepted": accepted, "resumed": resumed,
                "rejected_count": rejected, "rejected": rejections,
            })
        };
        json!({ "environments": self.environments.iter().map(environment).collect::<Vec<_>>() })
    }
}

fn figures(totals: &Totals) -> [u64; 4] {
    [totals.sent, totals.accepted, totals.resumed, totals.rejected]
}

fn rejection(rejected: &Rejected) -> Value {
    json!({ "position": rejected.position, "field": rejected.field, "reason": rejected.reason })
}
