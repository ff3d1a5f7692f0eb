//! The exactly-once rule against a database in memory: examples here, laws in `laws`.

mod laws;
mod memory;
mod order;
mod sending;

use std::slice::from_ref;

use memory::{Answer, Database, HALLWAY, KITCHEN};
use sending::{Sending, batch, tally};

use super::{Kept, Numbered, Outcome, Quotas, Refusal, inconsistency, last_dropped};
use crate::domain::{Acknowledged, Receipt, Records, Rejection, Sequence};

fn applied(batch: &Numbered) -> Outcome {
    Outcome::Acknowledged(Acknowledged::Applied(batch.receipt.clone()))
}

fn duplicate(batch: &Numbered) -> Outcome {
    Outcome::Acknowledged(Acknowledged::Duplicate(batch.receipt.clone()))
}

fn gap(expected: u64) -> Outcome {
    let expected = Sequence::from_stored(expected as i64);
    Outcome::Refused(Refusal::OutOfOrder { expected })
}

fn over(what: &'static str, limit: u64) -> Outcome {
    Outcome::Refused(Refusal::Quota { what, limit })
}

const REUSED: Outcome = Outcome::Refused(Refusal::Reused);
const FOREIGN: Outcome = Outcome::Refused(Refusal::Foreign);
const OVERFLOW: Outcome = Outcome::Refused(Refusal::Overflow);
const UNVERIFIED: Outcome = Outcome::Acknowledged(Acknowledged::Unverified);
const UNTOLD: Outcome = Outcome::Acknowledged(Acknowledged::Untold);

/// A batch of one cell.
fn one(producer: &str, sequence: u64) -> Sending {
    batch(producer, sequence).cell(0, 0, tally(1, 1))
}

#[test]
fn the_next_number_is_applied_and_a_gap_is_refused() {
    let mut database = Database::default();
    let first = one("p", 1).done();
    assert_eq!(database.commit(&[one("p", 2).done()]), [gap(1)]);
    assert_eq!(database.commit(from_ref(&first)), [applied(&first)]);
    assert_eq!(database.commit(&[one("p", 3).done()]), [gap(2)]);
    assert_eq!(database.world(HALLWAY).transitions, 1);
}

#[test]
fn zero_is_no_number() {
    let mut database = Database::default();
    let mut none = one("p", 1).done();
    none.sequence = Sequence::NONE;
    assert_eq!(database.commit(from_ref(&none)), [gap(1)]);
    database.commit(&[one("p", 1).done()]);
    assert_eq!(database.commit(&[none]), [gap(2)]);
}

#[test]
fn the_largest_number_is_the_last() {
    let mut database = Database::default();
    let last = i64::MAX as u64;
    database.commit(&[one("p", 1).done()]);
    database.set_watermark("p", last - 1);
    let largest = one("p", last).done();
    assert_eq!(database.commit(from_ref(&largest)), [applied(&largest)]);
    assert_eq!(database.commit(from_ref(&largest)), [duplicate(&largest)]);
}

#[test]
fn a_number_with_another_content_is_reused_here_and_in_a_later_commit() {
    let mut database = Database::default();
    let (first, other) = (one("p", 1).done(), one("p", 1).content(99).done());
    let commit = [first.clone(), first.clone(), other.clone()];
    assert_eq!(
        database.commit(&commit),
        [applied(&first), duplicate(&first), REUSED]
    );
    assert_eq!(
        database.commit(&commit),
        [duplicate(&first), duplicate(&first), REUSED]
    );
    assert_eq!(database.world(HALLWAY).transitions, 1);
}

#[test]
fn a_duplicate_gets_the_receipt_of_its_own_number() {
    let mut database = Database::default();
    let run: Vec<Numbered> = (1..=5)
        .map(|sequence| one("p", sequence).cell(1, 0, tally(sequence, 0)).done())
        .collect();
    database.commit(&run[..2]);
    // Two of them are older than the commit, and two are in it.
    let again: Vec<Numbered> = [2, 3, 4, 0, 1, 2, 3].map(|at| run[at].clone()).to_vec();
    assert_eq!(
        database.commit(&again),
        [
            applied(&run[2]),
            applied(&run[3]),
            applied(&run[4]),
            duplicate(&run[0]),
            duplicate(&run[1]),
            duplicate(&run[2]),
            duplicate(&run[3]),
        ]
    );
}

#[test]
fn the_window_holds_the_last_1024() {
    let mut database = Database::default();
    let run: Vec<Numbered> = (1..=1_025)
        .map(|sequence| one("p", sequence).done())
        .collect();

    // In one commit, where all of them are at hand, the window is the same.
    let mut commit = run.clone();
    commit.extend([run[0].clone(), run[1].clone()]);
    let outcomes = database.commit(&commit);
    assert_eq!(outcomes[1_025..], [UNVERIFIED, duplicate(&run[1])]);

    // And afterwards: what is not asked for is not kept.
    assert_eq!(database.producer("p").kept.len(), 1_024);
    assert_eq!(
        database.commit(&[
            run[0].clone(),
            run[1].clone(),
            one("p", 1).content(99).done()
        ]),
        [UNVERIFIED, duplicate(&run[1]), UNVERIFIED]
    );
}

#[test]
fn what_is_dropped_follows_from_the_watermark() {
    let dropped = |last: u64| last_dropped(Sequence::from_stored(last as i64)).get();
    assert_eq!(
        [0, 1, 1_024, 1_025, 5_000].map(dropped),
        [0, 0, 0, 1, 3_976]
    );
    assert_eq!(dropped(i64::MAX as u64), i64::MAX as u64 - 1_024);
}

#[test]
fn a_duplicate_whose_receipt_is_lost_was_counted_all_the_same() {
    let mut database = Database::default();
    database.commit(&[one("p", 1).done(), one("p", 2).done()]);
    database.lose_receipt("p", 1);
    assert_eq!(
        database.commit(&[
            one("p", 1).done(),
            one("p", 1).content(99).done(),
            one("p", 3).done()
        ]),
        [UNTOLD, REUSED, applied(&one("p", 3).done())]
    );
}

#[test]
fn a_digest_of_an_earlier_build_is_known_by_the_words_of_its_receipt() {
    let rejection = |index, reason: &str| Rejection {
        index,
        field: "/state/x".into(),
        reason: reason.into(),
    };
    let records = |reason| Records {
        len: 1,
        undecodable: vec![rejection(0, reason)],
        ..Records::default()
    };
    let digested = |reason| records(reason).worded(None).expect("one cannot be decoded");
    let told = [rejection(0, "as it was said then")];
    let kept = Kept {
        digest: digested("as it was said then").digest(&told),
        receipt: Some(Receipt {
            rejected_count: 1,
            rejected: told.to_vec(),
            ..Receipt::default()
        }),
    };

    let mut resent = one("p", 1).done();
    resent.worded = Some(Box::new(digested("as it is said now")));
    assert_eq!(
        kept.clone().answer(&resent),
        Outcome::Acknowledged(Acknowledged::Duplicate(
            kept.receipt.clone().expect("there")
        ))
    );
    // Without the words that were said, nobody can tell; and other values are another content.
    let untold = Kept {
        receipt: None,
        ..kept.clone()
    };
    assert_eq!(untold.answer(&resent), REUSED);
    resent.worded = None;
    assert_eq!(kept.answer(&resent), REUSED);
}

#[test]
fn an_all_bad_batch_uses_its_number() {
    let mut database = Database::default();
    let mut bad = batch("p", 1).done();
    bad.receipt.rejected_count = 2;
    let rejected = Outcome::Acknowledged(Acknowledged::Rejected(bad.receipt.clone()));
    let empty = batch("p", 2).segment("train").done();
    assert_eq!(
        database.commit(&[bad.clone(), bad.clone(), empty.clone()]),
        [rejected, duplicate(&bad), applied(&empty)]
    );
    let world = database.world(HALLWAY);
    assert_eq!((world.cells.len(), world.segments.len()), (0, 0));
    assert_eq!(database.producer("p").sequence, 2);
}

#[test]
fn a_producer_belongs_to_the_key_that_first_speaks_for_it() {
    let mut database = Database::default();
    let commit = [
        one("p", 1).owner("ann").done(),
        one("p", 2).owner("bob").done(),
        one("p", 1).owner("bob").done(),
        one("p", 2).owner("ann").done(),
        one("p", 3).done(),
    ];
    assert_eq!(
        database.commit(&commit),
        [
            applied(&commit[0]),
            FOREIGN,
            FOREIGN,
            applied(&commit[3]),
            applied(&commit[4])
        ]
    );
    let later = [
        one("p", 4).owner("bob").done(),
        one("p", 4).owner("ann").done(),
    ];
    assert_eq!(database.commit(&later), [FOREIGN, applied(&later[1])]);
    assert_eq!(database.producer("p").owner.as_deref(), Some("ann"));

    // One that nobody owned is the first speaker's, and a refused batch makes nobody an owner.
    database.commit(&[one("q", 1).done()]);
    let claims = [
        one("q", 9).owner("bob").done(),
        one("q", 2).owner("ann").done(),
    ];
    assert_eq!(database.commit(&claims), [gap(2), applied(&claims[1])]);
    assert_eq!(database.producer("q").owner.as_deref(), Some("ann"));
}

#[test]
fn environments_that_are_gone_or_damaged_refuse_and_hold_up_no_other() {
    let mut database = Database::default();
    database.answers.insert(KITCHEN, Answer::ReadOnly);
    let there = one("p", 1).done();
    let damaged = one("p", 1).environment(KITCHEN).done();
    let gone = one("p", 1)
        .environment(crate::domain::EnvironmentId(9))
        .done();
    assert_eq!(
        database.commit(&[damaged, gone, there.clone()]),
        [
            Outcome::Refused(Refusal::ReadOnly),
            Outcome::Refused(Refusal::Gone),
            applied(&there)
        ]
    );
}

#[test]
fn accounts_are_written_in_order_of_name() {
    let mut database = Database::default();
    let names = ["d", "b", "e", "a", "c"];
    database.commit(&names.map(|name| one(name, 1).done()));
    let ids = ["a", "b", "c", "d", "e"].map(|name| database.producer(name).id);
    assert_eq!(ids, [1, 2, 3, 4, 5]);
}

#[test]
fn environments_do_not_mix() {
    let mut database = Database::default();
    database.answers.insert(KITCHEN, Answer::Open);
    let here = one("p", 1).done();
    let there = one("p", 1).content(7).environment(KITCHEN).done();
    assert_eq!(
        database.commit(&[here.clone(), there.clone(), one("p", 3).done()]),
        [applied(&here), applied(&there), gap(2)]
    );
    assert_eq!(database.world(KITCHEN).transitions, 1);
}

#[test]
fn equal_cells_are_merged_and_entries_become_unknown() {
    let mut database = Database::default();
    let mut first = batch("p", 1)
        .cell(3, 5, tally(2, 1))
        .cell(3, 6, tally(1, 1))
        .cell(4, 5, tally(1, 0));
    first = first.again(0, 5, tally(1, 1));
    let mut second = batch("q", 1)
        .cell(4, 5, tally(4, 4))
        .cell(3, 5, tally(1, 1));
    second = second.unknown(4, 6, 1);
    let third = batch("r", 1).segment("train").cell(3, 5, tally(7, 7));
    database.commit(&[first.done(), second.done(), third.done()]);

    let world = database.world(HALLWAY);
    assert_eq!(world.transitions, 5 + 6 + 7);
    let cell = |place: u32, segment: &str, joint| {
        world.cells[&(place.to_string(), segment.to_owned(), 0, joint)]
    };
    assert_eq!(cell(3, "", 5), tally(4, 3));
    assert_eq!(cell(3, "", 6), tally(1, 1));
    assert_eq!(cell(4, "", 5), tally(5, 4));
    assert_eq!(cell(4, "", 6).entries, None);
    assert_eq!(cell(3, "train", 5), tally(7, 7));
    assert_eq!(world.cells.len(), 5);
}

fn with(quotas: Quotas) -> Database {
    Database {
        quotas,
        ..Database::default()
    }
}

#[test]
fn the_quota_of_cells_is_exact() {
    let quotas = Quotas {
        cells: 3,
        ..Quotas::default()
    };
    let mut database = with(quotas);
    let three = batch("p", 1)
        .cell(0, 0, tally(1, 1))
        .cell(0, 1, tally(1, 1))
        .cell(1, 0, tally(1, 1));
    let commit = [
        three.done(),
        batch("q", 1).cell(2, 0, tally(1, 1)).done(),
        batch("q", 1).cell(0, 1, tally(1, 1)).done(),
        // In a segment that is new, the same names are other cells.
        batch("q", 2)
            .segment("train")
            .cell(0, 1, tally(1, 1))
            .done(),
    ];
    assert_eq!(
        database.commit(&commit),
        [
            applied(&commit[0]),
            over("cells", 3),
            applied(&commit[2]),
            over("cells", 3)
        ]
    );
    assert_eq!(database.world(HALLWAY).cells.len(), 3);

    // One that is full takes known cells, also when the quota has become less than it holds.
    let known = [batch("q", 2).cell(0, 1, tally(1, 1)).done()];
    database.quotas.cells = 1;
    assert_eq!(database.commit(&known), [applied(&known[0])]);
    let more = batch("q", 3)
        .cell(0, 1, tally(1, 1))
        .cell(7, 7, tally(1, 1));
    assert_eq!(database.commit(&[more.done()]), [over("cells", 1)]);
}

#[test]
fn a_cell_that_a_batch_names_twice_is_one() {
    let quotas = Quotas {
        cells: 1,
        ..Quotas::default()
    };
    let mut database = with(quotas);
    let twice = one("p", 1).again(0, 0, tally(1, 1)).done();
    assert_eq!(database.commit(from_ref(&twice)), [applied(&twice)]);
}

#[test]
fn cells_are_looked_up_only_where_a_quota_is_near() {
    let quotas = Quotas {
        cells: 4,
        ..Quotas::default()
    };
    let mut database = with(quotas);
    let two = |sequence| {
        batch("p", sequence)
            .cell(0, 0, tally(1, 1))
            .cell(0, 1, tally(1, 1))
    };
    database.commit(&[two(1).done(), two(2).done()]);
    assert_eq!(database.cells_asked, 0, "four fit even if all were new");
    // Two are stored now, so that three could be too many.
    database.commit(&[two(3).cell(0, 2, tally(1, 1)).done()]);
    assert_eq!(database.cells_asked, 3);
}

#[test]
fn the_quota_of_producers_is_exact() {
    let quotas = Quotas {
        producers: 2,
        ..Quotas::default()
    };
    let mut database = with(quotas);
    let commit = [
        one("a", 1).done(),
        one("a", 2).done(),
        one("b", 1).done(),
        one("c", 1).done(),
        one("b", 2).done(),
    ];
    let expected = [
        applied(&commit[0]),
        applied(&commit[1]),
        applied(&commit[2]),
        over("producers", 2),
        applied(&commit[4]),
    ];
    assert_eq!(database.commit(&commit), expected);
    assert_eq!(database.commit(&commit[3..4]), [over("producers", 2)]);
    assert_eq!(database.world(HALLWAY).producers.len(), 2);
}

#[test]
fn the_quota_of_segments_is_exact() {
    let quotas = Quotas {
        segments: 2,
        ..Quotas::default()
    };
    let mut database = with(quotas);
    let commit = [
        one("p", 1).done(),
        one("p", 2).segment("a").done(),
        one("p", 3).segment("b").done(),
        // Nothing is counted in it, so it does not begin.
        batch("p", 3).segment("b").done(),
        one("p", 4).segment("a").done(),
    ];
    let expected = [
        applied(&commit[0]),
        applied(&commit[1]),
        over("segments", 2),
        applied(&commit[3]),
        applied(&commit[4]),
    ];
    assert_eq!(database.commit(&commit), expected);
    let later = [
        one("q", 1).segment("b").done(),
        one("q", 1).segment("a").done(),
    ];
    assert_eq!(
        database.commit(&later),
        [over("segments", 2), applied(&later[1])]
    );
    assert_eq!(database.world(HALLWAY).segments.len(), 2);
}

#[test]
fn transitions_stop_at_the_largest_number() {
    let mut database = Database::default();
    let most = i64::MAX as u64;
    let commit = [
        batch("p", 1).cell(0, 0, tally(most - 1, 0)).done(),
        batch("p", 2).cell(0, 0, tally(2, 0)).done(),
        batch("p", 2).cell(0, 0, tally(1, 0)).done(),
    ];
    let expected = [applied(&commit[0]), OVERFLOW, applied(&commit[2])];
    assert_eq!(database.commit(&commit), expected);
    assert_eq!(database.commit(&[one("p", 3).done()]), [OVERFLOW]);
    assert_eq!(
        database.commit(&[batch("p", 3).cell(0, 0, tally(u64::MAX, 0)).done()]),
        [OVERFLOW]
    );
    assert_eq!(database.world(HALLWAY).transitions, most);
}

#[test]
fn a_joint_action_that_no_database_holds_is_refused() {
    let mut database = Database::default();
    let commit = [
        batch("p", 1)
            .cell(0, i64::MAX as u64 + 1, tally(1, 0))
            .done(),
        batch("p", 1).cell(0, i64::MAX as u64, tally(1, 0)).done(),
    ];
    assert_eq!(database.commit(&commit), [OVERFLOW, applied(&commit[1])]);
}

#[test]
fn a_receipt_that_nobody_was_given_is_found() {
    let rejected = |indices: &[u32]| {
        let rejection = |index: &u32| Rejection {
            index: *index,
            field: String::new(),
            reason: String::new(),
        };
        indices.iter().map(rejection).collect::<Vec<_>>()
    };
    let receipt = |accepted, rejected_count, indices: &[u32]| Receipt {
        accepted,
        rejected_count,
        rejected: rejected(indices),
    };
    let first_hundred: Vec<u32> = (0..100).collect();
    for sound in [
        receipt(0, 0, &[]),
        receipt(7, 0, &[]),
        receipt(1, 2, &[0, 2]),
        receipt(1, 2, &[1, 1]),
        receipt(0, 101, &first_hundred),
        receipt(u64::MAX - 1, 1, &[0]),
    ] {
        assert_eq!(inconsistency(&sound), None, "{sound:?}");
    }

    let (many, fewer, which) = (
        "it has more records than there are numbers",
        "it tells of more or fewer rejected records than it counts",
        "it tells of rejected records that the batch cannot have",
    );
    for (wrong, why) in [
        (receipt(u64::MAX, 1, &[0]), many),
        (receipt(1, 0, &[0]), fewer),
        (receipt(1, 2, &[0]), fewer),
        (receipt(0, 101, &first_hundred[..99]), fewer),
        (receipt(1, 2, &[0, 3]), which),
        (receipt(1, 2, &[2, 0]), which),
    ] {
        assert_eq!(inconsistency(&wrong), Some(why), "{wrong:?}");
    }
}
