//! Hard worlds: what the default rule makes of states that the evidence was not built on.
//!
//! Other alphabets (2 x 2 to 64 x 64), other habits, other kinds and strengths of dependence, other
//! volumes (once to a million times a state). Only the default rule is asked: what it says of
//! mutual information and of any dependence, and its verdicts.

mod options;
mod plot;
mod report;
mod targets;

pub use options::{METHOD, Options, name, named, worlds};
pub use plot::plot;
pub use report::Report;

use super::{Figure, measured};
use crate::error::Problem;

/// Runs the experiment; `done` is called after each world of each seed.
pub async fn run(options: &Options, done: impl FnMut()) -> Result<Report, Problem> {
    let findings = measured(
        &options.worlds(),
        options.seeds,
        |_| &[METHOD],
        &Figure::HARD,
        done,
    )
    .await?;
    Ok(Report {
        options: options.clone(),
        findings,
    })
}
