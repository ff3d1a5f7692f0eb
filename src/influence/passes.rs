//! What takes a pass over all states, from the caches: rankings, and the discoveries in them.

use std::sync::Arc;

use super::Influence;
use super::count_ranking::{self, CountRanking};
use super::discoveries::{self, DiscoverySearch};
use super::pass_cache::PassResult;
use super::query_context::QueryContext;
use super::state_ranking::{self, StateRanking};
use super::store_errors::logged;
use crate::domain::Discovery;
use crate::error::Problem;
use crate::store::Totals;
use crate::work::Progress;

impl Influence {
    /// Returns the ranking of a query.
    pub(super) async fn ranking(
        &self,
        context: &QueryContext,
    ) -> Result<Arc<PassResult<StateRanking>>, Problem> {
        let totals = self.totals(context).await?;
        self.rankings
            .get(
                context.key(),
                totals,
                |ranking| ranking.is_current(context),
                |progress| self.make_ranking(context, progress),
            )
            .await
    }

    /// Returns the same to a job that needs it.
    pub(super) async fn ranking_for(
        &self,
        other: &Progress,
        context: &QueryContext,
    ) -> Result<Arc<PassResult<StateRanking>>, Problem> {
        let totals = self.totals(context).await?;
        let make = |progress| self.make_ranking(context, progress);
        self.rankings
            .get_for(
                other,
                context.key(),
                totals,
                |ranking| ranking.is_current(context),
                make,
            )
            .await
    }

    /// Returns the ranking of a query if there is one that nothing was counted since.
    pub(super) async fn fresh_ranking(
        &self,
        context: &QueryContext,
    ) -> Result<Option<Arc<PassResult<StateRanking>>>, Problem> {
        let totals = self.totals(context).await?;
        let last = self.rankings.last(&context.key());
        Ok(last
            .filter(|ranking| ranking.as_of >= totals.transitions && ranking.is_current(context)))
    }

    pub(super) fn make_ranking(
        &self,
        context: &QueryContext,
        progress: Progress,
    ) -> impl Future<Output = Result<(StateRanking, u64), Problem>> + Send + 'static {
        let (this, context) = (self.clone(), context.clone());
        async move {
            let (store, gate) = (&*this.store, &this.work.passes);
            state_ranking::make(store, gate, &context, &progress).await
        }
    }

    pub(super) async fn count_ranking(
        &self,
        context: &QueryContext,
    ) -> Result<Arc<PassResult<CountRanking>>, Problem> {
        let totals = self.totals(context).await?;
        let make = |progress: Progress| {
            let (this, context) = (self.clone(), context.clone());
            async move {
                count_ranking::make(&*this.store, &this.work.passes, &context, &progress).await
            }
        };
        self.count_rankings
            .get(context.count_ranking_key(), totals, |_| true, make)
            .await
    }

    /// Returns the discoveries by a query, with the ranking that they were looked for in.
    pub(super) async fn searched(
        &self,
        context: &QueryContext,
        discovery: Discovery,
    ) -> Result<Arc<PassResult<DiscoverySearch>>, Problem> {
        let totals = self.totals(context).await?;
        let make = |progress: Progress| {
            let (this, context) = (self.clone(), context.clone());
            async move {
                let ranking = this.ranking_for(&progress, &context).await?;
                let found = discoveries::find(
                    &*this.store,
                    &this.work.passes,
                    &context,
                    &ranking,
                    discovery,
                    &progress,
                )
                .await?;
                let as_of = ranking.as_of;
                Ok((DiscoverySearch { ranking, found }, as_of))
            }
        };

        let key = (context.key(), discovery.fdr.to_bits(), discovery.method);
        self.searched
            .get(
                key,
                totals,
                |searched| searched.ranking.is_current(context),
                make,
            )
            .await
    }

    pub(super) async fn totals(&self, context: &QueryContext) -> Result<Totals, Problem> {
        self.store
            .totals(context.environment.id)
            .await
            .map_err(logged)
    }
}
