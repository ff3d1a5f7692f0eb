//! The question itself: in this state, does the ego's action influence the other's, how strongly, and which of its actions do it?
//!
//! Reads counts from the store, makes tables of them, lets `information` measure and `evidence` decide. Nothing here counts, and nothing here knows
//! a wire format but for the size that an answer may have; what is fitted to all counts of an environment is kept in the store beside them.

use std::sync::Arc;
use std::time::Instant;

mod actions;
mod answer;
mod discoveries;
mod explore;
mod graph;
mod judge;
mod listing;
mod order;
mod size;
mod skeleton;
mod stratified;
mod summary;
mod survey;

use answer::Ground;
use listing::Listing;
use survey::{Plan, Survey, Surveys};

use crate::domain::draft::{DiscoveryDraft, ExplorationDraft, ListingDraft, PairDraft};
use crate::domain::{
    Agent, Answer, Answers, Basis, Cell, Discovery, Environment, Exploration, FittedPrior, Label, LabelledCell, Labels,
    Pair, Question, Schema, Scope, SegmentId, StatePage, StateView, Summary, Tally, Variable, page_size,
};
use crate::error::{ErrorKind, Fault, Problem};
use crate::model::Networks;
use crate::priors::Fits;
use crate::store::Store;
use crate::telemetry;

/// A handle on the answers. Cloning is cheap.
#[derive(Clone)]
pub struct Influence {
    store: Arc<dyn Store>,
    fits: Fits,
    networks: Networks,
    surveys: Surveys,
}

impl Influence {
    /// Makes a handle on the answers from a store, the priors fitted to it and the networks that are asked where counts do not decide.
    pub fn new(store: Arc<dyn Store>, fits: Fits, networks: Networks) -> Self {
        Self { fits, networks, surveys: Surveys::new(store.clone()), store }
    }

    /// Answers a question. Its answers stand on every transition acknowledged before it was asked.
    pub async fn answer(&self, environment: &Arc<Environment>, question: Question) -> Result<Answers, Problem> {
        let started = Instant::now();
        let schema = &environment.schema;
        size::check(schema, &question)?;
        let plan = self.plan(environment, question.scope.clone()).await?;
        let counts = self.store.counts(environment.id, &question.states).await.map_err(logged)?;
        let labels = labels(schema, &question.scope.pair);
        let answers = answer::answers(Ground { plan, question }, counts).await?;
        told(started, &answers);
        Ok(Answers { labels, answers })
    }

    /// Returns the counts of the state of that key.
    pub async fn state(&self, environment: &Environment, key: &str) -> Result<StateView, Problem> {
        let schema = &environment.schema;
        let wrong = |detail| Problem::invalid("state key", vec![Fault::new("/key", detail)]);
        let key = schema.key_of_text(key).map_err(wrong)?;
        let counts = self.store.counts(environment.id, std::slice::from_ref(&key)).await.map_err(logged)?;
        let segments = self.store.segments(environment.id).await.map_err(logged)?;
        let Some(state) = counts.first() else { return Err(Problem::invalid("state key", Vec::new())) };
        let labelled = |cell: &Cell| labelled(schema, &segments, cell);
        Ok(StateView {
            bins: answer::bins(schema, &key),
            total: Tally::of(state.counts.cells().iter()),
            cells: state.counts.cells().iter().map(labelled).collect(),
            revision: state.revision,
            key,
        })
    }

    /// Returns a page of states in an order.
    pub async fn states(&self, environment: &Arc<Environment>, listing: &ListingDraft) -> Result<StatePage, Problem> {
        let scope = Scope::new(environment, &listing.pair)?;
        let listing = Listing::new(&environment.schema, listing)?;
        let plan = self.plan(environment, scope).await?;
        let survey = self.surveys.get(&plan).await.map_err(logged)?;
        let found = self.discoveries(&plan, &survey, listing.discovery).await?;
        Ok(listing.page(&environment.schema, &plan.scope, &survey, found.as_deref()))
    }

    /// Returns what all states say together.
    pub async fn summary(
        &self,
        environment: &Arc<Environment>,
        pair: &PairDraft,
        discovery: &DiscoveryDraft,
    ) -> Result<Summary, Problem> {
        let scope = Scope::new(environment, pair)?;
        let discovery = Discovery::new(discovery).map_err(|faults| Problem::invalid("question", faults))?;
        let plan = self.plan(environment, scope).await?;
        let survey = self.surveys.get(&plan).await.map_err(logged)?;
        let found = self.discoveries(&plan, &survey, discovery).await?;
        let named = self.store.segments(environment.id).await.map_err(logged)?;
        let named = named.into_iter().filter_map(|(_, label)| label).collect();
        Ok(summary::summary(&environment.schema, &plan.scope, named, &survey, found.as_deref()))
    }

    /// Returns the states, and the ego's actions in them, where one more visit is worth most.
    pub async fn explore(
        &self,
        environment: &Arc<Environment>,
        draft: &ExplorationDraft,
    ) -> Result<Exploration, Problem> {
        let scope = Scope::new(environment, &draft.pair)?;
        let limit = page_size(draft.limit).map_err(|_| Problem::invalid("question", vec![limit_fault(draft.limit)]))?;
        let plan = self.plan(environment, scope).await?;
        let survey = self.surveys.get(&plan).await.map_err(logged)?;
        let keys = explore::candidates(&survey, draft.min_visits);
        let counts = self.store.counts(environment.id, &keys).await.map_err(logged)?;
        let explored = move || explore::explore(&plan, &keys, &counts, limit, survey.as_of);
        let explored = tokio::task::spawn_blocking(explored).await;
        explored.map_err(|error| Problem::new(ErrorKind::Internal, "INTERNAL", error.to_string()))
    }

    /// Fits the prior of a pair, or of every pair, to the counts as they are now.
    pub async fn fit(
        &self,
        environment: &Arc<Environment>,
        pair: Option<&PairDraft>,
    ) -> Result<Vec<FittedPrior>, Problem> {
        let pairs = match pair {
            Some(pair) => vec![Scope::new(environment, pair)?.pair.undirected()],
            None => Pair::every(&environment.schema),
        };
        let mut fitted = Vec::with_capacity(pairs.len());
        for pair in pairs {
            let Some(found) = self.fits.fit(environment, &pair).await.map_err(logged)? else { continue };
            let name = |agent: usize| environment.schema.agents()[agent].name.to_string();
            fitted.push(FittedPrior {
                earlier: name(pair.ego),
                later: name(pair.other),
                given: pair.given.iter().map(|agent| name(*agent)).collect(),
                fit: found.id,
                states: found.fit.states,
                dependent_share: found.fit.parameters.dependent,
            });
        }
        Ok(fitted)
    }

    /// Finds out what questions of that scope rest on: the numbers of their segments and the fit.
    async fn plan(&self, environment: &Arc<Environment>, scope: Scope) -> Result<Plan, Problem> {
        let segments = self.segments(environment, scope.segments.as_deref()).await?;
        let informed = self.fits.informed(environment, &scope.pair).await.map_err(logged)?;
        let network = self.networks.active(environment, &scope.pair).await?;
        Ok(Plan { environment: environment.clone(), scope, segments, informed, network })
    }

    async fn discoveries(
        &self,
        plan: &Plan,
        survey: &Survey,
        discovery: Option<Discovery>,
    ) -> Result<Option<Arc<discoveries::Found>>, Problem> {
        let Some(discovery) = discovery else { return Ok(None) };
        Ok(Some(survey.discoveries(&*self.store, plan, discovery).await.map_err(logged)?))
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
            match known.iter().find(|(_, known)| known.as_ref() == Some(label)) {
                Some((id, _)) => ids.push(*id),
                None => faults.push(Fault::new("/segments", format!("unknown segment {:?}", label.as_str()))),
            }
        }
        if faults.is_empty() { Ok(Some(ids)) } else { Err(Problem::invalid("question", faults)) }
    }
}

/// Counts a question that was answered.
fn told(since: Instant, answers: &[Answer]) {
    let mut bases = [0; 3];
    for answer in answers {
        bases[match answer.basis {
            Basis::Counts(_) => 0,
            Basis::Model(_) => 1,
            Basis::Prior => 2,
        }] += 1;
    }
    telemetry::answered(since.elapsed(), bases);
}

fn limit_fault(limit: u64) -> Fault {
    Fault::new("/limit", format!("got {limit}, expected 1 to 1000"))
}

fn logged(error: crate::store::StoreError) -> Problem {
    // That an environment was deleted meanwhile is no fault.
    if error.kind() != ErrorKind::NotFound {
        tracing::error!(%error, "a question could not be answered");
    }
    error.into()
}

fn labelled(schema: &Schema, segments: &[(SegmentId, Option<Label>)], cell: &Cell) -> LabelledCell {
    let actions = schema.actions_of(cell.joint);
    let labels = schema.agents().iter().zip(&actions).map(|(agent, index)| agent.action_label(*index)).collect();
    let segment = segments.iter().find(|(id, _)| *id == cell.segment).and_then(|(_, label)| label.clone());
    LabelledCell { segment, actions, labels, tally: cell.tally }
}

fn labels(schema: &Schema, pair: &Pair) -> Labels {
    let variable = |agent: &usize| variable(&schema.agents()[*agent]);
    Labels { ego: variable(&pair.ego), other: variable(&pair.other), given: pair.given.iter().map(variable).collect() }
}

fn variable(agent: &Agent) -> Variable {
    let told = agent.actions() <= Variable::MOST_LABELS;
    let actions = if told { (0..agent.actions()).map(|index| agent.action_label(index)).collect() } else { Vec::new() };
    Variable { name: agent.name.to_string(), actions }
}
