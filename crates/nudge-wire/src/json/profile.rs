//! Lag profiles: pooled evidence over the states of a region.

use nudge_core::domain::draft::{PairDraft, ProfileDraft};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::decode::or_default;
use super::whole::wholes_if_any;
use super::{Labels, Region, words};
use crate::proto;

/// A question for what all states of a region say together, by lag.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, ToSchema)]
#[serde(
    deny_unknown_fields,
    expecting = "an object of ego, other, region, lags and more"
)]
pub struct ProfileQuestion {
    /// The agent whose influence is asked about; absent for the first.
    #[schema(example = "robot")]
    pub ego: Option<String>,
    /// The agent that may be influenced; absent for the second. Or an outcome with values.
    #[schema(example = "human")]
    pub other: Option<String>,
    /// Agents whose actions are held fixed.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub given: Vec<String>,
    /// The segments to count; all if empty.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable)]
    pub segments: Vec<String>,
    /// Whether actions are compared within each segment alone: `auto` (the default) and `segments`
    /// say yes, `pooled` no.
    #[schema(example = "auto", value_type = Option<words::Within>)]
    pub within: Option<String>,
    /// The unit of the figures, `nats` or `bits`; absent for the rule's.
    #[schema(value_type = Option<words::Unit>)]
    pub unit: Option<String>,
    /// The states that are asked about: what some of their features, or of the derived ones, may be.
    /// All states if absent or empty.
    #[serde(default, deserialize_with = "or_default")]
    #[schema(nullable, value_type = Object, example = json!({"held": ["onion", "dish"], "distance": {"from": 1, "below": 3}}))]
    pub region: Region,
    /// The lags, 0 and those that are declared for the other; all of these if empty.
    #[serde(default, deserialize_with = "wholes_if_any")]
    #[schema(nullable, value_type = Vec<i64>, example = json!([0, 1, 2]))]
    pub lags: Vec<i64>,
}

/// What all states of a region say together, by lag.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Profile {
    /// Whose influence on whom: names alone, as nothing here has an index of the other's.
    pub labels: Labels,
    /// The region in its canonical form.
    #[schema(value_type = Object)]
    pub region: Region,
    /// The same in words.
    #[schema(example = "distance 1 to 2, held onion or dish")]
    pub region_in_words: String,
    /// The unit of the figures, `nats` or `bits`.
    #[schema(value_type = words::Unit)]
    pub unit: String,
    /// A point a lag, lags rising.
    pub profile: Vec<ProfilePoint>,
    /// The lag of the largest excess, of those whose p-value is at most .05 divided by the number of
    /// lags; null where there is none.
    pub peak: Option<u32>,
    /// The revision this was made from: how many transitions the environment had.
    pub as_of: u64,
}

/// What all states of a region say together at one lag. Strata are a state's, a segment's, and those
/// of the actions held fixed: actions are compared within them alone. Figures are of entries in
/// states where every transition carried the flag.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ProfilePoint {
    /// How many steps later the other is observed; 0 for the same tick.
    pub lag: u32,
    /// Whether the other is observed later than the ego.
    pub directed: bool,
    /// Visits that tell of the pair.
    pub visits: u64,
    /// Entries of these; absent unless every transition carried the flag.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entries: Option<u64>,
    /// What was counted as independent draws: entries where they are known, else visits.
    pub draws: u64,
    /// States with draws.
    pub states: u64,
    /// Strata with draws.
    pub strata: u64,
    /// Plug-in mutual information within the strata: their mean by draws. In the profile's unit.
    #[schema(minimum = 0)]
    pub plug_in: f64,
    /// Its mean under independence within them, exact. In the profile's unit.
    pub expected_if_independent: f64,
    /// `plug_in` less that: what a profile shows. It may be negative, and is no measure of strength.
    /// In the profile's unit.
    pub excess: f64,
    /// Where it lies with a probability of about 95 % under independence: lower and upper end. In the
    /// profile's unit.
    pub null: [f64; 2],
    /// How probable at least as large an excess is under independence.
    #[schema(minimum = 0, maximum = 1)]
    pub p_value: f64,
    /// The same of a test that looks for one pattern shared by all states; absent where none could be
    /// seen. Where actions are held, or some are rare, it finds too much.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1)]
    pub p_value_same_pattern: Option<f64>,
    /// Half of Pearson's phi-squared behind the counts, which is the mutual information where that is
    /// weak; may be negative. In the profile's unit.
    pub size: f64,
    /// Where it lies on these segments, with a probability of 95 %. In the profile's unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval: Option<[f64; 2]>,
    /// Where it lies on new segments like these, with a probability of 95 %; absent below three
    /// segments. In the profile's unit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub size_interval_new_segments: Option<[f64; 2]>,
    /// The share of draws that `size` stands on: below .5 it is a lower bound, above .8 it is
    /// somewhat too large.
    #[schema(minimum = 0, maximum = 1)]
    pub share: f64,
}

impl From<ProfileQuestion> for ProfileDraft {
    fn from(question: ProfileQuestion) -> Self {
        let pair = PairDraft {
            ego: question.ego,
            other: question.other,
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
            lags: question.lags,
        }
    }
}

impl From<proto::GetProfileResponse> for Profile {
    fn from(profile: proto::GetProfileResponse) -> Self {
        Self {
            labels: profile.labels.map(Into::into).unwrap_or_default(),
            region: Region(profile.region.unwrap_or_default().into()),
            region_in_words: profile.region_in_words,
            unit: profile.unit,
            profile: profile.profile.into_iter().map(Into::into).collect(),
            peak: profile.peak,
            as_of: profile.as_of,
        }
    }
}

/// Decodes the two ends of a range.
pub(super) fn ends(range: proto::Range) -> [f64; 2] {
    [range.lower, range.upper]
}

impl From<proto::ProfilePoint> for ProfilePoint {
    fn from(point: proto::ProfilePoint) -> Self {
        Self {
            lag: point.lag,
            directed: point.directed,
            visits: point.visits,
            entries: point.entries,
            draws: point.draws,
            states: point.states,
            strata: point.strata,
            plug_in: point.plug_in,
            expected_if_independent: point.expected_if_independent,
            excess: point.excess,
            null: ends(point.null.unwrap_or_default()),
            p_value: point.p_value,
            p_value_same_pattern: point.p_value_same_pattern,
            size: point.size,
            size_interval: point.size_interval.map(ends),
            size_interval_new_segments: point.size_interval_new_segments.map(ends),
            share: point.share,
        }
    }
}
