//! Schemas (state and action spaces), derived features, decision rules and environments.

use nudge_core::domain::draft::{
    AgentDraft, ChangeDraft, DerivedDraft, DerivedKindDraft, DescriptionDraft, FeatureDraft,
    KindDraft, OutcomeDraft, RuleDraft, SchemaDraft,
};
use nudge_core::domain::{
    Environment, EnvironmentPage, Threshold, UnreadableEnvironment, WrittenRule,
};

use crate::proto::derived_feature::Kind as DerivedKind;
use crate::proto::feature::Kind;
use crate::{present, proto};

impl proto::ApplyEnvironmentRequest {
    /// Makes the request for an environment of that name.
    pub fn of_description(name: String, draft: DescriptionDraft) -> Self {
        Self {
            name,
            schema: Some(draft.schema.into()),
            rule: draft.rule.map(Into::into),
            derived: draft.derived.map(Into::into),
        }
    }

    /// Returns the name and what it describes.
    pub fn into_description(self) -> (String, DescriptionDraft) {
        let draft = DescriptionDraft {
            schema: self.schema.unwrap_or_default().into(),
            schema_hash: None,
            derived: self.derived.map(Into::into),
            rule: self.rule.map(Into::into),
        };
        (self.name, draft)
    }
}

impl proto::UpdateEnvironmentRequest {
    /// Returns the name and what is to be changed.
    pub fn into_change(self) -> (String, ChangeDraft) {
        let change = ChangeDraft {
            rule: self.rule.map(Into::into),
            derived: self.derived.map(Into::into),
        };
        (self.name, change)
    }
}

impl From<proto::DerivedFeatures> for Vec<DerivedDraft> {
    fn from(derived: proto::DerivedFeatures) -> Self {
        derived.features.into_iter().map(Into::into).collect()
    }
}

impl From<Vec<DerivedDraft>> for proto::DerivedFeatures {
    fn from(drafts: Vec<DerivedDraft>) -> Self {
        Self {
            features: drafts.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::DerivedFeature> for DerivedDraft {
    fn from(feature: proto::DerivedFeature) -> Self {
        Self {
            name: feature.name,
            kinds: feature.kind.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<DerivedKind> for DerivedKindDraft {
    fn from(kind: DerivedKind) -> Self {
        let names = |pair: proto::FeaturePair| vec![pair.first, pair.second];
        match kind {
            DerivedKind::Difference(pair) => Self::Difference(names(pair)),
            DerivedKind::Manhattan(manhattan) => {
                Self::Manhattan(manhattan.pairs.into_iter().map(names).collect())
            }
            DerivedKind::Equal(pair) => Self::Equal(names(pair)),
        }
    }
}

impl From<DerivedDraft> for proto::DerivedFeature {
    /// Takes the first kind.
    fn from(draft: DerivedDraft) -> Self {
        Self {
            name: draft.name,
            kind: draft.kinds.into_iter().next().map(Into::into),
        }
    }
}

impl From<DerivedKindDraft> for DerivedKind {
    /// Takes the first two names of each list.
    fn from(kind: DerivedKindDraft) -> Self {
        match kind {
            DerivedKindDraft::Difference(names) => Self::Difference(pair(names)),
            DerivedKindDraft::Manhattan(pairs) => Self::Manhattan(proto::Manhattan {
                pairs: pairs.into_iter().map(pair).collect(),
            }),
            DerivedKindDraft::Equal(names) => Self::Equal(pair(names)),
        }
    }
}

fn pair(names: Vec<String>) -> proto::FeaturePair {
    let mut names = names.into_iter();
    let mut next = || names.next().unwrap_or_default();
    proto::FeaturePair {
        first: next(),
        second: next(),
    }
}

impl From<proto::Schema> for SchemaDraft {
    fn from(schema: proto::Schema) -> Self {
        Self {
            state: schema.state.into_iter().map(Into::into).collect(),
            agents: schema.agents.into_iter().map(Into::into).collect(),
            outcomes: schema.outcomes.into_iter().map(Into::into).collect(),
            lags: schema.lags.into_iter().map(i64::from).collect(),
        }
    }
}

impl From<proto::Outcome> for OutcomeDraft {
    fn from(outcome: proto::Outcome) -> Self {
        Self {
            name: outcome.name,
            agent: present(outcome.agent),
            // Absent and 0 are the same on the wire, and neither is a lag.
            lag: Some(i64::from(outcome.lag)),
            value: outcome.value.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<OutcomeDraft> for proto::Outcome {
    /// Takes numbers as far as the wire can hold them.
    fn from(draft: OutcomeDraft) -> Self {
        Self {
            name: draft.name,
            agent: draft.agent.unwrap_or_default(),
            lag: unsigned(draft.lag.unwrap_or(0)),
            value: draft.value.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<proto::Agent> for AgentDraft {
    fn from(agent: proto::Agent) -> Self {
        Self {
            name: agent.name,
            action: agent.action.into_iter().map(Into::into).collect(),
            may_be_absent: agent.may_be_absent,
        }
    }
}

impl From<SchemaDraft> for proto::Schema {
    fn from(draft: SchemaDraft) -> Self {
        Self {
            state: draft.state.into_iter().map(Into::into).collect(),
            agents: draft.agents.into_iter().map(Into::into).collect(),
            outcomes: draft.outcomes.into_iter().map(Into::into).collect(),
            lags: draft.lags.into_iter().map(unsigned).collect(),
        }
    }
}

impl From<AgentDraft> for proto::Agent {
    fn from(agent: AgentDraft) -> Self {
        Self {
            name: agent.name,
            action: agent.action.into_iter().map(Into::into).collect(),
            may_be_absent: agent.may_be_absent,
        }
    }
}

impl From<proto::Feature> for FeatureDraft {
    fn from(feature: proto::Feature) -> Self {
        Self {
            name: feature.name,
            unit: present(feature.unit),
            kinds: feature.kind.into_iter().map(Into::into).collect(),
        }
    }
}

impl From<Kind> for KindDraft {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Continuous(continuous) => Self::Continuous(continuous.edges),
            Kind::Circular(circular) => {
                Self::Circular(i64::from(circular.bins), present(circular.values))
            }
            Kind::Integer(integer) => Self::Integer(i64::from(integer.min), i64::from(integer.max)),
            Kind::Categorical(categorical) => Self::Categorical(categorical.labels),
        }
    }
}

impl From<FeatureDraft> for proto::Feature {
    /// Takes the first kind.
    fn from(draft: FeatureDraft) -> Self {
        Self {
            name: draft.name,
            unit: draft.unit.unwrap_or_default(),
            kind: draft.kinds.into_iter().next().map(Into::into),
        }
    }
}

impl From<KindDraft> for Kind {
    /// Takes numbers as far as the wire can hold them.
    fn from(kind: KindDraft) -> Self {
        match kind {
            KindDraft::Continuous(edges) => Self::Continuous(proto::Continuous { edges }),
            KindDraft::Circular(bins, values) => Self::Circular(proto::Circular {
                bins: u32::try_from(bins).unwrap_or(0),
                values: values.unwrap_or_default(),
            }),
            KindDraft::Integer(min, max) => Self::Integer(proto::Integer {
                min: saturated(min),
                max: saturated(max),
            }),
            KindDraft::Categorical(labels) => Self::Categorical(proto::Categorical { labels }),
        }
    }
}

/// Returns the nearest number without a sign that the wire can hold.
fn unsigned(number: i64) -> u32 {
    number.clamp(0, i64::from(u32::MAX)) as u32
}

/// Returns the nearest number that the wire can hold.
fn saturated(number: i64) -> i32 {
    number.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

impl From<proto::Rule> for RuleDraft {
    fn from(rule: proto::Rule) -> Self {
        let proto::Rule {
            kind,
            threshold,
            share,
            unit,
            min_visits,
            confidence,
            estimators,
            exploration,
        } = rule;
        let estimators = estimators.map(|estimators| estimators.names);
        let exploration = exploration.map(|list| list.segments);
        Self {
            kind,
            threshold,
            share,
            unit,
            min_visits,
            confidence,
            estimators,
            exploration,
        }
    }
}

impl From<RuleDraft> for proto::Rule {
    fn from(draft: RuleDraft) -> Self {
        let RuleDraft {
            kind,
            threshold,
            share,
            unit,
            min_visits,
            confidence,
            estimators,
            exploration,
        } = draft;
        let estimators = estimators.map(|names| proto::EstimatorList { names });
        let exploration = exploration.map(|segments| proto::SegmentList { segments });
        Self {
            kind,
            threshold,
            share,
            unit,
            min_visits,
            confidence,
            estimators,
            exploration,
        }
    }
}

impl From<WrittenRule> for proto::Rule {
    fn from(rule: WrittenRule) -> Self {
        let (threshold, share) = match rule.threshold {
            Threshold::Information(threshold) => (Some(threshold), None),
            Threshold::Share(share) => (None, Some(share)),
        };
        Self {
            kind: Some(rule.kind.as_str().into()),
            threshold,
            share,
            unit: Some(rule.unit.as_str().into()),
            min_visits: Some(rule.min_visits),
            confidence: Some(rule.confidence),
            estimators: Some(proto::EstimatorList {
                names: rule
                    .estimators
                    .iter()
                    .map(|estimator| estimator.as_str().into())
                    .collect(),
            }),
            exploration: (!rule.exploration.is_empty()).then(|| proto::SegmentList {
                segments: rule.exploration.iter().map(ToString::to_string).collect(),
            }),
        }
    }
}

impl From<&Environment> for proto::Environment {
    fn from(environment: &Environment) -> Self {
        Self {
            name: environment.name.to_string(),
            uid: environment.uid.to_string(),
            schema_hash: environment.schema.hash().0.to_vec(),
            schema: Some(environment.schema.draft().into()),
            rule: Some(environment.rule.clone().into()),
            derived: environment
                .derived
                .draft(&environment.schema)
                .into_iter()
                .map(Into::into)
                .collect(),
        }
    }
}

impl From<EnvironmentPage> for proto::ListEnvironmentsResponse {
    fn from(page: EnvironmentPage) -> Self {
        Self {
            environments: page
                .environments
                .iter()
                .map(|environment| (&**environment).into())
                .collect(),
            next_page_token: page.next_page_token.unwrap_or_default(),
            unreadable: page
                .unreadable
                .iter()
                .map(|environment| (&**environment).into())
                .collect(),
        }
    }
}

impl From<&UnreadableEnvironment> for proto::UnreadableEnvironment {
    fn from(environment: &UnreadableEnvironment) -> Self {
        let UnreadableEnvironment { uid, name, why, .. } = environment;
        Self {
            name: name.clone(),
            uid: uid.to_string(),
            unreadable: why.clone(),
        }
    }
}
