//! What the reader of a region's figures should know before believing them.

use super::stratified::written_p_value;
use crate::domain::Within;
use crate::information::pooled::Pooled;

/// The largest p-value of a test that finds dependence, and above what a test finds none.
const FOUND: f64 = 0.01;
const MISSED: f64 = 0.1;

/// The share of draws that the size stands on below which it is a lower bound.
const LITTLE: f64 = 0.5;

/// Returns a sentence for each thing to know of what strata show, of so many segments; they may have
/// been merged by leaving out features.
pub fn warnings(
    within: Within,
    segments: u64,
    pooled: &Pooled,
    stratified: Option<(Vec<String>, &Pooled)>,
) -> Vec<String> {
    let merged =
        stratified.and_then(|(left_out, stratified)| disagreement(pooled, &left_out, stratified));
    let told = [merged, mixture(within, segments), lower_bound(pooled)];
    told.into_iter().flatten().collect()
}

fn disagreement(merged: &Pooled, left_out: &[String], stratified: &Pooled) -> Option<String> {
    let [of_merged, of_stratified] = [merged, stratified].map(|pooled| pooled.p_value);
    let meaning = if of_merged <= FOUND && of_stratified > MISSED {
        "the cause may be in what was left out"
    } else if of_stratified <= FOUND && of_merged > MISSED {
        "states depend in different ways, which merging hides"
    } else {
        return None;
    };
    let [of_merged, of_stratified] = [of_merged, of_stratified].map(written_p_value);
    let left_out = left_out.join(", ");
    Some(format!(
        "merged over {left_out} p {of_merged}, but stratified by what was left out p \
         {of_stratified}: {meaning}"
    ))
}

fn mixture(within: Within, segments: u64) -> Option<String> {
    let is_mixed = within == Within::Pooled && segments > 1;
    is_mixed.then(|| {
        format!(
            "{segments} segments are pooled: where habits differ by segment, that alone looks like \
             dependence"
        )
    })
}

fn lower_bound(pooled: &Pooled) -> Option<String> {
    let is_bound = pooled.size_interval.is_some() && pooled.share < LITTLE;
    is_bound.then(|| {
        format!(
            "the size is a lower bound: strata are so small that it stands on {:.0} % of their draws",
            100.0 * pooled.share
        )
    })
}
