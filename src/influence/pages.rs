//! Questions about all states, a page at a time: where is influence highest? A page in an order
//! that needs no evidence is assessed alone; every other one is cut from a ranking.

use std::sync::Arc;

use tracing::instrument;

use super::Influence;
use super::listing::{self, Listing, MadeFrom};
use super::query_context::QueryContext;
use super::row;
use super::store_errors::logged;
use crate::domain::draft::ListingDraft;
use crate::domain::{Environment, Scope, StatePage};
use crate::error::Problem;
use crate::priors::PassEvidence;
use crate::store::ByVisits;

impl Influence {
    /// Returns a page of states in an order.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn states(
        &self,
        environment: &Arc<Environment>,
        listing: &ListingDraft,
    ) -> Result<StatePage, Problem> {
        let scope = Scope::new(environment, &listing.pair)?;
        let listing = Listing::new(&environment.schema, listing)?;
        let context = self.query_context(environment, scope).await?;
        let (ranking, searched) = match listing.discovery {
            Some(discovery) => {
                let searched = self.searched(&context, discovery).await?;
                (searched.ranking.clone(), Some(searched))
            }
            None if listing.needs_evidence() => (self.ranking(&context).await?, None),
            None => match self.fresh_ranking(&context).await? {
                Some(ranking) => (ranking, None),
                None => {
                    let (schema, pair) = (&environment.schema, &context.scope.pair);
                    return match listing.by_visits(schema, pair, context.segments.as_deref()) {
                        Some(wanted) => self.by_visits(context, listing, wanted).await,
                        None => self.ranked(context, listing).await,
                    };
                }
            },
        };

        let page = move || {
            let found = searched.as_ref().map(|searched| &searched.found);
            listing.page(&context.environment.schema, &context.scope, &ranking, found)
        };
        // The first page of an order sorts it.
        self.work.passes.run(move |_| Ok(page())).await
    }

    /// Returns a page in an order of visits: the store finds it in one pass, and only its own
    /// states are assessed.
    async fn by_visits(
        &self,
        context: QueryContext,
        listing: Listing,
        wanted: ByVisits,
    ) -> Result<StatePage, Problem> {
        let turn = self.work.questions.enter().await?;
        let (found, as_of) = self
            .store
            .by_visits(context.environment.id, &wanted)
            .await
            .map_err(logged)?;

        let states = found
            .into_iter()
            .map(|scanned| (scanned.key, Arc::new(scanned.counts)))
            .collect();

        turn.run(move |stop| {
            let (schema, scope) = (&context.environment.schema, &context.scope);
            let rows = row::measured(&context, states, &PassEvidence::default(), stop)?;
            let (size, next_page_token) = listing.cut(schema, &rows);
            let page = (&rows[..size], next_page_token);
            let fit = context.fit();
            Ok(listing::page_of(
                schema,
                scope,
                MadeFrom { as_of, fit },
                page,
            ))
        })
        .await
    }

    /// Returns a page in an order that needs no evidence: only its own states are assessed.
    async fn ranked(&self, context: QueryContext, listing: Listing) -> Result<StatePage, Problem> {
        let ranks = self.count_ranking(&context).await?;
        let (as_of, environment) = (ranks.as_of, context.environment.clone());
        let choosing = self
            .work
            .passes
            .run(move |_| Ok(listing.keys(&environment.schema, &ranks)));
        let (keys, next_page_token) = choosing.await?;

        let turn = self.work.questions.enter().await?;
        let counts = self
            .store
            .counts(context.environment.id, &keys)
            .await
            .map_err(logged)?;
        let states = keys
            .into_iter()
            .zip(counts)
            .map(|(key, state)| (key, state.counts))
            .collect();
        turn.run(move |stop| {
            let (schema, scope) = (&context.environment.schema, &context.scope);
            let rows = row::measured(&context, states, &PassEvidence::default(), stop)?;
            let page = (&rows[..], next_page_token);
            let fit = context.fit();
            Ok(listing::page_of(
                schema,
                scope,
                MadeFrom { as_of, fit },
                page,
            ))
        })
        .await
    }
}
