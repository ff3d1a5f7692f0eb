//! A table of states in columns: their keys one after the other, and a fixed-size value beside
//! each. Millions are kept at once, so that none has an allocation of its own.

use crate::domain::StateKey;

/// Values by state.
#[derive(Debug)]
pub struct Keyed<T> {
    /// The bins of all keys, as many of each as states have features.
    bins: Vec<u32>,
    values: Vec<T>,
}

impl<T> Default for Keyed<T> {
    fn default() -> Self {
        Self {
            bins: Vec::new(),
            values: Vec::new(),
        }
    }
}

impl<T> Keyed<T> {
    /// Makes room for so many states of so many features, if there is that much.
    pub fn reserve(&mut self, states: usize, features: usize) {
        let bins = states.saturating_mul(features);
        // Without it they grow as they come: a total may be too large to be true.
        let _ = self.bins.try_reserve_exact(bins);
        let _ = self.values.try_reserve_exact(states);
    }

    /// Adds a state, whose key has as many bins as all others.
    pub fn push(&mut self, key: &StateKey, value: T) {
        self.bins.extend_from_slice(key.bins());
        self.values.push(value);
    }

    /// Sorts the states by key and lets go of what was allocated beyond them.
    pub fn sort(&mut self) {
        let is_sorted = (1..self.len()).all(|at| self.bins(at - 1) <= self.bins(at));
        if !is_sorted {
            let mut order: Vec<u32> = (0..self.len() as u32).collect();
            order.sort_unstable_by(|a, b| self.bins(*a as usize).cmp(self.bins(*b as usize)));
            self.permute(order);
        }
        self.bins.shrink_to_fit();
        self.values.shrink_to_fit();
    }

    /// Moves to each place what `order` has there, in place: a second table might not fit.
    fn permute(&mut self, mut order: Vec<u32>) {
        for start in 0..order.len() {
            let mut at = start;
            loop {
                let from = std::mem::replace(&mut order[at], at as u32) as usize;
                if from == start {
                    break;
                }
                self.swap(at, from);
                at = from;
            }
        }
    }

    fn swap(&mut self, a: usize, b: usize) {
        self.values.swap(a, b);
        let features = self.features();
        (0..features).for_each(|at| self.bins.swap(a * features + at, b * features + at));
    }

    fn features(&self) -> usize {
        self.bins.len().checked_div(self.len()).unwrap_or(0)
    }

    /// Returns how many states there are.
    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Returns the bins of the state at a position.
    pub fn bins(&self, at: usize) -> &[u32] {
        let features = self.features();
        &self.bins[at * features..][..features]
    }

    /// Returns the key of the state at a position.
    pub fn key(&self, at: usize) -> StateKey {
        StateKey::new(self.bins(at))
    }

    /// Returns the values, by position.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// Returns the position of a state in a sorted table.
    pub fn position(&self, key: &StateKey) -> Option<usize> {
        let (mut low, mut high) = (0, self.len());
        while low < high {
            let middle = low + (high - low) / 2;
            match self.bins(middle).cmp(key.bins()) {
                std::cmp::Ordering::Less => low = middle + 1,
                std::cmp::Ordering::Equal => return Some(middle),
                std::cmp::Ordering::Greater => high = middle,
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keyed(keys: &[[u32; 2]]) -> Keyed<u32> {
        let mut keyed = Keyed::default();
        for [a, b] in keys {
            keyed.push(&StateKey::new(&[*a, *b]), 10 * a + b);
        }
        keyed.sort();
        keyed
    }

    #[test]
    fn values_stay_beside_their_keys() {
        // Cycles of one, two, three and four states, in every order.
        let keys = [[0, 1], [0, 2], [1, 0], [3, 3]];
        for number in 0..256_usize {
            let chosen = [number / 64, number / 16 % 4, number / 4 % 4, number % 4];
            if (0..4).any(|at| !chosen.contains(&at)) {
                continue;
            }
            let sorted = keyed(&chosen.map(|at| keys[at]));
            assert_eq!(sorted.values(), [1, 2, 10, 33], "{chosen:?}");
            for (at, key) in keys.iter().enumerate() {
                assert_eq!(sorted.bins(at), key);
                assert_eq!(sorted.position(&StateKey::new(key)), Some(at));
            }
        }
    }

    #[test]
    fn what_is_not_there_has_no_position() {
        let sorted = keyed(&[[3, 3], [1, 0]]);
        for key in [[0, 0], [1, 1], [4, 0]] {
            assert_eq!(sorted.position(&StateKey::new(&key)), None);
        }
        let nothing = keyed(&[]);
        assert_eq!(nothing.position(&StateKey::new(&[0, 0])), None);
        assert_eq!((nothing.len(), nothing.values()), (0, &[][..]));
    }
}
