//! Mutual information under a uniform policy (an interventional estimate): as it would be without
//! the ego's habits.

use crate::information::table::{Occupied, Table};

/// Rows with fewer visits are left out: their responses are not known well enough to stand for a
/// whole action.
const FEWEST: u64 = 3;

/// Returns the mutual information there would be if the ego chose uniformly among its actions with
/// at least three visits, in nats (the convention of Seitzer, Schoelkopf & Martius 2021, "Causal
/// influence detection for improving efficiency in reinforcement learning").
///
/// (1/m) sum_i sum_j p(j | i) ln(p(j | i) / q_j)
///
/// over those m rows, p(j | i) = n_ij / r_i, q = their unweighted mean.
///
/// In words: mutual information depends on the ego's habit (a robot that always turns left shows
/// none, whatever its power over the other); this figure does not. It weighs an action seen three
/// times like one seen a thousand times, and so is more biased upwards than the plug-in where some
/// actions are rare.
///
/// Never negative; 0 at N = 0 and with fewer than two such rows.
pub fn uniform_policy(table: &Table) -> f64 {
    let well_seen = |cells: &&[Occupied]| table.rows()[cells[0].row as usize] >= FEWEST;
    let rows: Vec<&[Occupied]> = table
        .cells()
        .chunk_by(|a, b| a.row == b.row)
        .filter(well_seen)
        .collect();

    let response = |cell: &Occupied| cell.n as f64 / table.rows()[cell.row as usize] as f64;
    let mut sums = vec![0.0; table.columns().len()];
    for cell in rows.iter().copied().flatten() {
        sums[cell.column as usize] += response(cell);
    }

    let count = rows.len() as f64;
    let divergence = |cell: &Occupied| {
        response(cell) * (response(cell) * count / sums[cell.column as usize]).ln()
    };
    let sum: f64 = rows.iter().copied().flatten().map(divergence).sum();

    if rows.is_empty() {
        0.0
    } else {
        (sum / count).max(0.0)
    }
}
