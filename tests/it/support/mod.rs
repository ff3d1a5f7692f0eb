//! What several tests need.

pub mod batches;
pub mod databases;
