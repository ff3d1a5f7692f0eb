//! A row of a ranking: what one state measures, in nats, and its verdict.

use std::sync::Arc;

use rayon::prelude::*;

use super::assessor::{Assessor, Memory};
use super::policy_segments::PolicySegments;
use super::query_context::QueryContext;
use crate::domain::{Basis, Counts, Evidence, StateKey, Verdict, View};
use crate::model::Prediction;
use crate::priors::PassEvidence;
use crate::work::{Stop, Stopped};

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

/// Measures states; those not seen in the segments asked for are left out. What is found of counts
/// that many have is remembered for the rest of the pass.
pub fn measured(
    context: &QueryContext,
    states: Vec<(StateKey, Arc<Counts>)>,
    memory: &PassEvidence,
    stop: &Stop,
) -> Result<Vec<Row>, Stopped> {
    // So many are looked at once that no state is worth remembering.
    let assessor = Assessor {
        memory: match context.policy {
            // Habits may be seen where nothing else is counted.
            PolicySegments::Observed => Memory::Counts(memory),
            _ => Memory::Nothing,
        },
        ..context.assessor(View::Figures)
    };

    let keys: Vec<StateKey> = states.iter().map(|(key, _)| key.clone()).collect();
    let predictions = assessor.predictions(&keys);

    let row = |((key, counts), predicted): ((StateKey, Arc<Counts>), Option<Prediction>)| {
        stop.check()?;
        let assessment = assessor.assess(&key, &counts, predicted);
        let visits = assessment.tally.n;
        Ok((visits > 0).then(|| Row {
            key,
            visits,
            plug_in: assessment.plug_in,
            expected: assessment.expected.map_or(0.0, |(mean, _)| mean),
            evidence: assessment.evidence,
            verdict: assessment.verdict,
            basis: assessment.basis,
        }))
    };

    let rows: Result<Vec<Option<Row>>, Stopped> =
        states.into_par_iter().zip(predictions).map(row).collect();
    Ok(rows?.into_iter().flatten().collect())
}
