//! Decision rules, whole and in part.

use nudge_core::domain::RuleDraft;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::whole::perhaps_whole;
use super::words;
use crate::proto;

/// How figures become a verdict. In requests, parts that are absent keep what they are merged over;
/// in answers every part is present, and of `threshold` and `share` the one that was given.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of kind, threshold or share, unit, min_visits, confidence, estimators and exploration"
)]
pub struct Rule {
    /// `evidence` or `paper`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "evidence", value_type = Option<words::RuleKind>)]
    pub kind: Option<String>,
    /// Mutual information above which there is influence, in `unit`; at least 0, and less than ln
    /// min(R, K) of two agents with R and K actions: those asked about, or in an environment's own
    /// rule those that can have the most. One that nobody can reach is refused where it is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = 0.5, minimum = 0)]
    pub threshold: Option<f64>,
    /// The threshold as a share of ln min(R, K), the most that two agents with R and K actions can
    /// have; at least 0 and below 1. Instead of `threshold`: given over a rule that has the other,
    /// it replaces it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = 0.5, minimum = 0, exclusive_maximum = 1)]
    pub share: Option<f64>,
    /// `nats` or `bits`. Given without a threshold, it converts the threshold.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "nats", value_type = Option<words::Unit>)]
    pub unit: Option<String>,
    /// Visits below which the paper's rule stays undecided.
    #[serde(
        default,
        deserialize_with = "perhaps_whole",
        skip_serializing_if = "Option::is_none"
    )]
    #[schema(example = 8, maximum = 9_223_372_036_854_775_807_i64)]
    pub min_visits: Option<u64>,
    /// Probability from which the evidence rule decides, above 0.5 and below 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = 0.8, exclusive_minimum = 0.5, exclusive_maximum = 1)]
    pub confidence: Option<f64>,
    /// What answers tell beside the plug-in, unless a question names others: `excess`,
    /// `miller_madow`, `chao_shen`, `james_stein`, `grassberger_2003`, `nsb`, `dirichlet`,
    /// `adjusted`, `uniform_policy`. A list replaces the one before.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = json!(["nsb"]), value_type = Option<Vec<words::Estimator>>)]
    pub estimators: Option<Vec<String>>,
    /// Segments in which agents explored, tried what `.../explore` suggested say: what they did there
    /// weighs nothing in mutual information, unless a question names a `policy`, while responses are
    /// by all visits. They need not be there yet. A list replaces the one before.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = json!(["exploration"]))]
    pub exploration: Option<Vec<String>>,
}

impl From<Rule> for RuleDraft {
    fn from(rule: Rule) -> Self {
        let Rule {
            kind,
            threshold,
            share,
            unit,
            min_visits,
            confidence,
            estimators,
            exploration,
        } = rule;
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

impl From<RuleDraft> for Rule {
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

impl From<proto::Rule> for Rule {
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
