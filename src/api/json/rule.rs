//! Rules, whole and in part.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::api::proto;
use crate::domain::RuleDraft;

/// How figures become a verdict. In requests, parts that are absent keep what they are merged over; in answers every part is present.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of kind, threshold, unit, min_visits, confidence and estimators")]
pub struct Rule {
    /// `evidence` or `paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "evidence")]
    pub kind: Option<String>,
    /// Mutual information above which there is influence, in `unit`; at least 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = 0.5, minimum = 0)]
    pub threshold: Option<f64>,
    /// `nats` or `bits`. Given without a threshold, it converts the threshold.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "nats")]
    pub unit: Option<String>,
    /// Visits below which the paper's rule stays undecided.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = 8)]
    pub min_visits: Option<u64>,
    /// Probability from which the evidence rule decides, above 0.5 and below 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = 0.8)]
    pub confidence: Option<f64>,
    /// What answers tell beside the plug-in, unless a question names others: `excess`, `miller_madow`, `chao_shen`, `james_stein`,
    /// `grassberger_2003`, `nsb`, `dirichlet`, `adjusted`, `uniform_policy`. A list replaces the one before.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = json!(["nsb"]))]
    pub estimators: Option<Vec<String>>,
}

/// A change of an environment: the parts of its rule that are given.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, expecting = "an object of rule")]
pub struct RuleChange {
    /// The parts to change.
    pub rule: Rule,
}

impl From<Rule> for RuleDraft {
    fn from(rule: Rule) -> Self {
        let Rule { kind, threshold, unit, min_visits, confidence, estimators } = rule;
        Self { kind, threshold, unit, min_visits, confidence, estimators }
    }
}

impl From<RuleDraft> for Rule {
    fn from(draft: RuleDraft) -> Self {
        let RuleDraft { kind, threshold, unit, min_visits, confidence, estimators } = draft;
        Self { kind, threshold, unit, min_visits, confidence, estimators }
    }
}

impl From<proto::Rule> for Rule {
    fn from(rule: proto::Rule) -> Self {
        let proto::Rule { kind, threshold, unit, min_visits, confidence, estimators } = rule;
        let estimators = estimators.map(|estimators| estimators.names);
        Self { kind, threshold, unit, min_visits, confidence, estimators }
    }
}
