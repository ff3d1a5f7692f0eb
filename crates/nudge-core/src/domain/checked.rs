//! From a draft to what cannot be wrong: the limits of features and agents, each fault with its
//! pointer.

use std::borrow::Cow;
use std::collections::{BTreeSet, HashSet};
use std::fmt::Display;
use std::hash::Hash;
use std::str::FromStr;
use std::sync::Arc;

use super::draft::{AgentDraft, FeatureDraft, KindDraft, OutcomeDraft, SchemaDraft};
use super::near::hint;
use super::outcome::MOST_LAG;
use super::{Agent, Angle, Feature, FeatureKind, Name, Outcome};
use crate::error::Fault;

const MOST_STATE_FEATURES: usize = 256;
const MOST_ACTION_FEATURES: usize = 16;
const AGENTS: std::ops::RangeInclusive<usize> = 2..=8;
const MOST_BINS: usize = 65_536;
pub(super) const LARGEST_INTEGER: u64 = 1 << 24;
const MOST_JOINT_ACTIONS: u64 = 1 << 62;
const MOST_OUTCOMES: usize = 512;

/// The faults found so far.
#[derive(Default)]
pub(super) struct Faults(Vec<Fault>);

impl Faults {
    pub(super) fn add(&mut self, pointer: impl Into<String>, detail: impl Into<String>) {
        self.0.push(Fault::new(pointer, detail));
    }

    pub(super) fn parse<T: FromStr<Err = String>>(
        &mut self,
        pointer: String,
        text: &str,
    ) -> Option<T> {
        text.parse()
            .map_err(|detail: String| self.add(pointer, detail))
            .ok()
    }

    pub(super) fn size(
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

    pub(super) fn len(&self) -> usize {
        self.0.len()
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
        unique(names(&at, &draft.action), faults);

        Some(Agent {
            name: name?,
            action,
            may_be_absent: draft.may_be_absent,
        })
    };
    drafts.iter().enumerate().filter_map(agent).collect()
}

/// Returns the outcomes: those that lags stand for, then those that are given.
pub(super) fn outcomes(draft: &SchemaDraft, agents: &[Agent], faults: &mut Faults) -> Vec<Outcome> {
    let lags = lags(&draft.lags, faults);
    let many = lags.len() * draft.agents.len() + draft.outcomes.len();
    faults.size("/outcomes".into(), "outcomes", many, 0..=MOST_OUTCOMES);

    let lagged = agents.iter().enumerate().flat_map(|(at, agent)| {
        let lagged = move |lag| ("/lags".to_owned(), Outcome::of_action(at, agent, lag));
        lags.iter().copied().map(lagged)
    });
    let mut outcomes: Vec<(String, Outcome)> = lagged.collect();
    for (i, given) in draft.outcomes.iter().enumerate() {
        let pointer = format!("/outcomes/{i}");
        let outcome = outcome(&pointer, given, draft, agents, faults);
        outcomes.extend(outcome.map(|outcome| (pointer, outcome)));
    }

    let joint = agents
        .iter()
        .map(|agent| letters(&agent.action, agent.may_be_absent));
    let joint = joint.fold(Some(1), product);
    let fits = |outcome: &Outcome| product(joint, letters(&outcome.value, false)).is_some();
    // Of too many joint actions somebody else tells.
    if joint.is_some()
        && let Some((pointer, _)) = outcomes.iter().find(|(_, outcome)| !fits(outcome))
    {
        let detail =
            "more than 2^62 joint actions with a value each: give actions or values fewer bins";
        faults.add(pointer, detail);
    }
    outcomes.into_iter().map(|(_, outcome)| outcome).collect()
}

/// Returns the lags, rising.
fn lags(drafts: &[i64], faults: &mut Faults) -> Vec<u32> {
    let mut lags = Vec::new();
    for (i, draft) in drafts.iter().enumerate() {
        let pointer = format!("/lags/{i}");
        match lag(pointer.clone(), Some(*draft), faults) {
            Some(lag) if lags.contains(&lag) => faults.add(pointer, format!("{lag} is used twice")),
            Some(lag) => lags.push(lag),
            None => {}
        }
    }
    lags.sort_unstable();
    lags
}

fn lag(pointer: String, draft: Option<i64>, faults: &mut Faults) -> Option<u32> {
    let expected = format!("expected 1 to {MOST_LAG}");
    let Some(draft) = draft else {
        faults.add(pointer, format!("missing, {expected}"));
        return None;
    };
    let lag = u32::try_from(draft).ok();
    let lag = lag.filter(|lag| (1..=MOST_LAG).contains(lag));
    if lag.is_none() {
        faults.add(pointer, format!("got {draft}, {expected}"));
    }
    lag
}

fn outcome(
    pointer: &str,
    draft: &OutcomeDraft,
    schema: &SchemaDraft,
    agents: &[Agent],
    faults: &mut Faults,
) -> Option<Outcome> {
    let lag = lag(format!("{pointer}/lag"), draft.lag, faults);
    match (&draft.agent, draft.value.as_slice()) {
        (Some(agent), []) => later_action(pointer, draft, agent, lag, schema, agents, faults),
        (None, [_, ..]) => value(pointer, draft, lag, faults),
        (agent, _) => {
            let got = if agent.is_some() { "both" } else { "neither" };
            let detail = format!("got {got} of agent and value, expected one of the two");
            faults.add(pointer, detail);
            None
        }
    }
}

/// An agent's action has the one name that says whose it is and when.
fn later_action(
    pointer: &str,
    draft: &OutcomeDraft,
    agent: &str,
    lag: Option<u32>,
    schema: &SchemaDraft,
    agents: &[Agent],
    faults: &mut Faults,
) -> Option<Outcome> {
    let is_meant = |name: &str| name == agent;
    let names = || schema.agents.iter().map(|agent| agent.name.as_str());
    if !names().any(is_meant) {
        let detail = format!("unknown agent {agent:?}{}", hint(agent, names()));
        faults.add(format!("{pointer}/agent"), detail);
    }

    // One whose own name is at fault is not among those that are checked.
    let at = agents.iter().position(|one| is_meant(one.name.as_str()))?;
    let outcome = Outcome::of_action(at, &agents[at], lag?);
    if !draft.name.is_empty() && draft.name != outcome.name {
        let detail = format!(
            "got {:?}, expected {:?}, as an action at that lag is called",
            draft.name, outcome.name
        );
        faults.add(format!("{pointer}/name"), detail);
    }
    Some(outcome)
}

fn value(
    pointer: &str,
    draft: &OutcomeDraft,
    lag: Option<u32>,
    faults: &mut Faults,
) -> Option<Outcome> {
    let name: Option<Name> = match draft.name.contains('@') {
        true => {
            let detail = format!(
                "got {:?}: '@' is for an agent's action, agent@lag",
                draft.name
            );
            faults.add(format!("{pointer}/name"), detail);
            None
        }
        false => faults.parse(format!("{pointer}/name"), &draft.name),
    };

    let at = format!("{pointer}/value");
    let size = draft.value.len();
    faults.size(at.clone(), "features", size, 1..=MOST_ACTION_FEATURES);
    let value = features(&at, &draft.value, faults);
    unique(names(&at, &draft.value), faults);
    Some(Outcome {
        name: name?.to_string(),
        lag: lag?,
        agent: None,
        value,
    })
}

/// State features, agents and outcomes are asked about by name, so no two may share one. The
/// features of an action live under their agent, and those of a value under their outcome.
pub(super) fn one_namespace(draft: &SchemaDraft, faults: &mut Faults) {
    let features =
        names("/state", &draft.state).map(|(pointer, name)| (pointer, Cow::Borrowed(name)));
    let agents = draft
        .agents
        .iter()
        .enumerate()
        .map(|(i, agent)| (format!("/agents/{i}/name"), Cow::Borrowed(&*agent.name)));

    let lags: BTreeSet<i64> = draft.lags.iter().copied().collect();
    let lagged = draft.agents.iter().flat_map(|agent| {
        let name = |lag| format!("{}@{lag}", agent.name);
        lags.iter()
            .map(move |lag| ("/lags".to_owned(), Cow::Owned(name(lag))))
    });
    let outcomes = draft
        .outcomes
        .iter()
        .enumerate()
        .map(|(i, outcome)| (format!("/outcomes/{i}/name"), name_of(outcome)));

    let all = features.chain(agents).chain(lagged).chain(outcomes);
    unique(all, faults);
}

/// Returns the name of an outcome, which an agent's action need not give.
fn name_of(draft: &OutcomeDraft) -> Cow<'_, str> {
    match (&draft.agent, draft.lag) {
        (Some(agent), Some(lag)) if draft.name.is_empty() => format!("{agent}@{lag}").into(),
        _ => draft.name.as_str().into(),
    }
}

fn names<'a>(
    at: &'a str,
    drafts: &'a [FeatureDraft],
) -> impl Iterator<Item = (String, &'a str)> + 'a {
    let features = drafts.iter().enumerate();
    features.map(move |(i, feature)| (format!("{at}/{i}/name"), feature.name.as_str()))
}

/// Returns how many joint actions lie between neighbouring actions of each agent; the last agent
/// varies fastest.
pub(super) fn strides(agents: &[Agent], faults: &mut Faults) -> Vec<u64> {
    let mut strides = vec![1; agents.len()];
    let mut joint = Some(1_u64);

    for (agent, stride) in agents.iter().zip(&mut strides).rev() {
        *stride = joint.unwrap_or(1);
        joint = product(joint, letters(&agent.action, agent.may_be_absent));
    }

    if joint.is_none() {
        faults.add(
            "/agents",
            "more than 2^62 joint actions: give actions fewer bins",
        );
    }
    strides
}

/// Returns how many letters some features have, and one more for an absence; `None` where it is more
/// than any alphabet has.
fn letters(features: &[Feature], may_be_absent: bool) -> Option<u64> {
    let bins = features.iter().map(|feature| feature.kind.bins());
    let letters = bins
        .map(|bins| Some(u64::from(bins)))
        .fold(Some(1), product)?;
    Some(letters + u64::from(may_be_absent))
}

/// Returns the size of a product of alphabets; `None` where it is more than any has.
fn product(a: Option<u64>, b: Option<u64>) -> Option<u64> {
    let product = a?.checked_mul(b?);
    product.filter(|product| *product <= MOST_JOINT_ACTIONS)
}

/// Adds a fault for each name that an earlier one has.
pub(super) fn unique<T: Hash + Eq + Display>(
    names: impl Iterator<Item = (String, T)>,
    faults: &mut Faults,
) {
    let mut seen = HashSet::new();
    for (pointer, name) in names {
        if let Some(again) = seen.replace(name) {
            faults.add(pointer, format!("{:?} is used twice", again.to_string()));
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
    let before = faults.len();
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
    (faults.len() == before).then_some(kind)
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
    let before = faults.len();
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

    let sound = faults.len() == before;
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

pub(super) fn draft_of(state: &[Feature], agents: &[Agent], outcomes: &[Outcome]) -> SchemaDraft {
    let agent = |agent: &Agent| AgentDraft {
        name: agent.name.to_string(),
        action: agent.action.iter().map(draft_of_feature).collect(),
        may_be_absent: agent.may_be_absent,
    };
    SchemaDraft {
        state: state.iter().map(draft_of_feature).collect(),
        agents: agents.iter().map(agent).collect(),
        outcomes: outcomes
            .iter()
            .map(|outcome| draft_of_outcome(agents, outcome))
            .collect(),
        lags: Vec::new(),
    }
}

fn draft_of_outcome(agents: &[Agent], outcome: &Outcome) -> OutcomeDraft {
    // The alphabet of an action is its agent's.
    let value = match outcome.agent {
        Some(_) => Vec::new(),
        None => outcome.value.iter().map(draft_of_feature).collect(),
    };
    OutcomeDraft {
        name: outcome.name.clone(),
        agent: outcome.agent.map(|at| agents[at].name.to_string()),
        lag: Some(i64::from(outcome.lag)),
        value,
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
