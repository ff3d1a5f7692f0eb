//! Numbers as the database holds them: signed.

/// Returns a number as the database holds it.
pub(super) fn signed(number: u64) -> i64 {
    i64::try_from(number).expect("a batch that would pass 2^63 - 1 was refused")
}
