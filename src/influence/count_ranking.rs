//! A ranking that needs no evidence: of all states by how often each was seen, or by its plug-in
//! mutual information.

use rayon::prelude::*;

use super::keyed::Keyed;
use super::order::{Orders, Ranked};
use super::query_context::QueryContext;
use super::store_errors::logged;
use crate::domain::StateKey;
use crate::error::Problem;
use crate::information::plug_in;
use crate::priors::{Pages, Tables};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress};

/// What one state is ranked by.
#[derive(Debug)]
pub struct Rank {
    visits: u64,
    plug_in: f64,
}

/// The ranks of every state seen, in order of key.
#[derive(Default)]
pub struct CountRanking {
    pub rows: Keyed<Rank>,
    pub orders: Orders,
}

impl Ranked for Keyed<Rank> {
    fn len(&self) -> usize {
        self.len()
    }

    fn bins(&self, at: usize) -> &[u32] {
        self.bins(at)
    }

    fn visits(&self, at: usize) -> u64 {
        self.values()[at].visits
    }

    fn plug_in(&self, at: usize) -> f64 {
        self.values()[at].plug_in
    }

    fn posterior_mean(&self, _: usize) -> f64 {
        0.0
    }

    fn dependent(&self, _: usize) -> f64 {
        0.0
    }
}

/// Passes over all states; returns their ranks, and how many transitions there were before.
pub async fn make(
    store: &dyn Store,
    gate: &Gate,
    context: &QueryContext,
    progress: &Progress,
) -> Result<(CountRanking, u64), Problem> {
    let totals = store.totals(context.environment.id).await.map_err(logged)?;
    progress.begin("states looked at", totals.states);

    let mut rows = Keyed::default();
    let mut pages = Pages::new(store, context.environment.id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, states) = (context.clone(), page.len() as u64);
        let ranks = gate.run(move |stop| stop.check().map(|()| ranks(&context, page)));
        for (key, rank) in ranks.await? {
            rows.push(&key, rank);
        }
        progress.add(states);
    }

    let rows = gate.run(move |_| {
        rows.sort();
        Ok(rows)
    });
    Ok((
        CountRanking {
            rows: rows.await?,
            orders: Orders::default(),
        },
        totals.transitions,
    ))
}

fn ranks(context: &QueryContext, page: Vec<Scanned>) -> Vec<(StateKey, Rank)> {
    let rank = |scanned: Scanned| {
        let (schema, scope) = (&context.environment.schema, &context.scope);
        let segments = context.segments.as_deref();
        let cells = scanned.counts.of_pair(schema, &scope.pair, segments);
        let tables = Tables::within(schema, &scope.pair, scope.within, cells);

        let visits = tables.whole.total();
        (visits > 0).then(|| {
            let plug_in = tables.figure(plug_in);
            (scanned.key, Rank { visits, plug_in })
        })
    };
    page.into_par_iter().filter_map(rank).collect()
}
