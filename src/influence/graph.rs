//! The causal graph of one state, by conditional independence tests: what every pair of agents is,
//! beside all others. At lag 0 nothing has a direction: what is found is a skeleton. At a lag each
//! pair is asked about in both directions, and others are held fixed by what they do now.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::answer::AnswerContext;
use super::labels::bins;
use super::questions::count_verdicts;
use super::skeleton::{self, EdgeFinding, Margin};
use super::store_errors::logged;
use super::{Influence, size};
use crate::domain::draft::{PairDraft, QuestionDraft};
use crate::domain::{
    Answer, Counts, Dependence, Edge, Environment, Exchange, Graph, Pair, Question, Schema,
    SegmentId, View, Within,
};
use crate::error::Problem;
use crate::evidence::Believed;
use crate::information::{self, Table};
use crate::priors::{Informed, Tables};
use crate::store::StateCounts;
use crate::work::{Stop, Stopped};

impl Influence {
    /// Returns the causal graph of one state: every pair of agents with its answer, and what it is
    /// once others are held fixed.
    pub async fn graph(
        &self,
        environment: &Arc<Environment>,
        draft: &QuestionDraft,
    ) -> Result<Graph, Problem> {
        let schema = &environment.schema;
        let pairs = every_pair(schema, draft);
        let question = Question {
            view: View::Figures,
            ..Question::new(environment, &about_widest_of(schema, &pairs, draft))?
        };
        let nothing = || Problem::invalid("question", Vec::new());
        let key = question.states.first().cloned().ok_or_else(nothing)?;
        let segments = self
            .segments(environment, question.scope.segments.as_deref())
            .await?;

        size::check_graph(schema, &key, pairs.len())?;
        let started = Instant::now();
        let mut contexts = Vec::with_capacity(pairs.len());
        for pair in &pairs {
            let question = Question {
                scope: question.scope.of_pair(schema, pair.clone()),
                ..question.clone()
            };
            let context = self
                .query_context(environment, question.scope.clone())
                .await?;
            contexts.push(AnswerContext {
                query: context,
                question,
            });
        }

        // Read once: all pairs, and all tests of them, are of the same counts.
        let turn = self.work.questions.enter().await?;
        let counts = self
            .store
            .counts(environment.id, &question.states)
            .await
            .map_err(logged)?;
        let state = counts.first().ok_or_else(nothing)?;
        let tests = TestedState {
            environment: environment.clone(),
            counts: state.counts.clone(),
            segments,
            within: question.scope.within,
            seed: key.seed(),
            informed: contexts
                .iter()
                .map(|context| context.query.informed.clone())
                .collect(),
        };
        let asked = pairs.clone();
        let (answers, found) = turn
            .run(move |stop| tests.graph(&asked, &contexts, &counts, stop))
            .await?;
        count_verdicts(
            started,
            answers.iter().map(|answer| (answer.verdict, answer.basis)),
        );
        let edges = pairs.into_iter().zip(answers).zip(found);
        Ok(Graph {
            bins: bins(schema, &key),
            key,
            nodes: schema
                .agents()
                .iter()
                .map(|agent| agent.name.to_string())
                .collect(),
            lag: question.scope.pair.lag(schema),
            edges: edges
                .map(|((pair, answer), found)| edge(&pair, answer, found))
                .collect(),
        })
    }
}

/// The probability of habits that differ by segment from which a pair is tested within segments.
const DIFFER: f64 = 0.5;

/// One state, for tests of its pairs.
struct TestedState {
    environment: Arc<Environment>,
    counts: Arc<Counts>,
    /// The segments to count; all if `None`.
    segments: Option<Vec<SegmentId>>,
    within: Within,
    /// For permutations.
    seed: u64,
    /// What the evidence on each pair rests on; `None` where its alphabets are too large.
    informed: Vec<Option<Informed>>,
}

impl TestedState {
    /// Answers for each pair, and finds what it is beside the others.
    fn graph(
        &self,
        pairs: &[Pair],
        contexts: &[AnswerContext],
        counts: &[StateCounts],
        stop: &Stop,
    ) -> Result<(Vec<Answer>, Vec<EdgeFinding>), Stopped> {
        let answered =
            |context: &AnswerContext| stop.check().map(|()| context.answers_here(counts));
        let answers: Result<Vec<Vec<Answer>>, Stopped> =
            contexts.par_iter().map(answered).collect();
        let answers: Vec<Answer> = answers?.into_iter().flatten().collect();

        let margins: Vec<Margin> = pairs
            .iter()
            .zip(&answers)
            .map(|(pair, answer)| margin(pair, answer))
            .collect();
        let tests = StateTests {
            state: self,
            asked: pairs,
            pairs: &margins,
            stop,
        };
        let found = skeleton::skeleton(self.environment.schema.agents().len(), &margins, &tests);

        // What was told after it was stopped is worth nothing.
        stop.check()?;
        Ok((answers, found))
    }
}

/// The conditional independence tests of a state's pairs.
struct StateTests<'a> {
    state: &'a TestedState,
    /// The pairs by themselves.
    asked: &'a [Pair],
    /// What is known of them.
    pairs: &'a [Margin],
    /// Once it is stopped, nothing more is asked.
    stop: &'a Stop,
}

impl StateTests<'_> {
    /// Returns whether a pair is tested within segments: the strata of a conditional test are too
    /// small to tell how habits go with segments, so that it is the pair by itself that tells.
    fn exchange(&self, pair: usize) -> Exchange {
        let is_cut = self.state.within != Within::Pooled
            && self.pairs[pair]
                .differ
                .is_some_and(|differ| differ > DIFFER);
        if is_cut {
            Exchange::WithinSegments
        } else {
            Exchange::Pooled
        }
    }

    /// Returns the tables of a pair, one for each joint action of those held fixed, and for each
    /// segment if it is tested within them.
    fn strata(&self, pair: usize, fixed: &[usize]) -> Vec<Table> {
        let schema = &self.state.environment.schema;
        let exchange = self.exchange(pair);
        let pair = Pair {
            given: fixed.to_vec(),
            ..self.asked[pair].clone()
        };
        let segments = self.state.segments.as_deref();
        let cells = self.state.counts.of_pair(schema, &pair, segments);
        Tables::exchangeable_alone(schema, &pair, exchange, cells)
    }
}

impl skeleton::IndependenceTests for StateTests<'_> {
    /// By the pair's own prior: nothing is fitted for it.
    fn believed(&self, pair: usize, fixed: &[usize]) -> Option<Believed> {
        self.stop.check().ok()?;
        let prior = &self.state.informed[pair].as_ref()?.prior;
        let strata = self.strata(pair, fixed);
        Some(Believed::of_dependence(
            prior.dependent(&strata),
            prior.unseen().dependent(),
            &strata,
        ))
    }

    fn p_value(&self, pair: usize, fixed: &[usize], permutations: u64) -> f64 {
        let strata = self.strata(pair, fixed);
        let tested = information::p_value_while(&strata, permutations, self.state.seed, &|| {
            self.stop.goes_on()
        });
        tested.map_or(1.0, |tested| tested.p_value)
    }
}

/// Returns what is known of a pair by itself.
fn margin(pair: &Pair, answer: &Answer) -> Margin {
    let evidence = answer.figures.as_ref().and_then(|figures| figures.evidence);
    let dependence = evidence.map_or(Dependence::Open, |evidence| evidence.dependence);
    let strength = evidence.map_or(0.0, |evidence| evidence.posterior_mean);
    let differ = evidence.and_then(|evidence| evidence.differ);
    Margin {
        ends: [pair.ego, pair.other],
        dependence,
        strength,
        differ,
    }
}

fn edge(
    pair: &Pair,
    answer: Answer,
    EdgeFinding {
        kind,
        explained_by,
        opened_by,
    }: EdgeFinding,
) -> Edge {
    Edge {
        from: pair.ego,
        to: pair.other,
        answer,
        kind,
        explained_by,
        opened_by,
    }
}

/// Returns the pairs of a graph at the lag that was written; those of one tick where nothing is
/// declared at it, which the question says then.
fn every_pair(schema: &Schema, draft: &QuestionDraft) -> Vec<Pair> {
    let at_lag = u32::try_from(draft.pair.lag).map(|lag| Pair::every_at_lag(schema, lag));
    match at_lag {
        Ok(pairs) if !pairs.is_empty() => pairs,
        _ => Pair::every(schema),
    }
}

/// Returns a question about all pairs for the one that can have the most: a threshold that it
/// cannot reach is beyond every pair.
fn about_widest_of(schema: &Schema, pairs: &[Pair], draft: &QuestionDraft) -> QuestionDraft {
    let Pair { ego, other, .. } = Pair::widest_of(schema, pairs);
    let name = |agent: usize| Some(schema.agents()[agent].name.to_string());
    let pair = PairDraft {
        ego: name(ego),
        other: name(other),
        ..draft.pair.clone()
    };
    QuestionDraft {
        pair,
        ..draft.clone()
    }
}
