//! Subgroup discovery over all states: in which regions a pair depends, found in one half of the
//! counts and tested on the other.
//!
//! Two passes: one adds up what the half to search says of each state, from which the rules are
//! found; the other pools the half to test over the states of each. What is counted between them
//! changes neither what was found nor how honest its test is.

use std::sync::Arc;

use rayon::prelude::*;

use super::labels::names;
use super::store_errors::logged;
use crate::domain::{
    Coordinates, Environment, EnvironmentId, FoundRegion, Half, Halves, Pair, Region, RegionSearch,
    RegionSearchQuestion, SegmentId, StateKey, Within, left_out,
};
use crate::error::Problem;
use crate::information::pooled::{MomentsMemo, Pool, Pooled};
use crate::information::search::{MOST_RULES, Searched, States, Sum, search};
use crate::priors::{Pages, Stratum, Tables};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress, Stop, Stopped};

/// Of the permutations that small pools are tested by.
const SEED: u64 = 1;

/// What a search rests on.
#[derive(Clone)]
pub struct RegionSearchContext {
    /// The environment.
    pub environment: Arc<Environment>,
    /// The question.
    pub question: RegionSearchQuestion,
    /// The segments to count; all if `None`.
    pub segments: Option<Vec<SegmentId>>,
    /// How the counts are dealt.
    pub halves: Halves,
}

/// What a search is of: pair, segments, strata, and the region with what coordinates mean, which
/// may change.
pub type RegionSearchKey = (EnvironmentId, Pair, Option<Vec<SegmentId>>, Within, String);

/// What was made of all states: every region that was tested, in nats, with the halves that it
/// stands on.
pub struct Candidates {
    halves: Halves,
    tested: Vec<(Region, Sum, Pooled)>,
    searched: Searched,
}

impl RegionSearchContext {
    /// Returns what the search is of.
    pub fn key(&self) -> RegionSearchKey {
        let (environment, question) = (&self.environment, &self.question);
        let region = format!("{:?} of {:?}", question.region, environment.derived);
        (
            environment.id,
            question.pair.clone(),
            self.segments.clone(),
            question.within,
            region,
        )
    }

    /// Returns what is told of these candidates, which were made from a revision.
    pub fn told(&self, candidates: &Candidates, as_of: u64) -> RegionSearch {
        let RegionSearchQuestion {
            pair,
            region,
            most,
            fdr,
            unit,
            ..
        } = &self.question;
        let schema = &self.environment.schema;
        // Each is the best that those before it leave: the first few are what fewer would have been.
        let tested: Vec<(Region, Sum, Pooled)> =
            candidates.tested.iter().take(*most).cloned().collect();
        let in_unit = |found: FoundRegion| found.in_unit(*unit);
        RegionSearch {
            labels: names(schema, pair),
            lag: pair.lag(schema),
            region: region.clone(),
            unit: *unit,
            fdr: *fdr,
            halves: candidates.halves.clone(),
            tested: tested.len(),
            regions: FoundRegion::passing(tested, *fdr)
                .into_iter()
                .map(in_unit)
                .collect(),
            looked_at: candidates.searched.looked_at,
            left_out: left_out(&candidates.searched, &self.environment.coordinates()),
            as_of,
        }
    }

    /// Returns the strata of a state that are in a half.
    fn strata(&self, state: &Scanned, half: Half) -> Vec<Stratum> {
        let (schema, pair) = (&self.environment.schema, &self.question.pair);
        let cells = state.counts.of_pair(schema, pair, self.segments.as_deref());
        let mut strata = Tables::strata_within(schema, pair, self.question.within, cells);
        strata.retain(|one| self.halves.of(&state.key, one.held, one.segment) == half);
        strata
    }
}

/// Passes over all states twice; returns the candidates, and how many transitions there were before.
pub async fn make(
    store: &dyn Store,
    gate: &Gate,
    context: &RegionSearchContext,
    progress: &Progress,
) -> Result<(Candidates, u64), Problem> {
    let totals = store.totals(context.environment.id).await.map_err(logged)?;
    progress.begin("states looked at", totals.states);
    let coordinates = Arc::new(context.environment.coordinates());

    let states = summed(store, gate, context, &coordinates, progress).await?;
    let found = gate.run(move |stop| search(states, MOST_RULES, &|| stop.goes_on()).ok_or(Stopped));
    let searched = found.await?;

    let rules = searched.rules.iter();
    let within = &context.question.region;
    let regions: Vec<Region> = rules.map(|rule| within.ruled(&coordinates, rule)).collect();
    progress.begin("states tested", totals.states);
    let pooled = tested(store, gate, context, &regions, progress).await?;

    let sums = searched.rules.iter().map(|rule| rule.sum);
    let tested = regions.into_iter().zip(sums).zip(pooled);
    let candidates = Candidates {
        halves: context.halves.clone(),
        tested: tested
            .map(|((region, sum), pooled)| (region, sum, pooled))
            .collect(),
        searched,
    };
    Ok((candidates, totals.transitions))
}

/// Returns every state of the region that is searched, with what the half to search says of it.
async fn summed(
    store: &dyn Store,
    gate: &Gate,
    context: &RegionSearchContext,
    coordinates: &Arc<Coordinates>,
    progress: &Progress,
) -> Result<States, Problem> {
    let mut states = States::new(coordinates.axes());
    let mut memos = vec![MomentsMemo::default(); gate.workers()];
    let mut pages = Pages::new(store, context.environment.id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, coordinates) = (context.clone(), coordinates.clone());
        let looked_at = page.len() as u64;
        let add = move |stop: &Stop| {
            let sums = sums(&mut memos, &context, &page, stop)?;
            for (key, sum) in sums {
                states.push(coordinates.all().iter().map(|one| one.bin(key)), sum);
            }
            Ok((states, memos))
        };
        (states, memos) = gate.run(add).await?;
        progress.add(looked_at);
    }
    Ok(states)
}

/// Returns the states of a page that are searched, each with its sum, in order. Each memo serves a
/// part of the page, and changes no bit.
fn sums<'a>(
    memos: &mut [MomentsMemo],
    context: &RegionSearchContext,
    page: &'a [Scanned],
    stop: &Stop,
) -> Result<Vec<(&'a StateKey, Sum)>, Stopped> {
    let part = page.len().div_ceil(memos.len()).max(1);
    let parts = page.par_chunks(part).zip(memos);
    let of_part = |(part, memo): (&'a [Scanned], &mut MomentsMemo)| {
        let mut sums = Vec::with_capacity(part.len());
        let region = &context.question.region;
        for state in part.iter().filter(|state| region.contains(&state.key)) {
            stop.check()?;
            let mut sum = Sum::default();
            for one in context.strata(state, Half::Search) {
                sum.add(&Sum::of(&one.table, memo));
            }
            sums.push((&state.key, sum));
        }
        Ok(sums)
    };
    let sums: Result<Vec<Vec<_>>, Stopped> = parts.map(of_part).collect();
    Ok(sums?.concat())
}

/// The half to test of the states of one region so far.
struct Tested {
    pool: Pool,
    memo: MomentsMemo,
}

/// Returns what the half to test says of each region, without the states of those before it.
async fn tested(
    store: &dyn Store,
    gate: &Gate,
    context: &RegionSearchContext,
    regions: &[Region],
    progress: &Progress,
) -> Result<Vec<Pooled>, Problem> {
    let alphabet = context.question.pair.alphabet(&context.environment.schema);
    let none = || Tested {
        pool: Pool::new(alphabet),
        memo: MomentsMemo::default(),
    };
    let mut all: Vec<Tested> = regions.iter().map(|_| none()).collect();
    if all.is_empty() {
        return Ok(Vec::new());
    }

    let (mut seen, mut pages) = (0, Pages::new(store, context.environment.id));
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, regions) = (context.clone(), regions.to_vec());
        let looked_at = page.len() as u64;
        let add = move |stop: &Stop| {
            added(&mut all, &context, &regions, (seen..).zip(&page), stop)?;
            Ok(all)
        };
        all = gate.run(add).await?;
        seen += looked_at;
        progress.add(looked_at);
    }

    let pooled = gate.run(move |_| {
        Ok(all
            .par_iter()
            .map(|tested| tested.pool.pooled(SEED))
            .collect())
    });
    pooled.await
}

/// Adds numbered states, each to the first region that it lies in.
fn added<'a>(
    all: &mut [Tested],
    context: &RegionSearchContext,
    regions: &[Region],
    states: impl Iterator<Item = (u64, &'a Scanned)>,
    stop: &Stop,
) -> Result<(), Stopped> {
    let first = |key| regions.iter().position(|region| region.contains(key));
    let mut of_regions: Vec<Vec<(u64, &Scanned)>> = vec![Vec::new(); regions.len()];
    for (number, state) in states {
        if let Some(at) = first(&state.key) {
            of_regions[at].push((number, state));
        }
    }

    let both = all.par_iter_mut().zip(of_regions);
    both.try_for_each(|(tested, states)| {
        for (number, state) in states {
            stop.check()?;
            tested.add(number, &context.strata(state, Half::Test));
        }
        Ok(())
    })
}

impl Tested {
    fn add(&mut self, state: u64, strata: &[Stratum]) {
        for one in strata {
            self.pool.add(one.of_state(state), &mut self.memo);
        }
    }
}
