//! Searches for the regions in which influence lives.

use nudge_core::domain::draft::RegionSearchDraft;
use nudge_core::domain::{FoundRegion, RegionSearch};
use nudge_core::error::Problem;

use super::question::scope;
use crate::proto;

/// Decodes a question for regions, and the environment's name.
pub fn region_search(
    request: proto::FindRegionsRequest,
) -> Result<(String, RegionSearchDraft), Problem> {
    let (environment, pair) = scope(request.scope)?;
    let draft = RegionSearchDraft {
        pair,
        region: request.region.unwrap_or_default().into(),
        most: request.most.into(),
        fdr: request.fdr,
    };
    Ok((environment, draft))
}

impl From<RegionSearch> for proto::FindRegionsResponse {
    fn from(search: RegionSearch) -> Self {
        let [searched, tested] = search.halves.segments();
        let left_out = search.left_out.iter();
        Self {
            labels: Some(search.labels.into()),
            lag: search.lag,
            directed: search.lag > 0,
            region: Some(search.region.draft().into()),
            region_in_words: search.region.to_string(),
            unit: search.unit.as_str().into(),
            fdr: search.fdr,
            dealt: search.halves.as_str().into(),
            segments_searched: searched as u32,
            segments_tested: tested as u32,
            regions: search.regions.into_iter().map(Into::into).collect(),
            tested: search.tested as u32,
            rules: search.looked_at,
            left_out: left_out.map(ToString::to_string).collect(),
            as_of: search.as_of,
        }
    }
}

impl From<FoundRegion> for proto::FoundRegion {
    fn from(found: FoundRegion) -> Self {
        let FoundRegion {
            region,
            searched,
            tested,
            q_value,
        } = found;
        Self {
            region: Some(region.draft().into()),
            region_in_words: region.to_string(),
            draws_searched: searched.visits,
            z_searched: searched.z(),
            draws: tested.visits,
            states: tested.states,
            strata: tested.strata,
            z: tested.z,
            p_value: tested.p_value,
            q_value,
            p_value_same_pattern: tested.same_pattern.map(|test| test.p_value),
            excess: tested.excess,
            size: tested.size,
            size_interval: tested.size_interval.map(Into::into),
            size_interval_new_segments: tested.size_interval_new_segments.map(Into::into),
            share: tested.share,
        }
    }
}
