//! Pooled evidence against references of 50 digits, by brute force over all tables.

use super::{TARGET, list, number};
use nudge::information::pooled::{MomentsMemo, Pool, Pooled, Stratum, gamma_tail};
use nudge::information::{Alphabet, Moments, Table};
use serde_json::Value;

/// Of the tails of gamma and chi-square distributions, relative.
const TAIL: f64 = 1e-9;

fn file() -> Value {
    serde_json::from_str(include_str!("../../golden/pooled.json")).expect("the file is JSON")
}

fn near(what: &Value, figure: f64, reference: &Value, tolerance: f64) {
    let reference = number(reference);
    let off = (figure - reference).abs();
    assert!(
        off <= tolerance * reference.abs().max(1.0),
        "{figure:e} instead of {reference:e}: {what}"
    );
}

#[test]
fn moments_of_margins_are_those_of_all_tables() {
    let mut memo = MomentsMemo::default();
    for golden in list(&file()["margins"]) {
        let [rows, columns] = [&golden["rows"], &golden["columns"]].map(labels);
        let cells = rows.into_iter().zip(columns).map(|(i, j)| (i, j, 1));

        let found = memo.moments(&Table::from_counts(cells));

        near(golden, found.mean, &golden["mean"], TARGET);
        near(golden, found.variance, &golden["variance"], TARGET);
    }
}

/// Returns each label as often as its sum says.
fn labels(sums: &Value) -> Vec<u64> {
    let of_label = |(label, sum): (u64, &Value)| {
        std::iter::repeat_n(label, sum.as_u64().expect("a sum") as usize)
    };
    (0..).zip(list(sums)).flat_map(of_label).collect()
}

#[test]
fn pools_match_50_digits() {
    for golden in list(&file()["pools"]) {
        let (pooled, reference) = (pooled(golden), &golden["reference"]);
        let what = &golden["shape"];
        let visits = pooled.visits as f64;
        let null = Moments {
            mean: pooled.expected_if_independent * visits,
            variance: (pooled.excess_deviation * visits).powi(2),
        };

        assert_eq!(pooled.visits, reference["visits"]);
        near(
            what,
            pooled.plug_in * visits,
            &reference["statistic"],
            TARGET,
        );
        near(what, null.mean, &reference["mean"], TARGET);
        near(what, null.variance, &reference["variance"], TARGET);
        let tail = gamma_tail(pooled.plug_in * visits, null);
        near(
            what,
            tail / number(&reference["p_gamma"]),
            &1.0.into(),
            TAIL,
        );
        near(
            what,
            pooled.effective_visits,
            &reference["effective_visits"],
            TARGET,
        );
        near(what, pooled.size, &reference["size"], TARGET);
        near_interval(what, pooled.size_interval, &reference["interval"]);
        let of_new = &reference["interval_new_segments"];
        near_interval(what, pooled.size_interval_new_segments, of_new);
    }
}

fn near_interval(what: &Value, interval: Option<[f64; 2]>, reference: &Value) {
    match interval {
        Some(ends) => {
            for (end, reference) in ends.into_iter().zip(list(reference)) {
                near(what, end, reference, TAIL);
            }
        }
        None => assert!(reference.is_null(), "{what}"),
    }
}

#[test]
fn the_same_pattern_is_that_of_exact_fractions() {
    for golden in list(&file()["pools"]) {
        let reference = &golden["reference"];

        let test = pooled(golden)
            .same_pattern
            .expect("strata that can show one");

        assert_eq!(test.rank, reference["rank"]);
        near(
            &golden["shape"],
            test.statistic,
            &reference["pattern"],
            10.0 * TARGET,
        );
        let tail = test.p_value / number(&reference["p_pattern"]);
        near(&golden["shape"], tail, &1.0.into(), TAIL);
    }
}

fn pooled(golden: &Value) -> Pooled {
    let size = |axis: usize| golden["shape"][axis].as_u64().expect("a size");
    let mut memo = MomentsMemo::default();
    let mut pool = Pool::new(Alphabet {
        rows: size(0),
        columns: size(1),
    });
    for stratum in list(&golden["strata"]) {
        let number = |name: &str| stratum[name].as_u64().expect("a number");
        let rows = (0..).zip(list(&stratum["counts"]));
        let cells = rows.flat_map(|(i, row)| {
            let count = move |(j, n): (u64, &Value)| (i, j, n.as_u64().expect("a count"));
            (0..).zip(list(row)).map(count)
        });
        let (state, segment) = (number("state"), number("segment"));
        let table = &Table::from_counts(cells);
        let stratum = Stratum {
            state,
            segment,
            table,
        };
        pool.add(stratum, &mut memo);
    }
    pool.pooled(1)
}
