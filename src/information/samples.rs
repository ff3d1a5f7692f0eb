//! Tables for the tests of this module.

use proptest::prelude::*;

/// Generates counts as they arrive: in any order, with repeated cells and zeros.
pub(super) fn counts() -> impl Strategy<Value = Vec<(u64, u64, u64)>> {
    let n = prop_oneof![4 => 0..4_u64, 1 => 0..60_u64];
    prop::collection::vec((0..7_u64, 0..7_u64, n), 0..50)
}
