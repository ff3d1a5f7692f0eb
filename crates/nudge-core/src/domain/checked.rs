//! From a draft to what cannot be wrong: the limits of features and agents, each fault with its
//! pointer.

use std::collections::HashSet;
use std::str::FromStr;
use std::sync::Arc;

use super::draft::{AgentDraft, FeatureDraft, KindDraft, SchemaDraft};
use super::{Agent, Angle, Feature, FeatureKind, Name};
use crate::error::Fault;

const MOST_STATE_FEATURES: usize = 256;
const MOST_ACTION_FEATURES: usize = 16;
const AGENTS: std::ops::RangeInclusive<usize> = 2..=8;
const MOST_BINS: usize = 65_536;
const LARGEST_INTEGER: u64 = 1 << 24;
const MOST_JOINT_ACTIONS: u64 = 1 << 62;

/// The faults found so far.
#[derive(Default)]
pub(super) struct Faults(Vec<Fault>);

impl Faults {
    fn add(&mut self, pointer: impl Into<String>, detail: impl Into<String>) {
        self.0.push(Fault::new(pointer, detail));
    }

    fn parse<T: FromStr<Err = String>>(&mut self, pointer: String, text: &str) -> Option<T> {
        text.parse()
            .map_err(|detail: String| self.add(pointer, detail))
            .ok()
    }

    fn size(
        &mut self,
        pointer: String,
        what: &str,
        size: usize,
        allowed: std::ops::RangeInclusive<usize>,
    ) {
        if !allowed.contains(&size) {
            self.add(
                pointer,
                format!(
                    "got {size} {what}, expected {} to {}",
                    allowed.start(),
                    allowed.end()
                ),
            );
        }
    }

    pub(super) fn into_result(self) -> Result<(), Vec<Fault>> {
        if self.0.is_empty() {
            Ok(())
        } else {
            Err(self.0)
        }
    }
}

pub(super) fn state_features(drafts: &[FeatureDraft], faults: &mut Faults) -> Vec<Feature> {
    faults.size(
        "/state".into(),
        "features",
        drafts.len(),
        1..=MOST_STATE_FEATURES,
    );
    features("/state", drafts, faults)
}

pub(super) fn agents(drafts: &[AgentDraft], faults: &mut Faults) -> Vec<Agent> {
    faults.size("/agents".into(), "agents", drafts.len(), AGENTS);
    let agent = |(i, draft): (usize, &AgentDraft)| {
        let pointer = format!("/agents/{i}");
        let name = faults.parse(format!("{pointer}/name"), &draft.name);
        let at = format!("{pointer}/action");

        faults.size(
            at.clone(),
            "features",
            draft.action.len(),
            1..=MOST_ACTION_FEATURES,
        );

        let action = features(&at, &draft.action, faults);
        unique(
            draft
                .action
                .iter()
                .enumerate()
                .map(|(j, f)| (format!("{at}/{j}/name"), f.name.as_str())),
            faults,
        );

        Some(Agent {
            name: name?,
            action,
        })
    };
    drafts.iter().enumerate().filter_map(agent).collect()
}

/// State features and agents are asked about by name, so no two may share one. The features of an
/// action live under their agent.
pub(super) fn one_namespace(draft: &SchemaDraft, faults: &mut Faults) {
    let features = draft
        .state
        .iter()
        .enumerate()
        .map(|(i, f)| (format!("/state/{i}/name"), f.name.as_str()));

    let agents = draft
        .agents
        .iter()
        .enumerate()
        .map(|(i, a)| (format!("/agents/{i}/name"), a.name.as_str()));
    unique(features.chain(agents), faults);
}

/// Returns how many joint actions lie between neighbouring actions of each agent; the last agent
/// varies fastest.
pub(super) fn strides(agents: &[Agent], faults: &mut Faults) -> Vec<u64> {
    let mut strides = vec![1; agents.len()];
    let mut joint = Some(1_u64);

    for (agent, stride) in agents.iter().zip(&mut strides).rev() {
        *stride = joint.unwrap_or(1);
        let sizes = agent
            .action
            .iter()
            .map(|feature| u64::from(feature.kind.bins()));
        joint = sizes.fold(joint, |product, size| {
            product?
                .checked_mul(size)
                .filter(|p| *p <= MOST_JOINT_ACTIONS)
        });
    }

    if joint.is_none() {
        faults.add(
            "/agents",
            "more than 2^62 joint actions: give actions fewer bins",
        );
    }
    strides
}

fn unique<'a>(names: impl Iterator<Item = (String, &'a str)>, faults: &mut Faults) {
    let mut seen = HashSet::new();
    for (pointer, name) in names {
        if !seen.insert(name) {
            faults.add(pointer, format!("{name:?} is used twice"));
        }
    }
}

fn features(pointer: &str, drafts: &[FeatureDraft], faults: &mut Faults) -> Vec<Feature> {
    let checked = |(i, draft)| feature(&format!("{pointer}/{i}"), draft, faults);
    drafts.iter().enumerate().filter_map(checked).collect()
}

fn feature(pointer: &str, draft: &FeatureDraft, faults: &mut Faults) -> Option<Feature> {
    let name: Option<Name> = faults.parse(format!("{pointer}/name"), &draft.name);
    let unit = draft
        .unit
        .as_deref()
        .and_then(|unit| faults.parse(format!("{pointer}/unit"), unit));

    let [one] = draft.kinds.as_slice() else {
        let got = draft.kinds.len();
        faults.add(
            pointer,
            format!("got {got} kinds, expected one of continuous, circular, integer, categorical"),
        );
        return None;
    };

    let kind = kind(pointer, one, draft.unit.as_deref(), faults)?;
    Some(Feature {
        name: name?,
        unit,
        kind,
    })
}

fn kind(
    pointer: &str,
    draft: &KindDraft,
    unit: Option<&str>,
    faults: &mut Faults,
) -> Option<FeatureKind> {
    let before = faults.0.len();
    let kind = match draft {
        KindDraft::Continuous(edges) => {
            continuous(&format!("{pointer}/continuous/edges"), edges, faults)
        }
        KindDraft::Circular(bins, values) => {
            circular(pointer, *bins, values.as_deref(), unit, faults)
        }
        KindDraft::Integer(min, max) => integer(&format!("{pointer}/integer"), *min, *max, faults),
        KindDraft::Categorical(labels) => {
            categorical(&format!("{pointer}/categorical/labels"), labels, faults)
        }
    };
    (faults.0.len() == before).then_some(kind)
}

/// Edges are compared as f32, the precision of the values that will meet them.
fn continuous(pointer: &str, edges: &[f64], faults: &mut Faults) -> FeatureKind {
    faults.size(pointer.into(), "edges", edges.len(), 0..=MOST_BINS - 1);

    // Adding zero turns -0.0 into 0.0.
    let rounded: Arc<[f32]> = edges.iter().map(|edge| *edge as f32 + 0.0).collect();

    for (i, edge) in rounded.iter().enumerate() {
        if !edge.is_finite() {
            faults.add(
                format!("{pointer}/{i}"),
                format!("got {}, expected a finite 32-bit float", edges[i]),
            );
        } else if i > 0 && rounded[i - 1] >= *edge {
            let detail = format!(
                "got {} after {}, expected edges that increase as 32-bit floats",
                edges[i],
                edges[i - 1]
            );
            faults.add(format!("{pointer}/{i}"), detail);
        }
    }
    FeatureKind::Continuous(rounded)
}

fn circular(
    pointer: &str,
    bins: i64,
    values: Option<&str>,
    unit: Option<&str>,
    faults: &mut Faults,
) -> FeatureKind {
    let allowed = 1..=MOST_BINS as i64;
    if !allowed.contains(&bins) {
        faults.add(
            format!("{pointer}/circular/bins"),
            format!("got {bins}, expected 1 to {MOST_BINS}"),
        );
    }

    FeatureKind::Circular(
        u32::try_from(bins).unwrap_or(1),
        angle(pointer, values, unit, faults),
    )
}

/// What values are said to be measured in counts. Radians may stand beside any unit: that is how
/// environments are described that were made before units were read.
fn angle(pointer: &str, values: Option<&str>, unit: Option<&str>, faults: &mut Faults) -> Angle {
    let by_unit = Angle::of_unit(unit);
    let said = values.map(|values| faults.parse(format!("{pointer}/circular/values"), values));

    match (said, unit) {
        (Some(Some(Angle::Degrees)), Some(unit)) if by_unit != Some(Angle::Degrees) => {
            faults.add(
                format!("{pointer}/unit"),
                format!("got {unit:?} beside values in degrees, expected deg, degrees, ° or none"),
            );
        }
        (None, Some(unit)) if by_unit.is_none() => {
            faults.add(
                format!("{pointer}/unit"),
                format!("got {unit:?} for an angle, expected {}", Angle::UNITS),
            );
        }
        _ => {}
    }
    said.flatten().or(by_unit).unwrap_or_default()
}

fn integer(pointer: &str, min: i64, max: i64, faults: &mut Faults) -> FeatureKind {
    let before = faults.0.len();
    for (name, value) in [("min", min), ("max", max)] {
        if value.unsigned_abs() > LARGEST_INTEGER {
            faults.add(
                format!("{pointer}/{name}"),
                format!("got {value}, expected -16777216 to 16777216"),
            );
        }
    }

    if min > max {
        faults.add(
            format!("{pointer}/max"),
            format!("got {max}, expected at least min, which is {min}"),
        );
    }

    let sound = faults.0.len() == before;
    if sound {
        FeatureKind::Integer(min as i32, max as i32)
    } else {
        FeatureKind::Integer(0, 0)
    }
}

fn categorical(pointer: &str, labels: &[String], faults: &mut Faults) -> FeatureKind {
    faults.size(pointer.into(), "labels", labels.len(), 1..=MOST_BINS);
    unique(
        labels
            .iter()
            .enumerate()
            .map(|(i, l)| (format!("{pointer}/{i}"), l.as_str())),
        faults,
    );

    let label = |(i, text): (usize, &String)| faults.parse(format!("{pointer}/{i}"), text);
    FeatureKind::Categorical(labels.iter().enumerate().filter_map(label).collect())
}

pub(super) fn draft_of(state: &[Feature], agents: &[Agent]) -> SchemaDraft {
    let agent = |agent: &Agent| AgentDraft {
        name: agent.name.to_string(),
        action: agent.action.iter().map(draft_of_feature).collect(),
    };
    SchemaDraft {
        state: state.iter().map(draft_of_feature).collect(),
        agents: agents.iter().map(agent).collect(),
    }
}

fn draft_of_feature(feature: &Feature) -> FeatureDraft {
    let kind = match &feature.kind {
        FeatureKind::Continuous(edges) => {
            KindDraft::Continuous(edges.iter().map(|edge| shortest(*edge)).collect())
        }
        FeatureKind::Circular(bins, angle) => {
            KindDraft::Circular(i64::from(*bins), unusual_angle(*angle, feature))
        }
        FeatureKind::Integer(min, max) => KindDraft::Integer(i64::from(*min), i64::from(*max)),
        FeatureKind::Categorical(labels) => {
            KindDraft::Categorical(labels.iter().map(ToString::to_string).collect())
        }
    };

    FeatureDraft {
        name: feature.name.to_string(),
        unit: feature.unit.as_ref().map(ToString::to_string),
        kinds: vec![kind],
    }
}

/// Returns the shortest decimal that rounds to a float, so that an edge given as 0.7 is told as
/// 0.7.
pub fn shortest(float: f32) -> f64 {
    float
        .to_string()
        .parse()
        .expect("a float prints as a float")
}

/// Returns what values are measured in, where that is not what everybody expects of the feature's
/// unit.
fn unusual_angle(angle: Angle, feature: &Feature) -> Option<String> {
    let by_unit = Angle::of_unit(feature.unit.as_ref().map(|unit| unit.as_str()));
    let plain = angle == Angle::Radians && by_unit == Some(Angle::Radians);
    (!plain).then(|| angle.as_str().to_owned())
}
