//! Cells are in order, and each there once.

use std::collections::BTreeMap;

use proptest::prelude::*;

use crate::domain::Tally;
use crate::store::ledger::order::{At, Part, Sorted};

/// A batch of numbers up to one, small ones often.
#[derive(Debug, Clone)]
struct Batch {
    cells: Vec<(u64, u64, Tally)>,
    segment: u32,
    family: u32,
    numbers: Option<Vec<u64>>,
}

fn batch(most: u64) -> impl Strategy<Value = Batch> {
    let n = prop_oneof![20 => 1u64..9, 1 => Just(u64::from(u32::MAX) / 200)];
    let tally = (n, any::<Option<bool>>()).prop_map(|(n, entered)| Tally {
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

/// Returns the visits of all cells together.
fn visits(parts: &[Part<'_>]) -> u64 {
    let cells = parts.iter().flat_map(Part::cells);
    cells.map(|(_, tally)| tally.n).sum()
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
        let (sorted, expected) = (Sorted::of(&parts, visits(&parts)), expected(&parts));

        prop_assert!(expected.iter().all(|(at, _)| sorted.has(*at)));
        for (at, _) in &expected {
            let beside = (at.0, at.1 ^ 1 << 20, at.2, at.3 ^ 1 << 40);
            prop_assert_eq!(sorted.has(beside), expected.binary_search_by_key(&beside, |(at, _)| *at).is_ok());
        }
        prop_assert_eq!(sorted.into_cells().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn what_was_sorted_apart_is_merged(batches in batches(), at in any::<proptest::sample::Index>()) {
        let parts = parts(&batches);
        let (a, b) = parts.split_at(at.index(parts.len() + 1));
        let visits = visits(&parts);
        let merged = Sorted::of(a, visits).merged(Sorted::of(b, visits));
        prop_assert_eq!(merged.iter().collect::<Vec<_>>(), expected(&parts));
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
    let sorted = Sorted::of(&parts, visits(&parts));
    assert!(matches!(sorted, Sorted::Packed(..)));
    assert_eq!(sorted.into_cells().collect::<Vec<_>>(), expected(&parts));
}

#[test]
fn sums_of_more_than_32_bits_are_kept() {
    let most = u64::from(u32::MAX) - 1;
    let one = |n| (7, 3, Tally { n, entries: None });
    for (n, is_packed) in [(most - 255, true), (most, false)] {
        let cells: Vec<_> = (0..255).map(|_| one(1)).chain([one(n)]).collect();
        let parts = [Part {
            cells: &cells,
            segment: 0,
            family: 0,
            numbers: None,
        }];
        let sorted = Sorted::of(&parts, n + 255);
        assert_eq!(matches!(sorted, Sorted::Packed(..)), is_packed, "{n}");
        let sum = Tally {
            n: n + 255,
            entries: None,
        };
        assert_eq!(
            sorted.into_cells().collect::<Vec<_>>(),
            [((7, 0, 0, 3), sum)]
        );
    }
}
