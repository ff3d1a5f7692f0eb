//! Cells are in order, and each there once.

use std::collections::BTreeMap;

use proptest::prelude::*;

use crate::domain::{Family, Increment, Tally};
use crate::store::ledger::order::{At, Part, Sorted, side_by_side, sorted};

/// A batch of numbers up to one, small ones often; outcomes are missing now and then.
#[derive(Debug, Clone)]
struct Batch {
    increment: Increment,
    segment: u32,
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
    let observed = prop_oneof![4 => number(), 1 => Just(Increment::MISSING)];
    let outcomes = proptest::collection::vec(proptest::collection::vec(observed, 300), 0..4);
    (cells, outcomes, 0u32..4, proptest::option::of(numbers)).prop_map(
        |(mut cells, mut outcomes, segment, numbers)| {
            if numbers.is_some() {
                cells.iter_mut().for_each(|(state, ..)| *state %= 4);
            }
            outcomes
                .iter_mut()
                .for_each(|column| column.truncate(cells.len()));
            let increment = Increment {
                cells,
                outcomes,
                ..Increment::default()
            };
            Batch {
                increment,
                segment,
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
            increment: &batch.increment,
            segment: batch.segment,
            numbers: batch.numbers.clone().map(Into::into),
        });
    }
    parts
}

/// Returns the visits of all cells together.
fn visits(parts: &[Part<'_>]) -> u64 {
    let cells = parts.iter().flat_map(|part| part.cells(Family::JOINT));
    cells.map(|(_, tally)| tally.n).sum()
}

/// Returns the cells of a family by their sums.
fn expected(parts: &[Part<'_>], family: Family) -> Vec<(At, Tally)> {
    let mut sums = BTreeMap::new();
    for (at, tally) in parts.iter().flat_map(|part| part.cells(family)) {
        sums.entry(at).or_insert(Tally::EMPTY).add(tally);
    }
    sums.into_iter().collect()
}

/// Returns what a batch of these cells is sorted into.
fn sorted_alone(cells: Vec<(u64, u64, Tally)>) -> Sorted {
    let increment = Increment {
        cells,
        ..Increment::default()
    };
    let parts = [Part {
        increment: &increment,
        segment: 0,
        numbers: None,
    }];
    sorted(&parts, visits(&parts)).remove(0)
}

proptest! {
    #[test]
    fn cells_of_each_family_are_in_order_and_each_once(batches in batches()) {
        let parts = parts(&batches);
        let families = sorted(&parts, visits(&parts));
        for (number, sorted) in (0..).zip(&families) {
            let expected = expected(&parts, Family::from_number(number));
            prop_assert!(expected.iter().all(|(at, _)| sorted.has(*at)));
            for (at, _) in &expected {
                let beside = (at.0, at.1 ^ 1 << 20, at.2 ^ 1 << 40);
                prop_assert_eq!(sorted.has(beside), expected.binary_search_by_key(&beside, |(at, _)| *at).is_ok());
            }
            prop_assert_eq!(sorted.iter().collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn families_side_by_side_are_in_order(batches in batches()) {
        let parts = parts(&batches);
        let families = sorted(&parts, visits(&parts));
        let mut all = Vec::new();
        for number in 0..families.len() as u32 {
            let cells = expected(&parts, Family::from_number(number));
            all.extend(cells.into_iter().map(|((state, segment, cell), tally)| {
                ((state, segment, number, cell), tally)
            }));
        }
        all.sort_unstable_by_key(|(at, _)| *at);

        let found = side_by_side(&families);
        let found = found.map(|(family, (state, segment, cell), tally)| {
            ((state, segment, family, cell), tally)
        });
        prop_assert_eq!(found.collect::<Vec<_>>(), all);
    }

    #[test]
    fn what_was_sorted_apart_is_merged(batches in batches(), at in any::<proptest::sample::Index>()) {
        let parts = parts(&batches);
        let (a, b) = parts.split_at(at.index(parts.len() + 1));
        let visits = visits(&parts);
        let [mut a, mut b] = [a, b].map(|parts| sorted(parts, visits));
        a.resize_with(a.len().max(b.len()), Sorted::default);
        b.resize_with(a.len(), Sorted::default);
        for (number, (a, b)) in (0..).zip(a.into_iter().zip(b)) {
            let expected = expected(&parts, Family::from_number(number));
            prop_assert_eq!(a.merged(b).iter().collect::<Vec<_>>(), expected);
        }
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
    let expected: BTreeMap<At, Tally> = cells
        .iter()
        .map(|(state, joint, tally)| ((*state, 0, *joint), *tally))
        .collect();
    let sorted = sorted_alone(cells);
    assert!(matches!(sorted, Sorted::Packed(..)));
    assert!(sorted.iter().eq(expected));
}

#[test]
fn sums_of_more_than_32_bits_are_kept() {
    let most = u64::from(u32::MAX) - 1;
    let one = |n| (7, 3, Tally { n, entries: None });
    for (n, is_packed) in [(most - 255, true), (most, false)] {
        let sorted = sorted_alone((0..255).map(|_| one(1)).chain([one(n)]).collect());
        assert_eq!(matches!(sorted, Sorted::Packed(..)), is_packed, "{n}");
        let sum = Tally {
            n: n + 255,
            entries: None,
        };
        assert_eq!(sorted.iter().collect::<Vec<_>>(), [((7, 0, 3), sum)]);
    }
}
