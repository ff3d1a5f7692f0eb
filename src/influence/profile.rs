//! Pooled evidence over all states of a region, at one lag after the other: where a state alone has
//! too few visits to tell, thousands together may.

use std::sync::Arc;

use rayon::prelude::*;

use super::labels::names;
use super::store_errors::logged;
use crate::domain::{
    Counts, Environment, EnvironmentId, Labels, Pair, Profile, ProfilePoint, ProfileQuestion,
    Schema, SegmentId, Tally, Within,
};
use crate::error::Problem;
use crate::information::pooled::{MomentsMemo, Pool};
use crate::priors::{Pages, Tables};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress, Stop, Stopped};

/// Of the permutations that small pools are tested by.
const SEED: u64 = 1;

/// What a profile rests on.
#[derive(Clone)]
pub struct ProfileContext {
    /// The environment.
    pub environment: Arc<Environment>,
    /// The question.
    pub question: ProfileQuestion,
    /// The segments to count; all if `None`.
    pub segments: Option<Vec<SegmentId>>,
}

/// What a profile is of: pairs, segments, strata, and the region with what its coordinates mean,
/// which may change.
pub type ProfileKey = (
    EnvironmentId,
    Vec<Pair>,
    Option<Vec<SegmentId>>,
    Within,
    String,
);

/// What was made of all states, in nats: a point a lag.
pub struct Points(Vec<ProfilePoint>);

impl ProfileContext {
    /// Returns what the profile is of.
    pub fn key(&self) -> ProfileKey {
        let question = &self.question;
        let region = format!("{:?}", question.region);
        (
            self.environment.id,
            question.pairs.clone(),
            self.segments.clone(),
            question.within,
            region,
        )
    }

    /// Returns what of the counts of states is pooled.
    fn drawn(&self) -> Drawn<'_> {
        Drawn {
            schema: &self.environment.schema,
            segments: self.segments.as_deref(),
            within: self.question.within,
        }
    }

    /// Returns what is told of these points, which were made from a revision.
    pub fn told(&self, points: &Points, as_of: u64) -> Profile {
        let ProfileQuestion { region, unit, .. } = &self.question;
        let in_unit = |point: &ProfilePoint| point.clone().in_unit(*unit);
        Profile {
            labels: self.labels(),
            region: region.clone(),
            unit: *unit,
            points: points.0.iter().map(in_unit).collect(),
            as_of,
        }
    }

    /// Returns the names of the variables, an agent's without a lag.
    fn labels(&self) -> Labels {
        let (schema, pair) = (&self.environment.schema, &self.question.pairs[0]);
        let now = pair
            .other_agent(schema)
            .and_then(|_| pair.at_lag(schema, 0));
        names(schema, now.as_ref().unwrap_or(pair))
    }
}

/// What of the counts of states is pooled.
#[derive(Clone, Copy)]
pub struct Drawn<'a> {
    /// The environment's.
    pub schema: &'a Schema,
    /// The segments to count; all if `None`.
    pub segments: Option<&'a [SegmentId]>,
    /// Whether segments are strata.
    pub within: Within,
}

/// The strata of one pair, at its lag, so far.
pub struct AtLag {
    pair: Pair,
    tally: Tally,
    pool: Pool,
    memo: MomentsMemo,
}

/// Passes over all states; returns the points, and how many transitions there were before.
pub async fn make(
    store: &dyn Store,
    gate: &Gate,
    context: &ProfileContext,
    progress: &Progress,
) -> Result<(Points, u64), Problem> {
    let totals = store.totals(context.environment.id).await.map_err(logged)?;
    progress.begin("states looked at", totals.states);

    let pairs = context.question.pairs.iter();
    let schema = &context.environment.schema;
    let mut lags: Vec<AtLag> = pairs.map(|pair| AtLag::new(schema, pair)).collect();
    let mut seen = 0;
    let mut pages = Pages::new(store, context.environment.id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, states) = (context.clone(), page.len() as u64);
        lags = gate
            .run(move |stop| added(lags, &context, &page, seen, stop))
            .await?;
        seen += states;
        progress.add(states);
    }

    let schema = context.environment.schema.clone();
    let point = move |at: &AtLag| at.point(&schema);
    let points = gate.run(move |_| Ok(Points(lags.par_iter().map(point).collect())));
    Ok((points.await?, totals.transitions))
}

/// Adds states, of which the first has this number, to every lag.
fn added(
    mut lags: Vec<AtLag>,
    context: &ProfileContext,
    page: &[Scanned],
    first: u64,
    stop: &Stop,
) -> Result<Vec<AtLag>, Stopped> {
    let region = &context.question.region;
    let within = |(_, state): &(u64, &Scanned)| region.contains(&state.key);
    let states: Vec<(u64, &Scanned)> = (first..).zip(page).filter(within).collect();
    let drawn = context.drawn();
    lags.par_iter_mut().try_for_each(|at| {
        for (number, state) in &states {
            stop.check()?;
            at.add(drawn, *number, &state.counts);
        }
        Ok(())
    })?;
    Ok(lags)
}

impl AtLag {
    /// Begins with no strata.
    pub fn new(schema: &Schema, pair: &Pair) -> Self {
        Self {
            pair: pair.clone(),
            tally: Tally::EMPTY,
            pool: Pool::new(pair.alphabet(schema)),
            memo: MomentsMemo::default(),
        }
    }

    /// Returns what all strata say together, in nats.
    pub fn point(&self, schema: &Schema) -> ProfilePoint {
        ProfilePoint {
            lag: self.pair.lag(schema),
            tally: self.tally,
            pooled: self.pool.pooled(SEED),
        }
    }

    /// Adds the strata of a state.
    pub fn add(&mut self, drawn: Drawn<'_>, state: u64, counts: &Counts) {
        let Drawn { schema, within, .. } = drawn;
        let cells = || counts.of_pair(schema, &self.pair, drawn.segments);
        self.tally.add(Tally::sum(cells()));
        for one in Tables::strata_within(schema, &self.pair, within, cells()) {
            self.pool.add(one.of_state(state), &mut self.memo);
        }
    }
}
