//! Hash maps whose keys come from outside.

/// A map of keys that came from outside: fast, and seeded so that nobody can choose them to
/// collide.
pub(in crate::store) type Map<K, V> = foldhash::HashMap<K, V>;
