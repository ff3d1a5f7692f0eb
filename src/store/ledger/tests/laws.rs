//! Laws of exactly-once counting, on random commits.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;

use super::memory::{Database, HALLWAY, World};
use super::sending::{batch, tally};
use super::{Outcome, Refusal};
use crate::domain::Acknowledged;
use crate::store::ledger::{Numbered, Quotas};

const PRODUCERS: [&str; 3] = ["a", "b", "c"];
const SEGMENTS: [&str; 3] = ["", "test", "train"];
/// Small enough that most runs meet each of them.
const TIGHT: Quotas = Quotas {
    cells: 9,
    segments: 2,
    producers: 2,
    models: 0,
    environments: 0,
};

/// One batch to be sent, with its number and content.
fn sent(sequences: std::ops::Range<u64>) -> impl Strategy<Value = Numbered> {
    let family = prop_oneof![3 => Just(0_u32), 1 => 1..3_u32];
    let cells = prop::collection::vec((0..4_u32, 0..3_u64, 1..4_u64, family), 0..4);
    (
        0..PRODUCERS.len(),
        sequences,
        prop::bool::weighted(0.1),
        0..SEGMENTS.len(),
        cells,
    )
        .prop_map(|(producer, sequence, is_other, segment, cells)| {
            let mut sending = batch(PRODUCERS[producer], sequence);
            for (place, joint, n, family) in cells {
                sending = sending.cell(place, joint, tally(n, n / 2));
                if family > 0 {
                    sending = sending.outcome(family, joint + 1);
                }
            }
            if !SEGMENTS[segment].is_empty() {
                sending = sending.segment(SEGMENTS[segment]);
            }
            if is_other {
                sending = sending.content(200);
            }
            sending.done()
        })
}

/// Batches in the order of their numbers, mostly, so that many of them are applied.
fn run() -> impl Strategy<Value = Vec<Numbered>> {
    let all = prop::collection::vec(sent(1..7), 1..40);
    all.prop_map(|mut all| {
        all.sort_by_key(|batch| batch.sequence.get() / 2);
        all
    })
}

fn tight() -> Database {
    Database {
        quotas: TIGHT,
        ..Database::default()
    }
}

fn is_counted(outcome: &Outcome) -> bool {
    let now = |acknowledged: &Acknowledged| {
        matches!(
            acknowledged,
            Acknowledged::Applied(_) | Acknowledged::Rejected(_)
        )
    };
    matches!(outcome, Outcome::Acknowledged(acknowledged) if now(acknowledged))
}

/// Returns a database after a commit, and the outcomes of it.
fn after(database: &Database, batches: &[Numbered]) -> (Database, Vec<Outcome>) {
    let mut database = database.clone();
    let outcomes = database.commit(batches);
    (database, outcomes)
}

/// Says by counting one by one why a quota has no room for a batch that comes next.
fn expected_refusal(world: &World, batch: &Numbered) -> Option<Refusal> {
    let label = batch
        .increment
        .segment
        .as_ref()
        .map_or("", |label| label.as_str());
    let mut cells = BTreeSet::new();
    for family in batch.increment.families() {
        for (state, joint, _) in batch.increment.of_family(family) {
            let listed = batch.increment.states.listed().get(state as usize);
            let state = listed.map_or_else(|| state.to_string(), ToString::to_string);
            cells.insert((state, label.to_owned(), family.number(), joint));
        }
    }
    let fresh = cells
        .iter()
        .filter(|cell| !world.cells.contains_key(*cell))
        .count() as u64;
    let is_new_producer = !world.producers.contains_key(batch.producer.as_str());
    let is_new_segment = !cells.is_empty() && !world.segments.contains_key(label);

    let over = |what, limit| Some(Refusal::Quota { what, limit });
    if is_new_producer && world.producers.len() as u64 >= TIGHT.producers {
        return over("producers", TIGHT.producers);
    }
    if is_new_segment && world.segments.len() as u64 >= TIGHT.segments {
        return over("segments", TIGHT.segments);
    }
    if fresh > 0 && world.cells.len() as u64 + fresh > TIGHT.cells {
        return over("cells", TIGHT.cells);
    }
    None
}

proptest! {
    #[test]
    fn applying_a_commit_twice_is_applying_it_once(batches in run()) {
        let (once, first) = after(&Database::default(), &batches);
        let counted: Vec<Numbered> = batches.iter().zip(&first).filter(|(_, outcome)| is_counted(outcome)).map(|(batch, _)| batch.clone()).collect();
        let (twice, second) = after(&once, &counted);
        prop_assert_eq!(&twice.worlds, &once.worlds);
        for (batch, outcome) in counted.iter().zip(second) {
            let expected = Outcome::Acknowledged(Acknowledged::Duplicate(batch.receipt.clone()));
            prop_assert_eq!(outcome, expected);
        }
    }

    #[test]
    fn a_group_commit_is_as_many_commits_of_one(batches in run()) {
        let (group, together) = after(&tight(), &batches);
        let (mut singly, mut one_by_one) = (tight(), Vec::new());
        for batch in &batches {
            one_by_one.extend(singly.commit(std::slice::from_ref(batch)));
        }
        prop_assert_eq!(together, one_by_one);
        prop_assert_eq!(contents(&group), contents(&singly));
    }

    #[test]
    fn the_order_of_accounts_does_not_matter(batches in run(), order in Just(PRODUCERS).prop_shuffle()) {
        let mut sorted = batches.clone();
        sorted.sort_by_key(|batch| order.iter().position(|name| *name == batch.producer.as_str()));
        let (mixed, outcomes) = after(&Database::default(), &batches);
        let (apart, sorted_outcomes) = after(&Database::default(), &sorted);
        prop_assert_eq!(contents(&mixed), contents(&apart));
        for name in PRODUCERS {
            prop_assert_eq!(of_producer(name, &batches, &outcomes), of_producer(name, &sorted, &sorted_outcomes));
        }
    }

    #[test]
    fn quotas_are_never_passed_and_never_refuse_what_fits(batches in run()) {
        let mut database = tight();
        for batch in &batches {
            let before = database.worlds.get(&HALLWAY).cloned().unwrap_or_default();
            let outcome = database.commit(std::slice::from_ref(batch)).remove(0);
            let watermark = before.producers.get(batch.producer.as_str()).map_or(0, |producer| producer.sequence);
            if batch.sequence.get() == watermark + 1 {
                let expected = expected_refusal(&before, batch);
                let refused = match &outcome {
                    Outcome::Refused(refusal) => Some(refusal.clone()),
                    Outcome::Acknowledged(_) => None,
                };
                prop_assert_eq!(refused, expected);
            }

            let world = database.world(HALLWAY);
            prop_assert!(world.cells.len() as u64 <= TIGHT.cells);
            prop_assert!(world.segments.len() as u64 <= TIGHT.segments);
            prop_assert!(world.producers.len() as u64 <= TIGHT.producers);
        }
    }

    #[test]
    fn counts_are_the_sum_of_what_was_acknowledged(batches in run()) {
        let (database, outcomes) = after(&tight(), &batches);
        let counted: Vec<&Numbered> = batches.iter().zip(&outcomes).filter(|(_, outcome)| is_counted(outcome)).map(|(batch, _)| batch).collect();
        let world = database.world(HALLWAY);
        let transitions: u64 = counted.iter().map(|batch| batch.increment.transitions).sum();
        prop_assert_eq!(world.transitions, transitions);
        let joint = world.cells.iter().filter(|((.., family, _), _)| *family == 0);
        prop_assert_eq!(joint.map(|(_, tally)| tally.n).sum::<u64>(), transitions);

        // Each family is counted for itself.
        let increments = counted.iter().map(|batch| &batch.increment);
        let outcomes = increments.flat_map(|increment| {
            let outcomes = increment.families().skip(1);
            outcomes.flat_map(|family| increment.of_family(family))
        });
        let observed: u64 = outcomes.map(|(.., tally)| tally.n).sum();
        let found = world.cells.iter().filter(|((.., family, _), _)| *family > 0);
        prop_assert_eq!(found.map(|(_, tally)| tally.n).sum::<u64>(), observed);

        // And a watermark is how many were counted: numbers have no gap.
        for (name, producer) in &world.producers {
            let own = counted.iter().filter(|batch| batch.producer.as_str() == name).count();
            prop_assert_eq!(producer.sequence, own as u64);
        }
    }
}

/// What is stored, without the numbers of rows, which follow the order of arrival.
fn contents(database: &Database) -> Vec<World> {
    let mut worlds: Vec<World> = database.worlds.values().cloned().collect();
    for world in &mut worlds {
        world
            .producers
            .values_mut()
            .for_each(|producer| producer.id = 0);
        world.segments.values_mut().for_each(|id| *id = 0);
    }
    worlds
}

fn of_producer<'a>(
    name: &str,
    batches: &[Numbered],
    outcomes: &'a [Outcome],
) -> BTreeMap<usize, &'a Outcome> {
    let own = batches
        .iter()
        .zip(outcomes)
        .filter(|(batch, _)| batch.producer.as_str() == name);
    own.map(|(_, outcome)| outcome).enumerate().collect()
}
