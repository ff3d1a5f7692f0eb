//! Lag profiles: pooled evidence over the states of a region.

use nudge_core::domain::draft::ProfileDraft;
use nudge_core::domain::{Profile, ProfilePoint};
use nudge_core::error::Problem;
use nudge_core::information::pooled::Pooled;

use super::question::scope;
use crate::proto;

/// Standard deviations of an excess under independence within which it lies in 95 %.
const BAND: f64 = 1.96;

/// Decodes a question for a profile, and the environment's name.
pub fn profile(request: proto::GetProfileRequest) -> Result<(String, ProfileDraft), Problem> {
    let (environment, pair) = scope(request.scope)?;
    let draft = ProfileDraft {
        pair,
        region: request.region.unwrap_or_default().into(),
        lags: request.lags.into_iter().map(Into::into).collect(),
    };
    Ok((environment, draft))
}

impl From<Profile> for proto::GetProfileResponse {
    fn from(profile: Profile) -> Self {
        let peak = profile.peak();
        Self {
            labels: Some(profile.labels.into()),
            region: Some(profile.region.draft().into()),
            region_in_words: profile.region.to_string(),
            unit: profile.unit.as_str().into(),
            profile: profile.points.into_iter().map(Into::into).collect(),
            peak,
            as_of: profile.as_of,
        }
    }
}

impl From<ProfilePoint> for proto::ProfilePoint {
    fn from(point: ProfilePoint) -> Self {
        let ProfilePoint { lag, tally, pooled } = point;
        Self {
            lag,
            directed: lag > 0,
            visits: tally.n,
            entries: tally.entries,
            draws: pooled.visits,
            states: pooled.states,
            strata: pooled.strata,
            plug_in: pooled.plug_in,
            expected_if_independent: pooled.expected_if_independent,
            excess: pooled.excess,
            null: Some(null_band(&pooled)),
            p_value: pooled.p_value,
            p_value_same_pattern: pooled.same_pattern.map(|test| test.p_value),
            size: pooled.size,
            size_interval: pooled.size_interval.map(Into::into),
            size_interval_new_segments: pooled.size_interval_new_segments.map(Into::into),
            share: pooled.share,
        }
    }
}

/// Encodes where an excess lies under independence.
pub(super) fn null_band(pooled: &Pooled) -> proto::Range {
    let band = BAND * pooled.excess_deviation;
    // Not a negative zero.
    [0.0 - band, band].into()
}

impl From<[f64; 2]> for proto::Range {
    fn from([lower, upper]: [f64; 2]) -> Self {
        Self { lower, upper }
    }
}
