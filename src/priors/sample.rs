//! Which states a fit is made from, where there are very many.

use crate::domain::StateKey;

/// The most states that a fit is made from: what it finds has some forty numbers. Of more, a part is taken by their keys.
const MOST_STATES: usize = 50_000;

/// States, thinned by half whenever they become too many: which ones stay depends on their keys alone.
pub struct Sample<T> {
    halvings: u32,
    /// Each state with what is kept of it, in the order of adding.
    pub states: Vec<(StateKey, T)>,
}

impl<T> Default for Sample<T> {
    fn default() -> Self {
        Self { halvings: 0, states: Vec::new() }
    }
}

impl<T> Sample<T> {
    /// Adds a state, if its turn has not passed.
    pub fn add(&mut self, key: StateKey, kept: T) {
        if !self.wants(&key) {
            return;
        }
        self.states.push((key, kept));
        while self.states.len() > MOST_STATES {
            self.halvings += 1;
            let states = std::mem::take(&mut self.states);
            self.states = states.into_iter().filter(|(key, _)| self.wants(key)).collect();
        }
    }

    fn wants(&self, key: &StateKey) -> bool {
        key.seed().trailing_zeros() >= self.halvings
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(order: impl Iterator<Item = u32>) -> Vec<StateKey> {
        let mut sample = Sample::default();
        order.for_each(|bin| sample.add(StateKey::new(&[bin]), ()));
        let mut keys: Vec<StateKey> = sample.states.into_iter().map(|(key, _)| key).collect();
        keys.sort_unstable();
        keys
    }

    #[test]
    fn which_states_stay_does_not_depend_on_their_order() {
        const MANY: u32 = 3 * MOST_STATES as u32;
        let kept = sampled(0..MANY);
        assert!((MOST_STATES / 3..=MOST_STATES).contains(&kept.len()), "{}", kept.len());
        assert_eq!(kept, sampled((0..MANY).rev()));
    }

    #[test]
    fn few_states_all_stay() {
        assert_eq!(sampled(0..100).len(), 100);
    }
}
