//! The context of a query: what questions of one scope rest on, and the keys by which what is made
//! for them is cached.

use std::sync::Arc;

use super::assessor::{Assessor, Memory};
use super::policy_segments::PolicySegments;
use crate::domain::{
    Environment, EnvironmentId, FitId, Pair, Policy, Rule, RuleKind, Scope, SegmentId, View, Within,
};
use crate::model::Network;
use crate::priors::Informed;

/// What questions of one scope rest on: the environment, the segments, the fitted prior and the
/// network.
#[derive(Clone)]
pub struct QueryContext {
    /// The environment.
    pub environment: Arc<Environment>,
    /// The pair and the rule.
    pub scope: Scope,
    /// The segments to count; all if `None`.
    pub segments: Option<Vec<SegmentId>>,
    /// Whose habits weigh the ego's actions.
    pub policy: PolicySegments,
    /// The fit and the habits that the evidence rests on.
    pub informed: Option<Informed>,
    /// The network that is asked where the counts do not decide.
    pub network: Option<Arc<Network>>,
}

impl QueryContext {
    /// Returns what a ranking by this query is of.
    pub fn key(&self) -> RankingKey {
        let Scope {
            pair,
            within,
            policy,
            rule,
            ..
        } = &self.scope;
        (
            self.environment.id,
            pair.clone(),
            self.segments.clone(),
            *within,
            policy.clone(),
            rule_bits(rule),
        )
    }

    /// Returns what ranks that need no evidence are of: no rule decides them.
    pub fn count_ranking_key(&self) -> CountRankingKey {
        let (environment, pair, segments, within, ..) = self.key();
        (environment, pair, segments, within)
    }

    /// Returns what assesses states for this query.
    pub fn assessor(&self, view: View) -> Assessor<'_> {
        let memory = match self.segments {
            None if self.policy == PolicySegments::Observed => Memory::States,
            _ => Memory::Nothing,
        };
        Assessor {
            schema: &self.environment.schema,
            scope: &self.scope,
            segments: self.segments.as_deref(),
            policy: &self.policy,
            informed: self.informed.as_ref(),
            network: self.network.as_deref(),
            view,
            memory,
        }
    }

    /// Returns the fit that the evidence rests on.
    pub fn fit(&self) -> FitId {
        self.informed
            .as_ref()
            .map(|informed| informed.id)
            .unwrap_or_default()
    }

    /// Returns the version of the network.
    pub fn network_version(&self) -> Option<u64> {
        self.network.as_ref().map(|network| network.version)
    }
}

/// The key of a ranking of states: what it is of, its rule by what decides, bit by bit.
pub type RankingKey = (
    EnvironmentId,
    Pair,
    Option<Vec<SegmentId>>,
    Within,
    Policy,
    (RuleKind, u64, u64, u64),
);

/// The key of a ranking that needs no evidence: the same without the rule.
pub type CountRankingKey = (EnvironmentId, Pair, Option<Vec<SegmentId>>, Within);

fn rule_bits(rule: &Rule) -> (RuleKind, u64, u64, u64) {
    (
        rule.kind,
        rule.threshold_nats().to_bits(),
        rule.min_visits,
        rule.confidence.to_bits(),
    )
}
