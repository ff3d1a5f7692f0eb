//! Ranking of states: mixed-radix numbers in the order of their keys, the first feature most
//! significant.

use super::{Schema, StateKey};

/// The most states that are named by their ranks. Where there are more, those that were seen are
/// listed.
pub const MOST_RANKED: u64 = 1 << 48;

impl Schema {
    /// Returns whether states are named by their ranks.
    pub fn is_ranked(&self) -> bool {
        self.states().is_some_and(|states| states <= MOST_RANKED)
    }

    /// Returns how many states there are; `None` where it is 2^64 or more.
    pub fn states(&self) -> Option<u64> {
        let bins = |states: u64, bins: u32| states.checked_mul(u64::from(bins));
        self.bins().try_fold(1, bins)
    }

    /// Returns the rank of a state: how many come before it in the order of keys. Only where
    /// [`Schema::states`] says how many there are.
    pub fn rank(&self, key: &StateKey) -> u64 {
        let digits = self.bins().zip(key.bins());
        digits.fold(0, |rank, (bins, bin)| {
            rank * u64::from(bins) + u64::from(*bin)
        })
    }

    /// Returns the state of a rank, which is below [`Schema::states`].
    pub fn state_of_rank(&self, mut rank: u64) -> StateKey {
        let mut bins: Vec<u32> = self.bins().collect();
        for bin in bins.iter_mut().rev() {
            let radix = u64::from(*bin);
            *bin = (rank % radix) as u32;
            rank /= radix;
        }
        StateKey::new(&bins)
    }

    /// Returns whether a key has a bin for each feature, and each is one of the feature's.
    pub fn has(&self, key: &StateKey) -> bool {
        let mut bins = self.bins().zip(key.bins());
        key.bins().len() == self.state().len() && bins.all(|(bins, bin)| *bin < bins)
    }

    /// Returns how many bins each feature of the state has.
    fn bins(&self) -> impl DoubleEndedIterator<Item = u32> {
        self.state().iter().map(|feature| feature.kind.bins())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::domain::SchemaDraft;
    use crate::domain::draft::{AgentDraft, FeatureDraft, KindDraft};

    /// Returns a schema of integer features with so many bins each.
    fn schema(bins: &[u32]) -> Schema {
        let feature = |(at, bins): (usize, &u32)| FeatureDraft {
            name: format!("f{at}"),
            unit: None,
            kinds: vec![KindDraft::Integer(0, i64::from(*bins) - 1)],
        };
        let agent = |name: &str| AgentDraft {
            name: name.into(),
            action: vec![FeatureDraft {
                name: format!("{name}-move"),
                ..feature((0, &2))
            }],
            ..AgentDraft::default()
        };
        let draft = SchemaDraft {
            state: bins.iter().enumerate().map(feature).collect(),
            agents: vec![agent("a"), agent("b")],
            ..SchemaDraft::default()
        };
        Schema::try_from(&draft).expect("valid")
    }

    #[test]
    fn the_last_feature_is_least_significant() {
        let schema = schema(&[3, 4, 1]);
        let key = schema.key_of_text("2.1.0").expect("valid");
        assert_eq!((schema.states(), schema.rank(&key)), (Some(12), 9));
        assert_eq!(schema.state_of_rank(9), key);
    }

    #[test]
    fn a_space_that_no_number_holds_has_no_size() {
        assert_eq!(schema(&[1 << 16; 3]).states(), Some(1 << 48));
        assert_eq!(schema(&[1 << 16; 4]).states(), None);
    }

    proptest! {
        #[test]
        fn ranks_are_in_the_order_of_keys(
            bins in proptest::collection::vec(1u32..9, 1..12),
            at in any::<[proptest::sample::Index; 2]>(),
        ) {
            let schema = schema(&bins);
            let states = schema.states().expect("small") as usize;
            let ranks = at.map(|at| at.index(states) as u64);
            let keys = ranks.map(|rank| schema.state_of_rank(rank));
            prop_assert_eq!([&keys[0], &keys[1]].map(|key| schema.rank(key)), ranks);
            prop_assert_eq!(keys[0].cmp(&keys[1]), ranks[0].cmp(&ranks[1]));
        }
    }
}
