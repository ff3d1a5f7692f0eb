//! The window in which duplicates are told from reused numbers (idempotency).

/// How many of each producer's batches are kept, with digest and receipt.
pub(in crate::store::sqlite) const KEPT: u64 = 1_024;
