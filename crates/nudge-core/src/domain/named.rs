//! From values by name to values by position: how JSON, query strings and people write states and
//! actions.

use super::draft::{ActionDraft, NamedValues, ValueDraft};
use super::label_set::is_plain_number;
use super::{Feature, FeatureKind, LabelSet, Schema};
use crate::error::{Fault, pointer};

/// From here on a number is told with its exponent.
const LARGE: f64 = 1e39;

impl Schema {
    /// Returns one value a state feature, or every fault: missing, unknown and doubled features,
    /// labels and numbers that do not fit. Numbers are rounded to f32; whether they have a bin is
    /// asked later.
    pub fn state_values(&self, named: &NamedValues) -> Result<Vec<f32>, Vec<Fault>> {
        values(self.state(), named)
    }

    /// Returns one value an action feature, agent after agent, or every fault. Agents that may be
    /// absent are absent where they are said to be.
    pub fn action_values(&self, named: &[(String, ActionDraft)]) -> Result<SlotValues, Vec<Fault>> {
        let names = self.agents().iter().map(|agent| agent.name.as_str());
        let mut faults = unknown(written_names(named), names, "agent");
        let mut slots = SlotValues::default();
        for agent in self.agents() {
            let pointer = format!("/{}", agent.name);
            match named.iter().find(|(name, _)| name == agent.name.as_str()) {
                None if agent.may_be_absent => {
                    let detail = "missing, expected an action, or null where it took none";
                    faults.push(Fault::new(pointer, detail));
                }
                None => faults.push(Fault::new(pointer, "missing, expected an action")),
                Some((_, ActionDraft::Absent)) if agent.may_be_absent => {
                    slots.push_missing(agent.action.len());
                }
                Some((_, draft)) => match slot(&agent.action, draft) {
                    Ok(values) => slots.push(values),
                    Err(more) => faults.extend(more.into_iter().map(|fault| fault.under(&pointer))),
                },
            }
        }
        kept(slots, faults)
    }

    /// Returns one value a feature of an outcome, outcome after outcome, or every fault. Those that
    /// are not given are missing.
    pub fn outcome_values(
        &self,
        named: &[(String, ActionDraft)],
    ) -> Result<SlotValues, Vec<Fault>> {
        let names = self.outcomes().iter().map(|outcome| outcome.name.as_str());
        let mut faults = unknown(written_names(named), names, "outcome");
        let mut slots = SlotValues::default();
        for outcome in self.outcomes() {
            match named.iter().find(|(name, _)| *name == outcome.name) {
                None | Some((_, ActionDraft::Absent)) => slots.push_missing(outcome.value.len()),
                Some((_, draft)) => match slot(&outcome.value, draft) {
                    Ok(values) => slots.push(values),
                    Err(more) => {
                        let pointer = pointer(&outcome.name);
                        faults.extend(more.into_iter().map(|fault| fault.under(&pointer)));
                    }
                },
            }
        }
        kept(slots, faults)
    }

    /// Returns a fault for each label that JSON numbers cannot tell from one before it.
    /// Environments that have such labels keep them.
    pub fn labels_alike(&self) -> Vec<Fault> {
        let actions = self.agents().iter().enumerate();
        let actions = actions.map(|(at, agent)| (format!("/agents/{at}/action"), &*agent.action));
        // An agent's later action has the labels of its action.
        let values = self.outcomes().iter().enumerate();
        let values = values
            .filter(|(_, outcome)| outcome.agent.is_none())
            .map(|(at, outcome)| (format!("/outcomes/{at}/value"), &*outcome.value));

        let lists = [("/state".to_owned(), self.state())];
        let lists = lists.into_iter().chain(actions).chain(values);
        let each = |(pointer, features): (String, &'_ [Feature])| {
            let features = features.iter().enumerate();
            let fault = |(k, feature): (usize, &Feature)| alike(&format!("{pointer}/{k}"), feature);
            features.filter_map(fault).collect::<Vec<_>>()
        };
        lists.flat_map(each).collect()
    }
}

/// Returns the fault of a feature with two labels that are one number.
fn alike(pointer: &str, feature: &Feature) -> Option<Fault> {
    let FeatureKind::Categorical(labels) = &feature.kind else {
        return None;
    };
    let (first, again) = labels.alike()?;

    let detail = format!(
        "{:?} is the same number as {:?}",
        labels[again].as_str(),
        labels[first].as_str()
    );
    Some(Fault::new(
        format!("{pointer}/categorical/labels/{again}"),
        detail,
    ))
}

/// Values of some slots, one a feature, and which of the slots have them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SlotValues {
    /// The values, slot after slot; zeros where one is missing.
    pub values: Vec<f32>,
    /// A flag a slot; empty where all are there.
    pub present: Vec<bool>,
    slots: usize,
}

impl SlotValues {
    fn push(&mut self, values: Vec<f32>) {
        self.values.extend(values);
        self.slots += 1;
        if !self.present.is_empty() {
            self.present.push(true);
        }
    }

    fn push_missing(&mut self, width: usize) {
        self.values.resize(self.values.len() + width, 0.0);
        self.present.resize(self.slots, true);
        self.present.push(false);
        self.slots += 1;
    }
}

fn kept(slots: SlotValues, faults: Vec<Fault>) -> Result<SlotValues, Vec<Fault>> {
    if faults.is_empty() {
        Ok(slots)
    } else {
        Err(faults)
    }
}

fn written_names(named: &[(String, ActionDraft)]) -> impl Iterator<Item = &str> {
    named.iter().map(|(name, _)| name.as_str())
}

/// Reads an action, or the value of an outcome. A value without a bin is a fault of its feature,
/// by the feature's name though it was written bare: the same pointer as where it comes by position.
fn slot(features: &[Feature], draft: &ActionDraft) -> Result<Vec<f32>, Vec<Fault>> {
    let absent = ValueDraft::Other("null".into());
    let bare = match draft {
        ActionDraft::Named(named) => return values(features, named),
        ActionDraft::Bare(draft) => draft,
        ActionDraft::Absent => &absent,
    };
    match features {
        [only] => {
            let pointer = match draft {
                ActionDraft::Absent => String::new(),
                _ => format!("/{}", only.name),
            };
            let value = value(&only.kind, bare);
            Ok(vec![
                value.map_err(|detail| vec![Fault::new(pointer, detail)])?,
            ])
        }
        features => {
            let names: Vec<&str> = features
                .iter()
                .map(|feature| feature.name.as_str())
                .collect();
            let detail = format!(
                "got {}, expected an object of {}",
                written(bare),
                names.join(", ")
            );
            Err(vec![Fault::new("", detail)])
        }
    }
}
fn values(features: &[Feature], named: &NamedValues) -> Result<Vec<f32>, Vec<Fault>> {
    let known = features.iter().map(|feature| feature.name.as_str());
    let mut faults = unknown(
        named.iter().map(|(name, _)| name.as_str()),
        known,
        "feature",
    );

    let mut all = Vec::with_capacity(features.len());
    for feature in features {
        let drafts: Vec<&ValueDraft> = named
            .iter()
            .filter(|(name, _)| name == feature.name.as_str())
            .map(|(_, draft)| draft)
            .collect();

        let found = match drafts.as_slice() {
            [draft] => value(&feature.kind, draft),
            [] => Err(format!("missing, expected {}", feature.kind.expected())),
            _ => Err(format!("given {} times, expected once", drafts.len())),
        };

        match found {
            Ok(value) => all.push(value),
            Err(detail) => faults.push(Fault::new(format!("/{}", feature.name), detail)),
        }
    }

    if faults.is_empty() {
        Ok(all)
    } else {
        Err(faults)
    }
}

fn unknown<'a>(
    names: impl Iterator<Item = &'a str>,
    known: impl Iterator<Item = &'a str> + Clone,
    what: &str,
) -> Vec<Fault> {
    let is_known = |name: &str| known.clone().any(|known| known == name);
    names
        .filter(|name| !is_known(name))
        .map(|name| Fault::new(pointer(name), unknown_one(known.clone(), what)))
        .collect()
}

/// Says which names there are, if they are few. Which is nearest is not looked for: a batch may
/// have a hundred thousand wrong names.
fn unknown_one<'a>(known: impl Iterator<Item = &'a str> + Clone, what: &str) -> String {
    const FEW: usize = 8;
    match known.clone().count() {
        0 => format!("unknown {what}, expected none: this environment has no {what}s"),
        1..=FEW => format!(
            "unknown {what}, expected {}",
            known.collect::<Vec<_>>().join(", ")
        ),
        _ => format!("unknown {what}"),
    }
}

/// Reads a value of a feature, the same for every face: what [`super::LabelSet`] says of labels,
/// and for other kinds a number, which text may be too. True and false are the labels `true` and
/// `false`.
pub(super) fn value(kind: &FeatureKind, draft: &ValueDraft) -> Result<f32, String> {
    let read = match kind {
        FeatureKind::Categorical(labels) => label(labels, draft),
        _ => number(draft).and_then(finite),
    };
    read.ok_or_else(|| format!("got {}, expected {}", written(draft), kind.expected()))
}

/// Returns the number that a value is, which text may be too.
pub(super) fn number(draft: &ValueDraft) -> Option<f64> {
    match draft {
        ValueDraft::Number(number) => Some(*number),
        ValueDraft::Text(text) | ValueDraft::Digits(text) => text.parse().ok(),
        ValueDraft::Truth(_) | ValueDraft::Other(_) => None,
    }
}

/// Returns the index that a value names. Text is a label by its very characters, or else by the
/// number that it is as JSON writes numbers.
fn label(labels: &LabelSet, draft: &ValueDraft) -> Option<f32> {
    let position = |text: &str| labels.position(text).map(|at| at as f32);
    let number = |number: f64| match labels.takes_indices() {
        true => finite(number),
        false => labels.position_of_number(number).map(|at| at as f32),
    };
    let index = |text: &str| {
        labels
            .takes_indices()
            .then(|| text.parse().ok().and_then(finite))
            .flatten()
    };

    match draft {
        ValueDraft::Number(written) => number(*written),
        ValueDraft::Text(text) | ValueDraft::Digits(text) if is_plain_number(text) => {
            position(text).or_else(|| number(text.parse().ok()?))
        }
        ValueDraft::Text(text) | ValueDraft::Digits(text) => position(text).or_else(|| index(text)),
        ValueDraft::Truth(truth) => position(&truth.to_string()),
        ValueDraft::Other(_) => None,
    }
}

/// Rounds to f32. A number beyond its range would become an infinity, which no feature takes.
fn finite(number: f64) -> Option<f32> {
    Some(number as f32).filter(|rounded| rounded.is_finite())
}

/// Returns a value as it was written, for error messages.
pub(super) fn written(draft: &ValueDraft) -> String {
    match draft {
        // Debug tells 1e300 as that, Display with three hundred zeros.
        ValueDraft::Number(number) if number.abs() >= LARGE => format!("{number:?}"),
        ValueDraft::Number(number) => number.to_string(),
        ValueDraft::Truth(truth) => truth.to_string(),
        ValueDraft::Text(text) => format!("{text:?}"),
        ValueDraft::Digits(text) | ValueDraft::Other(text) => text.clone(),
    }
}
