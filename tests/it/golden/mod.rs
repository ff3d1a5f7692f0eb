//! Figures, forces and networks against high-precision references and other tools' answers;
//! `tests/golden/SOURCE.md` says where each value came from.

mod estimators;
mod lagged;
mod networks;
mod pooled;
mod significance;
mod social_force;
mod tables;

use nudge::information::{Alphabet, Table};
use serde_json::Value;

/// The target for every figure, absolute, in nats.
const TARGET: f64 = 1e-12;

/// Returns the golden tables, each as it stands in the file and as counts.
fn tables() -> impl Iterator<Item = (Value, Table)> {
    let file: Value = serde_json::from_str(include_str!("../../golden/mi_tables.json"))
        .expect("the golden file is JSON");
    list(&file["tables"]).clone().into_iter().map(|golden| {
        let rows = (0..).zip(list(&golden["counts"]));
        let cells = rows.flat_map(|(i, row)| {
            (0..)
                .zip(list(row))
                .map(move |(j, n)| (i, j, n.as_u64().expect("a count")))
        });
        let table = Table::from_counts(cells);
        (golden, table)
    })
}

/// Returns the alphabet that the shape of a golden table stands for.
fn alphabet(golden: &Value) -> Alphabet {
    let size = |axis: usize| golden["shape"][axis].as_u64().expect("a size");
    Alphabet {
        rows: size(0),
        columns: size(1),
    }
}

fn with_reference() -> impl Iterator<Item = (Value, Table)> {
    tables().filter(|(golden, _)| golden["N"] != 0)
}

/// Returns what other tools answered under a key, as far as they did.
fn answers(golden: &Value, key: &str) -> Vec<f64> {
    let answers = golden["peers"][key].as_array().into_iter().flatten();
    answers
        .filter_map(|answer| answer["value"].as_f64())
        .collect()
}

fn list(value: &Value) -> &Vec<Value> {
    value.as_array().expect("a list in the golden file")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number in the golden file")
}

fn close(golden: &Value, value: f64, reference: f64, tolerance: f64) {
    let id = &golden["id"];
    assert!(
        (value - reference).abs() <= tolerance,
        "{id}: {value:e} instead of {reference:e}"
    );
}

fn relatively_close(value: f64, reference: f64) {
    assert!(
        (value / reference - 1.0).abs() <= TARGET,
        "{value:e} instead of {reference:e}"
    );
}
