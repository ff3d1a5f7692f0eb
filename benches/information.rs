//! Figures of tables, one thread: nanoseconds each, and how they compare with Python's on the same
//! tables.
//!
//! `cargo bench --bench information`; with `NUDGE_PYTHON=/path/to/python` also
//! `benches/information_yardsticks.py`, which says what that Python needs.

#![allow(missing_docs)]

mod support;

use std::collections::BTreeMap;
use std::fs;
use std::hint::black_box;
use std::slice;
use std::time::Instant;

use nudge::evidence::{Fitter, Prior, Uses};
use nudge::information::{
    Alphabet, Table, adjusted, chao_shen, dirichlet, expected_if_independent, grassberger_2003,
    james_stein, nsb, p_value, plug_in, plug_in_dense, smallest_p, uniform_policy,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use support::python;

const SEED: u64 = 1;
type Counts = [[u32; ACTIONS]; ACTIONS];

const TABLES: usize = 10_000;
const ACTIONS: usize = 6;
const ROUNDS: usize = 7;
/// Of the slow figures, only the first tables are made.
const FEW: usize = 500;
const PERMUTATIONS: u64 = 199;

fn main() {
    let counts = counts();
    let tables: Vec<Table> = counts.iter().map(table).collect();
    let alphabet = Alphabet {
        rows: ACTIONS as u64,
        columns: ACTIONS as u64,
    };
    let all = |figure: fn(&Table) -> f64| nanoseconds(&tables, figure);
    let few = |figure: &dyn Fn(&Table) -> f64| nanoseconds(&tables[..FEW], figure);
    let prior = prior(&tables, alphabet);
    let figures = [
        (
            "P(dependent), all slabs (target <= 5,000)",
            nanoseconds(&tables, |table| prior.dependent(slice::from_ref(table))),
        ),
        (
            "posterior: mean, P(above 0.5), interval (target <= 30,000)",
            nanoseconds(&tables, |table| believed(&prior, table)),
        ),
        ("plug_in_dense", nanoseconds(&counts, plug_in_dense)),
        (
            "table",
            nanoseconds(&counts, |counts| table(counts).total() as f64),
        ),
        ("plug_in", all(plug_in)),
        (
            "expected_if_independent",
            all(|table| expected_if_independent(table).0),
        ),
        ("adjusted", all(adjusted)),
        ("uniform_policy", all(uniform_policy)),
        ("chao_shen", all(chao_shen)),
        ("grassberger_2003", all(grassberger_2003)),
        (
            "james_stein",
            nanoseconds(&tables, |table| james_stein(table, alphabet)),
        ),
        (
            "dirichlet",
            nanoseconds(&tables, |table| dirichlet(table, alphabet)),
        ),
        ("nsb", few(&|table| nsb(table, alphabet))),
        (
            "p_value, B = 199",
            few(&|table| p_value(slice::from_ref(table), PERMUTATIONS, SEED).p_value),
        ),
        (
            "smallest_p",
            few(&|table| smallest_p(slice::from_ref(table))),
        ),
    ];
    println!(
        "{TABLES} tables of {ACTIONS} x {ACTIONS}, 1 to 500 visits, seed {SEED}; one thread, median of {ROUNDS}"
    );
    let beside = yardsticks(&counts);
    for (name, own) in figures {
        println!("{name}: {own:.0} ns");
        for (yardstick, other) in beside.get(name).into_iter().flatten() {
            println!(
                "  beside {other:.0} ns ({yardstick}): ratio {:.4}{}",
                own / other,
                target(yardstick)
            );
        }
    }
}

fn prior(tables: &[Table], alphabet: Alphabet) -> Prior {
    let mut uses = Uses::new(alphabet);
    tables
        .iter()
        .for_each(|table| uses.add(slice::from_ref(table)));
    let mut fitter = Fitter::new(alphabet, &uses);
    tables
        .iter()
        .for_each(|table| fitter.add(slice::from_ref(table)));
    Prior::new(&fitter.fit())
}

fn believed(prior: &Prior, table: &Table) -> f64 {
    let posterior = prior.posterior(prior.habits(), slice::from_ref(table));
    posterior.mean() + posterior.above(0.5) + posterior.interval()[1]
}

fn target(yardstick: &str) -> &'static str {
    if yardstick.starts_with("numpy") {
        " (target <= 0.07)"
    } else {
        ""
    }
}

/// Counts of independent actions: visits log-normal about 12, from 1 to 500, as states of real play
/// have them.
fn counts() -> Vec<Counts> {
    let mut random = Pcg64::seed_from_u64(SEED);
    let mut one = || {
        // The sum of twelve uniforms less 6 is as good as normal.
        let normal = (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let visits = (12_f64.ln() + 1.4 * normal).exp().round().clamp(1.0, 500.0) as u32;
        let mut counts = Counts::default();
        for _ in 0..visits {
            counts[random.random_range(0..ACTIONS)][random.random_range(0..ACTIONS)] += 1;
        }
        counts
    };
    (0..TABLES).map(|_| one()).collect()
}

fn table(counts: &Counts) -> Table {
    let row = |(row, counts): (u64, &[u32; ACTIONS])| {
        (0..)
            .zip(*counts)
            .map(move |(column, n)| (row, column, n.into()))
    };
    Table::from_counts((0..).zip(counts).flat_map(row))
}

/// Returns the median time of a pass over all of something, for each of them.
fn nanoseconds<T>(all: &[T], figure: impl Fn(&T) -> f64) -> f64 {
    let time = |_| {
        let started = Instant::now();
        let figures: Vec<f64> = all.iter().map(|one| figure(black_box(one))).collect();
        black_box(figures);
        started.elapsed().as_secs_f64() * 1e9 / all.len() as f64
    };
    let mut times: Vec<f64> = (0..ROUNDS).map(time).collect();
    times.sort_by(f64::total_cmp);
    times[ROUNDS / 2]
}

/// Runs the script on the same counts, as little-endian u32, and returns what it printed: for each
/// of our figures, the yardsticks beside it in nanoseconds.
fn yardsticks(counts: &[Counts]) -> BTreeMap<String, Vec<(String, f64)>> {
    let file = tempfile::NamedTempFile::new().expect("a temporary file");
    let bytes: Vec<u8> = counts
        .as_flattened()
        .as_flattened()
        .iter()
        .flat_map(|n| n.to_le_bytes())
        .collect();
    fs::write(file.path(), bytes).expect("the counts are written");
    let mut beside: BTreeMap<String, Vec<(String, f64)>> = BTreeMap::new();
    for line in python("information_yardsticks.py", Some(file.path()))
        .into_iter()
        .flatten()
    {
        let [figure, yardstick, time] = &line[..] else {
            panic!("not three fields: {line:?}")
        };
        beside
            .entry(figure.clone())
            .or_default()
            .push((yardstick.clone(), time.parse().expect("nanoseconds")));
    }
    beside
}
