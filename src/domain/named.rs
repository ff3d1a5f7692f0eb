//! From values by name to values by position: how JSON, query strings and people write states and actions.

use super::draft::{ActionDraft, NamedValues, ValueDraft};
use super::{Agent, Feature, Schema};
use crate::error::{Fault, pointer};

impl Schema {
    /// Returns one value a state feature, or every fault: missing, unknown and doubled features, labels and numbers that do not fit.
    /// Numbers are rounded to f32; whether they have a bin is asked later.
    pub fn state_values(&self, named: &NamedValues) -> Result<Vec<f32>, Vec<Fault>> {
        values(self.state(), named)
    }

    /// Returns one value an action feature, agent after agent, or every fault.
    pub fn action_values(&self, named: &[(String, ActionDraft)]) -> Result<Vec<f32>, Vec<Fault>> {
        let mut faults =
            unknown(named.iter().map(|(name, _)| name.as_str()), |name| self.agent(name).is_some(), "agent");
        let mut all = Vec::with_capacity(self.action_width());
        for agent in self.agents() {
            let pointer = format!("/{}", agent.name);
            match named.iter().find(|(name, _)| name == agent.name.as_str()) {
                None => faults.push(Fault::new(pointer, "missing, expected an action")),
                Some((_, draft)) => match action(agent, draft) {
                    Ok(values) => all.extend(values),
                    Err(more) => faults.extend(more.into_iter().map(|fault| fault.under(&pointer))),
                },
            }
        }
        if faults.is_empty() { Ok(all) } else { Err(faults) }
    }
}

fn action(agent: &Agent, draft: &ActionDraft) -> Result<Vec<f32>, Vec<Fault>> {
    match (draft, agent.action.as_slice()) {
        (ActionDraft::Named(named), features) => values(features, named),
        (ActionDraft::Bare(draft), [only]) => {
            Ok(vec![value(only, draft).map_err(|detail| vec![Fault::new("", detail)])?])
        }
        (ActionDraft::Bare(draft), features) => {
            let names: Vec<&str> = features.iter().map(|feature| feature.name.as_str()).collect();
            Err(vec![Fault::new("", format!("got {}, expected an object of {}", written(draft), names.join(", ")))])
        }
    }
}

fn values(features: &[Feature], named: &NamedValues) -> Result<Vec<f32>, Vec<Fault>> {
    let known = |name: &str| features.iter().any(|feature| feature.name.as_str() == name);
    let mut faults = unknown(named.iter().map(|(name, _)| name.as_str()), known, "feature");
    let mut all = Vec::with_capacity(features.len());
    for feature in features {
        let drafts: Vec<&ValueDraft> =
            named.iter().filter(|(name, _)| name == feature.name.as_str()).map(|(_, draft)| draft).collect();
        let found = match drafts.as_slice() {
            [draft] => value(feature, draft),
            [] => Err(format!("missing, expected {}", feature.kind.expected())),
            _ => Err(format!("given {} times, expected once", drafts.len())),
        };
        match found {
            Ok(value) => all.push(value),
            Err(detail) => faults.push(Fault::new(format!("/{}", feature.name), detail)),
        }
    }
    if faults.is_empty() { Ok(all) } else { Err(faults) }
}

fn unknown<'a>(names: impl Iterator<Item = &'a str>, known: impl Fn(&str) -> bool, what: &str) -> Vec<Fault> {
    names.filter(|name| !known(name)).map(|name| Fault::new(pointer(name), format!("unknown {what}"))).collect()
}

fn value(feature: &Feature, draft: &ValueDraft) -> Result<f32, String> {
    let wrong = || format!("got {}, expected {}", written(draft), feature.kind.expected());
    let label = |text: &str| feature.kind.label_index(text).map(|index| index as f32);
    match draft {
        ValueDraft::Number(number) => finite(*number).ok_or_else(wrong),
        ValueDraft::Text(text) => label(text).ok_or_else(wrong),
        ValueDraft::Untyped(text) => label(text).or_else(|| finite(text.parse().ok()?)).ok_or_else(wrong),
        ValueDraft::Other(_) => Err(wrong()),
    }
}

/// Rounds to f32. A number beyond its range would become an infinity, which no feature takes.
fn finite(number: f64) -> Option<f32> {
    Some(number as f32).filter(|rounded| rounded.is_finite())
}

fn written(draft: &ValueDraft) -> String {
    match draft {
        ValueDraft::Number(number) => number.to_string(),
        ValueDraft::Text(text) | ValueDraft::Untyped(text) => format!("{text:?}"),
        ValueDraft::Other(text) => text.clone(),
    }
}
