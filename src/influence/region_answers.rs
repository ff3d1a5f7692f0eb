//! Answers about regions: pooled evidence and the posterior of mean mutual information over all
//! states of each, made in one pass over them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rayon::prelude::*;

use super::actions;
use super::labels::labels;
use super::query_context::{QueryContext, RankingKey};
use super::region_warnings::warnings;
use super::store_errors::logged;
use crate::domain::{
    ActionFigures, AtGrain, CoarseKey, Evidence, FitId, Grain, Independence, Probability, Region,
    RegionAnswer, RegionAnswers, RegionFigures, RegionQuestion, SegmentId, Segmentation, Tally,
    View,
};
use crate::error::Problem;
use crate::evidence::{self, RegionPosterior, RegionState, RegionStates};
use crate::information::Table;
use crate::information::pooled::{self, MomentsMemo, Pool, Pooled, Responses};
use crate::priors::{Pages, Stratum, Tables};
use crate::store::{Scanned, Store};
use crate::work::{Gate, Progress, Stop, Stopped};

/// Of the permutations that small pools are tested by.
const SEED: u64 = 1;

/// What answers about regions rest on.
#[derive(Clone)]
pub struct RegionContext {
    /// The environment, the segments and the fit.
    pub query: QueryContext,
    /// The question.
    pub question: Arc<RegionQuestion>,
}

/// What is made for a question: its scope, the view, and the regions and the grain with what their
/// coordinates mean, which may change.
pub type RegionKey = (RankingKey, bool, String);

/// What was made of all states.
pub struct Made {
    /// One a region.
    regions: Vec<MadeRegion>,
    /// The fit that the evidence rests on.
    fit: FitId,
}

/// What was made of the states of a region, in nats.
struct MadeRegion {
    tally: Tally,
    segmentation: Segmentation,
    pooled: Pooled,
    stratified: Option<Pooled>,
    posterior: Option<RegionPosterior>,
    by_action: Option<Vec<ActionFigures>>,
}

impl RegionContext {
    /// Returns what the answers are of.
    pub fn key(&self) -> RegionKey {
        let RegionQuestion {
            regions,
            grain,
            view,
            ..
        } = &*self.question;
        let is_full = *view == View::Full;
        (self.query.key(), is_full, format!("{regions:?}{grain:?}"))
    }

    /// Returns the answers by what was made of all states from a revision.
    pub fn told(&self, made: &Made, revision: u64) -> RegionAnswers {
        let (schema, pair) = (&self.query.environment.schema, &self.question.scope.pair);
        let regions = self.question.regions.iter().zip(&made.regions);
        RegionAnswers {
            labels: labels(schema, pair),
            lag: pair.lag(schema),
            answers: regions
                .map(|(region, sums)| self.answer(region, sums, made.fit, revision))
                .collect(),
        }
    }

    fn answer(
        &self,
        region: &Region,
        made: &MadeRegion,
        fit: FitId,
        revision: u64,
    ) -> RegionAnswer {
        let (rule, posterior) = (&self.question.scope.rule, made.posterior.as_ref());
        // What is left out at a grain may be a common cause: nothing is decided without it.
        let finest = made.stratified.as_ref().unwrap_or(&made.pooled);
        let figures = || Box::new(self.figures(made, finest, fit, revision));
        let unit = self.question.scope.unit;
        let in_unit = |action: &ActionFigures| action.clone().in_unit(unit);
        RegionAnswer {
            region: region.clone(),
            tally: made.tally,
            verdict: evidence::decide_region(rule, made.tally.n, finest, posterior),
            basis: evidence::basis(made.tally.n),
            figures: (self.question.view != View::Verdict).then(figures),
            by_action: made
                .by_action
                .as_ref()
                .map(|actions| actions.iter().map(in_unit).collect()),
        }
    }

    fn figures(
        &self,
        made: &MadeRegion,
        finest: &Pooled,
        fit: FitId,
        revision: u64,
    ) -> RegionFigures {
        let (schema, scope) = (&self.query.environment.schema, &self.question.scope);
        let in_unit = |pooled: &Pooled| pooled.clone().in_unit(|nats| scope.unit.from_nats(nats));
        let posterior = made.posterior.as_ref();
        let evidence = posterior.map(|posterior| self.evidence(finest, posterior));
        let grain = self.question.grain.as_ref().zip(made.stratified.as_ref());

        RegionFigures {
            lag: scope.pair.lag(schema),
            unit: scope.unit,
            threshold: scope.rule.in_unit(scope.unit).threshold,
            share: scope.share(schema),
            rule: scope.rule.kind,
            pooled: in_unit(&made.pooled),
            grain: grain.map(|(grain, stratified)| AtGrain {
                left_out: left_out(grain),
                stratified: in_unit(stratified),
            }),
            independence: Independence::from(made.tally),
            evidence: evidence.map(|evidence| evidence.in_unit(scope.unit)),
            segmentation: made.segmentation,
            warnings: warnings(
                scope.within,
                made.segmentation.count,
                &made.pooled,
                grain.map(|(grain, stratified)| (left_out(grain), stratified)),
            ),
            fit,
            revision,
        }
    }

    /// Returns what is believed, in nats, beside what the strata show.
    fn evidence(&self, pooled: &Pooled, posterior: &RegionPosterior) -> Evidence {
        Evidence {
            dependence: evidence::dependence_in_region(pooled, posterior),
            probability: Probability {
                dependent: posterior.dependent_share(),
                above_threshold: posterior.above(self.question.scope.rule.threshold_nats()),
            },
            posterior_mean: posterior.mean(),
            interval: posterior.interval(),
            differ: None,
            pooled: None,
        }
    }
}

impl Made {
    /// Returns whether it was made by the fit of a query.
    pub fn is_current(&self, query: &QueryContext) -> bool {
        self.fit == query.fit()
    }
}

fn left_out(grain: &Grain) -> Vec<String> {
    let names = grain.left_out().iter().map(|one| one.name().to_string());
    names.collect()
}

/// Passes over all states; returns what was made of them, and how many transitions there were before.
pub async fn make(
    store: &dyn Store,
    gate: &Gate,
    context: &RegionContext,
    progress: &Progress,
) -> Result<(Made, u64), Problem> {
    let id = context.query.environment.id;
    let totals = store.totals(id).await.map_err(logged)?;
    progress.begin("states looked at", totals.states);

    let mut sums = Sums::new(context);
    let mut seen = 0;
    let mut pages = Pages::new(store, id);
    while let Some(page) = pages.next().await.map_err(logged)? {
        let (context, states) = (context.clone(), page.len() as u64);
        sums = gate
            .run(move |stop| sums.added(&context, &page, seen, stop))
            .await?;
        seen += states;
        progress.add(states);
    }

    let fit = context.query.fit();
    let context = context.clone();
    let made = gate.run(move |_| {
        let regions = sums.regions.par_iter();
        let regions = regions.map(|region| region.made(&context)).collect();
        Ok(Made { regions, fit })
    });
    Ok((made.await?, totals.transitions))
}

/// The regions of a question so far.
struct Sums {
    regions: Vec<RegionSums>,
    /// One for each thread.
    memos: Vec<MomentsMemo>,
}

/// The states of one region so far.
struct RegionSums {
    region: Region,
    tally: Tally,
    segments: BTreeSet<SegmentId>,
    /// The sums of P(habits differ) and of visits, of the states whose evidence tells.
    differ: [f64; 2],
    pool: Pool,
    coarse: BTreeMap<(CoarseKey, u64, SegmentId), Table>,
    states: Option<RegionStates>,
    responses: Option<Responses>,
}

/// One state, as every region that it lies in adds it.
struct Measured<'a> {
    number: u64,
    scanned: &'a Scanned,
    tally: Tally,
    segments: BTreeSet<SegmentId>,
    strata: Vec<Stratum>,
    believed: Option<(RegionState, Option<f64>)>,
}

impl Sums {
    fn new(context: &RegionContext) -> Self {
        let regions = context.question.regions.iter();
        Self {
            regions: regions
                .map(|region| RegionSums::new(context, region))
                .collect(),
            memos: vec![MomentsMemo::default(); rayon::current_num_threads()],
        }
    }

    /// Adds states, of which the first has this number, to every region.
    fn added(
        mut self,
        context: &RegionContext,
        page: &[Scanned],
        first: u64,
        stop: &Stop,
    ) -> Result<Self, Stopped> {
        let is_asked = |(_, state): &(u64, &Scanned)| {
            let mut regions = context.question.regions.iter();
            regions.any(|region| region.contains(&state.key))
        };
        let states: Vec<(u64, &Scanned)> = (first..).zip(page).filter(is_asked).collect();
        let measured = states.into_par_iter().map(|(number, scanned)| {
            stop.check()?;
            Ok(context.measured(number, scanned))
        });
        let measured: Vec<Measured<'_>> = measured.collect::<Result<_, Stopped>>()?;

        let each = self.regions.len().div_ceil(self.memos.len()).max(1);
        let parts = self.regions.par_chunks_mut(each).zip(&mut self.memos);
        parts.try_for_each(|(regions, memo)| {
            for region in regions {
                stop.check()?;
                region.add(context, &measured, memo);
            }
            Ok(())
        })?;
        Ok(self)
    }
}

impl RegionContext {
    fn measured<'a>(&self, number: u64, scanned: &'a Scanned) -> Measured<'a> {
        let (schema, scope) = (&self.query.environment.schema, &self.question.scope);
        let segments = self.query.segments.as_deref();
        let cells = || scanned.counts.of_pair(schema, &scope.pair, segments);

        let tally = Tally::sum(cells());
        let assessor = self.query.assessor(View::Figures);
        Measured {
            number,
            scanned,
            tally,
            segments: cells().map(|cell| cell.segment).collect(),
            strata: Tables::strata_within(schema, &scope.pair, scope.within, cells()),
            believed: assessor.region_state(tally, &scanned.counts),
        }
    }
}

impl RegionSums {
    fn new(context: &RegionContext, region: &Region) -> Self {
        let (schema, scope) = (&context.query.environment.schema, &context.question.scope);
        let alphabet = scope.pair.alphabet(schema);
        // Of a single action there is nothing to believe.
        let informed = context.query.informed.as_ref();
        let informed = informed.filter(|_| alphabet.largest_information() > 0.0);
        let share = informed.map(|informed| informed.unseen(scope.rule.threshold_nats()).dependent);
        Self {
            region: region.clone(),
            tally: Tally::EMPTY,
            segments: BTreeSet::new(),
            differ: [0.0; 2],
            pool: Pool::new(alphabet),
            coarse: BTreeMap::new(),
            states: share.map(RegionStates::new),
            responses: (context.question.view == View::Full).then(|| Responses::new(alphabet)),
        }
    }

    /// Adds those states that lie in the region.
    fn add(&mut self, context: &RegionContext, states: &[Measured<'_>], memo: &mut MomentsMemo) {
        let region = self.region.clone();
        let within = |state: &&Measured<'_>| region.contains(&state.scanned.key);
        for state in states.iter().filter(within) {
            self.tally.add(state.tally);
            self.segments.extend(&state.segments);
            self.believe(state);
            for stratum in &state.strata {
                self.pool.add(stratum.of_state(state.number), memo);
                if let Some(responses) = &mut self.responses {
                    responses.add(&stratum.table);
                }
            }
            if let Some(grain) = &context.question.grain {
                self.merge(grain.coarse(&state.scanned.key), &state.strata);
            }
        }
    }

    fn believe(&mut self, state: &Measured<'_>) {
        let (Some((believed, differ)), Some(states)) = (state.believed, &mut self.states) else {
            return;
        };
        states.add(believed);
        if let Some(differ) = differ {
            let visits = believed.visits as f64;
            self.differ[0] += visits * differ;
            self.differ[1] += visits;
        }
    }

    /// Adds strata to those of a coarse state.
    fn merge(&mut self, coarse: CoarseKey, strata: &[Stratum]) {
        for stratum in strata {
            let key = (coarse, stratum.held, stratum.segment);
            let merged = self.coarse.entry(key).or_default();
            *merged = match merged.total() {
                0 => stratum.table.clone(),
                _ => Table::sum(&[std::mem::take(merged), stratum.table.clone()]),
            };
        }
    }

    fn made(&self, context: &RegionContext) -> MadeRegion {
        let stratified = self.pool.pooled(SEED);
        let merged = context
            .question
            .grain
            .as_ref()
            .map(|_| self.merged(context));
        let [differ, visits] = self.differ;
        let states = self.states.as_ref();
        let posterior = states.and_then(|states| states.posterior(&stratified));
        let (pooled, stratified) = match merged {
            Some(merged) => (merged, Some(stratified)),
            None => (stratified, None),
        };

        MadeRegion {
            tally: self.tally,
            segmentation: Segmentation {
                count: self.segments.len() as u64,
                differ: (visits > 0.0).then(|| differ / visits),
            },
            pooled,
            stratified,
            posterior,
            by_action: self.responses.as_ref().map(|responses| {
                actions::on_the_whole(
                    &context.query.environment.schema,
                    &context.question.scope,
                    responses,
                )
            }),
        }
    }

    /// Returns what coarse states show together.
    fn merged(&self, context: &RegionContext) -> Pooled {
        let (schema, scope) = (&context.query.environment.schema, &context.question.scope);
        let (mut pool, mut memo) = (
            Pool::new(scope.pair.alphabet(schema)),
            MomentsMemo::default(),
        );
        let (mut number, mut last) = (0, None);
        for ((coarse, _, segment), table) in &self.coarse {
            if last.replace(coarse).is_some_and(|last| last != coarse) {
                number += 1;
            }
            let stratum = pooled::Stratum {
                state: number,
                segment: segment.0.unsigned_abs(),
                table,
            };
            pool.add(stratum, &mut memo);
        }
        pool.pooled(SEED)
    }
}
