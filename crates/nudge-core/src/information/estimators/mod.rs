//! Estimators of mutual information by corrected, shrunk and Bayesian entropies: on request, beside
//! the plug-in and the verdict. Not what a verdict rests on: none of them knows that most states
//! have no influence at all.
//!
//! All but [`adjusted`] return nats; all are finite on every table and 0 where nothing was seen.
//! Which to ask for:
//!
//! | estimator | adds to the plug-in | mind |
//! |---|---|---|
//! | [`chao_shen`] | what singletons say about cells not seen | may be negative; noisy below some 50 visits |
//! | [`james_stein`] | a pull of the whole table towards uniform | pulls influence towards 0 |
//! | [`grassberger_2003`] | a correction for each count | may be negative; not 0 with one row |
//! | [`nsb`] | a prior under which every entropy is as likely | may be negative; slow; the best of these at few visits |
//! | [`dirichlet`] | one visit, spread evenly over the alphabet | above 0 even where the actions are independent |
//! | [`adjusted`] | chance agreement taken out, in units of the entropies | a share, not nats; may be negative |
//! | [`uniform_policy`] | the ego's habits taken out | biased upwards like the plug-in |

mod adjusted;
mod chao_shen;
mod dirichlet;
mod grassberger;
mod james_stein;
mod nsb;
#[cfg(test)]
mod tests;
mod uniform_policy;

pub use adjusted::adjusted;
pub use chao_shen::chao_shen;
pub use dirichlet::dirichlet;
pub use grassberger::grassberger_2003;
pub use james_stein::james_stein;
pub use nsb::nsb;
pub use uniform_policy::uniform_policy;

use super::counts_of_counts::{CountOfCounts, counts_of_counts};
use super::table::Table;

/// Returns what an entropy estimator makes of a mutual information:
/// S(rows) + S(columns) - S(cells).
fn by_entropies(table: &Table, entropy: impl Fn(&[CountOfCounts]) -> f64) -> f64 {
    let [rows, columns, cells] = margins_and_cells(table);
    entropy(&rows) + entropy(&columns) - entropy(&cells)
}

/// Returns the row sums, the column sums and the cells of a table, equal counts together.
fn margins_and_cells(table: &Table) -> [Vec<CountOfCounts>; 3] {
    let sums = |sums: &[u64]| counts_of_counts(sums.iter().copied());
    [
        sums(table.rows()),
        sums(table.columns()),
        counts_of_counts(table.cells().iter().map(|cell| cell.n)),
    ]
}
