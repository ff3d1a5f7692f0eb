//! The promise of a store, case by case. One suite for every backend: [`store_contract!`] runs it
//! on a database.

use std::sync::Arc;

use nudge::domain::draft::{DerivedDraft, DerivedKindDraft};
use nudge::domain::{
    ActionTotals, Cell, Change, Counts, DerivedFeatures, Environment, EnvironmentId, Family, FitId,
    Schema, SegmentId, Sequence, StateKey, Tally, Threshold, WrittenRule,
};
use nudge::error::ErrorKind;
use nudge::store::{
    ByVisits, Cursor, FitRecord, Leftovers, ModelRecord, NewModel, Numbered, Outcome, Quotas,
    Refusal, Scanned, Store, StoreError, Totals,
};

use crate::support::batches::*;
use crate::support::databases::{Database, SqliteFile, actions_by_scan};

macro_rules! store_contract {
    ($($backend:ident: $database:expr),*; $cases:tt) => {
        $(mod $backend {
            store_contract!(@ $database; $cases);
        })*
    };
    (@ $database:expr; { $($case:ident),* $(,)? }) => {
        $(#[tokio::test]
        async fn $case() {
            super::$case(&$database).await;
        })*
    };
}

/// Runs the cases that hold whatever is counted beside joint actions, and those that are named.
macro_rules! store_contract_with {
    ($($backend:ident: $database:expr),*; { $($case:ident),* $(,)? }) => {
        store_contract!($($backend: $database),*; {
            $($case,)*
            an_environment_is_made_changed_and_removed,
            what_is_not_changed_of_an_environment_stays,
            environments_survive,
            batches_count_in_their_order,
            a_gap_is_refused,
            a_number_used_with_another_content_is_refused,
            duplicates_get_their_first_receipt,
            duplicates_are_known_after_reopening,
            duplicates_older_than_the_last_1024_are_unverified,
            the_largest_sequence_has_no_successor,
            a_run_of_one_producer_advances_in_one_commit,
            a_refused_batch_changes_nothing_for_the_others,
            empty_batches_use_their_numbers,
            a_new_environment_of_the_same_name_begins_anew,
            a_deleted_environment_is_gone_before_its_rows,
            a_read_that_goes_on_ends_with_its_environment,
            several_environments_are_removed_at_once,
            an_interrupted_removal_goes_on_after_reopening,
            the_segments_quota_is_exact,
            the_producers_quota_is_exact,
            transitions_stop_at_the_largest_number,
            a_joint_action_that_cannot_be_stored_is_refused,
            entries_become_unknown_and_stay_so,
            segments_are_kept_apart,
            counts_come_in_the_order_asked,
            many_states_are_read_at_once,
            a_scan_sees_every_state_once,
            states_are_found_in_the_order_of_their_visits,
            what_a_commit_counts_is_read_after_it,
            nobody_acted_in_an_empty_environment,
            actions_add_up_over_states_and_segments,
            actions_of_three_agents_come_apart,
            actions_follow_every_commit,
            actions_are_drawn_by_visits_once_a_flag_is_missing,
            actions_go_with_their_environment,
            an_audit_finds_nothing_wrong,
            many_new_states_in_one_commit,
            environments_do_not_mix,
        });
    };
}

store_contract_with!(
    sqlite: super::SqliteFile::new(),
    sqlite_compacted: super::SqliteFile::compacted(),
    sqlite_listed: super::SqliteFile::listed(); {
    a_producer_belongs_to_the_first_name_that_speaks_for_it,
    the_cells_quota_is_exact,
    the_cells_quota_counts_what_the_same_commit_adds,
    known_cells_fit_at_the_quota,
    the_environments_quota_is_exact,
    the_models_quota_is_exact,
    the_last_fit_of_each_pair_is_kept,
    model_versions_are_never_used_again,
    the_model_activated_last_is_active_until_rolled_back_or_deleted,
    each_pair_has_an_active_model_of_its_own,
    models_survive,
    weights_come_back_to_the_byte,
    models_go_with_their_environment,
    an_unknown_model_is_not_found,
});

// Where outcomes are observed beside each joint action: the same, but for cases that say how many
// cells there are, which have twins of their own, and those of what is not counted.
store_contract_with!(
    sqlite_observed: super::SqliteFile::observed(),
    sqlite_observed_listed: super::SqliteFile::observed_listed(); {
    outcomes_are_counted_apart_from_joint_actions,
    cells_of_outcomes_count_towards_the_quota,
    a_cell_that_no_outcome_has_is_damage,
    outcomes_survive_and_are_folded,
});

async fn make(store: &Arc<dyn Store>, name: &str) -> EnvironmentId {
    let made = store
        .create(
            &name.parse().expect("a name"),
            &schema(),
            &Default::default(),
        )
        .await;
    made.expect("a new environment").id
}

async fn open(database: &dyn Database) -> (Arc<dyn Store>, EnvironmentId) {
    let store = database.open(Quotas::default()).await;
    let id = make(&store, "hallway").await;
    (store, id)
}

async fn commit(store: &Arc<dyn Store>, batches: &[Numbered]) -> Vec<Outcome> {
    store.commit(batches).await.expect("a commit")
}

async fn watermark(store: &Arc<dyn Store>, id: EnvironmentId, producer: &str) -> u64 {
    store
        .watermark(id, &producer.parse().expect("a producer"))
        .await
        .expect("a watermark")
        .get()
}

/// Returns (joint action, visits, entries) of every cell of a state.
async fn cells(
    store: &Arc<dyn Store>,
    id: EnvironmentId,
    place: u32,
) -> Vec<(u64, u64, Option<u64>)> {
    let counts = store.counts(id, &[state_at(place)]).await.expect("counts");
    assert_eq!(counts.len(), 1);
    assert_observed(&counts[0].counts);
    counts[0]
        .counts
        .cells()
        .iter()
        .map(|cell| (cell.joint, cell.tally.n, cell.tally.entries))
        .collect()
}

/// Returns how many cells of all families these of joint actions are counted in.
fn cells_of(joints: &[u64]) -> u64 {
    let observed = |joint: &u64| {
        let outcomes = 0..OUTCOMES.len();
        1 + outcomes
            .filter(|at| observed(*at, *joint).is_some())
            .count() as u64
    };
    joints.iter().map(observed).sum()
}

/// Asserts that the families of outcomes have what the joint actions of a state were observed with.
fn assert_observed(counts: &Counts) {
    for outcome in 0..OUTCOMES.len() {
        let beside = |cell: &Cell| {
            let joint = observed(outcome, cell.joint)?;
            Some(Cell { joint, ..*cell })
        };
        let expected: Vec<Cell> = counts.cells().iter().filter_map(beside).collect();
        assert_eq!(counts.of_family(Family::of_outcome(outcome)), expected);
    }
}

async fn totals(store: &Arc<dyn Store>, id: EnvironmentId) -> Totals {
    store.totals(id).await.expect("totals")
}

fn is_unknown<T: std::fmt::Debug>(result: Result<T, StoreError>) -> bool {
    matches!(result, Err(StoreError::UnknownEnvironment))
}

async fn an_environment_is_made_changed_and_removed(database: &dyn Database) {
    let (store, id) = open(database).await;
    let made: Arc<Environment> = store.environment("hallway").expect("made");
    assert_eq!((made.id, made.schema.hash()), (id, schema().hash()));

    let again = store
        .create(&made.name, &schema(), &made.rule.clone().into())
        .await;
    assert!(matches!(again, Err(StoreError::AlreadyExists(name)) if name == "hallway"));

    let threshold = |threshold| WrittenRule {
        threshold,
        ..made.rule.clone()
    };
    let rule = threshold(Threshold::Information(0.1 + 0.2));
    for rule in [threshold(Threshold::Share(0.1 + 0.2)), rule.clone()] {
        assert_eq!(
            store
                .change(id, &rule.clone().into())
                .await
                .expect("changed")
                .rule,
            rule
        );
        assert_eq!(
            store.environment("hallway").expect("still there").rule,
            rule
        );
    }

    store.delete(id).await.expect("removed");
    assert!(store.environment("hallway").is_none() && store.environments().is_empty());
    assert!(is_unknown(store.delete(id).await));
    assert!(is_unknown(store.change(id, &rule.into()).await));
    assert!(is_unknown(store.totals(id).await));
    assert!(is_unknown(
        store
            .watermark(id, &"game".parse().expect("a producer"))
            .await
    ));
    assert!(is_unknown(store.counts(id, &[state_at(1)]).await));
}

/// Returns a schema of two wide features of the state, and what follows from them.
fn of_two_features() -> (Schema, DerivedFeatures) {
    let mut draft = schema().draft();
    let mut goal = draft.state[0].clone();
    goal.name = "goal".into();
    draft.state.push(goal);

    let schema = Schema::try_from(&draft).expect("valid");
    let names = ["place", "goal"].map(String::from).to_vec();
    let there = DerivedDraft {
        name: "there".into(),
        kinds: vec![DerivedKindDraft::Equal(names)],
    };
    let derived = DerivedFeatures::checked(&[there], &schema).expect("valid");
    (schema, derived)
}

async fn what_is_not_changed_of_an_environment_stays(database: &dyn Database) {
    let (store, _) = open(database).await;
    let (schema, derived) = of_two_features();
    let name = "street".parse().expect("a name");
    let (some, none) = (Some(derived.clone()), Some(DerivedFeatures::default()));
    let of_derived = |derived| Change {
        derived,
        rule: None,
    };

    let made = store
        .create(&name, &schema, &of_derived(some.clone()))
        .await;
    let made = made.expect("made");
    assert_eq!(
        (&made.derived, made.rule.clone()),
        (&derived, WrittenRule::default())
    );
    let rule = WrittenRule {
        min_visits: 3,
        ..made.rule.clone()
    };
    let ruled = store
        .change(made.id, &rule.clone().into())
        .await
        .expect("changed");
    assert_eq!((&ruled.derived, &ruled.rule), (&derived, &rule));
    let without = store.change(made.id, &of_derived(none)).await;
    let without = without.expect("changed");
    assert_eq!((without.derived.len(), &without.rule), (0, &rule));
    assert_eq!(store.environment("street"), Some(without));

    let changed = store.change(made.id, &of_derived(some)).await;
    let changed = changed.expect("changed");
    store.close().await;
    drop(store);
    let store = database.open(Quotas::default()).await;
    assert_eq!(store.environment("street"), Some(changed));
}

async fn environments_survive(database: &dyn Database) {
    let (store, _) = open(database).await;
    make(&store, "counter_circuit").await;
    let before = store.environments();
    assert_eq!(
        before.iter().map(|e| e.name.as_str()).collect::<Vec<_>>(),
        ["counter_circuit", "hallway"]
    );
    drop(store);
    let store = database.open(Quotas::default()).await;
    assert_eq!(store.environments(), before);
    store.close().await;
    assert_eq!(
        database.open(Quotas::default()).await.environments(),
        before
    );
}

async fn batches_count_in_their_order(database: &dyn Database) {
    let (store, id) = open(database).await;
    let first = batch(id, "game", 1)
        .cell(3, 5, tally(2, 1))
        .cell(3, 6, tally(1, 1))
        .cell(4, 5, tally(1, 0))
        .done();
    let second = batch(id, "game", 2).cell(3, 5, tally(10, 3)).done();
    assert_eq!(
        commit(&store, std::slice::from_ref(&first)).await,
        [applied(&first)]
    );
    assert_eq!(
        commit(&store, std::slice::from_ref(&second)).await,
        [applied(&second)]
    );
    assert_eq!(
        cells(&store, id, 3).await,
        [(5, 12, Some(4)), (6, 1, Some(1))]
    );
    assert_eq!(cells(&store, id, 4).await, [(5, 1, Some(0))]);
    assert_eq!(cells(&store, id, 9).await, []);
    let expected = Totals {
        transitions: 14,
        states: 2,
        cells: cells_of(&[5, 6, 5]),
        segments: 1,
        producers: 1,
    };
    assert_eq!(totals(&store, id).await, expected);
    assert_eq!(watermark(&store, id, "game").await, 2);
    assert_eq!(watermark(&store, id, "another").await, 0);
}

async fn a_producer_belongs_to_the_first_name_that_speaks_for_it(database: &dyn Database) {
    let (store, id) = open(database).await;
    let of = |producer: &str, sequence, owner: Option<&str>| {
        let batch = batch(id, producer, sequence).cell(0, 1, tally(1, 1)).done();
        Numbered {
            owner: owner.map(|owner| owner.parse().expect("a name")),
            ..batch
        }
    };
    let owner = async |producer: &str| {
        let owner = store
            .owner(id, &producer.parse().expect("an id"))
            .await
            .expect("read");
        owner.map(|name| name.to_string())
    };
    let refused = Outcome::Refused(Refusal::Foreign);

    // In one commit, and nobody's from before.
    let batches = [
        of("p", 1, Some("a")),
        of("p", 2, Some("b")),
        of("p", 2, Some("a")),
        of("old", 1, None),
    ];
    let outcomes = store.commit(&batches).await.expect("committed");
    assert_eq!(
        outcomes
            .iter()
            .map(|outcome| *outcome == refused)
            .collect::<Vec<_>>(),
        [false, true, false, false]
    );
    assert_eq!(
        (
            owner("p").await.as_deref(),
            owner("old").await,
            owner("new").await
        ),
        (Some("a"), None, None)
    );

    // In a later one: also what was counted before is not told to others, and a gap of theirs is
    // none of their business.
    let batches = [
        of("p", 1, Some("b")),
        of("p", 9, Some("b")),
        of("old", 2, Some("b")),
        of("old", 3, Some("a")),
    ];
    let outcomes = store.commit(&batches).await.expect("committed");
    assert_eq!(
        outcomes
            .iter()
            .map(|outcome| *outcome == refused)
            .collect::<Vec<_>>(),
        [true, true, false, true]
    );
    assert_eq!(owner("old").await.as_deref(), Some("b"));

    // A refused batch gives nobody a producer, and whoever needs no key speaks for all.
    let outcomes = store
        .commit(&[of("gap", 2, Some("a")), of("p", 3, None)])
        .await
        .expect("committed");
    assert!(
        matches!(outcomes[0], Outcome::Refused(Refusal::OutOfOrder { .. }))
            && outcomes[1] != refused
    );
    assert_eq!(
        (owner("gap").await, owner("p").await.as_deref()),
        (None, Some("a"))
    );
}

async fn a_gap_is_refused(database: &dyn Database) {
    let (store, id) = open(database).await;
    for ahead in [2, 3, u64::MAX >> 1] {
        let batch = batch(id, "game", ahead).cell(1, 1, tally(1, 1)).done();
        assert_eq!(commit(&store, &[batch]).await, [out_of_order(1)]);
    }
    assert_eq!(totals(&store, id).await, Totals::default());
    let first = batch(id, "game", 1).done();
    commit(&store, std::slice::from_ref(&first)).await;
    assert_eq!(
        commit(&store, &[batch(id, "game", 3).done()]).await,
        [out_of_order(2)]
    );
}

async fn a_number_used_with_another_content_is_refused(database: &dyn Database) {
    let (store, id) = open(database).await;
    let first = batch(id, "game", 1).cell(1, 1, tally(1, 1)).done();
    let other = batch(id, "game", 1)
        .cell(2, 2, tally(5, 5))
        .content(77)
        .done();
    assert_eq!(
        commit(&store, &[first.clone(), other.clone()]).await,
        [applied(&first), Outcome::Refused(Refusal::Reused)]
    );
    assert_eq!(
        commit(&store, &[other]).await,
        [Outcome::Refused(Refusal::Reused)]
    );
    assert_eq!(
        commit(&store, std::slice::from_ref(&first)).await,
        [duplicate(&first)]
    );
    assert_eq!(totals(&store, id).await.transitions, 1);
}

async fn duplicates_get_their_first_receipt(database: &dyn Database) {
    let (store, id) = open(database).await;
    let mut first = batch(id, "game", 1).cell(1, 1, tally(1, 1)).done();
    let rejection = nudge::domain::Rejection {
        index: 7,
        field: "/state/x".into(),
        reason: "got \"NaN\"".into(),
    };
    first.receipt.rejected_count = 101;
    first.receipt.rejected = vec![rejection; 100];
    let mut again = first.clone();
    again.receipt = Default::default();
    let outcomes = commit(&store, &[first.clone(), again.clone(), again.clone()]).await;
    assert_eq!(
        outcomes,
        [applied(&first), duplicate(&first), duplicate(&first)]
    );
    assert_eq!(commit(&store, &[again]).await, [duplicate(&first)]);
    assert_eq!(totals(&store, id).await.transitions, 1);
}

async fn duplicates_are_known_after_reopening(database: &dyn Database) {
    let (store, id) = open(database).await;
    let batches: Vec<Numbered> = (1..=5)
        .map(|s| batch(id, "game", s).cell(1, s, tally(s, 0)).done())
        .collect();
    commit(&store, &batches).await;
    drop(store);
    let store = database.open(Quotas::default()).await;
    let expected: Vec<Outcome> = batches.iter().map(duplicate).collect();
    assert_eq!(commit(&store, &batches).await, expected);
    assert_eq!(watermark(&store, id, "game").await, 5);
    assert_eq!(totals(&store, id).await.transitions, 15);
}

async fn duplicates_older_than_the_last_1024_are_unverified(database: &dyn Database) {
    let (store, id) = open(database).await;
    let batches: Vec<Numbered> = (1..=1_030)
        .map(|s| batch(id, "game", s).cell(1, 1, tally(1, 1)).done())
        .collect();
    for chunk in batches.chunks(300) {
        commit(&store, chunk).await;
    }
    let kept = 1_030 - 1_024;
    let outcomes = commit(
        &store,
        &[
            batches[0].clone(),
            batches[kept - 1].clone(),
            batches[kept].clone(),
        ],
    )
    .await;
    assert_eq!(
        outcomes,
        [unverified(), unverified(), duplicate(&batches[kept])]
    );
    let mut other = batches[0].clone();
    other.digest = nudge::domain::Digest([99; 32]);
    assert_eq!(commit(&store, &[other]).await, [unverified()]);
    // A commit may itself push a batch out of what is kept.
    let next = batch(id, "game", 1_031).done();
    assert_eq!(
        commit(&store, &[next.clone(), batches[kept].clone()]).await,
        [applied(&next), unverified()]
    );
    assert_eq!(totals(&store, id).await.transitions, 1_030);
}

/// Nobody sends 2^63 batches, so the last number is only refused here; the SQLite tests reach it.
async fn the_largest_sequence_has_no_successor(database: &dyn Database) {
    let (store, id) = open(database).await;
    let last = batch(id, "game", u64::MAX >> 1).done();
    assert_eq!(commit(&store, &[last]).await, [out_of_order(1)]);
    assert!(Sequence::new(1 << 63).is_err());
}

async fn a_run_of_one_producer_advances_in_one_commit(database: &dyn Database) {
    let (store, id) = open(database).await;
    let send = |producer, sequence| batch(id, producer, sequence).cell(1, 1, tally(1, 1)).done();
    let batches = [
        send("a", 1),
        send("b", 1),
        send("a", 2),
        send("a", 4),
        send("a", 3),
        send("a", 4),
        send("a", 2),
    ];
    let outcomes = commit(&store, &batches).await;
    let expected = [
        applied(&batches[0]),
        applied(&batches[1]),
        applied(&batches[2]),
        out_of_order(3),
        applied(&batches[4]),
        applied(&batches[5]),
        duplicate(&batches[6]),
    ];
    assert_eq!(outcomes, expected);
    assert_eq!(
        (
            watermark(&store, id, "a").await,
            watermark(&store, id, "b").await
        ),
        (4, 1)
    );
    assert_eq!(cells(&store, id, 1).await, [(1, 5, Some(5))]);
}

async fn a_refused_batch_changes_nothing_for_the_others(database: &dyn Database) {
    let (store, id) = open(database).await;
    let gone = EnvironmentId(id.0 + 1);
    let batches = [
        batch(gone, "a", 1).cell(1, 1, tally(1, 1)).done(),
        batch(id, "a", 2).cell(1, 1, tally(1, 1)).done(),
        batch(id, "b", 1).cell(1, 1, tally(1, 1)).done(),
    ];
    let expected = [
        Outcome::Refused(Refusal::Gone),
        out_of_order(1),
        applied(&batches[2]),
    ];
    assert_eq!(commit(&store, &batches).await, expected);
    let expected = Totals {
        transitions: 1,
        states: 1,
        cells: cells_of(&[1]),
        segments: 1,
        producers: 1,
    };
    assert_eq!(totals(&store, id).await, expected);
    assert_eq!(commit(&store, &[]).await, []);
}

async fn empty_batches_use_their_numbers(database: &dyn Database) {
    let (store, id) = open(database).await;
    let first = batch(id, "game", 1).segment("trial-1").done();
    let second = batch(id, "game", 2).cell(1, 1, tally(1, 1)).done();
    assert_eq!(
        commit(&store, std::slice::from_ref(&first)).await,
        [applied(&first)]
    );
    assert_eq!(
        commit(&store, &[first.clone(), second.clone()]).await,
        [duplicate(&first), applied(&second)]
    );
    assert_eq!(
        totals(&store, id).await.segments,
        1,
        "a segment begins with its first cell"
    );
    assert_eq!(watermark(&store, id, "game").await, 2);
}

async fn a_new_environment_of_the_same_name_begins_anew(database: &dyn Database) {
    let (store, old) = open(database).await;
    let first = batch(old, "game", 1)
        .cell(1, 1, tally(1, 1))
        .segment("trial")
        .done();
    commit(&store, std::slice::from_ref(&first)).await;
    assert_eq!(cells(&store, old, 1).await.len(), 1);
    let old_uid = store.environment("hallway").expect("there").uid.clone();
    store.delete(old).await.expect("removed");

    let new = make(&store, "hallway").await;
    assert_ne!(
        (old, &old_uid),
        (new, &store.environment("hallway").expect("there").uid)
    );
    assert_eq!(
        commit(&store, &[first]).await,
        [Outcome::Refused(Refusal::Gone)]
    );
    assert_eq!(
        (
            watermark(&store, new, "game").await,
            totals(&store, new).await
        ),
        (0, Totals::default())
    );
    assert_eq!(cells(&store, new, 1).await, []);
    let first = batch(new, "game", 1).cell(1, 1, tally(3, 3)).done();
    assert_eq!(
        commit(&store, std::slice::from_ref(&first)).await,
        [applied(&first)]
    );
    assert_eq!(cells(&store, new, 1).await, [(1, 3, Some(3))]);
    assert!(
        store
            .audit()
            .await
            .expect("an audit")
            .iter()
            .all(|audit| audit.is_sound())
    );
}

/// Makes an environment with so many states, of three cells each.
async fn make_large(store: &Arc<dyn Store>, name: &str, states: u32) -> EnvironmentId {
    let id = make(store, name).await;
    let cells = (0..states).flat_map(|place| (0..3).map(move |joint| (place, joint)));
    let sending = cells.fold(batch(id, "game", 1), |sending, (place, joint)| {
        sending.cell(place, joint, tally(1, 1))
    });
    let first = sending.done();
    assert_eq!(
        commit(store, std::slice::from_ref(&first)).await,
        [applied(&first)]
    );
    id
}

/// Removes what deleted environments have left, to the last row.
async fn sweep(store: &Arc<dyn Store>) {
    while store.leftovers() != Leftovers::default() {
        store.sweep().await.expect("a step");
    }
}

async fn a_deleted_environment_is_gone_before_its_rows(database: &dyn Database) {
    let store = database.open(Quotas::default()).await;
    let old = make_large(&store, "hallway", 1_000).await;
    let environment = store.environment("hallway").expect("made");
    keep(&store, old, 0, 1).await;
    store.delete(old).await.expect("removed");
    assert_eq!(
        store.leftovers(),
        Leftovers {
            environments: 1,
            states: 1_000
        }
    );

    // Before anything is swept, when something is, and after: nothing finds it.
    let new = make(&store, "hallway").await;
    let first = batch(new, "game", 1).cell(1, 1, tally(7, 7)).done();
    assert_eq!(
        commit(&store, std::slice::from_ref(&first)).await,
        [applied(&first)]
    );
    for steps in [0, 3, 1_000] {
        for _ in 0..steps {
            if store.leftovers() != Leftovers::default() {
                store.sweep().await.expect("a step");
            }
        }
        assert!(is_unknown(store.delete(old).await));
        assert!(is_unknown(store.totals(old).await) && is_unknown(store.segments(old).await));
        assert!(
            is_unknown(store.counts(old, &[state_at(1)]).await)
                && is_unknown(store.actions(&environment).await)
        );
        assert!(is_unknown(store.scan(old, Cursor::default(), 10).await));
        assert!(is_unknown(store.fits(old).await) && is_unknown(store.models(old).await));
        assert!(is_unknown(store.model(old, 1).await));
        assert!(is_unknown(
            store
                .watermark(old, &"game".parse().expect("a producer"))
                .await
        ));
        let late = batch(old, "game", 2).cell(1, 1, tally(1, 1)).done();
        assert_eq!(
            commit(&store, &[late]).await,
            [Outcome::Refused(Refusal::Gone)]
        );
        assert_eq!(cells(&store, new, 1).await, [(1, 7, Some(7))]);
    }
    assert_eq!(store.leftovers(), Leftovers::default());
    assert!(
        store
            .audit()
            .await
            .expect("an audit")
            .iter()
            .all(|audit| audit.is_sound())
    );
}

async fn a_read_that_goes_on_ends_with_its_environment(database: &dyn Database) {
    let store = database.open(Quotas::default()).await;
    let id = make_large(&store, "hallway", 30).await;
    let page = store.scan(id, Cursor::default(), 10).await.expect("a page");
    store.delete(id).await.expect("removed");
    assert!(is_unknown(store.scan(id, page[9].cursor, 10).await));
}

async fn several_environments_are_removed_at_once(database: &dyn Database) {
    let store = database.open(Quotas::default()).await;
    let stays = make_large(&store, "stays", 50).await;
    let mut left = 0;
    // Each has more parts than steps were taken: journal, producers, segments, itself.
    for _ in 0..4 {
        let id = make_large(&store, "hallway", 1_000).await;
        store.delete(id).await.expect("removed");
        left += 1;
        assert_eq!(store.leftovers().environments, left);
        // The next one goes while this one is swept.
        store.sweep().await.expect("a step");
    }
    sweep(&store).await;
    assert_eq!(totals(&store, stays).await.states, 50);
    assert!(
        store
            .audit()
            .await
            .expect("an audit")
            .iter()
            .all(|audit| audit.is_sound())
    );
}

async fn an_interrupted_removal_goes_on_after_reopening(database: &dyn Database) {
    let store = database.open(Quotas::default()).await;
    let [one, other] = [
        make_large(&store, "one", 1_000).await,
        make_large(&store, "other", 1_000).await,
    ];
    store.delete(one).await.expect("removed");
    store.sweep().await.expect("a step");
    store.delete(other).await.expect("removed");
    drop(store);

    let store = database.open(Quotas::default()).await;
    assert_eq!(store.leftovers().environments, 2);
    store.sweep().await.expect("a step");
    let left = store.leftovers().states;
    assert!(
        (1_000..=2_000).contains(&left),
        "all are counted with the first step: {left}"
    );
    make_large(&store, "one", 20).await;
    sweep(&store).await;
    drop(store);
    let store = database.open(Quotas::default()).await;
    assert_eq!(store.leftovers(), Leftovers::default());
    assert_eq!(store.environments().len(), 1);
    assert!(
        store
            .audit()
            .await
            .expect("an audit")
            .iter()
            .all(|audit| audit.is_sound())
    );
}

async fn the_cells_quota_is_exact(database: &dyn Database) {
    let store = database
        .open(Quotas {
            cells: 4,
            ..Quotas::default()
        })
        .await;
    let id = make(&store, "hallway").await;
    let three = batch(id, "a", 1)
        .cell(1, 1, tally(1, 1))
        .cell(1, 2, tally(1, 1))
        .cell(2, 1, tally(1, 1))
        .done();
    let two_more = batch(id, "b", 1)
        .cell(5, 1, tally(1, 1))
        .cell(5, 2, tally(1, 1))
        .done();
    let one_more = batch(id, "b", 1)
        .cell(1, 1, tally(1, 1))
        .cell(5, 1, tally(1, 1))
        .content(2)
        .done();
    assert_eq!(
        commit(&store, std::slice::from_ref(&three)).await,
        [applied(&three)]
    );
    assert_eq!(
        commit(&store, std::slice::from_ref(&two_more)).await,
        [over_quota("cells", 4)]
    );
    assert_eq!(
        totals(&store, id).await.producers,
        1,
        "a refused batch does not make its producer"
    );
    assert_eq!(
        commit(&store, &[two_more.clone(), one_more.clone()]).await,
        [over_quota("cells", 4), applied(&one_more)]
    );
    assert_eq!(totals(&store, id).await.cells, 4);
    let another_segment = batch(id, "a", 2)
        .cell(1, 1, tally(1, 1))
        .segment("x")
        .done();
    assert_eq!(
        commit(&store, &[another_segment]).await,
        [over_quota("cells", 4)]
    );
    assert_eq!(
        totals(&store, id).await.segments,
        1,
        "a refused batch does not make its segment"
    );
}

async fn the_cells_quota_counts_what_the_same_commit_adds(database: &dyn Database) {
    let store = database
        .open(Quotas {
            cells: 3,
            ..Quotas::default()
        })
        .await;
    let id = make(&store, "hallway").await;
    let known = batch(id, "a", 1).cell(1, 1, tally(1, 1)).done();
    commit(&store, std::slice::from_ref(&known)).await;
    let batches = [
        batch(id, "a", 2)
            .cell(1, 1, tally(1, 1))
            .cell(1, 2, tally(1, 1))
            .done(),
        batch(id, "b", 1)
            .cell(1, 2, tally(1, 1))
            .cell(1, 1, tally(1, 1))
            .done(),
        batch(id, "c", 1)
            .cell(1, 3, tally(1, 1))
            .cell(1, 4, tally(1, 1))
            .done(),
        batch(id, "d", 1)
            .cell(1, 3, tally(1, 1))
            .cell(1, 2, tally(1, 1))
            .cell(1, 1, tally(1, 1))
            .done(),
        batch(id, "e", 1).cell(1, 5, tally(1, 1)).done(),
    ];
    let expected = [
        applied(&batches[0]),
        applied(&batches[1]),
        over_quota("cells", 3),
        applied(&batches[3]),
        over_quota("cells", 3),
    ];
    assert_eq!(commit(&store, &batches).await, expected);
    assert_eq!(
        cells(&store, id, 1).await,
        [(1, 4, Some(4)), (2, 3, Some(3)), (3, 1, Some(1))]
    );
    assert_eq!(totals(&store, id).await.cells, 3);
}

async fn known_cells_fit_at_the_quota(database: &dyn Database) {
    let store = database.open(Quotas::default()).await;
    let id = make(&store, "hallway").await;
    let first = batch(id, "a", 1)
        .cell(1, 1, tally(1, 1))
        .cell(1, 2, tally(1, 1))
        .done();
    commit(&store, &[first]).await;
    drop(store);
    // Somebody lowered the quota below what is there.
    let store = database
        .open(Quotas {
            cells: 1,
            ..Quotas::default()
        })
        .await;
    let known = batch(id, "a", 2)
        .cell(1, 1, tally(1, 1))
        .cell(1, 2, tally(1, 1))
        .done();
    let new = batch(id, "a", 3).cell(1, 3, tally(1, 1)).done();
    assert_eq!(
        commit(&store, &[known.clone(), new]).await,
        [applied(&known), over_quota("cells", 1)]
    );
}

async fn the_segments_quota_is_exact(database: &dyn Database) {
    let store = database
        .open(Quotas {
            segments: 2,
            ..Quotas::default()
        })
        .await;
    let id = make(&store, "hallway").await;
    let send = |producer, label: &str| {
        batch(id, producer, 1)
            .cell(1, 1, tally(1, 1))
            .segment(label)
            .done()
    };
    let plain = batch(id, "a", 1).cell(1, 1, tally(1, 1)).done();
    let batches = [
        plain,
        send("b", "x"),
        send("c", "x"),
        send("d", "y"),
        batch(id, "e", 1).segment("z").done(),
    ];
    let expected = [
        applied(&batches[0]),
        applied(&batches[1]),
        applied(&batches[2]),
        over_quota("segments", 2),
        applied(&batches[4]),
    ];
    assert_eq!(commit(&store, &batches).await, expected);
    assert_eq!(
        commit(&store, &[send("d", "y")]).await,
        [over_quota("segments", 2)]
    );
    assert_eq!(totals(&store, id).await.segments, 2);
}

async fn the_producers_quota_is_exact(database: &dyn Database) {
    let store = database
        .open(Quotas {
            producers: 2,
            ..Quotas::default()
        })
        .await;
    let id = make(&store, "hallway").await;
    let batches = [
        batch(id, "a", 1).done(),
        batch(id, "b", 1).done(),
        batch(id, "c", 1).done(),
        batch(id, "a", 2).done(),
    ];
    let expected = [
        applied(&batches[0]),
        applied(&batches[1]),
        over_quota("producers", 2),
        applied(&batches[3]),
    ];
    assert_eq!(commit(&store, &batches).await, expected);
    assert_eq!(
        commit(&store, &batches[2..3]).await,
        [over_quota("producers", 2)]
    );
    assert_eq!(totals(&store, id).await.producers, 2);
}

async fn the_environments_quota_is_exact(database: &dyn Database) {
    let store = database
        .open(Quotas {
            environments: 2,
            ..Quotas::default()
        })
        .await;
    let create = async |store: &Arc<dyn Store>, name: &str| {
        store
            .create(
                &name.parse().expect("a name"),
                &schema(),
                &Default::default(),
            )
            .await
    };
    let is_full = |made| {
        matches!(
            made,
            Err(StoreError::Quota {
                what: "environments",
                limit: 2,
                ..
            })
        )
    };
    let one = make_large(&store, "one", 10).await;
    make(&store, "two").await;
    assert!(is_full(create(&store, "three").await));
    assert!(matches!(
        create(&store, "two").await,
        Err(StoreError::AlreadyExists(_))
    ));
    store.delete(one).await.expect("removed");
    make(&store, "three").await;
    assert!(is_full(create(&store, "four").await));
    assert_eq!(
        store.leftovers().environments,
        1,
        "rows that are left are no environment"
    );
    drop(store);

    let store = database
        .open(Quotas {
            environments: 1,
            ..Quotas::default()
        })
        .await;
    assert_eq!(store.environments().len(), 2, "what is stored stays");
    assert!(matches!(
        create(&store, "four").await,
        Err(StoreError::Quota { limit: 1, .. })
    ));
}

async fn the_models_quota_is_exact(database: &dyn Database) {
    let store = database
        .open(Quotas {
            models: 2,
            ..Quotas::default()
        })
        .await;
    let (id, elsewhere) = (make(&store, "hallway").await, make(&store, "kitchen").await);
    assert_eq!(
        (keep(&store, id, 0, 1).await, keep(&store, id, 1, 0).await),
        (1, 2)
    );
    let refused = store.keep_model(id, &network(0, 1, b"more")).await;
    assert!(
        matches!(
            refused,
            Err(StoreError::Quota {
                what: "models",
                limit: 2,
                ..
            })
        ),
        "{refused:?}"
    );
    assert_eq!(keep(&store, elsewhere, 0, 1).await, 1);
    store.delete_model(id, 1).await.expect("deleted");
    assert_eq!(
        keep(&store, id, 0, 1).await,
        3,
        "a refused one uses no version"
    );
    drop(store);

    let store = database
        .open(Quotas {
            models: 1,
            ..Quotas::default()
        })
        .await;
    assert_eq!(models(&store, id).await.len(), 2, "what is stored stays");
    activate(&store, id, &[2]).await;
    assert!(store.keep_model(id, &network(0, 1, b"more")).await.is_err());
}

async fn transitions_stop_at_the_largest_number(database: &dyn Database) {
    let (store, id) = open(database).await;
    const MOST: u64 = u64::MAX >> 1;
    let nearly = batch(id, "a", 1)
        .cell(1, 1, tally(MOST - 1, MOST - 1))
        .done();
    let two = batch(id, "a", 2).cell(1, 1, tally(2, 0)).done();
    let elsewhere = batch(id, "b", 1)
        .cell(9, 9, tally(u64::MAX, 0))
        .cell(9, 8, tally(2, 0))
        .done();
    let one = batch(id, "c", 1).cell(1, 1, tally(1, 0)).done();
    let one_too_many = batch(id, "d", 1).cell(7, 7, tally(1, 0)).done();
    let overflow = Outcome::Refused(Refusal::Overflow);
    let batches = [nearly.clone(), two, elsewhere, one.clone(), one_too_many];
    let expected = [
        applied(&nearly),
        overflow.clone(),
        overflow.clone(),
        applied(&one),
        overflow.clone(),
    ];
    assert_eq!(commit(&store, &batches).await, expected);
    assert_eq!(commit(&store, &batches[4..]).await, [overflow]);
    assert_eq!(totals(&store, id).await.transitions, MOST);
    assert_eq!(cells(&store, id, 1).await, [(1, MOST, Some(MOST - 1))]);
    assert_eq!(watermark(&store, id, "a").await, 1);
    assert!(store.audit().await.expect("an audit")[0].is_sound());
}

async fn a_joint_action_that_cannot_be_stored_is_refused(database: &dyn Database) {
    let (store, id) = open(database).await;
    let far = batch(id, "a", 1).cell(1, 3, tally(1, 1)).done();
    let beyond = batch(id, "b", 1).cell(1, 1 << 63, tally(1, 1)).done();
    assert_eq!(
        commit(&store, &[far.clone(), beyond]).await,
        [applied(&far), Outcome::Refused(Refusal::Overflow)]
    );
    assert_eq!(cells(&store, id, 1).await, [(3, 1, Some(1))]);
}

async fn entries_become_unknown_and_stay_so(database: &dyn Database) {
    let (store, id) = open(database).await;
    let unknown = Tally {
        n: 2,
        entries: None,
    };
    let steps = [tally(3, 2), unknown, tally(1, 1)];
    for (sequence, step) in (1..).zip(steps) {
        // One cell warm in the cache, one never read before the end.
        commit(
            &store,
            &[batch(id, "a", sequence)
                .cell(1, 1, step)
                .cell(2, 1, step)
                .done()],
        )
        .await;
        cells(&store, id, 1).await;
    }
    assert_eq!(cells(&store, id, 1).await, [(1, 6, None)]);
    assert_eq!(cells(&store, id, 2).await, [(1, 6, None)]);
    let together: Vec<Numbered> = (1..)
        .zip(steps)
        .map(|(s, step)| batch(id, "b", s).cell(3, 1, step).done())
        .collect();
    commit(&store, &together).await;
    assert_eq!(cells(&store, id, 3).await, [(1, 6, None)]);
}

async fn segments_are_kept_apart(database: &dyn Database) {
    let (store, id) = open(database).await;
    let batches = [
        batch(id, "a", 1).cell(1, 1, tally(1, 1)).done(),
        batch(id, "a", 2)
            .cell(1, 1, tally(2, 2))
            .segment("train")
            .done(),
        batch(id, "a", 3)
            .cell(1, 1, tally(4, 4))
            .segment("a \"quoted\" 左")
            .done(),
        batch(id, "a", 4)
            .cell(1, 1, tally(8, 8))
            .segment("train")
            .done(),
    ];
    commit(&store, &batches[..2]).await;
    commit(&store, &batches[2..]).await;
    let segments = store.segments(id).await.expect("segments");
    let labels: Vec<Option<&str>> = segments
        .iter()
        .map(|(_, label)| label.as_ref().map(|l| l.as_str()))
        .collect();
    assert_eq!(labels, [None, Some("a \"quoted\" 左"), Some("train")]);
    let counts = store.counts(id, &[state_at(1)]).await.expect("counts");
    let of = |at: usize| {
        counts[0]
            .counts
            .of_segments(Some(&[segments[at].0]))
            .map(|cell| cell.tally.n)
            .sum::<u64>()
    };
    assert_eq!([of(0), of(1), of(2)], [1, 4, 10]);
    assert_eq!(totals(&store, id).await.cells, cells_of(&[1; 3]));
}

async fn counts_come_in_the_order_asked(database: &dyn Database) {
    let (store, id) = open(database).await;
    commit(
        &store,
        &[batch(id, "a", 1)
            .cell(1, 1, tally(1, 0))
            .cell(2, 1, tally(2, 0))
            .done()],
    )
    .await;
    store.counts(id, &[state_at(2)]).await.expect("counts");
    let keys = [state_at(2), state_at(7), state_at(1), state_at(2)];
    for _ in 0..2 {
        let counts = store.counts(id, &keys).await.expect("counts");
        let visits: Vec<u64> = counts
            .iter()
            .map(|c| c.counts.cells().iter().map(|cell| cell.tally.n).sum())
            .collect();
        assert_eq!(visits, [2, 0, 1, 2]);
        assert!(counts.iter().all(|c| c.revision == 3));
    }
    assert_eq!(store.counts(id, &[]).await.expect("nothing asked"), []);
}

async fn many_states_are_read_at_once(database: &dyn Database) {
    let (store, id) = open(database).await;
    let sending = (0..5_000).fold(batch(id, "a", 1), |sending, place| {
        if place % 2 == 0 {
            sending.cell(place, u64::from(place), tally(1, 1))
        } else {
            sending
        }
    });
    commit(&store, &[sending.done()]).await;
    let keys: Vec<_> = (0..10_000).rev().map(|at| state_at(at % 5_000)).collect();
    let counts = store.counts(id, &keys).await.expect("counts");
    for (key, counts) in keys.iter().zip(&counts) {
        let place = key.bins()[0];
        let joints: Vec<u64> = counts
            .counts
            .cells()
            .iter()
            .map(|cell| cell.joint)
            .collect();
        assert_eq!(
            joints,
            if place % 2 == 0 {
                vec![u64::from(place)]
            } else {
                vec![]
            }
        );
    }
}

async fn a_scan_sees_every_state_once(database: &dyn Database) {
    let (store, id) = open(database).await;
    let other = make(&store, "other").await;
    let many = |id, producer: &str, places: std::ops::Range<u32>| {
        places
            .fold(batch(id, producer, 1), |b, place| {
                b.cell(place, 1, tally(1, 1)).cell(place, 2, tally(1, 0))
            })
            .done()
    };
    commit(
        &store,
        &[
            many(id, "a", 0..10),
            many(other, "a", 0..10),
            many(id, "b", 10..25),
        ],
    )
    .await;
    for most in [1, 2, 7, 25] {
        let mut seen = Vec::new();
        let mut cursor = Cursor::default();
        loop {
            let page = store.scan(id, cursor, most).await.expect("a page");
            let Some(last) = page.last() else { break };
            assert!(page.len() <= most as usize);
            cursor = last.cursor;
            assert!(page.iter().all(|state| state.counts.cells().len() == 2));
            seen.extend(page.into_iter().map(|scanned| scanned.key));
        }
        seen.sort();
        assert_eq!(seen, (0..25).map(state_at).collect::<Vec<_>>(), "{most}");
    }
}

/// Returns every state in the order asked for, by what a scan finds.
async fn ordered(
    store: &Arc<dyn Store>,
    id: EnvironmentId,
    wanted: &ByVisits,
) -> Vec<(u64, StateKey)> {
    let visits = |scanned: &Scanned| {
        let cells = scanned.counts.of_segments(wanted.segments.as_deref());
        (
            cells.map(|cell| cell.tally.n).sum::<u64>(),
            scanned.key.clone(),
        )
    };
    let scanned = store
        .scan(id, Cursor::default(), 1_000)
        .await
        .expect("a page");
    let mut states: Vec<_> = scanned.iter().map(visits).collect();
    states.retain(|(visits, _)| *visits >= wanted.min_visits.max(1));
    states.sort();
    // Equally many stay in order of key.
    if wanted.descending {
        states.sort_by_key(|(visits, _)| std::cmp::Reverse(*visits));
    }
    states
}

async fn states_are_found_in_the_order_of_their_visits(database: &dyn Database) {
    let (store, id) = open(database).await;
    let other = make(&store, "other").await;
    let all = |descending, min_visits| ByVisits {
        segments: None,
        min_visits,
        descending,
        after: None,
        states: 7,
    };
    assert_eq!(
        store.by_visits(id, &all(true, 0)).await.expect("none yet"),
        (Vec::new(), 0)
    );

    // Two segments, another environment in between, and keys whose texts are in another order than
    // their bins.
    let many = |id, producer: &str, places: std::ops::Range<u32>, step: u64| {
        let cell = |b: Sending, place: u32| {
            b.cell(place, 1, tally(1 + u64::from(place) * step % 5, 0))
                .cell(place, 2, tally(1, 0))
        };
        places.fold(batch(id, producer, 1), cell)
    };
    let (plain, trained) = (
        many(id, "a", 0..130, 7).done(),
        many(id, "b", 90..140, 3).segment("train").done(),
    );
    commit(
        &store,
        &[plain, many(other, "a", 0..140, 1).done(), trained],
    )
    .await;
    let segments = store.segments(id).await.expect("segments");
    let chosen = [
        None,
        Some(vec![segments[1].0]),
        Some(segments.iter().map(|(id, _)| *id).collect()),
        Some(vec![]),
    ];
    let transitions = totals(&store, id).await.transitions;

    for segments in chosen {
        for (descending, min_visits) in [
            (true, 0),
            (false, 0),
            (true, 4),
            (false, 4),
            (true, 1_000),
            (true, u64::MAX),
        ] {
            let mut wanted = ByVisits {
                segments: segments.clone(),
                ..all(descending, min_visits)
            };
            let expected = ordered(&store, id, &wanted).await;
            for page in expected.chunks(7) {
                let (found, revision) = store.by_visits(id, &wanted).await.expect("a page");
                let keys: Vec<&StateKey> = found.iter().map(|scanned| &scanned.key).collect();
                assert_eq!(
                    keys,
                    page.iter().map(|(_, key)| key).collect::<Vec<_>>(),
                    "{wanted:?}"
                );
                assert_eq!(revision, transitions);
                let read = store
                    .counts(id, &keys.into_iter().cloned().collect::<Vec<_>>())
                    .await
                    .expect("counts");
                assert!(
                    found
                        .iter()
                        .zip(read)
                        .all(|(found, read)| found.counts == *read.counts),
                    "all of its cells"
                );
                wanted.after = page.last().cloned();
            }
            assert_eq!(
                store.by_visits(id, &wanted).await.expect("the end").0,
                [],
                "{wanted:?}"
            );
        }
    }

    store.delete(id).await.expect("deleted");
    assert!(matches!(
        store.by_visits(id, &all(true, 0)).await,
        Err(StoreError::UnknownEnvironment)
    ));
}

async fn what_a_commit_counts_is_read_after_it(database: &dyn Database) {
    let (store, id) = open(database).await;
    for sequence in 1..=20 {
        let sending = batch(id, "a", sequence)
            .cell(1, sequence % 3, tally(1, 1))
            .cell(2, 0, tally(1, 1));
        commit(&store, &[sending.done()]).await;
        let counts = store
            .counts(id, &[state_at(1), state_at(2), state_at(3)])
            .await
            .expect("counts");
        let visits = |at: usize| {
            counts[at]
                .counts
                .cells()
                .iter()
                .map(|cell| cell.tally.n)
                .sum::<u64>()
        };
        assert_eq!([visits(0), visits(1), visits(2)], [sequence, sequence, 0]);
        assert!(counts.iter().all(|c| c.revision == 2 * sequence));
    }
}

/// Returns how often each action was taken, after comparing that with the cells.
async fn actions(store: &Arc<dyn Store>, name: &str) -> Arc<ActionTotals> {
    let environment = store.environment(name).expect("made");
    let actions = store.actions(&environment).await.expect("actions");
    assert_eq!(*actions, actions_by_scan(&**store, &environment).await);
    assert_eq!(
        actions.revision,
        totals(store, environment.id).await.transitions
    );
    actions
}

/// Returns the actions that an agent took, with how often.
fn drawn(actions: &ActionTotals, agent: usize) -> Vec<(usize, u64)> {
    actions
        .draws(agent)
        .into_iter()
        .enumerate()
        .filter(|(_, n)| *n > 0)
        .collect()
}

async fn nobody_acted_in_an_empty_environment(database: &dyn Database) {
    let (store, _) = open(database).await;
    for _ in 0..2 {
        let actions = actions(&store, "hallway").await;
        assert_eq!(
            [0, 1].map(|agent| actions.draws(agent)),
            [vec![0; 1_024], vec![0; 1_024]]
        );
    }
}

async fn actions_add_up_over_states_and_segments(database: &dyn Database) {
    let (store, id) = open(database).await;
    let elsewhere = make(&store, "kitchen").await;
    let batches = [
        batch(id, "a", 1)
            .cell(1, 3 * 1_024 + 7, tally(5, 2))
            .cell(2, 3 * 1_024 + 8, tally(4, 4))
            .done(),
        batch(id, "a", 2)
            .cell(1, 3 * 1_024 + 7, tally(9, 1))
            .segment("train")
            .done(),
        batch(id, "b", 1)
            .cell(3, 1_023 * 1_024 + 1_023, tally(1, 1))
            .done(),
        batch(elsewhere, "a", 1).cell(1, 0, tally(100, 100)).done(),
    ];
    commit(&store, &batches).await;
    for _ in 0..2 {
        let actions = actions(&store, "hallway").await;
        assert_eq!(drawn(&actions, 0), [(3, 7), (1_023, 1)]);
        assert_eq!(drawn(&actions, 1), [(7, 3), (8, 4), (1_023, 1)]);
    }
    assert_eq!(drawn(&*actions(&store, "kitchen").await, 1), [(0, 100)]);
}

async fn actions_of_three_agents_come_apart(database: &dyn Database) {
    let store = database.open(Quotas::default()).await;
    let schema = schema_of(&[("robot", 2), ("human", 5_000), ("dog", 3)]);
    let made = store
        .create(
            &"yard".parse().expect("a name"),
            &schema,
            &Default::default(),
        )
        .await
        .expect("made");
    let joint = |[robot, human, dog]: [u64; 3]| (robot * 5_000 + human) * 3 + dog;
    for sequence in 1..=2 {
        let sending = batch(made.id, "a", sequence).cell(1, joint([1, 4_999, 2]), tally(2, 2));
        commit(
            &store,
            &[sending.cell(2, joint([0, 0, 2]), tally(1, 1)).done()],
        )
        .await;
        let actions = actions(&store, "yard").await;
        assert_eq!(drawn(&actions, 0), [(0, sequence), (1, 2 * sequence)]);
        assert!(actions.draws(1).is_empty(), "too many to tell");
        assert_eq!(actions.draws(2), [0, 0, 3 * sequence]);
    }
}

async fn actions_follow_every_commit(database: &dyn Database) {
    let (store, id) = open(database).await;
    let mut before: Option<Arc<ActionTotals>> = None;
    for sequence in 1..=5 {
        let next = batch(id, "a", sequence)
            .cell(sequence as u32, 1_024 * sequence, tally(sequence, 1))
            .done();
        commit(&store, &[next.clone(), next]).await;
        let now = actions(&store, "hallway").await;
        assert_eq!(
            drawn(&now, 0),
            (1..=sequence as usize)
                .map(|action| (action, 1))
                .collect::<Vec<_>>()
        );
        let last = before.replace(now);
        assert!(
            last.is_none_or(|last| drawn(&last, 0).len() as u64 == sequence - 1),
            "what was told has changed"
        );
    }
    store.close().await;
    let store = database.open(Quotas::default()).await;
    assert_eq!(Some(actions(&store, "hallway").await), before);
    commit(&store, &[batch(id, "a", 6).cell(1, 0, tally(1, 1)).done()]).await;
    assert_eq!(drawn(&*actions(&store, "hallway").await, 1), [(0, 6)]);
}

async fn actions_are_drawn_by_visits_once_a_flag_is_missing(database: &dyn Database) {
    let (store, id) = open(database).await;
    let unknown = Tally {
        n: 2,
        entries: None,
    };
    commit(
        &store,
        &[batch(id, "a", 1)
            .cell(1, 1, tally(3, 1))
            .cell(1, 2, tally(5, 0))
            .done()],
    )
    .await;
    assert_eq!(drawn(&*actions(&store, "hallway").await, 1), [(1, 1)]);
    // One told to what is in memory, one read with the rest.
    commit(&store, &[batch(id, "a", 2).cell(2, 9, unknown).done()]).await;
    let told = actions(&store, "hallway").await;
    store.close().await;
    let store = database.open(Quotas::default()).await;
    for actions in [told, actions(&store, "hallway").await] {
        assert_eq!(drawn(&actions, 0), [(0, 10)]);
        assert_eq!(drawn(&actions, 1), [(1, 3), (2, 5), (9, 2)]);
    }
}

async fn actions_go_with_their_environment(database: &dyn Database) {
    let (store, id) = open(database).await;
    let old = store.environment("hallway").expect("made");
    commit(&store, &[batch(id, "a", 1).cell(1, 1, tally(3, 3)).done()]).await;
    actions(&store, "hallway").await;
    store.delete(id).await.expect("removed");
    assert!(is_unknown(store.actions(&old).await));
    let again = make(&store, "hallway").await;
    assert!(is_unknown(store.actions(&old).await));
    assert_eq!(drawn(&*actions(&store, "hallway").await, 1), []);
    commit(
        &store,
        &[batch(again, "a", 1).cell(1, 2, tally(1, 1)).done()],
    )
    .await;
    assert_eq!(drawn(&*actions(&store, "hallway").await, 1), [(2, 1)]);
}

async fn an_audit_finds_nothing_wrong(database: &dyn Database) {
    let (store, id) = open(database).await;
    make(&store, "empty").await;
    commit(
        &store,
        &[batch(id, "a", 1)
            .cell(1, 1, tally(5, 1))
            .cell(2, 1, tally(6, 1))
            .done()],
    )
    .await;
    let audits = store.audit().await.expect("an audit");
    assert_eq!(
        audits
            .iter()
            .map(|a| a.environment.as_str())
            .collect::<Vec<_>>(),
        ["empty", "hallway"]
    );
    assert_eq!((audits[0].kept, audits[0].found), ([0; 3], [0; 3]));
    let held = [11, 2, cells_of(&[1, 1])];
    assert_eq!((audits[1].kept, audits[1].found), (held, held));
    assert!(store.ready().await.is_ok());
    assert!(store.bytes().await.expect("a size") > 0);
}

async fn many_new_states_in_one_commit(database: &dyn Database) {
    let (store, id) = open(database).await;
    let sending = |sequence, from: u32| {
        (from..from + 3_000)
            .fold(batch(id, "a", sequence), |b, place| {
                b.cell(place, 7, tally(1, 1))
            })
            .done()
    };
    commit(&store, &[sending(1, 0), sending(2, 1_500)]).await;
    commit(&store, &[sending(3, 3_000)]).await;
    let expected = Totals {
        transitions: 9_000,
        states: 6_000,
        cells: 6_000 * cells_of(&[7]),
        segments: 1,
        producers: 1,
    };
    assert_eq!(totals(&store, id).await, expected);
    assert_eq!(cells(&store, id, 3_100).await, [(7, 2, Some(2))]);
    assert!(store.audit().await.expect("an audit")[0].is_sound());
}

async fn environments_do_not_mix(database: &dyn Database) {
    let (store, one) = open(database).await;
    let two = make(&store, "other").await;
    let batches = [
        batch(one, "a", 1).cell(1, 1, tally(1, 1)).done(),
        batch(two, "a", 1).cell(1, 1, tally(10, 1)).done(),
        batch(two, "a", 2).cell(1, 1, tally(10, 1)).done(),
    ];
    let expected: Vec<Outcome> = batches.iter().map(applied).collect();
    assert_eq!(commit(&store, &batches).await, expected);
    assert_eq!(
        (
            watermark(&store, one, "a").await,
            watermark(&store, two, "a").await
        ),
        (1, 2)
    );
    assert_eq!(
        (cells(&store, one, 1).await, cells(&store, two, 1).await),
        (vec![(1, 1, Some(1))], vec![(1, 20, Some(2))])
    );
    let counts = store.counts(one, &[state_at(1)]).await.expect("counts");
    let cell = Cell {
        joint: 1,
        segment: SegmentId(counts[0].counts.cells()[0].segment.0),
        tally: tally(1, 1),
    };
    assert_eq!(
        (counts[0].counts.cells(), counts[0].revision),
        (&[cell][..], 1)
    );
    store.delete(one).await.expect("removed");
    assert_eq!(
        (
            totals(&store, two).await.transitions,
            cells(&store, two, 1).await.len()
        ),
        (20, 1)
    );
}

async fn the_last_fit_of_each_pair_is_kept(database: &dyn Database) {
    let (store, id) = open(database).await;
    let other = make(&store, "kitchen").await;
    let fit = |pair: &str, version: u64, body: &str| FitRecord {
        pair: pair.into(),
        id: FitId {
            version,
            revision: 10 * version,
        },
        body: body.into(),
        is_sound: true,
    };
    for kept in [
        fit("0,1", 1, "old"),
        fit("0,1|2", 1, "given"),
        fit("0,1", 2, "new"),
    ] {
        store.keep_fit(id, &kept).await.expect("kept");
    }
    let expected = [fit("0,1", 2, "new"), fit("0,1|2", 1, "given")];
    assert_eq!(store.fits(id).await.expect("fits"), expected);
    assert_eq!(store.fits(other).await.expect("fits"), []);
    store.close().await;

    let store = database.open(Quotas::default()).await;
    assert_eq!(
        store.fits(id).await.expect("fits"),
        expected,
        "they survive"
    );
    store.delete(id).await.expect("removed");
    assert!(is_unknown(store.fits(id).await));
    let refused = store.keep_fit(id, &fit("0,1", 3, "late")).await;
    assert!(
        matches!(refused, Err(StoreError::UnknownEnvironment)),
        "{refused:?}"
    );
}

fn network(ego: usize, other: usize, weights: &[u8]) -> NewModel {
    NewModel {
        ego,
        other,
        kind: "direct".into(),
        card: "{\"epochs\": 3}".into(),
        weights: weights.into(),
    }
}

async fn keep(store: &Arc<dyn Store>, id: EnvironmentId, ego: usize, other: usize) -> u64 {
    store
        .keep_model(id, &network(ego, other, b"weights"))
        .await
        .expect("kept")
}

async fn activate(store: &Arc<dyn Store>, id: EnvironmentId, versions: &[u64]) {
    for version in versions {
        store.activate_model(id, *version).await.expect("activated");
    }
}

async fn models(store: &Arc<dyn Store>, id: EnvironmentId) -> Vec<ModelRecord> {
    store.models(id).await.expect("models")
}

/// Returns the active versions, after asking for each version alone whether it agrees.
async fn active(store: &Arc<dyn Store>, id: EnvironmentId) -> Vec<u64> {
    let records = models(store, id).await;
    for record in &records {
        let (alone, _) = store
            .model(id, record.version)
            .await
            .expect("a model")
            .expect("it is listed");
        assert_eq!(&alone, record);
    }
    records
        .iter()
        .filter(|record| record.active)
        .map(|record| record.version)
        .collect()
}

async fn model_versions_are_never_used_again(database: &dyn Database) {
    let (store, id) = open(database).await;
    let elsewhere = make(&store, "kitchen").await;
    assert_eq!(
        (keep(&store, id, 0, 1).await, keep(&store, id, 1, 0).await),
        (1, 2)
    );
    assert_eq!(
        keep(&store, elsewhere, 0, 1).await,
        1,
        "each environment counts for itself"
    );
    store.delete_model(id, 2).await.expect("deleted");
    assert_eq!(keep(&store, id, 0, 1).await, 3);
    for version in [1, 3] {
        store.delete_model(id, version).await.expect("deleted");
    }
    store.close().await;
    let store = database.open(Quotas::default()).await;
    assert_eq!(
        keep(&store, id, 0, 1).await,
        4,
        "none was left to count from"
    );
}

async fn the_model_activated_last_is_active_until_rolled_back_or_deleted(database: &dyn Database) {
    let (store, id) = open(database).await;
    for expected in 1..=4 {
        assert_eq!(keep(&store, id, 0, 1).await, expected);
    }
    assert!(
        active(&store, id).await.is_empty(),
        "a new one is not active"
    );
    activate(&store, id, &[2, 3, 1, 4, 2]).await;
    let activated: Vec<_> = models(&store, id)
        .await
        .iter()
        .map(|record| record.activated)
        .collect();
    assert_eq!(activated, [Some(3), Some(5), Some(2), Some(4)]);
    assert_eq!(active(&store, id).await, [2]);

    store.deactivate_model(id, 2).await.expect("rolled back");
    assert_eq!(active(&store, id).await, [4]);
    store.delete_model(id, 4).await.expect("deleted");
    assert_eq!(active(&store, id).await, [1]);
    store
        .deactivate_model(id, 3)
        .await
        .expect("one that is not active");
    assert_eq!(active(&store, id).await, [1]);
    store.deactivate_model(id, 1).await.expect("rolled back");
    assert!(active(&store, id).await.is_empty());
    store
        .deactivate_model(id, 1)
        .await
        .expect("nothing left to roll back");
    activate(&store, id, &[3]).await;
    assert_eq!(active(&store, id).await, [3]);
}

async fn each_pair_has_an_active_model_of_its_own(database: &dyn Database) {
    let (store, id) = open(database).await;
    let elsewhere = make(&store, "kitchen").await;
    for (ego, other) in [(0, 1), (1, 0), (0, 1), (0, 2)] {
        keep(&store, id, ego, other).await;
    }
    keep(&store, elsewhere, 0, 1).await;
    activate(&store, elsewhere, &[1]).await;
    activate(&store, id, &[1, 3, 2]).await;
    assert_eq!(active(&store, id).await, [2, 3]);
    store.deactivate_model(id, 3).await.expect("rolled back");
    assert_eq!(active(&store, id).await, [1, 2]);
    store.delete_model(id, 2).await.expect("deleted");
    assert_eq!(active(&store, id).await, [1]);
    assert_eq!(active(&store, elsewhere).await, [1]);
}

async fn models_survive(database: &dyn Database) {
    let (store, id) = open(database).await;
    let joint = NewModel {
        kind: "joint".into(),
        card: "a \"card\" 左".into(),
        ..network(1, 0, b"joint")
    };
    keep(&store, id, 0, 1).await;
    store.keep_model(id, &joint).await.expect("kept");
    activate(&store, id, &[1, 2]).await;
    let direct = network(0, 1, b"");
    let record = |version: u64, model: NewModel| ModelRecord {
        version,
        ego: model.ego,
        other: model.other,
        kind: model.kind,
        activated: Some(version),
        active: true,
        card: model.card,
        is_sound: true,
    };
    let expected = [record(1, direct), record(2, joint)];
    assert_eq!(models(&store, id).await, expected);
    store.close().await;

    let store = database.open(Quotas::default()).await;
    assert_eq!(models(&store, id).await, expected);
    assert_eq!(
        store.model(id, 2).await.expect("a model"),
        Some((expected[1].clone(), b"joint".to_vec()))
    );
}

async fn weights_come_back_to_the_byte(database: &dyn Database) {
    let (store, id) = open(database).await;
    let every_byte = |length: u32| {
        (0..length)
            .map(|at| (at.wrapping_mul(2_654_435_761) >> 24) as u8)
            .collect()
    };
    let weights: [Vec<u8>; 3] = [Vec::new(), vec![0; 1_000], every_byte(3 << 20)];
    for weights in &weights {
        store
            .keep_model(id, &network(0, 1, weights))
            .await
            .expect("kept");
    }
    activate(&store, id, &[3]).await;
    for (version, expected) in (1..).zip(&weights) {
        let (_, kept) = store
            .model(id, version)
            .await
            .expect("a model")
            .expect("it is there");
        assert!(
            kept == *expected,
            "version {version}: {} bytes of {}",
            kept.len(),
            expected.len()
        );
    }
}

async fn models_go_with_their_environment(database: &dyn Database) {
    let (store, id) = open(database).await;
    let elsewhere = make(&store, "kitchen").await;
    for _ in 0..12 {
        keep(&store, id, 0, 1).await;
    }
    keep(&store, elsewhere, 0, 1).await;
    activate(&store, id, &[7]).await;
    store.delete(id).await.expect("removed");
    assert!(is_unknown(store.models(id).await) && is_unknown(store.model(id, 7).await));
    assert!(is_unknown(
        store.keep_model(id, &network(0, 1, b"late")).await
    ));
    assert!(is_unknown(store.activate_model(id, 7).await));
    assert!(is_unknown(store.deactivate_model(id, 7).await));
    assert!(is_unknown(store.delete_model(id, 7).await));
    assert_eq!(models(&store, elsewhere).await.len(), 1);
    let again = make(&store, "hallway").await;
    assert_eq!(
        (models(&store, again).await, keep(&store, again, 0, 1).await),
        (vec![], 1)
    );
}

async fn an_unknown_model_is_not_found(database: &dyn Database) {
    let (store, id) = open(database).await;
    let elsewhere = make(&store, "kitchen").await;
    keep(&store, id, 0, 1).await;
    keep(&store, id, 0, 1).await;
    keep(&store, elsewhere, 0, 1).await;
    store.delete_model(id, 2).await.expect("deleted");
    for (id, version) in [(id, 0), (id, 2), (id, 3), (id, u64::MAX), (elsewhere, 2)] {
        assert_eq!(store.model(id, version).await.expect("none"), None);
        let refused = [
            store.activate_model(id, version).await,
            store.deactivate_model(id, version).await,
            store.delete_model(id, version).await,
        ];
        for refused in refused {
            let Err(error @ StoreError::UnknownModel(told)) = refused else {
                panic!("{refused:?}")
            };
            assert_eq!((told, error.kind()), (version, ErrorKind::NotFound));
        }
    }
    assert_eq!(models(&store, id).await.len(), 1);
}

async fn outcomes_are_counted_apart_from_joint_actions(database: &dyn Database) {
    let (store, id) = open(database).await;
    let first = batch(id, "a", 1)
        .cell(1, 1, tally(3, 2))
        .cell(1, 4, tally(1, 0))
        .done();
    let second = batch(id, "a", 2)
        .cell(1, 1, tally(2, 2))
        .segment("x")
        .done();
    commit(&store, &[first, second]).await;

    let counts = store.counts(id, &[state_at(1)]).await.expect("counts");
    let family = |outcome| -> Vec<(u64, u64)> {
        let cells = counts[0].counts.of_family(Family::of_outcome(outcome));
        cells
            .iter()
            .map(|cell| (cell.joint, cell.tally.n))
            .collect()
    };
    // Joint action 4 was not observed with the first outcome.
    assert_eq!(family(0), [(4, 3), (4, 2)]);
    assert_eq!(family(1), [(1, 3), (1, 2), (4, 1)]);
    assert_eq!(family(2), [(257, 3), (257, 2), (1_028, 1)]);
    assert_eq!(counts[0].revision, 6, "transitions are counted once");

    let totals = totals(&store, id).await;
    assert_eq!((totals.transitions, totals.states), (6, 1));
    assert_eq!(totals.cells, 3 + 2 + 3 + 3);
    let page = store.scan(id, Cursor::default(), 10).await.expect("a page");
    assert_eq!(page[0].counts, *counts[0].counts);

    // A state has as many visits as transitions, however many outcomes.
    let wanted = |min_visits| ByVisits {
        segments: None,
        min_visits,
        descending: true,
        after: None,
        states: 10,
    };
    for (min_visits, states) in [(6, 1), (7, 0)] {
        let found = store.by_visits(id, &wanted(min_visits)).await;
        assert_eq!(found.expect("a page").0.len(), states);
    }
    let audits = store.audit().await.expect("an audit");
    assert!(audits.iter().all(|audit| audit.is_sound()), "{audits:?}");
}

async fn cells_of_outcomes_count_towards_the_quota(database: &dyn Database) {
    let quotas = Quotas {
        cells: 8,
        ..Quotas::default()
    };
    let store = database.open(quotas).await;
    let id = make(&store, "hallway").await;
    let four = batch(id, "a", 1).cell(1, 1, tally(1, 1)).done();
    let five = batch(id, "b", 1)
        .cell(1, 1, tally(1, 1))
        .cell(2, 1, tally(1, 1))
        .cell(1, 4, tally(1, 1))
        .done();
    let three_more = batch(id, "b", 1)
        .cell(1, 1, tally(1, 1))
        .cell(1, 4, tally(1, 1))
        .content(2)
        .done();
    let outcomes = commit(&store, &[four.clone(), five, three_more.clone()]).await;
    let expected = [applied(&four), over_quota("cells", 8), applied(&three_more)];
    assert_eq!(outcomes, expected);
    assert_eq!(totals(&store, id).await.cells, 7);

    // One of joint actions would fit, and what it was observed with does not.
    let next = batch(id, "a", 2).cell(9, 2, tally(1, 1)).done();
    assert_eq!(commit(&store, &[next]).await, [over_quota("cells", 8)]);
    let known = batch(id, "a", 2).cell(1, 4, tally(5, 5)).done();
    assert_eq!(
        commit(&store, std::slice::from_ref(&known)).await,
        [applied(&known)]
    );
}

async fn a_cell_that_no_outcome_has_is_damage(database: &dyn Database) {
    let (store, id) = open(database).await;
    let mut beyond = batch(id, "a", 1).cell(1, 1, tally(1, 1)).done();
    // A family and a cell that the schema does not have, which no valid batch adds.
    beyond.increment.outcomes[1][0] = 1 << 40;
    commit(&store, &[beyond]).await;
    assert!(store.counts(id, &[state_at(1)]).await.is_err());
    let audits = store.audit().await.expect("an audit");
    assert!(!audits[0].is_sound(), "{audits:?}");
}

async fn outcomes_survive_and_are_folded(database: &dyn Database) {
    let (store, id) = open(database).await;
    for sequence in 1..=20 {
        let place = sequence as u32 % 3;
        let next = batch(id, "a", sequence)
            .cell(place, sequence % 4, tally(sequence, 1))
            .cell(40, 7, tally(1, 1));
        commit(&store, &[next.done()]).await;
    }
    let keys: Vec<StateKey> = [0, 1, 2, 40].map(state_at).to_vec();
    let before = store.counts(id, &keys).await.expect("counts");
    let held = totals(&store, id).await;
    store.close().await;
    drop(store);

    let store = database.open(Quotas::default()).await;
    assert_eq!(totals(&store, id).await, held);
    let after = store.counts(id, &keys).await.expect("counts");
    assert_eq!(after, before);
    after
        .iter()
        .for_each(|state| assert_observed(&state.counts));
    let audits = store.audit().await.expect("an audit");
    assert!(audits.iter().all(|audit| audit.is_sound()), "{audits:?}");
}
