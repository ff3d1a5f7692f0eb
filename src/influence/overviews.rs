//! Questions about all states together: summary statistics, and experimental design, where one more
//! visit is worth most.

use std::sync::Arc;

use tracing::instrument;

use super::explore::{self, Explored};
use super::profile::{self, ProfileContext};
use super::region_search::{self, RegionSearchContext};
use super::store_errors::logged;
use super::{Influence, size, summary};
use crate::domain::draft::{ExplorationDraft, SummaryDraft};
use crate::domain::{
    Discovery, Environment, Exploration, Halves, Profile, ProfileQuestion, RegionSearch,
    RegionSearchQuestion, Scope, Summary, page_size,
};
use crate::error::{Fault, Problem};
use crate::work::{Progress, aside};

impl Influence {
    /// Returns what all states say together.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn summary(
        &self,
        environment: &Arc<Environment>,
        draft: &SummaryDraft,
    ) -> Result<Summary, Problem> {
        let scope = Scope::new(environment, &draft.pair)?;
        let discovery = Discovery::new(&draft.discovery)
            .map_err(|faults| Problem::invalid("question", faults))?;
        let context = self.query_context(environment, scope).await?;
        let (ranking, searched) = match discovery {
            None => (self.ranking(&context).await?, None),
            Some(discovery) => {
                let searched = self.searched(&context, discovery).await?;
                (searched.ranking.clone(), Some(searched))
            }
        };

        let named = match draft.omit_segments {
            true => Vec::new(),
            false => self.store.segments(environment.id).await.map_err(logged)?,
        };
        let named = named.into_iter().filter_map(|(_, label)| label).collect();

        let rows = ranking.rows.len();
        let summary = move || {
            let found = searched.as_ref().map(|searched| &searched.found);
            summary::summary(
                &context.environment.schema,
                &context.scope,
                named,
                &ranking,
                found,
            )
        };
        aside(rows * size_of::<u64>(), summary).await
    }

    /// Returns the states, and the ego's actions in them, where one more visit is worth most.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn explore(
        &self,
        environment: &Arc<Environment>,
        draft: &ExplorationDraft,
    ) -> Result<Exploration, Problem> {
        let scope = Scope::new(environment, &draft.pair)?;
        let limit = page_size(draft.limit)
            .map_err(|_| Problem::invalid("question", vec![limit_fault(draft.limit)]))?;
        let context = self.query_context(environment, scope).await?;

        let (totals, min_visits) = (self.totals(&context).await?, draft.min_visits);
        let made = |progress: Progress| {
            let (this, context) = (self.clone(), context.clone());
            async move {
                let ranking = this.ranking_for(&progress, &context).await?;
                let (store, gate, as_of) = (&*this.store, &this.work.passes, ranking.as_of);
                Ok((
                    explore::explore(store, gate, &context, ranking, min_visits, &progress).await?,
                    as_of,
                ))
            }
        };

        let is_current = |explored: &Explored| explored.ranking.is_current(&context);
        let explored = self
            .explored
            .get((context.key(), min_visits), totals, is_current, made)
            .await?;

        size::check_states(
            &environment.schema,
            explored.trials(limit).iter().map(|trial| &trial.key),
        )?;
        Ok(explored.first(&context, limit))
    }
}

impl Influence {
    /// Returns what all states of a region say together, at one lag after the other.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn profile(
        &self,
        environment: &Arc<Environment>,
        question: ProfileQuestion,
    ) -> Result<Profile, Problem> {
        let segments = question.segments.as_deref();
        let context = ProfileContext {
            segments: self.segments(environment, segments).await?,
            environment: environment.clone(),
            question,
        };

        let totals = self.store.totals(environment.id).await.map_err(logged)?;
        let made = |progress: Progress| {
            let (this, context) = (self.clone(), context.clone());
            async move {
                let (store, gate) = (&*this.store, &this.work.passes);
                profile::make(store, gate, &context, &progress).await
            }
        };
        let points = self.profiles.get(context.key(), totals, |_| true, made);
        let points = points.await?;
        Ok(context.told(&points, points.as_of))
    }
}

impl Influence {
    /// Returns the regions in which a pair depends: found in one half of the counts, tested on the
    /// other.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn regions(
        &self,
        environment: &Arc<Environment>,
        question: RegionSearchQuestion,
    ) -> Result<RegionSearch, Problem> {
        let segments = question.segments.as_deref();
        let segments = self.segments(environment, segments).await?;
        let mut dealt = self.store.segments(environment.id).await.map_err(logged)?;
        if let Some(asked) = &segments {
            dealt.retain(|(id, _)| asked.contains(id));
        }
        let context = RegionSearchContext {
            halves: Halves::deal(&dealt, question.within),
            environment: environment.clone(),
            question,
            segments,
        };

        let totals = self.store.totals(environment.id).await.map_err(logged)?;
        let made = |progress: Progress| {
            let (this, context) = (self.clone(), context.clone());
            async move {
                let (store, gate) = (&*this.store, &this.work.passes);
                region_search::make(store, gate, &context, &progress).await
            }
        };
        let searches = &self.region_searches;
        let candidates = searches.get(context.key(), totals, |_| true, made).await?;
        Ok(context.told(&candidates, candidates.as_of))
    }
}

fn limit_fault(limit: u64) -> Fault {
    Fault::new("/limit", format!("got {limit}, expected 1 to 1000"))
}
