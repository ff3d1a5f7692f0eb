//! Conditions in words, for answers and for people.

use std::ops::Range;

use super::Condition;
use crate::domain::FeatureKind;

impl Condition {
    /// Says what must be so: `distance 1 to 2`, `held onion or dish`, `gap 0.5 to 3 m`.
    pub(super) fn words(&self) -> String {
        let kind = self.coordinate.kind();
        let parts: Vec<String> = match kind {
            FeatureKind::Continuous(edges) => {
                let runs = self.bins.runs().iter();
                runs.map(|run| interval(edges, run)).collect()
            }
            FeatureKind::Integer(..) => {
                let runs = self.bins.runs().iter();
                runs.map(|run| span(kind, run)).collect()
            }
            FeatureKind::Circular(..) | FeatureKind::Categorical(_) => {
                self.bins.bins().map(|bin| kind.bin_label(bin)).collect()
            }
        };

        let unit = self.coordinate.unit().map(|unit| format!(" {unit}"));
        let (name, unit) = (self.coordinate.name(), unit.unwrap_or_default());
        format!("{name} {}{unit}", alternatives(&parts))
    }
}

fn span(kind: &FeatureKind, run: &Range<u32>) -> String {
    let [first, last] = [run.start, run.end - 1].map(|bin| kind.bin_label(bin));
    match first == last {
        true => first,
        false => format!("{first} to {last}"),
    }
}

fn interval(edges: &[f32], run: &Range<u32>) -> String {
    let from = run.start.checked_sub(1).map(|at| edges[at as usize]);
    let below = edges.get(run.end as usize - 1);
    match (from, below) {
        (None, None) => "any".into(),
        (None, Some(below)) => format!("below {below}"),
        (Some(from), None) => format!("from {from}"),
        (Some(from), Some(below)) => format!("{from} to {below}"),
    }
}

/// Returns "a, b or c".
fn alternatives(parts: &[String]) -> String {
    match parts {
        [others @ .., last] if !others.is_empty() => format!("{} or {last}", others.join(", ")),
        _ => parts.concat(),
    }
}
