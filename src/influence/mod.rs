//! The question itself: in this state, does the ego's action influence the other's, how strongly,
//! and which of its actions do it?
//!
//! Reads counts from the store, makes tables of them, lets `information` measure and `evidence`
//! decide. Nothing here counts, and nothing here knows a wire format but for the size that an
//! answer may have; what is fitted to all counts of an environment is kept in the store beside
//! them.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tracing::instrument;

mod actions;
mod answer;
mod assessor;
mod count_ranking;
mod discoveries;
mod explore;
mod graph;
mod listing;
mod order;
mod pass_cache;
mod size;
mod skeleton;
mod state_ranking;
mod store_errors;
mod stratified;
mod summary;

use answer::AnswerContext;
use count_ranking::CountRanking;
use discoveries::DiscoverySearch;
use explore::Explored;
use listing::Listing;
use pass_cache::{PassCache, PassResult};
use state_ranking::{QueryContext, StateRanking};
use store_errors::logged;

use crate::domain::draft::{ExplorationDraft, ListingDraft, PairDraft, SummaryDraft};
use crate::domain::{
    Agent, Answer, Answers, Cell, Discovery, DiscoveryMethod, Environment, EnvironmentId,
    Exploration, FittedPrior, Label, LabelledCell, Labels, Pair, Question, Schema, Scope,
    SegmentId, StatePage, StateView, Summary, Tally, Variable, hint, page_size,
};
use crate::error::{Fault, Problem};
use crate::model::Networks;
use crate::priors::PriorRegistry;
use crate::store::{ByVisits, Store, Totals};
use crate::telemetry;
use crate::work::{Jobs, Progress, Work, aside};

/// For how long fits that nobody was told are kept for whoever asked for them.
const FITTED: Duration = Duration::from_secs(120);

/// Which discoveries: the ranking they are looked for in, the bits of the rate, and the method.
type Sought = (state_ranking::RankingKey, u64, DiscoveryMethod);

/// Which priors: of one pair, or of all.
type Fitting = (EnvironmentId, Option<Pair>);

/// A handle on the answers. Cloning is cheap.
#[derive(Clone)]
pub struct Influence {
    store: Arc<dyn Store>,
    fits: PriorRegistry,
    networks: Networks,
    work: Work,
    count_rankings: PassCache<state_ranking::CountRankingKey, CountRanking>,
    rankings: PassCache<state_ranking::RankingKey, StateRanking>,
    searched: PassCache<Sought, DiscoverySearch>,
    explored: PassCache<(state_ranking::RankingKey, u64), Explored>,
    fitting: Jobs<Fitting, Vec<FittedPrior>>,
}

impl Influence {
    /// Makes a handle on the answers from a store, the priors fitted to it and the networks that
    /// are asked where counts do not decide.
    pub fn new(store: Arc<dyn Store>, fits: PriorRegistry, networks: Networks, work: Work) -> Self {
        let stopping = || work.stopping.clone();
        Self {
            count_rankings: PassCache::new("the ranking", stopping()),
            rankings: PassCache::new("the ranking", stopping()),
            searched: PassCache::new("the list of discoveries", stopping()),
            explored: PassCache::new("the exploration", stopping()),
            fitting: Jobs::new("the fit", FITTED, stopping()),
            store,
            fits,
            networks,
            work,
        }
    }

    /// Answers a question. Its answers stand on every transition acknowledged before it was asked.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn answer(
        &self,
        environment: &Arc<Environment>,
        question: Question,
    ) -> Result<Answers, Problem> {
        let started = Instant::now();
        let schema = &environment.schema;
        size::check(schema, &question)?;
        let context = self
            .query_context(environment, question.scope.clone())
            .await?;
        size::check_informed(&context, &question)?;
        let labels = labels(schema, &question.scope.pair);
        let answers = answer::answers(
            &*self.store,
            &self.work.questions,
            AnswerContext {
                query: context,
                question,
            },
        )
        .await?;
        count_answers(started, &answers);
        Ok(Answers { labels, answers })
    }

    /// Returns the counts of the state of that key.
    pub async fn state_view(
        &self,
        environment: &Environment,
        key: &str,
    ) -> Result<StateView, Problem> {
        let schema = environment.schema.clone();
        let wrong = |detail| Problem::invalid("state key", vec![Fault::new("/key", detail)]);
        let key = schema.key_of_text(key).map_err(wrong)?;
        let counts = self
            .store
            .counts(environment.id, std::slice::from_ref(&key))
            .await
            .map_err(logged)?;
        let segments = self.store.segments(environment.id).await.map_err(logged)?;
        let Some(state) = counts.into_iter().next() else {
            return Err(Problem::invalid("state key", Vec::new()));
        };
        size::check_counts(&schema, &state.counts)?;
        let bytes = size_of_val(state.counts.cells());
        let view = move || {
            let cells = state.counts.cells();
            StateView {
                bins: answer::bins(&schema, &key),
                total: Tally::of(cells.iter()),
                cells: cells
                    .iter()
                    .map(|cell| labelled(&schema, &segments, cell))
                    .collect(),
                revision: state.revision,
                key,
            }
        };
        aside(bytes, view).await
    }

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
                None => match listing.by_visits(context.segments.as_deref()) {
                    Some(wanted) => return self.by_visits(context, listing, wanted).await,
                    None => return self.ranked(context, listing).await,
                },
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
            let (schema, unit) = (&context.environment.schema, context.scope.unit);
            let rows = state_ranking::measured(&context, states, stop)?;
            let (size, next_page_token) = listing.cut(schema, &rows);
            let states = rows[..size]
                .iter()
                .map(|row| listing::figures(schema, unit, row))
                .collect();
            Ok(StatePage {
                states,
                next_page_token,
                as_of,
                unit,
            })
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
        let unit = context.scope.unit;
        let assessing = turn.run(move |stop| {
            let schema = &context.environment.schema;
            let rows = state_ranking::measured(&context, states, stop)?;
            Ok(rows
                .iter()
                .map(|row| listing::figures(schema, unit, row))
                .collect())
        });
        Ok(StatePage {
            states: assessing.await?,
            next_page_token,
            as_of,
            unit,
        })
    }

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
        let is_current = |explored: &Explored| context.is_of(&explored.ranking);
        let explored = self
            .explored
            .get((context.key(), min_visits), totals, is_current, made)
            .await?;
        size::check_states(
            &environment.schema,
            explored.trials(limit).iter().map(|trial| &trial.key),
        )?;
        Ok(explored.first(limit))
    }

    /// Fits the prior of a pair, or of every pair, to the counts as they are now. Whoever could not
    /// wait for it is told of it when it asks again.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn fit(
        &self,
        environment: &Arc<Environment>,
        pair: Option<&PairDraft>,
    ) -> Result<Vec<FittedPrior>, Problem> {
        let pair = pair
            .map(|pair| Scope::new(environment, pair))
            .transpose()?
            .map(|scope| scope.pair.undirected());
        let fits = |progress: Progress| {
            let (this, environment, pair) = (self.clone(), environment.clone(), pair.clone());
            async move {
                let pairs =
                    pair.map_or_else(|| Pair::every(&environment.schema), |pair| vec![pair]);
                let mut fitted = Vec::with_capacity(pairs.len());
                for pair in pairs {
                    fitted.extend(this.fitted(&progress, &environment, &pair).await?);
                }
                Ok(fitted)
            }
        };
        self.fitting.ask((environment.id, pair.clone()), fits).await
    }

    /// Fits one prior; `None` where the alphabets are too large for evidence.
    async fn fitted(
        &self,
        progress: &Progress,
        environment: &Environment,
        pair: &Pair,
    ) -> Result<Option<FittedPrior>, Problem> {
        let Some(found) = self.fits.fit_telling(progress, environment, pair).await? else {
            return Ok(None);
        };
        let name = |agent: usize| environment.schema.agents()[agent].name.to_string();
        Ok(Some(FittedPrior {
            earlier: name(pair.ego),
            later: name(pair.other),
            given: pair.given.iter().map(|agent| name(*agent)).collect(),
            fit: found.id,
            states: found.fit.states,
            dependent_share: found.fit.parameters.dependent,
        }))
    }

    /// Returns the ranking of a query.
    async fn ranking(
        &self,
        context: &QueryContext,
    ) -> Result<Arc<PassResult<StateRanking>>, Problem> {
        let totals = self.totals(context).await?;
        self.rankings
            .get(
                context.key(),
                totals,
                |ranking| context.is_of(ranking),
                |progress| self.make_ranking(context, progress),
            )
            .await
    }

    /// Returns the same to a job that needs it.
    async fn ranking_for(
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
                |ranking| context.is_of(ranking),
                make,
            )
            .await
    }

    /// Returns the ranking of a query if there is one that nothing was counted since.
    async fn fresh_ranking(
        &self,
        context: &QueryContext,
    ) -> Result<Option<Arc<PassResult<StateRanking>>>, Problem> {
        let totals = self.totals(context).await?;
        let last = self.rankings.last(&context.key());
        Ok(last.filter(|ranking| ranking.as_of >= totals.transitions && context.is_of(ranking)))
    }

    fn make_ranking(
        &self,
        context: &QueryContext,
        progress: Progress,
    ) -> impl Future<Output = Result<(StateRanking, u64), Problem>> + Send + 'static {
        let (this, context) = (self.clone(), context.clone());
        async move { state_ranking::make(&*this.store, &this.work.passes, &context, &progress).await }
    }

    async fn count_ranking(
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
    async fn searched(
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
                |searched| context.is_of(&searched.ranking),
                make,
            )
            .await
    }

    async fn totals(&self, context: &QueryContext) -> Result<Totals, Problem> {
        self.store
            .totals(context.environment.id)
            .await
            .map_err(logged)
    }

    /// Finds out what questions of that scope rest on: the numbers of their segments and the fit.
    async fn query_context(
        &self,
        environment: &Arc<Environment>,
        scope: Scope,
    ) -> Result<QueryContext, Problem> {
        let segments = self
            .segments(environment, scope.segments.as_deref())
            .await?;
        let informed = self
            .fits
            .informed(environment, &scope.pair)
            .await
            .map_err(logged)?;
        let network = self.networks.active(environment, &scope.pair).await?;
        Ok(QueryContext {
            environment: environment.clone(),
            scope,
            segments,
            informed,
            network,
        })
    }

    /// Returns the numbers of the segments named, or every unknown one as a fault.
    async fn segments(
        &self,
        environment: &Environment,
        named: Option<&[Label]>,
    ) -> Result<Option<Vec<SegmentId>>, Problem> {
        let Some(named) = named else { return Ok(None) };
        let known = self.store.segments(environment.id).await.map_err(logged)?;
        let mut faults = Vec::new();
        let mut ids = Vec::with_capacity(named.len());
        for label in named {
            match known
                .iter()
                .find(|(_, known)| known.as_ref() == Some(label))
            {
                Some((id, _)) => ids.push(*id),
                None => {
                    let known = known
                        .iter()
                        .filter_map(|(_, label)| Some(label.as_ref()?.as_str()));
                    let hint = hint(label.as_str(), known);
                    faults.push(Fault::new(
                        "/segments",
                        format!("unknown segment {:?}{hint}", label.as_str()),
                    ));
                }
            }
        }
        if faults.is_empty() {
            Ok(Some(ids))
        } else {
            Err(Problem::invalid("question", faults))
        }
    }
}

/// Counts a question that was answered.
fn count_answers(since: Instant, answers: &[Answer]) {
    telemetry::answered(since.elapsed());
    let mut verdicts: BTreeMap<_, u64> = BTreeMap::new();
    for answer in answers {
        *verdicts
            .entry((answer.verdict.as_str(), answer.basis.as_str()))
            .or_default() += 1;
    }
    verdicts
        .into_iter()
        .for_each(|((verdict, basis), number)| telemetry::decided(verdict, basis, number));
}

fn limit_fault(limit: u64) -> Fault {
    Fault::new("/limit", format!("got {limit}, expected 1 to 1000"))
}

fn labelled(schema: &Schema, segments: &[(SegmentId, Option<Label>)], cell: &Cell) -> LabelledCell {
    let actions = schema.actions_of(cell.joint);
    let labels = schema
        .agents()
        .iter()
        .zip(&actions)
        .map(|(agent, index)| agent.action_label(*index))
        .collect();
    let segment = segments
        .iter()
        .find(|(id, _)| *id == cell.segment)
        .and_then(|(_, label)| label.clone());
    LabelledCell {
        segment,
        actions,
        labels,
        tally: cell.tally,
    }
}

fn labels(schema: &Schema, pair: &Pair) -> Labels {
    let variable = |agent: &usize| variable(&schema.agents()[*agent]);
    Labels {
        ego: variable(&pair.ego),
        other: variable(&pair.other),
        given: pair.given.iter().map(variable).collect(),
    }
}

fn variable(agent: &Agent) -> Variable {
    let are_told = agent.actions() <= Variable::MOST_LABELS;
    let actions = if are_told {
        (0..agent.actions())
            .map(|index| agent.action_label(index))
            .collect()
    } else {
        Vec::new()
    };
    Variable {
        name: agent.name.to_string(),
        actions,
    }
}
