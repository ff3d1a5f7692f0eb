//! Summary statistics of a ranking: what all states say together.

use super::discoveries::FoundDiscoveries;
use super::labels::names;
use super::pass_cache::PassResult;
use super::state_ranking::StateRanking;
use super::stratified;
use crate::domain::{
    Dependence, Evidence, HistogramBin, Label, Schema, Scope, Segmentation, Summary, Verdict,
};

/// The lower bounds of the histogram's bins, in the summary's unit.
const BOUNDS: [f64; 12] = [
    0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0,
];

/// Sums up a ranking.
pub fn summary(
    schema: &Schema,
    scope: &Scope,
    segments: Vec<Label>,
    ranking: &PassResult<StateRanking>,
    found: Option<&FoundDiscoveries>,
) -> Summary {
    let transitions = visits(ranking, 0);
    let enough = visits(ranking, scope.rule.min_visits);
    let share = if transitions == 0 {
        0.0
    } else {
        enough as f64 / transitions as f64
    };

    Summary {
        labels: names(schema, &scope.pair),
        lag: scope.pair.lag(schema),
        transitions,
        states: ranking.rows.len() as u64,
        segments,
        segmentation: segmentation(ranking),
        habits_differ: habits_differ(ranking),
        pooled: ranking.pooled.clone().in_unit(scope.unit),
        min_visits: scope.rule.min_visits,
        share_of_visits_with_enough_data: share,
        verdicts: tally(&Verdict::ALL, ranking.rows.verdicts()),
        histogram: histogram(scope, ranking),
        as_of: ranking.as_of,
        unit: scope.unit,
        threshold: scope.rule.in_unit(scope.unit).threshold,
        threshold_nats: scope.rule.threshold_nats(),
        threshold_share: scope.share(schema),
        dependence: tally(
            &Dependence::ALL,
            evidence(ranking).map(|evidence| evidence.dependence),
        ),
        fit: ranking.fit,
        dependent_share: ranking.dependent_share,
        discoveries: found.map(|found| found.discoveries),
        warnings: warnings(ranking, found),
    }
}

/// Returns the visits of all states that were seen at least so often.
fn visits(ranking: &StateRanking, least: u64) -> u64 {
    ranking.rows.visits().filter(|n| *n >= least).sum()
}

/// Returns what the counts say of the states, of those where that is known.
fn evidence(ranking: &StateRanking) -> impl Iterator<Item = Evidence> + Clone {
    ranking.rows.evidence().flatten()
}

/// Returns where pooled and stratified answers disagree: by their tests, where those were made,
/// else by the evidence.
fn warnings(ranking: &StateRanking, found: Option<&FoundDiscoveries>) -> Vec<String> {
    match found {
        Some(found) if !found.warnings.is_empty() => found.warnings.clone(),
        _ => stratified::warnings(evidence(ranking)),
    }
}

/// Returns which segments the counts come from, and the mean over the states whose evidence tells
/// whether habits differ there.
fn segmentation(ranking: &StateRanking) -> Segmentation {
    let differing: Vec<f64> = evidence(ranking).filter_map(|told| told.differ).collect();
    let differ =
        (!differing.is_empty()).then(|| differing.iter().sum::<f64>() / differing.len() as f64);
    Segmentation {
        count: ranking.segments,
        differ,
    }
}

/// Returns the mean by visits of the probability that habits differ by segment, over the states
/// whose evidence tells it.
fn habits_differ(ranking: &StateRanking) -> Option<f64> {
    let states = ranking.rows.visits().zip(ranking.rows.evidence());
    let told = states.filter_map(|(visits, evidence)| Some((visits, evidence?.differ?)));
    let add = |(sum, weight): (f64, f64), (visits, differ): (u64, f64)| {
        let visits = visits as f64;
        (sum + visits * differ, weight + visits)
    };
    let (sum, weight) = told.fold((0.0, 0.0), add);
    (weight > 0.0).then(|| sum / weight)
}

/// Returns how often each of three words was said.
fn tally<T: PartialEq>(words: &[T; 3], said: impl Iterator<Item = T>) -> [u64; 3] {
    let mut counted = [0; 3];
    for word in said {
        counted[words
            .iter()
            .position(|one| *one == word)
            .expect("all are listed")] += 1;
    }
    counted
}

fn histogram(scope: &Scope, ranking: &StateRanking) -> Vec<HistogramBin> {
    let bin = |(i, from): (usize, &f64)| HistogramBin {
        from: *from,
        to: BOUNDS.get(i + 1).copied(),
        plug_in: 0,
        expected_if_independent: 0,
        posterior_mean: 0,
    };

    let mut bins: Vec<HistogramBin> = BOUNDS.iter().enumerate().map(bin).collect();

    // Every figure is at least 0, the first bound.
    let at = |nats: f64| BOUNDS.partition_point(|bound| *bound <= scope.unit.from_nats(nats)) - 1;
    for [plug_in, expected] in ranking.rows.plug_in() {
        bins[at(plug_in)].plug_in += 1;
        bins[at(expected)].expected_if_independent += 1;
    }
    for evidence in evidence(ranking) {
        bins[at(evidence.posterior_mean)].posterior_mean += 1;
    }
    bins
}
