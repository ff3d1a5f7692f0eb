//! The question itself: in this state, does the ego's action influence the other's?

use std::sync::Arc;

use crate::domain::draft::{ListingDraft, PairDraft};
use crate::domain::{Answers, Environment, Question, StatePage, StateView, Summary};
use crate::error::Problem;
use crate::store::Store;

/// A handle on the answers. Cloning is cheap.
#[derive(Clone)]
pub struct Influence {}

impl Influence {
    /// Makes a handle.
    pub fn new(_store: Arc<dyn Store>) -> Self {
        todo!()
    }

    /// Answers a question.
    pub async fn answer(&self, _environment: &Environment, _question: &Question) -> Result<Answers, Problem> {
        todo!()
    }

    /// Returns the counts of the state of that key.
    pub async fn state(&self, _environment: &Environment, _key: &str) -> Result<StateView, Problem> {
        todo!()
    }

    /// Returns a page of states in an order.
    pub async fn states(&self, _environment: &Arc<Environment>, _listing: &ListingDraft) -> Result<StatePage, Problem> {
        todo!()
    }

    /// Returns what all states say together.
    pub async fn summary(&self, _environment: &Arc<Environment>, _pair: &PairDraft) -> Result<Summary, Problem> {
        todo!()
    }
}
