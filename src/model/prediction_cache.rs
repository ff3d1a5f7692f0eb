//! A bounded cache of predictions: a state has few bins and its network never changes, so that
//! games ask for the same again and again.

use std::sync::{Arc, PoisonError, RwLock};

use foldhash::HashMap;

use crate::domain::StateKey;

/// Numbers that are remembered: the bins of states and what was said of them. When there are more,
/// all are forgotten.
const MOST: usize = 1 << 20;

/// What each member predicted of states.
#[derive(Default)]
pub struct PredictionCache(RwLock<HashMap<StateKey, Arc<[f64]>>>);

impl PredictionCache {
    /// Returns what is remembered of states, in their order, and lets `predict` make the rest.
    pub fn get_or_predict(
        &self,
        states: &[StateKey],
        predict: impl FnOnce(&[&StateKey]) -> Vec<Arc<[f64]>>,
    ) -> Vec<Arc<[f64]>> {
        let known: Vec<Option<Arc<[f64]>>> = {
            let told = self.0.read().unwrap_or_else(PoisonError::into_inner);
            states
                .iter()
                .map(|state| told.get(state).cloned())
                .collect()
        };

        let unknown: Vec<&StateKey> = states
            .iter()
            .zip(&known)
            .filter(|(_, known)| known.is_none())
            .map(|(state, _)| state)
            .collect();
        if unknown.is_empty() {
            return known.into_iter().flatten().collect();
        }

        let predicted = predict(&unknown);
        self.remember(&unknown, &predicted);

        let mut predicted = predicted.into_iter();
        known
            .into_iter()
            .filter_map(|known| known.or_else(|| predicted.next()))
            .collect()
    }

    fn remember(&self, states: &[&StateKey], numbers: &[Arc<[f64]>]) {
        let mut told = self.0.write().unwrap_or_else(PoisonError::into_inner);
        let each = states.first().map_or(1, |state| state.bins().len())
            + numbers.first().map_or(0, |said| said.len());

        let most = MOST / each;
        if told.len() + states.len() > most {
            told.clear();
        }
        told.extend(
            states
                .iter()
                .copied()
                .cloned()
                .zip(numbers.iter().cloned())
                .take(most),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(bins: &[u32]) -> Vec<StateKey> {
        bins.iter().map(|bin| StateKey::new(&[*bin])).collect()
    }

    fn tell(states: &[&StateKey]) -> Vec<Arc<[f64]>> {
        states
            .iter()
            .map(|state| [f64::from(state.bins()[0])].into())
            .collect()
    }

    #[test]
    fn what_was_told_is_not_asked_again_and_order_is_kept() {
        let cache = PredictionCache::default();
        cache.get_or_predict(&keys(&[3, 1]), tell);
        let answers = cache.get_or_predict(&keys(&[1, 2, 3, 2]), |unknown| {
            assert_eq!(
                unknown
                    .iter()
                    .map(|state| state.bins()[0])
                    .collect::<Vec<_>>(),
                [2, 2]
            );
            tell(unknown)
        });
        assert_eq!(
            answers.iter().map(|numbers| numbers[0]).collect::<Vec<_>>(),
            [1.0, 2.0, 3.0, 2.0]
        );
    }

    #[test]
    fn memory_is_bounded() {
        let cache = PredictionCache::default();
        let most = MOST / 2;
        (0..3).for_each(|round| {
            let bins: Vec<u32> = (0..most as u32)
                .map(|bin| bin + round * most as u32)
                .collect();
            cache.get_or_predict(&keys(&bins), tell);
        });
        assert!(cache.0.read().expect("no panic").len() <= most);
    }
}
