//! A bounded cache with generational eviction, which approximates least-recently-used.
//!
//! Two generations bound it: what is used moves to the young one, and when that is full the old one
//! is dropped. This costs one look into a map, where a list in order of use would be rewritten at
//! every look.

use std::hash::Hash;

use crate::store::map::Map;

/// A map of at most two generations of keys.
pub(super) struct Recent<K, V> {
    generation: usize,
    young: Map<K, V>,
    old: Map<K, V>,
}

impl<K: Hash + Eq, V: Copy> Recent<K, V> {
    /// Makes an empty map with this many keys a generation.
    pub(super) fn new(generation: usize) -> Self {
        Self {
            generation,
            young: Map::default(),
            old: Map::default(),
        }
    }

    /// Returns the value of a key, where it is remembered.
    pub(super) fn get(&mut self, key: &K) -> Option<V> {
        if let Some(value) = self.young.get(key) {
            return Some(*value);
        }
        let (key, value) = self.old.remove_entry(key)?;
        self.insert(key, value);
        Some(value)
    }

    /// Remembers a value.
    pub(super) fn insert(&mut self, key: K, value: V) {
        if self.young.len() == self.generation {
            self.old = std::mem::take(&mut self.young);
        }
        self.young.insert(key, value);
    }

    /// Forgets every key that does not pass.
    pub(super) fn retain(&mut self, passes: impl Fn(&K) -> bool) {
        self.young.retain(|key, _| passes(key));
        self.old.retain(|key, _| passes(key));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_bounded_and_keeps_what_is_used() {
        let mut recent = Recent::new(100);
        for n in 0..1_000 {
            recent.insert(n, n * 2);
            assert_eq!(recent.get(&0), Some(0));
            assert!(recent.young.len() + recent.old.len() <= 200);
        }
        assert_eq!((recent.get(&1), recent.get(&999)), (None, Some(1_998)));
        recent.retain(|n| *n == 0);
        assert_eq!((recent.get(&0), recent.get(&999)), (Some(0), None));
    }
}
