//! A ranking that needs no evidence: of all states by how often each was seen, or by its plug-in
//! mutual information.

use rayon::prelude::*;

use super::order::{Orders, Ranked};
use super::query_context::QueryContext;
use super::store_errors::logged;
use crate::domain::{Evidence, StateKey};
use crate::error::Problem;
use crate::information::plug_in;
use crate::priors::{Pages, Tables};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress};

/// What one state is ranked by.
pub struct Rank {
    key: StateKey,
    visits: u64,
    plug_in: f64,
}

/// The ranks of every state seen, in order of key.
#[derive(Default)]
pub struct CountRanking {
    pub rows: Vec<Rank>,
    pub orders: Orders,
}

impl Ranked for Rank {
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
        None
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

    let mut rows = Vec::new();
    let mut pages = Pages::new(store, context.environment.id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, states) = (context.clone(), page.len() as u64);
        rows.extend(
            gate.run(move |stop| stop.check().map(|()| ranks(&context, page)))
                .await?,
        );
        progress.add(states);
    }

    let rows = gate.run(move |_| {
        rows.sort_unstable_by(|a: &Rank, b| a.key.cmp(&b.key));
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

fn ranks(context: &QueryContext, page: Vec<Scanned>) -> Vec<Rank> {
    let rank = |scanned: Scanned| {
        let cells = scanned.counts.of_segments(context.segments.as_deref());
        let tables = Tables::within(
            &context.environment.schema,
            &context.scope.pair,
            context.scope.within,
            cells,
        );

        let visits = tables.whole.total();
        (visits > 0).then(|| Rank {
            key: scanned.key,
            visits,
            plug_in: tables.figure(plug_in),
        })
    };
    page.into_par_iter().filter_map(rank).collect()
}
