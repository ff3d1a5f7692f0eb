//! The question itself: in this state, does the ego's action influence the other's, how strongly, and which of its actions do it?
//!
//! Reads counts from the store, makes tables of them, lets `information` measure and `evidence` decide. Nothing here writes, and nothing here knows
//! a wire format but for the size that an answer may have.

use std::sync::Arc;
use std::time::Instant;

mod answer;
mod listing;
mod size;
mod summary;
mod survey;
mod tables;

use listing::Listing;
use survey::Surveys;

use crate::domain::draft::{ListingDraft, PairDraft};
use crate::domain::{
    Agent, Answers, Basis, Cell, Environment, Label, LabelledCell, Labels, Pair, Question, Schema, Scope, SegmentId,
    StatePage, StateView, Summary, Variable,
};
use crate::error::{Fault, Problem};
use crate::store::Store;
use crate::telemetry;

/// A handle on the answers. Cloning is cheap.
#[derive(Clone)]
pub struct Influence {
    store: Arc<dyn Store>,
    surveys: Surveys,
}

impl Influence {
    /// Makes a handle on the answers from a store.
    pub fn new(store: Arc<dyn Store>) -> Self {
        Self { surveys: Surveys::new(store.clone()), store }
    }

    /// Answers a question. Its answers stand on every transition acknowledged before it was asked.
    pub async fn answer(&self, environment: &Environment, question: &Question) -> Result<Answers, Problem> {
        let started = Instant::now();
        let schema = &environment.schema;
        size::check(schema, question)?;
        let segments = self.segments(environment, question.scope.segments.as_deref()).await?;
        let counts = self.store.counts(environment.id, &question.states).await.map_err(logged)?;
        let answers = answer::answers(schema, question, segments.as_deref(), counts).await?;
        let by_prior = answers.iter().filter(|answer| answer.basis == Basis::Prior).count() as u64;
        telemetry::answered(started.elapsed(), answers.len() as u64 - by_prior, by_prior);
        Ok(Answers { labels: labels(schema, &question.scope.pair), answers })
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
            total: answer::total(state.counts.cells().iter()),
            cells: state.counts.cells().iter().map(labelled).collect(),
            revision: state.revision,
            key,
        })
    }

    /// Returns a page of states in an order.
    pub async fn states(&self, environment: &Arc<Environment>, listing: &ListingDraft) -> Result<StatePage, Problem> {
        let scope = Scope::new(environment, &listing.pair)?;
        let listing = Listing::new(&environment.schema, listing)?;
        let segments = self.segments(environment, scope.segments.as_deref()).await?;
        let survey = self.surveys.get(environment, &scope.pair, segments).await.map_err(logged)?;
        Ok(listing.page(&environment.schema, &scope, &survey))
    }

    /// Returns what all states say together.
    pub async fn summary(&self, environment: &Arc<Environment>, pair: &PairDraft) -> Result<Summary, Problem> {
        let scope = Scope::new(environment, pair)?;
        let segments = self.segments(environment, scope.segments.as_deref()).await?;
        let survey = self.surveys.get(environment, &scope.pair, segments).await.map_err(logged)?;
        let named = self.store.segments(environment.id).await.map_err(logged)?;
        let named = named.into_iter().filter_map(|(_, label)| label).collect();
        Ok(summary::summary(&scope, named, &survey))
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

fn logged(error: crate::store::StoreError) -> Problem {
    tracing::error!(%error, "a question could not be answered");
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
