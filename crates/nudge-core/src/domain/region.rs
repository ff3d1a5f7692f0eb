//! Regions: the states that match a partial description, over features of the state and derived
//! ones. Nothing here asks what was counted in them.

mod conditions;
mod words;
mod written;

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use super::bin_set::BinSet;
use super::draft::RegionDraft;
use super::{Coordinate, Coordinates, StateKey};
use crate::error::{Fault, pointer};

/// The most regions of a question.
pub const MOST_REGIONS: usize = 1_000;

/// The states in which each of some coordinates has one of some bins. Without any condition it is
/// the whole environment. Cloning is cheap.
///
/// In canonical form: conditions in the order of features, then of derived features, each of which
/// leaves a bin out. So two that say the same of each coordinate are equal.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Region(Arc<[Condition]>);

/// The bins that one coordinate may have, at least one.
#[derive(Debug, Clone, PartialEq)]
struct Condition {
    coordinate: Coordinate,
    bins: BinSet,
}

impl Region {
    /// Returns the region that a draft means, or every fault by its pointer, `/distance/from`.
    pub fn checked(draft: &RegionDraft, coordinates: &Coordinates) -> Result<Self, Vec<Fault>> {
        let mut faults = Vec::new();
        let region = Self::read("", draft, coordinates, &mut faults);
        region.ok_or(faults)
    }

    /// Returns the regions of a question, or every fault by its pointer,
    /// `/regions/3/distance/from`.
    pub fn several(
        drafts: &[RegionDraft],
        coordinates: &Coordinates,
    ) -> Result<Vec<Self>, Vec<Fault>> {
        if drafts.len() > MOST_REGIONS {
            let detail = format!(
                "got {} regions, expected at most {MOST_REGIONS}",
                drafts.len()
            );
            return Err(vec![Fault::new("/regions", detail)]);
        }

        let mut faults = Vec::new();
        let read = |(i, draft): (usize, &RegionDraft)| {
            Self::read(&format!("/regions/{i}"), draft, coordinates, &mut faults)
        };
        let regions: Vec<Self> = drafts.iter().enumerate().filter_map(read).collect();
        match faults.is_empty() {
            true => Ok(regions),
            false => Err(faults),
        }
    }

    /// Adds the faults of a draft, each below its place; `None` where there is one.
    fn read(
        place: &str,
        draft: &RegionDraft,
        coordinates: &Coordinates,
        faults: &mut Vec<Fault>,
    ) -> Option<Self> {
        let before = faults.len();
        let mut conditions = Vec::<Condition>::new();
        for (name, draft) in &draft.0 {
            let condition = match coordinates.find(name) {
                Some(found) => Condition::checked(found, draft),
                None => Err(vec![Fault::new(
                    "",
                    coordinates.unknown(name, faults.len()),
                )]),
            };
            match condition {
                Ok(condition) => conditions.push(condition),
                Err(found) => {
                    let place = format!("{place}{}", pointer(name));
                    faults.extend(found.into_iter().map(|fault| fault.under(&place)));
                }
            }
        }

        conditions.sort_by_key(|condition| condition.coordinate.place());
        for two in conditions.windows(2) {
            if two[0].coordinate.place() == two[1].coordinate.place() {
                let place = format!("{place}{}", pointer(two[0].coordinate.name().as_str()));
                faults.push(Fault::new(place, "given twice, expected once"));
            }
        }

        conditions.retain(|condition| !condition.is_free());
        (faults.len() == before).then(|| Self(conditions.into()))
    }

    /// Returns whether a state lies in it. The key must be of its environment.
    #[inline]
    pub fn contains(&self, key: &StateKey) -> bool {
        let mut conditions = self.0.iter();
        conditions.all(|condition| condition.bins.contains(condition.coordinate.bin(key)))
    }

    /// Returns whether it is the whole environment.
    pub fn is_everything(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns those of its states in which some coordinates have one of these bins: from the first to
    /// before the last. At least one bin of each must be left.
    pub fn narrowed<'a>(
        &self,
        conditions: impl IntoIterator<Item = (&'a Coordinate, Range<u32>)>,
    ) -> Self {
        let mut all = self.0.to_vec();
        for (coordinate, bins) in conditions {
            let bins = BinSet::of_runs(vec![bins]);
            match all.iter_mut().find(|one| one.coordinate == *coordinate) {
                Some(condition) => condition.bins = condition.bins.intersection(&bins),
                None => all.push(Condition {
                    coordinate: coordinate.clone(),
                    bins,
                }),
            }
        }
        all.sort_by_key(|condition| condition.coordinate.place());
        all.retain(|condition| !condition.is_free());
        Self(all.into())
    }

    /// Returns its canonical description, of which [`Region::checked`] makes the same region.
    pub fn draft(&self) -> RegionDraft {
        RegionDraft(self.0.iter().map(Condition::draft).collect())
    }
}

impl fmt::Display for Region {
    /// Says in words what must be so: `distance 1 to 2, player_1.held onion or dish`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_everything() {
            return f.write_str("everywhere");
        }
        let words: Vec<String> = self.0.iter().map(Condition::words).collect();
        f.write_str(&words.join(", "))
    }
}

#[cfg(test)]
mod tests;
