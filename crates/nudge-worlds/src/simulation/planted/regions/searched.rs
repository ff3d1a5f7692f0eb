//! What a search finds in a world, as the service searches: one half for the rules, the other for
//! the tests.

use std::collections::BTreeMap;

use nudge_core::domain::{Half, Halves, Label, SegmentId, StateKey, Within};
use nudge_core::information::pooled::{MomentsMemo, Pool, Pooled, Stratum};
use nudge_core::information::search::{
    Axis, Condition, FoundRule, MOST_RULES, States, Sum, search,
};
use nudge_core::information::{Alphabet, Table, q_values};

use super::{ACTIONS, BINS, Drawn, PLANTED, SEGMENTS, UNORDERED, is_planted};

/// A rule, what the other half says of it, and the false discovery rate at which it passes.
pub type Tested = (FoundRule, Pooled, f64);

/// Returns z of the planted region on the half that is searched.
pub fn planted_z(drawn: &Drawn) -> f64 {
    let (halves, tables, mut memo) = (halves(), tables(drawn), MomentsMemo::default());
    let mut sum = Sum::default();
    for ((state, segment), table) in &tables {
        let bins = &drawn.states[*state];
        if is_planted(bins)
            && halves.of(&StateKey::new(bins), 0, SegmentId(*segment as i64)) == Half::Search
        {
            sum.add(&Sum::of(table, &mut memo));
        }
    }
    sum.z()
}

/// Returns whether a rule is the planted region, and nothing else.
pub fn is_exact(rule: &FoundRule) -> bool {
    let planted = PLANTED.map(|(axis, [first, end])| Condition {
        axis,
        bins: first..end,
    });
    rule.conditions == planted
}

/// Returns every rule that is tested.
pub fn searched(drawn: &Drawn) -> Vec<Tested> {
    let halves = halves();
    let tables = tables(drawn);
    let mut memo = MomentsMemo::default();
    let half = |state: usize, segment: usize| {
        let key = StateKey::new(&drawn.states[state]);
        halves.of(&key, 0, SegmentId(segment as i64))
    };
    let mut sums = vec![Sum::default(); drawn.states.len()];
    for ((state, segment), table) in &tables {
        if half(*state, *segment) == Half::Search {
            sums[*state].add(&Sum::of(table, &mut memo));
        }
    }

    let mut states = States::new(axes());
    for (bins, sum) in drawn.states.iter().zip(sums) {
        states.push(*bins, sum);
    }
    let found = search(states, MOST_RULES, &|| true).map(|found| found.rules);
    let found = found.unwrap_or_default();

    let alphabet = Alphabet {
        rows: ACTIONS as u64,
        columns: ACTIONS as u64,
    };
    let mut pools = vec![Pool::new(alphabet); found.len()];
    for ((state, segment), table) in &tables {
        let first = found
            .iter()
            .position(|rule| meets(rule, &drawn.states[*state]));
        if let Some(at) = first
            && half(*state, *segment) == Half::Test
        {
            let stratum = Stratum {
                state: *state as u64,
                segment: *segment as u64,
                table,
            };
            pools[at].add(stratum, &mut memo);
        }
    }
    let pooled: Vec<Pooled> = pools.iter().map(|pool| pool.pooled(1)).collect();
    let p_values: Vec<f64> = pooled.iter().map(|pooled| pooled.p_value).collect();
    let tested = found.into_iter().zip(pooled).zip(q_values(&p_values));
    tested
        .map(|((rule, pooled), q)| (rule, pooled, q))
        .collect()
}

fn halves() -> Halves {
    let label = |at: i64| at.to_string().parse::<Label>().ok();
    let segments: Vec<(SegmentId, Option<Label>)> = (0..SEGMENTS as i64)
        .map(|at| (SegmentId(at), label(at)))
        .collect();
    Halves::deal(&segments, Within::Auto)
}

/// Returns the features as a search takes them.
pub fn axes() -> Vec<Axis> {
    let axis = |(at, bins): (usize, &u32)| match UNORDERED.contains(&at) {
        true => Axis::Unordered,
        false => Axis::Ordered(*bins),
    };
    BINS.iter().enumerate().map(axis).collect()
}

fn meets(rule: &FoundRule, bins: &[u32]) -> bool {
    let conditions = rule.conditions.iter();
    conditions
        .clone()
        .all(|one| one.bins.contains(&bins[one.axis]))
}

/// The ego's action, the other's, and how often.
type Count = (u64, u64, u64);

/// Returns the table of each state and segment, rows for the ego.
fn tables(drawn: &Drawn) -> BTreeMap<(usize, usize), Table> {
    let mut counts: BTreeMap<(usize, usize), Vec<Count>> = BTreeMap::new();
    for draw in &drawn.draws {
        let stratum = counts.entry((draw.state, draw.segment)).or_default();
        stratum.push((draw.ego as u64, draw.other as u64, 1));
    }
    let table = |(at, counts): (_, Vec<_>)| (at, Table::from_counts(counts));
    counts.into_iter().map(table).collect()
}
