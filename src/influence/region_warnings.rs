//! What the reader of a region's figures should know before believing them.

use super::stratified::written_p_value;
use crate::information::pooled::Pooled;

/// The largest p-value of a test that finds dependence, and above what a test finds none.
const FOUND: f64 = 0.01;
const MISSED: f64 = 0.1;

/// The share of draws that the size stands on below which it is a lower bound.
const LITTLE: f64 = 0.5;

/// Returns a sentence for each thing to know of what strata show, which may have been merged by
/// leaving out features.
pub fn warnings(pooled: &Pooled, stratified: Option<(Vec<String>, &Pooled)>) -> Vec<String> {
    let cause =
        stratified.and_then(|(left_out, stratified)| common_cause(pooled, &left_out, stratified));
    cause.into_iter().chain(lower_bound(pooled)).collect()
}

fn common_cause(merged: &Pooled, left_out: &[String], stratified: &Pooled) -> Option<String> {
    let is_gone = merged.p_value <= FOUND && stratified.p_value > MISSED;
    is_gone.then(|| {
        format!(
            "merged over {} there is dependence (p {}), stratified by it there is none (p {}): \
             the cause may be in what was left out",
            left_out.join(", "),
            written_p_value(merged.p_value),
            written_p_value(stratified.p_value)
        )
    })
}

fn lower_bound(pooled: &Pooled) -> Option<String> {
    let is_bound = pooled.visits > 0 && pooled.share < LITTLE;
    is_bound.then(|| {
        format!(
            "the size is a lower bound: strata are so small that it stands on {:.0} % of their draws",
            100.0 * pooled.share
        )
    })
}
