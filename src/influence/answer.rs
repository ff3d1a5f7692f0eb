//! Answers: of one state, and of thousands by several threads.

use std::cell::LazyCell;
use std::sync::Arc;

use super::actions;
use super::judge::{Judge, Judged};
use super::stratified::{self, Tested};
use super::survey::Plan;
use crate::domain::{
    Answer, Bin, Estimator, Figures, ModelAction, ModelFigures, Question, Schema, Scope, StateKey, Unit, View,
};
use crate::error::{ErrorKind, Problem};
use crate::information::{self, Alphabet};
use crate::model::Prediction;
use crate::priors::{self, Draws, Tables};
use crate::store::StateCounts;

/// States that are answered at once; more are shared among threads, so that nobody waits behind ten thousand.
const SHARE: usize = 2_500;

/// What an answer is made from, beside the counts of its state.
#[derive(Clone)]
pub struct Ground {
    /// The environment, the segments and the fit.
    pub plan: Plan,
    /// The question.
    pub question: Question,
}

/// Returns the answers for the states of a question, which have these counts.
pub async fn answers(ground: Ground, counts: Vec<StateCounts>) -> Result<Vec<Answer>, Problem> {
    let states = ground.question.states.len();
    if states <= SHARE && !ground.question.is_slow() {
        return Ok(ground.answers(&counts, 0..states));
    }
    let shared = Arc::new((ground, counts));
    let share = |from: usize| {
        let shared = shared.clone();
        tokio::task::spawn_blocking(move || shared.0.answers(&shared.1, from..(from + SHARE).min(states)))
    };
    let shares: Vec<_> = (0..states).step_by(SHARE).map(share).collect();
    let mut answers = Vec::with_capacity(states);
    for share in shares {
        let share = share.await;
        answers.extend(share.map_err(|error| Problem::new(ErrorKind::Internal, "INTERNAL", error.to_string()))?);
    }
    Ok(answers)
}

/// Returns a warning where pooled and stratified answers disagree: by their tests, where those were asked for, else by the evidence.
fn warning(tested: Option<Tested>, judged: &Judged) -> Option<String> {
    match tested {
        Some(tested) => tested.warning(),
        None => stratified::warning(&judged.evidence?),
    }
}

impl Ground {
    fn judge(&self) -> Judge<'_> {
        self.plan.judge(self.question.view)
    }

    fn answers(&self, counts: &[StateCounts], states: std::ops::Range<usize>) -> Vec<Answer> {
        let judge = self.judge();
        let keys = &self.question.states[states.clone()];
        let told = keys.iter().zip(&counts[states]).zip(judge.predictions(keys));
        told.map(|((key, counts), predicted)| self.answer(judge, key, counts, predicted)).collect()
    }

    /// Returns the answer for a state with these counts.
    fn answer(&self, judge: Judge<'_>, key: &StateKey, state: &StateCounts, predicted: Option<Prediction>) -> Answer {
        let cells = || state.counts.of_segments(self.plan.segments.as_deref());
        let judged = judge.judge(key, cells(), predicted);
        let visits = judged.tables.whole.total();
        // What the evidence rests on, for those figures that need the tables themselves.
        let (schema, Scope { pair, within, .. }) = (judge.schema, judge.scope);
        let draws = LazyCell::new(|| judged.tables.evidence(schema, pair, *within, cells()));
        let figures = (judge.view != View::Verdict).then(|| {
            let tested = self.question.significance.map(|how| {
                let strata = (judged.tables.segments > 1).then(|| Tables::draws_by_segment(schema, pair, cells()));
                let pooled = judged.tables.draws(schema, pair, cells());
                (Tested::new(&pooled, strata.as_deref(), key.seed()), how.exchange(*within))
            });
            let visits_to_decide =
                self.question.visits_to_decide.then(|| self.visits_to_decide(judge, &draws)).flatten();
            Box::new(Figures {
                bins: bins(judge.schema, key),
                significance: tested.map(|(tested, exchange)| tested.told(exchange)),
                warnings: warning(tested.map(|(tested, _)| tested), &judged).into_iter().collect(),
                visits_to_decide,
                model: predicted.and_then(|predicted| self.model(judge, key, predicted)),
                revision: state.revision,
                ..self.figures(judge, &judged)
            })
        });
        let by_action = (judge.view == View::Full).then(|| actions::by_action(judge, &judged.tables, &draws));
        Answer { key: key.clone(), visits, verdict: judged.verdict, basis: judged.basis, figures, by_action }
    }

    /// Returns how many more visits a verdict would take, if there are not too many actions for it.
    fn visits_to_decide(&self, judge: Judge<'_>, draws: &Draws<'_>) -> Option<Option<u64>> {
        let informed = judge.informed?;
        let (prior, scope) = (informed.in_detail()?, judge.scope);
        let visits = prior.visits_to_decide(&informed.habits, draws.counted(), priors::ego(&scope.pair), &scope.rule);
        Some(visits.filter(|_| judge.is_open()))
    }

    /// Returns what the network says of a state, in the question's unit.
    fn model(&self, judge: Judge<'_>, key: &StateKey, predicted: Prediction) -> Option<ModelFigures> {
        let network = judge.network?;
        let unit = judge.scope.unit;
        let in_unit = |action: ModelAction| ModelAction { divergence: unit.from_nats(action.divergence), ..action };
        let by_action = (judge.view == View::Full).then(|| network.by_action(&self.plan.environment, key));
        Some(ModelFigures {
            version: network.version,
            kind: network.kind,
            probability: predicted.probability,
            mutual_information: predicted.mutual_information.map(|nats| unit.from_nats(nats)),
            agrees: predicted.agrees,
            out_of_range: network.out_of_range(&self.plan.environment, key),
            by_action: by_action.into_iter().flatten().map(in_unit).collect(),
        })
    }

    fn figures(&self, judge: Judge<'_>, judged: &Judged) -> Figures {
        let unit = judge.scope.unit;
        let (expected, method) = judged.tables.expected_if_independent();
        let alphabet = judge.scope.pair.alphabet(judge.schema);
        let estimate =
            |estimator: Estimator| (estimator.as_str(), estimated(estimator, &judged.tables, alphabet, unit));
        Figures {
            bins: Vec::new(),
            entries: judged.tally.entries,
            unit,
            threshold: judge.scope.rule.in_unit(unit).threshold,
            share: judge.scope.share(judge.schema),
            rule: judge.scope.rule.kind,
            plug_in: unit.from_nats(judged.plug_in),
            expected_if_independent: unit.from_nats(expected),
            expected_method: method.as_str(),
            estimates: self.question.estimators.iter().map(estimate).collect(),
            independence: judged.tally.into(),
            evidence: judged.evidence.map(|evidence| evidence.in_unit(unit)),
            segmentation: judged.segmentation(),
            significance: None,
            warnings: Vec::new(),
            visits_to_decide: None,
            model: None,
            fit: self.plan.fit(),
            revision: 0,
        }
    }
}

/// Returns the bins of a state with their labels.
pub fn bins(schema: &Schema, key: &StateKey) -> Vec<Bin> {
    let bin = |(feature, bin): (&crate::domain::Feature, &u32)| Bin {
        feature: feature.name.to_string(),
        bin: *bin,
        label: feature.kind.bin_label(*bin),
    };
    schema.state().iter().zip(key.bins()).map(bin).collect()
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
    if estimator == Estimator::Adjusted { nats } else { unit.from_nats(nats) }
}
