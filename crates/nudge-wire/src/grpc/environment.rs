//! Descriptions, rules and environments.

use nudge_core::domain::draft::{AgentDraft, FeatureDraft, KindDraft, RuleDraft, SchemaDraft};
use nudge_core::domain::{
    Environment, EnvironmentPage, Threshold, UnreadableEnvironment, WrittenRule,
};

use super::given;
use crate::proto;

impl From<proto::Schema> for SchemaDraft {
    fn from(schema: proto::Schema) -> Self {
        let features =
            |features: Vec<proto::Feature>| features.into_iter().map(FeatureDraft::from).collect();
        let agent = |agent: proto::Agent| AgentDraft {
            name: agent.name,
            action: features(agent.action),
        };
        Self {
            state: features(schema.state),
            agents: schema.agents.into_iter().map(agent).collect(),
        }
    }
}

impl From<SchemaDraft> for proto::Schema {
    fn from(draft: SchemaDraft) -> Self {
        let features =
            |features: Vec<FeatureDraft>| features.into_iter().map(proto::Feature::from).collect();
        let agent = |agent: AgentDraft| proto::Agent {
            name: agent.name,
            action: features(agent.action),
        };
        Self {
            state: features(draft.state),
            agents: draft.agents.into_iter().map(agent).collect(),
        }
    }
}

impl From<proto::Feature> for FeatureDraft {
    fn from(feature: proto::Feature) -> Self {
        use proto::feature::Kind;
        let kind = |kind| match kind {
            Kind::Continuous(continuous) => KindDraft::Continuous(continuous.edges),
            Kind::Circular(circular) => {
                KindDraft::Circular(i64::from(circular.bins), given(circular.values))
            }
            Kind::Integer(integer) => {
                KindDraft::Integer(i64::from(integer.min), i64::from(integer.max))
            }
            Kind::Categorical(categorical) => KindDraft::Categorical(categorical.labels),
        };
        Self {
            name: feature.name,
            unit: given(feature.unit),
            kinds: feature.kind.into_iter().map(kind).collect(),
        }
    }
}

impl From<FeatureDraft> for proto::Feature {
    /// Takes the first kind, and numbers as far as the wire can hold them.
    fn from(draft: FeatureDraft) -> Self {
        use proto::feature::Kind;
        let narrow = |number: i64| number.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
        let kind = |kind| match kind {
            KindDraft::Continuous(edges) => Kind::Continuous(proto::Continuous { edges }),
            KindDraft::Circular(bins, values) => Kind::Circular(proto::Circular {
                bins: u32::try_from(bins).unwrap_or(0),
                values: values.unwrap_or_default(),
            }),
            KindDraft::Integer(min, max) => Kind::Integer(proto::Integer {
                min: narrow(min),
                max: narrow(max),
            }),
            KindDraft::Categorical(labels) => Kind::Categorical(proto::Categorical { labels }),
        };
        let kind = draft.kinds.into_iter().next().map(kind);
        Self {
            name: draft.name,
            unit: draft.unit.unwrap_or_default(),
            kind,
        }
    }
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
        } = rule;
        let estimators = estimators.map(|estimators| estimators.names);
        Self {
            kind,
            threshold,
            share,
            unit,
            min_visits,
            confidence,
            estimators,
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
        } = draft;
        let estimators = estimators.map(|names| proto::EstimatorList { names });
        Self {
            kind,
            threshold,
            share,
            unit,
            min_visits,
            confidence,
            estimators,
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
            rule: Some(environment.rule.into()),
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
