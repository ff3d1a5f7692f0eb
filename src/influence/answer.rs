//! Answers about states: point estimates, credible intervals, p-values and verdicts; of one state
//! at once, of thousands by several threads, when it is their turn.

use std::cell::LazyCell;

use rayon::prelude::*;

use super::actions;
use super::assessor::{Assessment, Assessor};
use super::holds;
use super::labels::bins;
use super::query_context::QueryContext;
use super::store_errors::logged;
use super::stratified::{self, Tested};
use crate::domain::{
    Answer, Cell, Estimator, Figures, ModelAction, ModelFigures, Question, Schema, Scope, StateKey,
    Unit, View,
};
use crate::error::Problem;
use crate::information::{self, Alphabet, ExpectedMethod};
use crate::model::Prediction;
use crate::priors::{self, Observations, Tables};
use crate::store::{StateCounts, Store};
use crate::work::{Gate, Stop, Stopped};

/// States that a network is asked about together.
const TOGETHER: usize = 256;

/// What is answered where it is asked: figures of pairs of actions, over all states; some tenths of
/// a millisecond.
const LIGHT: u64 = 1_024;

/// By how much more the figures of each of the ego's actions take.
const FULL: u64 = 40;

/// The most states, and the most cells of all of them, that are answered where it is asked.
const FEW_STATES: u64 = 16;
const FEW_CELLS: usize = 1_024;

/// What an answer is made from, beside the counts of its state.
#[derive(Clone)]
pub struct AnswerContext {
    /// The environment, the segments and the fit.
    pub query: QueryContext,
    /// The question.
    pub question: Question,
}

/// Returns whether a question is sooner answered where it is asked than handed to another thread.
fn is_light(schema: &Schema, question: &Question) -> bool {
    let Alphabet { rows, columns } = question.scope.pair.alphabet(schema);
    let (states, detail) = (
        question.states.len() as u64,
        if question.view == View::Full { FULL } else { 1 },
    );

    let figures = states
        .saturating_mul(rows.saturating_mul(columns))
        .saturating_mul(detail);

    let is_slow = question.significance.is_some() || question.visits_to_decide;
    !is_slow && states <= FEW_STATES && figures <= LIGHT
}

/// Returns the answers for the states of a question. One that takes long waits for its turn before
/// the counts are read, so that it holds next to nothing until then.
pub async fn answers(
    store: &dyn Store,
    gate: &Gate,
    context: AnswerContext,
) -> Result<Vec<Answer>, Problem> {
    let environment = &context.query.environment;
    let turn = match is_light(&environment.schema, &context.question) {
        true => None,
        false => Some(gate.enter().await?),
    };

    let counts = store
        .counts(environment.id, &context.question.states)
        .await
        .map_err(logged)?;

    let cells: usize = counts.iter().map(|state| state.counts.cells().len()).sum();
    let turn = match turn {
        None if cells <= FEW_CELLS => return Ok(context.answers_here(&counts)),
        None => gate.enter().await?,
        Some(turn) => turn,
    };
    turn.run(move |stop| context.answers(&counts, stop)).await
}

/// Returns a warning where pooled and stratified answers disagree: by their tests, where those were
/// asked for, else by the evidence.
fn warning(tested: Option<Tested>, assessment: &Assessment) -> Option<String> {
    match tested {
        Some(tested) => tested.warning(),
        None => stratified::warning(&assessment.evidence?),
    }
}

/// Tests a state for independence by permutations, pooled and where it has several segments within
/// them too.
fn independence_tests<'a>(
    assessor: Assessor<'_>,
    tables: &Tables,
    cells: impl Iterator<Item = &'a Cell> + Clone,
    seed: u64,
) -> Tested {
    let (schema, pair) = (assessor.schema, &assessor.scope.pair);
    let strata =
        (tables.segments > 1).then(|| Tables::strata_by_segment(schema, pair, cells.clone()));
    let pooled = tables.strata_of_observations(schema, pair, cells);
    Tested::new(&pooled, strata.as_deref(), seed)
}

impl AnswerContext {
    fn assessor(&self) -> Assessor<'_> {
        self.query.assessor(self.question.view)
    }

    /// Answers one state after another.
    pub fn answers_here(&self, counts: &[StateCounts]) -> Vec<Answer> {
        let (assessor, keys) = (self.assessor(), &self.question.states);
        let states = keys.iter().zip(counts).zip(assessor.predictions(keys));
        states
            .map(|((key, counts), predicted)| self.answer(assessor, key, counts, predicted))
            .collect()
    }

    /// Answers by several threads.
    fn answers(&self, counts: &[StateCounts], stop: &Stop) -> Result<Vec<Answer>, Stopped> {
        let assessor = self.assessor();
        let mut answers = Vec::with_capacity(counts.len());
        for (keys, counts) in self
            .question
            .states
            .chunks(TOGETHER)
            .zip(counts.chunks(TOGETHER))
        {
            stop.check()?;
            let states = keys.par_iter().zip(counts).zip(assessor.predictions(keys));
            let answer = |((key, counts), predicted)| {
                stop.check()?;
                Ok(self.answer(assessor, key, counts, predicted))
            };
            answers.extend(
                states
                    .map(answer)
                    .collect::<Result<Vec<Answer>, Stopped>>()?,
            );
        }
        Ok(answers)
    }

    /// Returns the answer for a state with these counts.
    fn answer(
        &self,
        assessor: Assessor<'_>,
        key: &StateKey,
        state: &StateCounts,
        predicted: Option<Prediction>,
    ) -> Answer {
        let (of, segments) = (&assessor.scope.pair, self.query.segments.as_deref());
        let cells = || state.counts.of_pair(assessor.schema, of, segments);
        let assessment = assessor.assess(key, &state.counts, predicted);

        // Both for those figures that need the tables themselves: most that are asked for do not.
        let tables = LazyCell::new(|| assessor.tables(cells()));
        let (schema, Scope { pair, within, .. }) = (assessor.schema, assessor.scope);
        let observations = LazyCell::new(|| tables.observations(schema, pair, *within, cells()));

        let figures = assessment.expected.map(|expected| {
            let tested = self.question.significance.map(|how| {
                let tested = independence_tests(assessor, &tables, cells(), key.seed());
                (tested, how.exchange(*within))
            });
            let alphabet = pair.alphabet(schema);
            let estimate = |estimator: Estimator| {
                let estimated = estimated(estimator, &tables, alphabet, assessor.scope.unit);
                (estimator.as_str(), estimated)
            };
            let visits_to_decide = self
                .question
                .visits_to_decide
                .then(|| self.visits_to_decide(assessor, &observations))
                .flatten();

            Box::new(Figures {
                bins: bins(assessor.schema, key),
                significance: tested.map(|(tested, exchange)| tested.significance(exchange)),
                warnings: warning(tested.map(|(tested, _)| tested), &assessment)
                    .into_iter()
                    .collect(),
                visits_to_decide,
                estimates: self.question.estimators.iter().map(estimate).collect(),
                holds: (assessor.view == View::Full)
                    .then(|| holds::holds(schema, pair, &state.counts, segments))
                    .flatten(),
                model: predicted.and_then(|predicted| self.model(assessor, key, predicted)),
                revision: state.revision,
                ..self.figures(assessor, &assessment, expected)
            })
        });
        let by_action = (assessor.view == View::Full)
            .then(|| actions::by_action(assessor, &tables, &observations));

        Answer {
            key: key.clone(),
            visits: assessment.tally.n,
            verdict: assessment.verdict,
            basis: assessment.basis,
            figures,
            by_action,
        }
    }

    /// Returns how many more visits a verdict would take, if there are not too many actions for it.
    fn visits_to_decide(
        &self,
        assessor: Assessor<'_>,
        observations: &Observations<'_>,
    ) -> Option<Option<u64>> {
        let informed = assessor.informed?;
        let (prior, scope) = (informed.in_detail()?, assessor.scope);
        let visits = prior.visits_to_decide(
            &informed.habits,
            observations.counted(),
            priors::ego(&scope.pair),
            &scope.rule,
        );
        Some(visits.filter(|_| assessor.is_open()))
    }

    /// Returns what the network says of a state, in the question's unit.
    fn model(
        &self,
        assessor: Assessor<'_>,
        key: &StateKey,
        predicted: Prediction,
    ) -> Option<ModelFigures> {
        let network = assessor.network?;
        let unit = assessor.scope.unit;
        let in_unit = |action: ModelAction| ModelAction {
            divergence: unit.from_nats(action.divergence),
            ..action
        };
        let by_action =
            (assessor.view == View::Full).then(|| network.by_action(&self.query.environment, key));

        Some(ModelFigures {
            version: network.version,
            kind: network.kind,
            probability: predicted.probability,
            mutual_information: predicted
                .mutual_information
                .map(|nats| unit.from_nats(nats)),
            agrees: predicted.agrees,
            out_of_range: network.out_of_range(&self.query.environment, key),
            by_action: by_action.into_iter().flatten().map(in_unit).collect(),
        })
    }

    fn figures(
        &self,
        assessor: Assessor<'_>,
        assessment: &Assessment,
        (expected, method): (f64, ExpectedMethod),
    ) -> Figures {
        let unit = assessor.scope.unit;
        Figures {
            bins: Vec::new(),
            lag: assessor.scope.pair.lag(assessor.schema),
            entries: assessment.tally.entries,
            unit,
            threshold: assessor.scope.rule.in_unit(unit).threshold,
            share: assessor.scope.share(assessor.schema),
            rule: assessor.scope.rule.kind,
            plug_in: unit.from_nats(assessment.plug_in),
            expected_if_independent: unit.from_nats(expected),
            expected_method: method.as_str(),
            estimates: Default::default(),
            independence: assessment.tally.into(),
            evidence: assessment.evidence.map(|evidence| evidence.in_unit(unit)),
            segmentation: assessment.segmentation(),
            significance: None,
            warnings: Vec::new(),
            visits_to_decide: None,
            model: None,
            holds: None,
            fit: self.query.fit(),
            revision: 0,
        }
    }
}

/// Returns an estimate in a unit.
fn estimated(estimator: Estimator, tables: &Tables, alphabet: Alphabet, unit: Unit) -> f64 {
    let nats = tables.figure(|table| match estimator {
        Estimator::Excess => information::excess(table),
        Estimator::MillerMadow => information::miller_madow(table),
        Estimator::ChaoShen => information::chao_shen(table),
        Estimator::JamesStein => information::james_stein(table, alphabet),
        Estimator::Grassberger2003 => information::grassberger_2003(table),
        Estimator::Nsb => information::nsb(table, alphabet),
        Estimator::Dirichlet => information::dirichlet(table, alphabet),
        Estimator::Adjusted => information::adjusted(table),
        Estimator::UniformPolicy => information::uniform_policy(table),
    });

    // A share has no unit.
    if estimator == Estimator::Adjusted {
        nats
    } else {
        unit.from_nats(nats)
    }
}
