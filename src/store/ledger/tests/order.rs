//! Cells are in order, and each there once.

use std::collections::BTreeMap;

use proptest::prelude::*;

use crate::domain::Tally;
use crate::store::ledger::order::{At, Part, merged, sorted};

/// A batch of numbers up to one, small ones often.
#[derive(Debug, Clone)]
struct Batch {
    cells: Vec<(u64, u64, Tally)>,
    segment: u32,
    family: u32,
    numbers: Option<Vec<u64>>,
}

fn batch(most: u64) -> impl Strategy<Value = Batch> {
    let tally = (1u64..9, any::<Option<bool>>()).prop_map(|(n, entered)| Tally {
        n,
        entries: entered.map(|entered| n * u64::from(entered)),
    });
    let number = move || prop_oneof![0..5u64, Just(most), 0..=most];
    let cells = proptest::collection::vec((number(), number(), tally), 0..300);
    let numbers = proptest::collection::vec(number(), 4);
    let families = prop_oneof![4 => Just(0u32), 1 => 1u32..600];
    (cells, 0u32..4, families, proptest::option::of(numbers)).prop_map(
        |(mut cells, segment, family, numbers)| {
            if numbers.is_some() {
                cells.iter_mut().for_each(|(state, ..)| *state %= 4);
            }
            Batch {
                cells,
                segment,
                family,
                numbers,
            }
        },
    )
}

/// Narrow numbers, those that fill 64 bits and those that do not fit into them.
fn batches() -> impl Strategy<Value = Vec<Batch>> {
    let most = prop_oneof![
        Just(0),
        Just(40),
        Just(1 << 20),
        Just((1 << 31) - 1),
        Just((1 << 48) - 1),
        Just(i64::MAX as u64),
    ];
    most.prop_flat_map(|most| proptest::collection::vec(batch(most), 0..9))
}

fn parts(batches: &[Batch]) -> Vec<Part<'_>> {
    let mut parts = Vec::new();
    for batch in batches {
        parts.push(Part {
            cells: &batch.cells,
            segment: batch.segment,
            family: batch.family,
            numbers: batch.numbers.clone().map(Into::into),
        });
    }
    parts
}

fn expected(parts: &[Part<'_>]) -> Vec<(At, Tally)> {
    let mut sums = BTreeMap::new();
    for (at, tally) in parts.iter().flat_map(Part::cells) {
        sums.entry(at).or_insert(Tally::EMPTY).add(tally);
    }
    sums.into_iter().collect()
}

proptest! {
    #[test]
    fn cells_are_in_order_and_each_once(batches in batches()) {
        let parts = parts(&batches);
        prop_assert_eq!(sorted(&parts), expected(&parts));
    }

    #[test]
    fn what_was_sorted_apart_is_merged(batches in batches(), at in any::<proptest::sample::Index>()) {
        let parts = parts(&batches);
        let (a, b) = parts.split_at(at.index(parts.len() + 1));
        prop_assert_eq!(merged(sorted(a), sorted(b)), expected(&parts));
    }
}

#[test]
fn all_of_64_bits_are_sorted_by() {
    let one = Tally {
        n: 1,
        entries: None,
    };
    // States of 48 bits and joint actions of 16.
    let cells: Vec<(u64, u64, Tally)> = (0..1_000_u64)
        .map(|i| (i * 0x5851_f42d_4c95 % (1 << 48), i * 7_919 % (1 << 16), one))
        .chain([((1 << 48) - 1, (1 << 16) - 1, one)])
        .collect();
    let parts = [Part {
        cells: &cells,
        segment: 0,
        family: 0,
        numbers: None,
    }];
    assert_eq!(sorted(&parts), expected(&parts));
}
