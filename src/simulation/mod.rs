//! Worlds that produce transitions: pedestrians who avoid each other in a hallway. Seeded, and without I/O: the same seed gives the same bytes.

pub mod planted;
