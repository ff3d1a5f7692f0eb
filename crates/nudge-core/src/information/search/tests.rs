//! Searches of small grids: what is found, and that nothing better is missed.

use std::cell::Cell;
use std::ops::Range;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;

/// Returns states with a variance of 1 each and so many visits.
fn states(axes: &[Axis], rows: &[(Vec<u32>, f64)], visits: u64) -> States {
    let mut states = States::new(axes.to_vec());
    for (bins, beyond) in rows {
        let sum = Sum {
            beyond: *beyond,
            variance: 1.0,
            visits,
        };
        states.push(bins.iter().copied(), sum);
    }
    states
}

fn found(states: States, most: usize) -> Searched {
    search(states, most, &|| true).expect("nobody ends it")
}

fn conditions(rule: &FoundRule) -> Vec<(usize, Range<u32>)> {
    let conditions = rule.conditions.iter();
    conditions.map(|one| (one.axis, one.bins.clone())).collect()
}

/// Returns a grid of two ordered axes and one without an order, in which a part lies beyond
/// independence.
fn grid(is_beyond: impl Fn(&[u32]) -> bool, by: f64) -> (Vec<Axis>, Vec<(Vec<u32>, f64)>) {
    let axes = vec![Axis::Ordered(6), Axis::Ordered(5), Axis::Unordered];
    let mut rows = Vec::new();
    for number in 0..6 * 5 * 3 {
        let bins = vec![number % 6, number / 6 % 5, number / 30];
        let beyond = if is_beyond(&bins) { by } else { 0.0 };
        rows.push((bins, beyond));
    }
    (axes, rows)
}

#[test]
fn the_planted_conditions_are_found_and_no_others() {
    let is_planted = |bins: &[u32]| (1..4).contains(&bins[0]) && bins[2] == 1;
    let (axes, rows) = grid(is_planted, 4.0);
    let searched = found(states(&axes, &rows, 20), MOST_RULES);

    let [rule] = searched.rules.as_slice() else {
        panic!("one rule: {searched:?}")
    };
    assert_eq!(conditions(rule), [(0, 1..4), (2, 1..2)]);
    assert_eq!(rule.sum.visits, 15 * 20);
    assert!((rule.sum.z() - 60.0 / 15.0_f64.sqrt()).abs() < 1e-12);
    // 20, 14 and 3 conditions, by themselves, in pairs, and all three.
    let pairs = 20 * 14 + 20 * 3 + 14 * 3;
    assert_eq!(searched.looked_at, 37 + pairs + 20 * 14 * 3);
    assert_eq!(searched.left_out, [] as [usize; 0]);
}

#[test]
fn regions_are_found_one_after_the_other() {
    let (axes, rows) = grid(|bins| bins[0] == 5 || bins[1] == 0 && bins[0] < 2, 5.0);
    let searched = found(states(&axes, &rows, 50), MOST_RULES);
    let rules: Vec<_> = searched.rules.iter().map(conditions).collect();
    assert_eq!(rules, [vec![(0, 5..6)], vec![(0, 0..2), (1, 0..1)]]);

    let first = found(states(&axes, &rows, 50), 1);
    assert_eq!(first.rules, searched.rules[..1]);
}

#[test]
fn what_is_everywhere_is_said_to_be_everywhere() {
    let (axes, rows) = grid(|_| true, 1.0);
    let searched = found(states(&axes, &rows, 20), MOST_RULES);
    let rules: Vec<_> = searched.rules.iter().map(conditions).collect();
    assert_eq!(rules, [vec![]]);
    assert_eq!(searched.rules[0].sum.visits, 90 * 20);
}

#[test]
fn nothing_is_found_below_independence_or_with_few_visits() {
    let (axes, rows) = grid(|bins| bins[0] == 5, -9.0);
    assert_eq!(found(states(&axes, &rows, 20), MOST_RULES).rules, []);
    let (axes, rows) = grid(|bins| bins[0] == 5 && bins[1] == 0, 30.0);
    // The three states of it have too few visits, and so has whatever it could be a part of.
    assert_eq!(found(states(&axes, &rows, 1), MOST_RULES).rules, []);
    assert_eq!(found(States::new(axes), MOST_RULES), Searched::default());
}

#[test]
fn an_outermost_interval_has_no_end_there_and_a_gap_belongs_to_neither_side() {
    let axes = [Axis::Ordered(100)];
    let beyond = |bin| if bin >= 40 { 6.0 } else { 0.0 };
    let rows: Vec<(Vec<u32>, f64)> = [10, 11, 20, 40, 50, 60]
        .map(|bin| (vec![bin], beyond(bin)))
        .into();
    let searched = found(states(&axes, &rows, 60), MOST_RULES);
    assert_eq!(conditions(&searched.rules[0]), [(0, 40..100)]);
}

#[test]
fn many_bins_are_cut_where_visits_are_parted_evenly() {
    let axes = [Axis::Ordered(1_000)];
    let beyond = |bin| if bin < 250 { 2.0 } else { 0.0 };
    let rows: Vec<(Vec<u32>, f64)> = (0..1_000).map(|bin| (vec![bin], beyond(bin))).collect();
    let searched = found(states(&axes, &rows, 3), MOST_RULES);
    // A quarter is four of sixteen steps.
    assert_eq!(conditions(&searched.rules[0]), [(0, 0..250)]);
    assert_eq!(searched.looked_at, 16 * 17 / 2 - 1);
}

#[test]
fn where_rules_are_too_many_those_with_the_best_coordinates_are_looked_at() {
    let mut random = Pcg64::seed_from_u64(7);
    let axes = vec![Axis::Ordered(8); 12];
    let row = |_| {
        let bins: Vec<u32> = (0..12).map(|_| random.random_range(0..8)).collect();
        let is_planted = bins[3] < 4 && bins[7] < 4 && bins[11] < 4;
        (bins, if is_planted { 2.0 } else { 0.0 })
    };
    let rows: Vec<(Vec<u32>, f64)> = (0..2_000).map(row).collect();
    let rounds = Cell::new(0);
    let goes_on = || {
        rounds.set(rounds.get() + 1);
        true
    };
    let search = Search::new(states(&axes, &rows, 10), 1_000_000);
    let searched = search.rules(1, &goes_on).expect("nobody ends it");
    assert_eq!(
        conditions(&searched.rules[0]),
        [(3, 0..4), (7, 0..4), (11, 0..4)]
    );
    assert!(
        searched.left_out.len() > 2 && !searched.left_out.contains(&3),
        "{searched:?}"
    );
    assert!(rounds.get() > 12 + 66, "asked at every tuple");
}

#[test]
fn nobody_waits_any_more() {
    let (axes, rows) = grid(|_| true, 1.0);
    assert_eq!(search(states(&axes, &rows, 20), 1, &|| false), None);
}

/// Returns the best score of all rules, one by one.
fn best_of_all(axes: &[Axis], rows: &[(Vec<u32>, f64)], visits: u64) -> f64 {
    let intervals = |axis: &Axis| -> Vec<Range<u32>> {
        match axis {
            Axis::Ordered(bins) => {
                let all =
                    (0..*bins).flat_map(|start| (start + 1..=*bins).map(move |end| start..end));
                all.filter(|run| run.len() < *bins as usize).collect()
            }
            Axis::Unordered => (0..3).map(|bin| bin..bin + 1).collect(),
        }
    };
    let choices: Vec<Vec<Range<u32>>> = axes.iter().map(intervals).collect();
    let price = (choices.iter().map(Vec::len).sum::<usize>() as f64).ln();

    let mut rules: Vec<Vec<Option<&Range<u32>>>> = vec![Vec::new()];
    for choices in &choices {
        let mut all = Vec::new();
        for rule in &rules {
            for choice in choices.iter().map(Some).chain([None]) {
                all.push([rule.as_slice(), &[choice]].concat());
            }
        }
        rules = all;
    }

    let score = |rule: &Vec<Option<&Range<u32>>>| {
        let size = rule.iter().flatten().count();
        let meets = |bins: &[u32]| {
            let mut both = rule.iter().zip(bins);
            both.all(|(run, bin)| run.is_none_or(|run| run.contains(bin)))
        };
        let inside = rows.iter().filter(|(bins, _)| meets(bins));
        let (beyond, n) = inside.fold((0.0, 0), |(sum, n), (_, beyond)| (sum + beyond, n + 1));
        let is_told = size > 0 && beyond > 0.0 && n * visits >= FEWEST_VISITS;
        is_told.then(|| beyond * beyond / (2.0 * n as f64) - size as f64 * price)
    };
    rules.iter().filter_map(score).fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn no_rule_is_better_than_the_one_found(noise in prop::collection::vec(-3.0..4.0_f64, 90), visits in 5..40_u64) {
        let (axes, mut rows) = grid(|_| false, 0.0);
        for ((_, beyond), noise) in rows.iter_mut().zip(noise) {
            *beyond = noise;
        }
        let best = best_of_all(&axes, &rows, visits);
        let search = Search::new(states(&axes, &rows, visits), MOST_WORK);
        let round = Round::new(&search).run(&|| true).expect("nobody ends it");
        match round.best() {
            None => prop_assert_eq!(best, 0.0),
            Some(rule) => {
                let sum = search.states.sum(&rule);
                let score = sum.beyond.powi(2) / (2.0 * sum.variance) - rule.len() as f64 * search.price;
                prop_assert!((score - best).abs() < 1e-9, "{} and {}", score, best);
            }
        }
    }
}
