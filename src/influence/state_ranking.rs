//! The ranking of all states of an environment for one pair, made in one pass over them: where
//! influence is highest, and what all states say together.

use std::collections::HashSet;
use std::sync::Arc;

use rayon::prelude::*;

use super::assessor::Assessor;
use super::order::{Orders, Ranked};
use super::store_errors::logged;
use crate::domain::{
    Basis, Counts, Environment, EnvironmentId, Evidence, FitId, Pair, Rule, RuleKind, Scope,
    SegmentId, StateKey, Verdict, View, Within,
};
use crate::error::Problem;
use crate::model::{Network, Prediction};
use crate::priors::{Informed, Pages};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress, Stop, Stopped};

/// What one state measures, in nats.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The state.
    pub key: StateKey,
    /// How often it was seen, at least once.
    pub visits: u64,
    /// Plug-in mutual information.
    pub plug_in: f64,
    /// Its mean under independence.
    pub expected: f64,
    /// What the counts say by the fitted prior.
    pub evidence: Option<Evidence>,
    /// The verdict.
    pub verdict: Verdict,
    /// What it rests on.
    pub basis: Basis,
}

/// A ranking of states: the rows of one environment, pair, choice of segments and rule, within
/// segments or not.
pub struct StateRanking {
    /// Every state seen, in order of key.
    pub rows: Vec<Row>,
    /// How many segments have visits in them, of those asked for.
    pub segments: u64,
    /// The fit that the evidence rests on.
    pub fit: FitId,
    /// The version of the network that was asked where the counts did not decide.
    pub network: Option<u64>,
    /// The share of dependent states by that fit.
    pub dependent_share: Option<f64>,
    /// Its orders.
    pub orders: Orders,
}

impl Ranked for Row {
    fn key(&self) -> &StateKey {
        &self.key
    }

    fn visits(&self) -> u64 {
        self.visits
    }

    fn plug_in(&self) -> f64 {
        self.plug_in
    }

    fn evidence(&self) -> Option<&Evidence> {
        self.evidence.as_ref()
    }
}

/// What a ranking is of: its rule by what decides, bit by bit.
pub type RankingKey = (
    EnvironmentId,
    Pair,
    Option<Vec<SegmentId>>,
    Within,
    (RuleKind, u64, u64, u64),
);

/// The same without the rule.
pub type CountRankingKey = (EnvironmentId, Pair, Option<Vec<SegmentId>>, Within);

fn rule_bits(rule: &Rule) -> (RuleKind, u64, u64, u64) {
    (
        rule.kind,
        rule.threshold_nats().to_bits(),
        rule.min_visits,
        rule.confidence.to_bits(),
    )
}

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
    /// The fit and the habits that the evidence rests on.
    pub informed: Option<Informed>,
    /// The network that is asked where the counts do not decide.
    pub network: Option<Arc<Network>>,
}

impl QueryContext {
    /// Returns what a ranking by this query is of.
    pub fn key(&self) -> RankingKey {
        let Scope {
            pair, within, rule, ..
        } = &self.scope;
        (
            self.environment.id,
            pair.clone(),
            self.segments.clone(),
            *within,
            rule_bits(rule),
        )
    }

    /// Returns what ranks that need no evidence are of: no rule decides them.
    pub fn count_ranking_key(&self) -> CountRankingKey {
        let (environment, pair, segments, within, _) = self.key();
        (environment, pair, segments, within)
    }

    /// Returns what assesses states for this query.
    pub fn assessor(&self, view: View) -> Assessor<'_> {
        Assessor {
            schema: &self.environment.schema,
            scope: &self.scope,
            informed: self.informed.as_ref(),
            network: self.network.as_deref(),
            view,
            remembers: self.segments.is_none(),
        }
    }

    /// Returns whether a ranking was made by the same fit and the same network.
    pub fn is_of(&self, ranking: &StateRanking) -> bool {
        ranking.fit == self.fit()
            && ranking.network == self.network.as_ref().map(|network| network.version)
    }

    /// Returns which fit it is.
    pub fn fit(&self) -> FitId {
        self.informed
            .as_ref()
            .map(|informed| informed.id)
            .unwrap_or_default()
    }
}

/// Passes over all states; returns the ranking, and how many transitions there were before.
pub async fn make(
    store: &dyn Store,
    gate: &Gate,
    context: &QueryContext,
    progress: &Progress,
) -> Result<(StateRanking, u64), Problem> {
    let totals = store.totals(context.environment.id).await.map_err(logged)?;
    progress.begin("states measured", totals.states);
    let mut rows = Vec::new();
    let mut segments = HashSet::new();
    let mut pages = Pages::new(store, context.environment.id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, states) = (context.clone(), page.len() as u64);
        let measuring = gate.run(move |stop| {
            let named = named(&context, &page);
            let states = page
                .into_iter()
                .map(|scanned| (scanned.key, Arc::new(scanned.counts)))
                .collect();
            Ok((named, measured(&context, states, stop)?))
        });
        let (named, measured) = measuring.await?;
        segments.extend(named);
        rows.extend(measured);
        progress.add(states);
    }
    let rows = gate.run(move |_| {
        rows.sort_unstable_by(|a: &Row, b| a.key.cmp(&b.key));
        Ok(rows)
    });
    let ranking = StateRanking {
        rows: rows.await?,
        segments: segments.len() as u64,
        fit: context.fit(),
        network: context.network.as_ref().map(|network| network.version),
        dependent_share: context
            .informed
            .as_ref()
            .map(|informed| informed.fit.parameters.dependent),
        orders: Orders::default(),
    };
    Ok((ranking, totals.transitions))
}

/// Returns the segments that have visits in the states of a page, of those asked for.
fn named(context: &QueryContext, page: &[Scanned]) -> HashSet<SegmentId> {
    let cells = page
        .iter()
        .flat_map(|scanned| scanned.counts.of_segments(context.segments.as_deref()));
    cells.map(|cell| cell.segment).collect()
}

/// Measures states; those not seen in the segments asked for are left out.
pub fn measured(
    context: &QueryContext,
    states: Vec<(StateKey, Arc<Counts>)>,
    stop: &Stop,
) -> Result<Vec<Row>, Stopped> {
    // So many are looked at once that nothing is worth remembering.
    let assessor = Assessor {
        remembers: false,
        ..context.assessor(View::Figures)
    };
    let keys: Vec<StateKey> = states.iter().map(|(key, _)| key.clone()).collect();
    let predictions = assessor.predictions(&keys);
    let row = |((key, counts), predicted): ((StateKey, Arc<Counts>), Option<Prediction>)| {
        stop.check()?;
        let assessment = assessor.assess(
            &key,
            counts.of_segments(context.segments.as_deref()),
            predicted,
        );
        let visits = assessment.tables.whole.total();
        Ok((visits > 0).then(|| Row {
            key,
            visits,
            plug_in: assessment.plug_in,
            expected: assessment.tables.expected_if_independent().0,
            evidence: assessment.evidence,
            verdict: assessment.verdict,
            basis: assessment.basis,
        }))
    };
    let rows: Result<Vec<Option<Row>>, Stopped> =
        states.into_par_iter().zip(predictions).map(row).collect();
    Ok(rows?.into_iter().flatten().collect())
}
