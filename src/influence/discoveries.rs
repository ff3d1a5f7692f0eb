//! Which states are called dependent when thousands are looked at: at a rate of false ones that the caller accepts.

use rayon::prelude::*;

use super::stratified::{Disagreement, Disagreements};
use super::survey::{Plan, Survey};
use crate::domain::{Discoveries, Discovery, DiscoveryMethod, Exchange, StateKey};
use crate::information::{Method, Significance, Table, bayesian_fdr, benjamini_hochberg, p_value, smallest_p};
use crate::priors::{Pages, Tables};
use crate::store::{Scanned, Store, StoreError};

/// Permutations of every state that can pass; those that may yet pass get more, tenfold each time.
const FIRST: u64 = 199;

/// The most permutations, in tests over the rate: a p-value that decides alone is then known to a fifth of itself.
const LAST: f64 = 20.0;

/// Standard deviations by which a p-value may be smaller than its permutations say.
const DOUBT: f64 = 4.0;

/// The discoveries among the rows of a survey.
pub struct Found {
    /// How many they are.
    pub discoveries: Discoveries,
    /// For each row, whether it is one.
    pub rows: Vec<bool>,
    /// For each row its p-value, where it was tested; empty where no tests were made.
    pub p_values: Vec<Option<f64>>,
    /// What the reader should know before believing them: a sentence each.
    pub warnings: Vec<String>,
}

/// Finds the discoveries in a survey.
pub async fn find(store: &dyn Store, plan: &Plan, survey: &Survey, discovery: Discovery) -> Result<Found, StoreError> {
    match discovery.method {
        DiscoveryMethod::Bayes => Ok(by_posterior(survey, discovery)),
        DiscoveryMethod::Bh => by_tests(store, plan, survey, discovery).await,
    }
}

fn by_posterior(survey: &Survey, discovery: Discovery) -> Found {
    let dependent: Vec<f64> =
        survey.rows.iter().map(|row| row.evidence.map_or(0.0, |evidence| evidence.probability.dependent)).collect();
    found(discovery, bayesian_fdr(&dependent, discovery.fdr), survey.rows.len() as u64, Vec::new())
}

fn found(discovery: Discovery, rows: Vec<bool>, testable: u64, p_values: Vec<Option<f64>>) -> Found {
    let states = rows.iter().filter(|row| **row).count() as u64;
    Found { discoveries: Discoveries { discovery, states, testable }, rows, p_values, warnings: Vec::new() }
}

/// A state whose margins allow a p-value small enough.
struct Testable {
    key: StateKey,
    slices: Vec<Table>,
    p_value: f64,
    /// Whether it was computed without permutations.
    is_exact: bool,
    permutations: u64,
}

async fn by_tests(store: &dyn Store, plan: &Plan, survey: &Survey, discovery: Discovery) -> Result<Found, StoreError> {
    let mut testable = Vec::new();
    let mut disagreements = Disagreements::default();
    let mut pages = Pages::new(store, plan.environment.id);
    while let Some(page) = pages.next().await? {
        let plan = plan.clone();
        let tested = tokio::task::spawn_blocking(move || tested(&plan, page, discovery.fdr)).await;
        for (state, disagreement) in tested.map_err(|error| StoreError::Unreadable(error.to_string()))? {
            testable.extend(state);
            disagreement.into_iter().for_each(|one| disagreements.add(one));
        }
    }
    // In order of key, so that ties are broken alike whatever the order of the scan.
    testable.sort_unstable_by(|a, b| a.key.cmp(&b.key));
    let refined = tokio::task::spawn_blocking(move || refined(testable, discovery.fdr)).await;
    let (testable, passed) = refined.map_err(|error| StoreError::Unreadable(error.to_string()))?;
    let mut rows = vec![false; survey.rows.len()];
    let mut p_values = vec![None; survey.rows.len()];
    for (state, passed) in testable.iter().zip(passed) {
        // A state that was seen for the first time after the survey has no row.
        if let Ok(row) = survey.rows.binary_search_by(|row| row.key.cmp(&state.key)) {
            rows[row] = passed;
            p_values[row] = Some(state.p_value);
        }
    }
    Ok(Found { warnings: disagreements.warnings(), ..found(discovery, rows, testable.len() as u64, p_values) })
}

/// Tests the states of a page: those that can pass, and where pooled and stratified tests disagree.
fn tested(plan: &Plan, page: Vec<Scanned>, fdr: f64) -> Vec<(Option<Testable>, Option<Disagreement>)> {
    let (schema, pair) = (&plan.environment.schema, &plan.scope.pair);
    let test = |scanned: Scanned| {
        let cells = || scanned.counts.of_segments(plan.segments.as_deref());
        let tables = Tables::new(schema, pair, cells());
        let draws = |exchange| tables.exchangeable(schema, pair, exchange, cells());
        let (exchange, seed) = (plan.scope.within.exchange(), scanned.key.seed());
        let disagreement = (tables.segments > 1)
            .then(|| Disagreement::between(&draws(Exchange::Pooled), &draws(Exchange::WithinSegments), FIRST, seed));
        (Testable::new(scanned.key.clone(), draws(exchange).into_owned(), fdr), disagreement.flatten())
    };
    page.into_par_iter().map(test).collect()
}

/// Permutes more and more the states that would pass if every p-value were as small as its permutations allow, until those have passed, cannot pass
/// any more, or have had as many as could matter.
fn refined(mut testable: Vec<Testable>, fdr: f64) -> (Vec<Testable>, Vec<bool>) {
    let most = (LAST * testable.len() as f64 / fdr).ceil() as u64;
    loop {
        let passed = benjamini_hochberg(&testable.iter().map(|state| state.p_value).collect::<Vec<_>>(), fdr);
        let may_pass = benjamini_hochberg(&testable.iter().map(Testable::smallest_likely).collect::<Vec<_>>(), fdr);
        let open = |(state, (passed, may)): &(&mut Testable, (&bool, &bool))| {
            !**passed && **may && !state.is_exact && state.permutations < most
        };
        let open = testable.par_iter_mut().zip(passed.par_iter().zip(&may_pass)).filter(open);
        if open.map(|(state, _)| state.refine(most)).count() == 0 {
            return (testable, passed);
        }
    }
}

impl Testable {
    /// Tests a state, if its margins allow a p-value that can pass.
    fn new(key: StateKey, slices: Vec<Table>, fdr: f64) -> Option<Self> {
        (smallest_p(&slices) <= fdr).then(|| {
            let Significance { p_value, method } = p_value(&slices, FIRST, key.seed());
            Self { key, slices, p_value, is_exact: method != Method::Permutation, permutations: FIRST }
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

    fn refine(&mut self, most: u64) {
        self.permutations = (self.permutations * 10).min(most);
        self.p_value = p_value(&self.slices, self.permutations, self.key.seed()).p_value;
    }
}
