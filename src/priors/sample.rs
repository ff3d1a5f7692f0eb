//! Subsampling by hash: which states a fit is made from, where there are very many.

use crate::domain::StateKey;

/// The most tables that a fit is made from, one a state and one for each of its parts by segment:
/// what it finds has some sixty numbers. Of more, a part of the states is taken by their keys.
const MOST_TABLES: usize = 50_000;

/// So few states all stay, however many tables they have.
const FEWEST_STATES: usize = 100;

/// A sample of states, thinned by half whenever they become too many: which ones stay depends on
/// the hash of their keys alone, so that the order of adding does not matter.
pub struct Sample<T> {
    halvings: u32,
    tables: usize,
    /// Each state with what is kept of it and the number of its tables, in the order of adding.
    states: Vec<(StateKey, T, usize)>,
}

impl<T> Default for Sample<T> {
    fn default() -> Self {
        Self {
            halvings: 0,
            tables: 0,
            states: Vec::new(),
        }
    }
}

impl<T> Sample<T> {
    /// Adds a state of so many tables, if its turn has not passed.
    pub fn add(&mut self, key: StateKey, kept: T, tables: usize) {
        if !self.wants(&key) {
            return;
        }
        self.states.push((key, kept, tables));
        self.tables += tables;

        while self.tables > MOST_TABLES && self.states.len() > FEWEST_STATES {
            self.halvings += 1;
            let states = std::mem::take(&mut self.states);
            self.states = states
                .into_iter()
                .filter(|(key, ..)| self.wants(key))
                .collect();
            self.tables = self.states.iter().map(|(.., tables)| tables).sum();
        }
    }

    /// Returns the states that stayed, in order of key.
    pub fn sorted(mut self) -> Vec<(StateKey, T)> {
        self.states.sort_unstable_by(|a, b| a.0.cmp(&b.0));
        self.states
            .into_iter()
            .map(|(key, kept, _)| (key, kept))
            .collect()
    }

    /// Returns whether it is the turn of a state.
    pub fn wants(&self, key: &StateKey) -> bool {
        key.seed().trailing_zeros() >= self.halvings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(order: impl Iterator<Item = u32>) -> Vec<StateKey> {
        let mut sample = Sample::default();
        order.for_each(|bin| sample.add(StateKey::new(&[bin]), (), 1));
        sample.sorted().into_iter().map(|(key, ())| key).collect()
    }

    #[test]
    fn which_states_stay_does_not_depend_on_their_order() {
        const MANY: u32 = 3 * MOST_TABLES as u32;
        let kept = sampled(0..MANY);
        assert!(
            (MOST_TABLES / 3..=MOST_TABLES).contains(&kept.len()),
            "{}",
            kept.len()
        );
        assert_eq!(kept, sampled((0..MANY).rev()));
    }

    #[test]
    fn few_states_all_stay() {
        assert_eq!(sampled(0..100).len(), 100);
    }

    #[test]
    fn parts_count_as_tables() {
        let mut sample = Sample::default();
        (0..1_000).for_each(|bin| sample.add(StateKey::new(&[bin]), (), 1 + 300));
        let kept = sample.sorted().len();
        assert!((50..=MOST_TABLES / 301).contains(&kept), "{kept}");
        let mut few = Sample::default();
        (0..90).for_each(|bin| few.add(StateKey::new(&[bin]), (), MOST_TABLES));
        assert_eq!(few.sorted().len(), 90);
    }
}
