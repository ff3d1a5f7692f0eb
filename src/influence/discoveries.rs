//! Multiple testing: which states are called dependent when thousands are looked at, at a false
//! discovery rate that the caller accepts. By posterior probabilities (Bayesian FDR), or by
//! permutation tests and Benjamini-Hochberg.

use std::sync::Arc;

use rayon::prelude::*;

use super::pass_cache::PassResult;
use super::query_context::QueryContext;
use super::state_ranking::StateRanking;
use super::store_errors::logged;
use super::stratified::{Disagreement, Disagreements};
use crate::domain::{Discoveries, Discovery, DiscoveryMethod, Exchange, StateKey};
use crate::error::Problem;
use crate::information::{
    Method, Significance, Table, bayesian_fdr, benjamini_hochberg, p_value, p_value_while,
    smallest_p,
};
use crate::priors::{Pages, Tables};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress, Stop, Stopped};

/// Permutations of every state that can pass; those that may yet pass get more, tenfold each time.
const FIRST: u64 = 199;

/// The most permutations, in tests over the rate: a p-value that decides alone is then known to a
/// fifth of itself.
const LAST: f64 = 20.0;

/// States that are tested in one piece of work.
const TESTED_TOGETHER: usize = 100;

/// Standard errors (of Monte Carlo) by which a p-value may be smaller than its permutations say.
const DOUBT: f64 = 4.0;

/// The discoveries among the rows of a ranking.
pub struct FoundDiscoveries {
    /// How many they are.
    pub discoveries: Discoveries,
    /// For each row, whether it is one.
    pub rows: Vec<bool>,
    /// For each row its p-value, where it was tested; empty where no tests were made.
    pub p_values: Vec<Option<f64>>,
    /// What the reader should know before believing them: a sentence each.
    pub warnings: Vec<String>,
}

/// A ranking with the discoveries in it.
pub struct DiscoverySearch {
    /// What they were looked for in.
    pub ranking: Arc<PassResult<StateRanking>>,
    /// What was found.
    pub found: FoundDiscoveries,
}

/// Permutations of one piece of work: some seconds at most.
const PIECE: u64 = 1 << 18;

/// Finds the discoveries in a ranking.
pub async fn find(
    store: &dyn Store,
    gate: &Gate,
    context: &QueryContext,
    ranking: &Arc<PassResult<StateRanking>>,
    discovery: Discovery,
    progress: &Progress,
) -> Result<FoundDiscoveries, Problem> {
    match discovery.method {
        DiscoveryMethod::Bayes => {
            let ranking = ranking.clone();
            gate.run(move |_| Ok(by_posterior(&ranking, discovery)))
                .await
        }
        DiscoveryMethod::Bh => by_tests(store, gate, context, ranking, discovery, progress).await,
    }
}

fn by_posterior(ranking: &StateRanking, discovery: Discovery) -> FoundDiscoveries {
    let evidence = ranking.rows.evidence();
    let dependent: Vec<f64> = evidence
        .map(|told| told.map_or(0.0, |evidence| evidence.probability.dependent))
        .collect();
    found(
        discovery,
        bayesian_fdr(&dependent, discovery.fdr),
        ranking.rows.len() as u64,
        Vec::new(),
    )
}

fn found(
    discovery: Discovery,
    rows: Vec<bool>,
    testable: u64,
    p_values: Vec<Option<f64>>,
) -> FoundDiscoveries {
    let states = rows.iter().filter(|row| **row).count() as u64;
    FoundDiscoveries {
        discoveries: Discoveries {
            discovery,
            states,
            testable,
        },
        rows,
        p_values,
        warnings: Vec::new(),
    }
}

/// A state whose margins allow a p-value small enough.
struct Testable {
    key: StateKey,
    strata: Arc<[Table]>,
    p_value: f64,
    /// Whether it was computed without permutations.
    is_exact: bool,
    permutations: u64,
}

/// What the tests of a state say.
type Tested = (Option<Testable>, Option<Disagreement>);

async fn by_tests(
    store: &dyn Store,
    gate: &Gate,
    context: &QueryContext,
    ranking: &StateRanking,
    discovery: Discovery,
    progress: &Progress,
) -> Result<FoundDiscoveries, Problem> {
    let mut testable = Vec::new();
    let mut disagreements = Disagreements::default();
    progress.begin("states tested", ranking.rows.len() as u64);
    let mut pages = Pages::new(store, context.environment.id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let mut states = page.into_iter().peekable();
        // Tests take longer than measuring does: a part of a page is long enough for one piece of
        // work.
        while states.peek().is_some() {
            let part: Vec<Scanned> = states.by_ref().take(TESTED_TOGETHER).collect();
            let (context, size) = (context.clone(), part.len() as u64);
            for (state, disagreement) in gate
                .run(move |stop| tested(&context, part, discovery.fdr, stop))
                .await?
            {
                testable.extend(state);
                disagreement
                    .into_iter()
                    .for_each(|one| disagreements.add(one));
            }
            progress.add(size);
        }
    }

    // In order of key, so that ties are broken alike whatever the order of the scan.
    testable.sort_unstable_by(|a, b| a.key.cmp(&b.key));
    let (testable, passed) = refined(gate, testable, discovery.fdr, progress).await?;

    let mut rows = vec![false; ranking.rows.len()];
    let mut p_values = vec![None; ranking.rows.len()];
    for (state, passed) in testable.iter().zip(passed) {
        // A state that was seen for the first time after the ranking has no row.
        if let Some(row) = ranking.rows.position(&state.key) {
            rows[row] = passed;
            p_values[row] = Some(state.p_value);
        }
    }
    Ok(FoundDiscoveries {
        warnings: disagreements.warnings(),
        ..found(discovery, rows, testable.len() as u64, p_values)
    })
}

/// Tests states: those that can pass, and where pooled and stratified tests disagree.
fn tested(
    context: &QueryContext,
    states: Vec<Scanned>,
    fdr: f64,
    stop: &Stop,
) -> Result<Vec<Tested>, Stopped> {
    let (schema, pair) = (&context.environment.schema, &context.scope.pair);
    let test = |scanned: Scanned| {
        stop.check()?;
        let cells = || {
            scanned
                .counts
                .of_pair(schema, pair, context.segments.as_deref())
        };
        let tables = Tables::new(schema, pair, cells());
        let strata = |exchange| tables.exchangeable(schema, pair, exchange, cells());
        let (exchange, seed) = (context.scope.within.exchange(), scanned.key.seed());
        let disagreement = (tables.segments > 1).then(|| {
            Disagreement::between(
                &strata(Exchange::Pooled),
                &strata(Exchange::WithinSegments),
                FIRST,
                seed,
            )
        });
        Ok((
            Testable::new(scanned.key.clone(), strata(exchange).into_owned(), fdr),
            disagreement.flatten(),
        ))
    };
    states.into_par_iter().map(test).collect()
}

/// Permutes more and more the states that would pass if every p-value were as small as its
/// permutations allow, until those have passed, cannot pass any more, or have had as many as could
/// matter.
async fn refined(
    gate: &Gate,
    mut testable: Vec<Testable>,
    fdr: f64,
    progress: &Progress,
) -> Result<(Vec<Testable>, Vec<bool>), Problem> {
    let most = (LAST * testable.len() as f64 / fdr).ceil() as u64;
    loop {
        let deciding = gate.run(move |_| {
            let passed = passing(&testable, fdr, |state| state.p_value);
            let may_pass = passing(&testable, fdr, Testable::smallest_likely);
            Ok((testable, passed, may_pass))
        });
        let (tested, passed, may_pass) = deciding.await?;
        testable = tested;

        let is_open = |at: &usize| {
            let state = &testable[*at];
            !passed[*at] && may_pass[*at] && !state.is_exact && state.permutations < most
        };
        let mut open: Vec<usize> = (0..testable.len()).filter(is_open).collect();
        if open.is_empty() {
            return Ok((testable, passed));
        }

        progress.begin("states tested more closely", open.len() as u64);
        while let Some(first) = open.first() {
            let together =
                (PIECE / testable[*first].permutations).max(gate.workers() as u64) as usize;
            let part = open.split_off(open.len().saturating_sub(together));
            let tests: Vec<Refined> = part.iter().map(|at| testable[*at].refined(most)).collect();
            let refining =
                gate.run(move |stop| tests.par_iter().map(|test| test.p_value(stop)).collect());
            let p_values: Vec<f64> = refining.await?;

            for (at, p_value) in part.iter().zip(p_values) {
                testable[*at].p_value = p_value;
                testable[*at].permutations = testable[*at].more(most);
            }
            progress.add(part.len() as u64);
        }
    }
}

/// Returns which states pass by the Benjamini-Hochberg procedure, by a p-value of each.
fn passing(testable: &[Testable], fdr: f64, p_value: impl Fn(&Testable) -> f64) -> Vec<bool> {
    let p_values: Vec<f64> = testable.iter().map(p_value).collect();
    benjamini_hochberg(&p_values, fdr)
}

/// A test of more permutations.
struct Refined {
    strata: Arc<[Table]>,
    permutations: u64,
    seed: u64,
}

impl Refined {
    fn p_value(&self, stop: &Stop) -> Result<f64, Stopped> {
        let tested = p_value_while(&self.strata, self.permutations, self.seed, &|| {
            stop.goes_on()
        });
        tested.map(|tested| tested.p_value).ok_or(Stopped)
    }
}

impl Testable {
    /// Tests a state, if its margins allow a p-value that can pass.
    fn new(key: StateKey, strata: Vec<Table>, fdr: f64) -> Option<Self> {
        (smallest_p(&strata) <= fdr).then(|| {
            let Significance { p_value, method } = p_value(&strata, FIRST, key.seed());
            Self {
                key,
                strata: strata.into(),
                p_value,
                is_exact: method != Method::Permutation,
                permutations: FIRST,
            }
        })
    }

    /// Returns how small the p-value may be, given how many permutations it comes from.
    fn smallest_likely(&self) -> f64 {
        if self.is_exact {
            return self.p_value;
        }
        let deviation = (self.p_value * (1.0 - self.p_value) / self.permutations as f64).sqrt();
        (self.p_value - DOUBT * deviation).max(0.0)
    }

    fn more(&self, most: u64) -> u64 {
        (self.permutations * 10).min(most)
    }

    fn refined(&self, most: u64) -> Refined {
        Refined {
            strata: self.strata.clone(),
            permutations: self.more(most),
            seed: self.key.seed(),
        }
    }
}
