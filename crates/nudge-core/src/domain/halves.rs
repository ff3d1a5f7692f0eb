//! Sample splitting: the counts of an environment in two halves, one to search and one to test what
//! was found. Which is which follows from names alone, and not from what was counted.

use std::collections::BTreeSet;

use super::{Label, SegmentId, StateKey, Within};

/// What is hashed before each name, so that another choice by hashes is another choice.
const SEED: &[u8] = b"nudge.halves.v1";

/// One of two halves of the counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Half {
    /// Rules are looked for in it.
    Search,
    /// They are tested on it.
    Test,
}

/// How counts are dealt into two halves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Halves {
    /// Whole segments, each to one half: what holds in others too was not made of one segment's
    /// habits.
    Segments {
        /// The segments of the half to search.
        search: BTreeSet<SegmentId>,
        /// How many are in the other.
        test: usize,
    },
    /// Strata, each a state given the actions held fixed: where there are fewer than two segments,
    /// or segments are pooled. Strata are independent of each other where nothing depends on
    /// anything, so that the test stays honest; it cannot tell whether other segments are alike.
    Strata,
}

impl Halves {
    /// Deals the segments of a question, whose labels are `None` for transitions without one: in
    /// the order of a hash of their labels, every other one to the half to search.
    pub fn deal(segments: &[(SegmentId, Option<Label>)], within: Within) -> Self {
        if segments.len() < 2 || within == Within::Pooled {
            return Self::Strata;
        }
        let mut hashed: Vec<(u64, SegmentId)> = segments
            .iter()
            .map(|(id, label)| {
                let label = label.as_ref().map_or("", Label::as_str);
                (hash(&[label.as_bytes()]), *id)
            })
            .collect();
        hashed.sort_unstable();
        let search: BTreeSet<SegmentId> = hashed.iter().step_by(2).map(|(_, id)| *id).collect();
        let test = segments.len() - search.len();
        Self::Segments { search, test }
    }

    /// Returns the half of what was counted in a segment, in a state, where agents that are held
    /// fixed act so.
    pub fn of(&self, key: &StateKey, given: u64, segment: SegmentId) -> Half {
        let is_searched = match self {
            Self::Segments { search, .. } => search.contains(&segment),
            Self::Strata => {
                hash(&[&key.seed().to_le_bytes(), &given.to_le_bytes()]).is_multiple_of(2)
            }
        };
        if is_searched {
            Half::Search
        } else {
            Half::Test
        }
    }

    /// Returns the word on the wire for what is dealt: `segments` or `strata`.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::Segments { .. } => "segments",
            Self::Strata => "strata",
        }
    }

    /// Returns how many segments are in the half to search and in the other; 0 where strata are
    /// dealt.
    pub fn segments(&self) -> [usize; 2] {
        match self {
            Self::Segments { search, test } => [search.len(), *test],
            Self::Strata => [0, 0],
        }
    }
}

fn hash(parts: &[&[u8]]) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(SEED);
    for part in parts {
        hasher.update(part);
    }
    let [first, ..] = bytemuck::cast::<[u8; 32], [u64; 4]>(*hasher.finalize().as_bytes());
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segments(labels: &[&str]) -> Vec<(SegmentId, Option<Label>)> {
        let label = |label: &&str| label.parse::<Label>().ok();
        (1..).map(SegmentId).zip(labels.iter().map(label)).collect()
    }

    #[test]
    fn segments_are_dealt_by_their_labels_whatever_their_numbers() {
        let labels = ["a", "b", "c", "d", "e", "f", "g"];
        let dealt = Halves::deal(&segments(&labels), Within::Auto);
        assert_eq!(dealt.segments(), [4, 3]);

        let backwards: Vec<&str> = labels.into_iter().rev().collect();
        let again = Halves::deal(&segments(&backwards), Within::Segments);
        let key = StateKey::new(&[3]);
        let half = |dealt: &Halves, segment| dealt.of(&key, 0, SegmentId(segment));
        assert!((1..=7).all(|at| half(&dealt, at) == half(&again, 8 - at)));
    }

    #[test]
    fn strata_are_dealt_where_there_are_no_segments_to_deal() {
        assert_eq!(
            Halves::deal(&segments(&["a"]), Within::Auto),
            Halves::Strata
        );
        let pooled = Halves::deal(&segments(&["a", "b"]), Within::Pooled);
        assert_eq!(pooled, Halves::Strata);

        let searched = |given| {
            let keys = (0..1_000).map(|at| StateKey::new(&[at, 7]));
            let halves = keys.map(|key| pooled.of(&key, given, SegmentId(1)));
            halves.collect::<Vec<Half>>()
        };
        let [one, other] = [0, 1].map(searched);
        let half = |halves: &[Half]| halves.iter().filter(|half| **half == Half::Search).count();
        assert!((450..550).contains(&half(&one)) && (450..550).contains(&half(&other)));
        assert_ne!(one, other);
    }
}
