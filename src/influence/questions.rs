//! Questions about states that are named: their answers, and their counts.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use tracing::instrument;

use super::answer::{self, AnswerContext};
use super::labels::{bins, labelled, labels};
use super::region_answers::{self, Made, RegionContext};
use super::store_errors::logged;
use super::{Influence, size};
use crate::domain::{
    Answers, Basis, Environment, Question, RegionAnswers, RegionQuestion, StateView, Tally, Verdict,
};
use crate::error::{Fault, Problem};
use crate::telemetry;
use crate::work::{Progress, aside};

impl Influence {
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

        let pair = &question.scope.pair;
        let (labels, lag) = (labels(schema, pair), pair.lag(schema));
        let answers = answer::answers(
            &*self.store,
            &self.work.questions,
            AnswerContext {
                query: context,
                question,
            },
        )
        .await?;
        count_verdicts(
            started,
            answers.iter().map(|answer| (answer.verdict, answer.basis)),
        );
        Ok(Answers {
            labels,
            lag,
            answers,
        })
    }

    /// Answers a question about regions.
    #[instrument(level = "debug", skip_all, fields(environment = %environment.name))]
    pub async fn answer_regions(
        &self,
        environment: &Arc<Environment>,
        question: RegionQuestion,
    ) -> Result<RegionAnswers, Problem> {
        let started = Instant::now();
        size::check_regions(&environment.schema, &question)?;
        let scope = question.scope.clone();
        let context = RegionContext {
            query: self.query_context(environment, scope).await?,
            question: Arc::new(question),
        };

        let totals = self.totals(&context.query).await?;
        let made = |progress: Progress| {
            let (this, context) = (self.clone(), context.clone());
            async move {
                let (store, gate) = (&*this.store, &this.work.passes);
                region_answers::make(store, gate, &context, &progress).await
            }
        };
        let is_current = |made: &Made| made.is_current(&context.query);
        let made = self.regions.get(context.key(), totals, is_current, made);
        let made = made.await?;
        let answers = context.told(&made, made.as_of);
        let verdicts = answers.answers.iter();
        count_verdicts(
            started,
            verdicts.map(|answer| (answer.verdict, answer.basis)),
        );
        Ok(answers)
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
                bins: bins(&schema, &key),
                total: Tally::sum(cells.iter()),
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
}

/// Counts a question that was answered, with these verdicts and what each rests on.
pub fn count_verdicts(since: Instant, told: impl Iterator<Item = (Verdict, Basis)>) {
    telemetry::answered(since.elapsed());

    let mut verdicts: BTreeMap<_, u64> = BTreeMap::new();
    for (verdict, basis) in told {
        *verdicts
            .entry((verdict.as_str(), basis.as_str()))
            .or_default() += 1;
    }
    verdicts
        .into_iter()
        .for_each(|((verdict, basis), number)| telemetry::decided(verdict, basis, number));
}
