//! Discretisation of many records at once: the ranks of their states and their joint actions, as
//! numbers in mixed radix, the first feature most significant.
//!
//! Feature after feature and not record after record, so that the same few instructions run over
//! all of them (SIMD, as the compiler finds it).

use super::feature::MISFIT;
use super::{FeatureKind, Schema, Values};

/// One number a record; none where a value of it has no bin.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Numbers([u64; Numbers::LANES]);

/// No rank and no joint action: those are below 2^62.
const NONE: u64 = u64::MAX;

impl Numbers {
    /// How many records are discretised together.
    pub const LANES: usize = 64;

    /// Returns the number of a record.
    #[inline]
    pub fn get(&self, lane: usize) -> Option<u64> {
        Some(self.0[lane]).filter(|number| *number != NONE)
    }

    /// Discretises the records from one on, as many as there are. All their numbers together must
    /// be below 2^63.
    fn of<'k>(
        kinds: impl ExactSizeIterator<Item = &'k FeatureKind>,
        values: &Values,
        first: usize,
    ) -> Self {
        let width = kinds.len();
        let rest = values.len().saturating_sub(first * width);
        let lanes = Self::LANES.min(rest.checked_div(width).unwrap_or(0));

        let (mut numbers, mut fits) = ([0u64; Self::LANES], [true; Self::LANES]);
        for (feature, kind) in kinds.enumerate() {
            let mut column = [0.0; Self::LANES];
            let block = values.at(first * width, lanes * width);
            for (slot, value) in column.iter_mut().zip(block.skip(feature).step_by(width)) {
                *slot = value;
            }

            let (radix, bins) = (u64::from(kind.bins()), kind.bins_of(&column));
            for lane in 0..Self::LANES {
                fits[lane] &= bins[lane] != MISFIT;
                // A misfit may pass 2^64; it has no number anyway.
                numbers[lane] = numbers[lane]
                    .wrapping_mul(radix)
                    .wrapping_add(u64::from(bins[lane]));
            }
        }

        for lane in 0..Self::LANES {
            numbers[lane] = if fits[lane] { numbers[lane] } else { NONE };
        }
        Self(numbers)
    }
}

impl Schema {
    /// Returns the ranks of the states of [`Numbers::LANES`] records from one on. Only where the
    /// schema [is ranked](Schema::is_ranked).
    pub fn ranks_at(&self, states: &Values, first: usize) -> Numbers {
        Numbers::of(
            self.state().iter().map(|feature| &feature.kind),
            states,
            first,
        )
    }

    /// Returns the joint actions of [`Numbers::LANES`] records from one on.
    pub fn joint_actions_at(&self, actions: &Values, first: usize) -> Numbers {
        Numbers::of(self.action_kinds().iter(), actions, first)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

    fn kinds() -> Vec<KindDraft> {
        let edges = |count: i32| (0..count).map(|edge| f64::from(edge) - 2.5).collect();
        vec![
            KindDraft::Continuous(edges(3)),
            KindDraft::Continuous(edges(16)),
            KindDraft::Continuous(edges(17)),
            KindDraft::Continuous(vec![0.5]),
            KindDraft::Circular(8, None),
            KindDraft::Integer(-3, 4),
            KindDraft::Integer(2, 2),
            KindDraft::Categorical(["a", "b", "c"].map(String::from).to_vec()),
        ]
    }

    fn schema() -> Schema {
        let features = || {
            let feature = |(at, kind)| FeatureDraft {
                name: format!("f{at}"),
                unit: None,
                kinds: vec![kind],
            };
            kinds().into_iter().enumerate().map(feature)
        };
        let agent = |name: &str, features: Vec<FeatureDraft>| AgentDraft {
            name: name.into(),
            action: features,
        };
        let draft = SchemaDraft {
            state: features().collect(),
            agents: vec![
                agent("one", features().take(4).collect()),
                agent("two", features().skip(4).collect()),
            ],
        };
        Schema::try_from(&draft).expect("valid")
    }

    /// Values that mostly fit, those beside an edge, and those that never do.
    fn value() -> impl Strategy<Value = f32> {
        prop_oneof![
            12 => (-3i8..5).prop_map(f32::from),
            4 => (-6i8..12).prop_map(|half| f32::from(half) / 2.0),
            1 => any::<f32>(),
            1 => Just(f32::NAN),
            1 => Just(f32::INFINITY),
            1 => Just(-0.0),
        ]
    }

    proptest! {
        #[test]
        fn many_records_are_discretised_as_one_is(values in proptest::collection::vec(value(), 0..200 * 8)) {
            let schema = schema();
            let width = schema.state().len();
            let records = values.len() / width;
            let column = Values::from(values[..records * width].to_vec());

            for index in 0..records {
                let (first, lane) = (index - index % Numbers::LANES, index % Numbers::LANES);
                let record: Vec<f32> = column.at(index * width, width).collect();
                let rank = schema.key_of_values(&record).ok().map(|key| schema.rank(&key));
                prop_assert_eq!(schema.ranks_at(&column, first).get(lane), rank);
                let joint = schema.joint_action(&record);
                prop_assert_eq!(schema.joint_actions_at(&column, first).get(lane), joint);
            }
        }

        #[test]
        fn whole_numbers_of_a_wide_range_keep_every_digit(numbers in proptest::collection::vec(-(1i32 << 24)..=1 << 24, 1..70)) {
            let kind = FeatureKind::Integer(-(1 << 24), 1 << 24);
            let values = Values::from(numbers.iter().map(|number| *number as f32).collect::<Vec<_>>());
            for first in (0..numbers.len()).step_by(Numbers::LANES) {
                let found = Numbers::of([&kind].into_iter(), &values, first);
                for (lane, number) in numbers[first..].iter().take(Numbers::LANES).enumerate() {
                    prop_assert_eq!(found.get(lane), Some((number + (1 << 24)) as u64));
                }
            }
        }
    }
}
