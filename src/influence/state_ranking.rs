//! The ranking of all states of an environment for one pair, made in one pass over them: where
//! influence is highest, and what all states say together.

use std::collections::HashSet;
use std::sync::Arc;

use super::order::Orders;
use super::profile::{AtLag, Drawn};
use super::query_context::QueryContext;
use super::row::{Row, measured};
use super::rows::Rows;
use super::store_errors::logged;
use crate::domain::{Counts, FitId, ProfilePoint, SegmentId, StateKey};
use crate::error::Problem;
use crate::priors::{Pages, PassEvidence};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress, Stop, Stopped};

/// A ranking of states: the rows of one environment, pair, choice of segments and rule, within
/// segments or not.
pub struct StateRanking {
    /// Every state seen, in order of key.
    pub rows: Rows,
    /// How many segments have visits in them, of those asked for.
    pub segments: u64,
    /// The fit that the evidence rests on.
    pub fit: FitId,
    /// The version of the network that was asked where the counts did not decide.
    pub network: Option<u64>,
    /// The share of dependent states by that fit.
    pub dependent_share: Option<f64>,
    /// What all states say as one, in nats.
    pub pooled: ProfilePoint,
    /// Its orders.
    pub orders: Orders,
}

impl StateRanking {
    /// Returns whether it was made by the fit and the network of a query.
    pub fn is_current(&self, context: &QueryContext) -> bool {
        self.fit == context.fit() && self.network == context.network_version()
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

    let mut rows = Rows::new(context.network_version());
    let features = context.environment.schema.state().len();
    rows.reserve(totals.states as usize, features);
    let mut segments = HashSet::new();
    let memory = Arc::new(PassEvidence::default());
    let mut pool = AtLag::new(&context.environment.schema, &context.scope.pair);
    let mut seen = 0;
    let mut pages = Pages::new(store, context.environment.id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, memory) = (context.clone(), memory.clone());
        let states = page.len() as u64;
        let measuring = gate.run(move |stop| {
            let named = named(&context, &page);
            let (measured, pool) = measured_and_pooled(&context, page, &memory, pool, seen, stop)?;
            Ok((named, measured, pool))
        });
        let (named, measured, added) = measuring.await?;
        pool = added;
        segments.extend(named);
        measured.iter().for_each(|row| rows.push(row));
        seen += states;
        progress.add(states);
    }

    let schema = context.environment.schema.clone();
    let finishing = gate.run(move |_| {
        rows.sort();
        Ok((rows, pool.point(&schema)))
    });
    let (rows, pooled) = finishing.await?;

    let ranking = StateRanking {
        rows,
        pooled,
        segments: segments.len() as u64,
        fit: context.fit(),
        network: context.network_version(),
        dependent_share: context
            .informed
            .as_ref()
            .map(|informed| informed.fit.parameters.dependent),
        orders: Orders::default(),
    };
    Ok((ranking, totals.transitions))
}

/// Measures each state of a page, of which the first has this number, and adds their strata to what
/// all states say as one. The two go side by side: strata are added in order, by one thread.
fn measured_and_pooled(
    context: &QueryContext,
    page: Vec<Scanned>,
    memory: &PassEvidence,
    mut pool: AtLag,
    first: u64,
    stop: &Stop,
) -> Result<(Vec<Row>, AtLag), Stopped> {
    let counted: Vec<(StateKey, Arc<Counts>)> = page
        .into_iter()
        .map(|scanned| (scanned.key, Arc::new(scanned.counts)))
        .collect();
    let states = counted.clone();
    let drawn = Drawn {
        schema: &context.environment.schema,
        segments: context.segments.as_deref(),
        within: context.scope.within,
    };

    let add_all = || {
        for (number, (_, counts)) in (first..).zip(&counted) {
            stop.check()?;
            pool.add(drawn, number, counts);
        }
        Ok(())
    };
    let (measured, added) = rayon::join(|| measured(context, states, memory, stop), add_all);
    added?;
    Ok((measured?, pool))
}

/// Returns the segments that have visits in the states of a page, of those asked for.
fn named(context: &QueryContext, page: &[Scanned]) -> HashSet<SegmentId> {
    let (schema, pair) = (&context.environment.schema, &context.scope.pair);
    let segments = context.segments.as_deref();
    let cells = page
        .iter()
        .flat_map(|scanned| scanned.counts.of_pair(schema, pair, segments));
    cells.map(|cell| cell.segment).collect()
}
