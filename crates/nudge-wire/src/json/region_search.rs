//! Searches for the regions in which influence lives.

use nudge_core::domain::draft::{PairDraft, RegionSearchDraft};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::decode::or_default;
use super::whole::perhaps_whole;
use super::{Labels, Region, words};
use crate::proto;

/// A question for the regions in which a pair depends.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of ego, other, lag, region, most and more"
)]
pub struct RegionSearchQuestion {
    /// The agent whose influence is asked about; absent for the first.
    #[schema(example = "robot")]
    pub ego: Option<String>,
    /// The agent that may be influenced; absent for the second. Or an outcome with values.
    #[schema(example = "human")]
    pub other: Option<String>,
    /// How many steps later the other's action is observed, one of the lags that are declared for
    /// it; 0, or absent, for the same tick. The other's own action one step before, as far as that is
    /// declared, is held fixed too. An outcome with values has a lag of its own.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(minimum = 0, maximum = 64, example = 3)]
    pub lag: Option<i64>,
    /// Agents whose actions are held fixed.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub given: Vec<String>,
    /// The segments to count; all if empty.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub segments: Vec<String>,
    /// Whether actions are compared within each segment alone, and segments dealt into halves: `auto`
    /// (the default) and `segments` say yes, `pooled` no.
    #[schema(example = "auto", value_type = Option<words::Within>)]
    pub within: Option<String>,
    /// The unit of the figures, `nats` or `bits`; absent for the rule's.
    #[schema(value_type = Option<words::Unit>)]
    pub unit: Option<String>,
    /// The states that are searched: what some of their features, or of the derived ones, may be. All
    /// states if absent or empty.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable, value_type = Object, example = json!({"held": ["onion", "dish"], "distance": {"from": 1, "below": 3}}))]
    pub region: Region,
    /// The most regions that are tested, 1 to 10; 10 if absent or 0.
    #[serde(default, deserialize_with = "perhaps_whole")]
    #[schema(minimum = 0, maximum = 10, example = 3)]
    pub most: Option<u64>,
    /// The share of false ones among the regions told that is accepted on average, above 0 and below
    /// 1; .05 if absent.
    #[schema(example = 0.05)]
    pub fdr: Option<f64>,
}

/// The regions in which a pair depends, as far as they could be told.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RegionSearch {
    /// Whose influence on whom: names alone, as nothing here has an index of the other's.
    pub labels: Labels,
    /// How many steps later the other is observed; 0 for the same tick.
    pub lag: u32,
    /// Whether the other is observed later than the ego.
    pub directed: bool,
    /// The states that were searched, in canonical form.
    #[schema(value_type = Object)]
    pub region: Region,
    /// The same in words.
    #[schema(example = "everywhere")]
    pub region_in_words: String,
    /// The unit of the figures, `nats` or `bits`.
    #[schema(value_type = words::Unit)]
    pub unit: String,
    /// The false discovery rate at which regions are told.
    #[schema(example = 0.05)]
    pub fdr: f64,
    /// What was dealt into halves: `segments`, or `strata` where there are fewer than two of them or
    /// they are pooled.
    #[schema(example = "segments")]
    pub dealt: String,
    /// How many segments are in the half that was searched; 0 where strata were dealt.
    pub segments_searched: u32,
    /// How many are in the half that tests; 0 where strata were dealt.
    pub segments_tested: u32,
    /// Those that passed, in the order in which they were found. The states of each are without those
    /// of the regions before it, tested or not.
    pub regions: Vec<FoundRegion>,
    /// How many regions were tested.
    pub tested: u32,
    /// How many rules the first of them was chosen from.
    pub rules: u64,
    /// Features that rules of several conditions were not looked for with, since those would have been
    /// too many.
    pub left_out: Vec<String>,
    /// The revision this was made from: how many transitions the environment had.
    pub as_of: u64,
}

/// A region in which a pair depends. Its figures are of the half that tests: in the other it was
/// chosen because it looks strong there.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FoundRegion {
    /// The region in its canonical form.
    #[schema(value_type = Object)]
    pub region: Region,
    /// The same in words.
    #[schema(example = "distance 1 to 2, held onion")]
    pub region_in_words: String,
    /// What was counted as independent draws in the half that was searched: entries where they are
    /// known, else visits.
    pub draws_searched: u64,
    /// By how many standard deviations the excess exceeds independence there. No evidence: it was
    /// looked for.
    pub z_searched: f64,
    /// Draws in the half that tests.
    pub draws: u64,
    /// States with draws in it.
    pub states: u64,
    /// Strata with draws in it.
    pub strata: u64,
    /// By how many standard deviations the excess exceeds independence in it.
    pub z: f64,
    /// How probable at least as large an excess is under independence.
    #[schema(minimum = 0, maximum = 1)]
    pub p_value: f64,
    /// The smallest false discovery rate at which the region passes, of all that were tested.
    #[schema(minimum = 0, maximum = 1)]
    pub q_value: f64,
    /// The same as `p_value` of a test that looks for one pattern shared by all states; absent where
    /// none could be seen. Where actions are held, or some are rare, it finds too much.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub p_value_same_pattern: Option<f64>,
    /// Plug-in mutual information less its mean under independence. It may be negative, and is no
    /// measure of strength. In the answer's unit.
    pub excess: f64,
    /// Half of Pearson's phi-squared behind the counts, which is the mutual information where that is
    /// weak; may be negative. In the answer's unit.
    pub size: f64,
    /// Where it lies on these segments, with a probability of 95 %. In the answer's unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval: Option<[f64; 2]>,
    /// Where it lies on new segments like these, with a probability of 95 %; absent below three
    /// segments. In the answer's unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval_new_segments: Option<[f64; 2]>,
    /// The share of draws that `size` stands on: below .5 it is a lower bound, above .8 it is
    /// somewhat too large.
    #[schema(minimum = 0, maximum = 1)]
    pub share: f64,
}

impl From<RegionSearchQuestion> for RegionSearchDraft {
    fn from(question: RegionSearchQuestion) -> Self {
        let pair = PairDraft {
            ego: question.ego,
            other: question.other,
            lag: question.lag.unwrap_or(0),
            given: question.given,
            segments: question.segments,
            within: question.within,
            unit: question.unit,
            ..PairDraft::default()
        };
        let Region(region) = question.region;
        Self {
            pair,
            region,
            most: question.most.unwrap_or(0),
            fdr: question.fdr,
        }
    }
}

impl From<proto::FindRegionsResponse> for RegionSearch {
    fn from(search: proto::FindRegionsResponse) -> Self {
        Self {
            labels: search.labels.map(Into::into).unwrap_or_default(),
            lag: search.lag,
            directed: search.directed,
            region: Region(search.region.unwrap_or_default().into()),
            region_in_words: search.region_in_words,
            unit: search.unit,
            fdr: search.fdr,
            dealt: search.dealt,
            segments_searched: search.segments_searched,
            segments_tested: search.segments_tested,
            regions: search.regions.into_iter().map(Into::into).collect(),
            tested: search.tested,
            rules: search.rules,
            left_out: search.left_out,
            as_of: search.as_of,
        }
    }
}

impl From<proto::FoundRegion> for FoundRegion {
    fn from(found: proto::FoundRegion) -> Self {
        let ends = |range: proto::Range| [range.lower, range.upper];
        Self {
            region: Region(found.region.unwrap_or_default().into()),
            region_in_words: found.region_in_words,
            draws_searched: found.draws_searched,
            z_searched: found.z_searched,
            draws: found.draws,
            states: found.states,
            strata: found.strata,
            z: found.z,
            p_value: found.p_value,
            q_value: found.q_value,
            p_value_same_pattern: found.p_value_same_pattern,
            excess: found.excess,
            size: found.size,
            size_interval: found.size_interval.map(ends),
            size_interval_new_segments: found.size_interval_new_segments.map(ends),
            share: found.share,
        }
    }
}
