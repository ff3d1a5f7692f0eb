//! What only the SQLite store can show: its lock, files that are not its own, damage, and numbers
//! that no test can count up to.

use std::path::Path;
use std::sync::Arc;

use nudge::domain::EnvironmentId;
use nudge::store::{
    NewModel, Numbered, Options, Outcome, Quotas, Refusal, SqliteStore, Store, StoreError,
};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use crate::support::batches::*;
use crate::support::databases::{Database, LEFT, SqliteFile, execute, number};

async fn open(file: &SqliteFile) -> Arc<dyn Store> {
    file.open(Quotas::default()).await
}

async fn refused(path: &Path) -> String {
    match SqliteStore::open(path, Options::default()).await {
        Ok(_) => panic!("{} was opened", path.display()),
        Err(error) => error.to_string(),
    }
}

async fn with_some_counts(store: &Arc<dyn Store>) -> (EnvironmentId, Numbered) {
    let id = store
        .create(
            &"hallway".parse().expect("a name"),
            &schema(),
            &Default::default(),
        )
        .await
        .expect("made")
        .id;
    let first = batch(id, "game", 1)
        .cell(1, 1, tally(2, 1))
        .cell(1, 2, tally(3, 1))
        .done();
    store
        .commit(std::slice::from_ref(&first))
        .await
        .expect("a commit");
    (id, first)
}

#[tokio::test]
async fn a_second_store_on_the_same_file_is_refused() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let second = SqliteStore::open(&file.path(), Options::default())
        .await
        .err();
    let Some(StoreError::InUse(path)) = second else {
        panic!("{second:?}")
    };
    assert!(path.ends_with("nudge.db"));
    assert!(!StoreError::InUse(path).to_string().contains('\n'));
    drop(store);
    let store = open(&file).await;
    store.close().await;
    open(&file).await;
}

#[tokio::test]
async fn what_is_not_our_database_is_refused_with_advice() {
    let file = SqliteFile::new();
    let path = file.path();
    std::fs::create_dir_all(path.parent().expect("a directory")).expect("made");
    std::fs::write(
        &path,
        "to be, or not to be: that is the question ".repeat(100),
    )
    .expect("written");
    assert!(
        refused(&path)
            .await
            .contains("not a database; move it away")
    );

    std::fs::remove_file(&path).expect("removed");
    execute_making(&path, "create table poems (line text)").await;
    let before = std::fs::read(&path).expect("a file");
    assert!(refused(&path).await.contains("another program's database"));
    // Other programs have lists of migrations too.
    let list = "create table _sqlx_migrations (version bigint primary key, description text,
         success boolean, checksum blob, execution_time bigint)";
    assert_eq!(
        std::fs::read(&path).expect("a file"),
        before,
        "left as it was"
    );
    for text in [
        list,
        "insert into _sqlx_migrations values (1, 'poems', true, x'00', 0)",
    ] {
        execute_making(&path, text).await;
        assert!(refused(&path).await.contains("another program's database"));
    }

    let directory = path.with_file_name("directory.db");
    std::fs::create_dir(&directory).expect("made");
    assert!(
        refused(&directory)
            .await
            .contains("give this user the right")
    );

    let below_a_file = path.join("nudge.db");
    assert!(
        refused(&below_a_file)
            .await
            .contains("cannot make its directory")
    );
}

async fn execute_making(path: &Path, sql: &'static str) {
    let options = SqliteConnectOptions::new()
        .filename(path)
        .create_if_missing(true);
    let mut connection = options.connect().await.expect("a connection");
    sqlx::query(sql)
        .execute(&mut connection)
        .await
        .expect("a statement that works");
    connection.close().await.expect("closed");
}

#[tokio::test]
async fn a_database_of_a_newer_version_is_refused() {
    let file = SqliteFile::new();
    open(&file).await.close().await;
    let newer =
        "insert into _sqlx_migrations (version, description, success, checksum, execution_time)
                 values (9999, 'of the future', true, x'00', 0)";
    execute(&file.path(), newer).await;
    assert!(
        refused(&file.path())
            .await
            .contains("made by a newer nudge")
    );
    execute(
        &file.path(),
        "delete from _sqlx_migrations where version = 9999",
    )
    .await;
    execute(&file.path(), "update _sqlx_migrations set checksum = x'00'").await;
    assert!(
        refused(&file.path())
            .await
            .contains("its record of migration 1 is not as it was written")
    );
}

#[tokio::test]
async fn damage_is_found_and_makes_the_environment_read_only() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (id, first) = with_some_counts(&store).await;
    let healthy = store
        .create(
            &"healthy".parse().expect("a name"),
            &schema(),
            &Default::default(),
        )
        .await
        .expect("made")
        .id;
    assert!(
        store
            .audit()
            .await
            .expect("an audit")
            .iter()
            .all(|audit| audit.is_sound())
    );

    // Totals and what they are totals of say something else: so it is where a bit of a total flips.
    execute(
        &file.path(),
        "update totals set transitions = transitions + 4 where environment = 1",
    )
    .await;
    let audits = store.audit().await.expect("an audit");
    assert_eq!((audits[0].kept, audits[0].found), ([9, 1, 2], [5, 1, 2]));
    let next = batch(id, "game", 2).done();
    let elsewhere = batch(healthy, "game", 1).cell(1, 1, tally(1, 1)).done();
    let outcomes = store
        .commit(&[next, first, elsewhere.clone()])
        .await
        .expect("a commit");
    let read_only = Outcome::Refused(Refusal::ReadOnly);
    assert_eq!(
        outcomes,
        [read_only.clone(), read_only, applied(&elsewhere)]
    );
    assert_eq!(
        store
            .counts(id, &[state_at(1)])
            .await
            .expect("still readable")
            .len(),
        1
    );
}

#[tokio::test]
async fn damage_beyond_any_number_is_still_told() {
    const LARGEST: u64 = i64::MAX as u64;
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (id, _) = with_some_counts(&store).await;
    // Two batches of as much as fits, because a damaged total has forgotten the first.
    execute(&file.path(), "update totals set transitions = 0").await;
    let large = |sequence, joint| {
        batch(id, "game", sequence)
            .cell(1, joint, tally(LARGEST, 0))
            .done()
    };
    let first = large(2, 3);
    assert_eq!(
        store
            .commit(std::slice::from_ref(&first))
            .await
            .expect("a commit"),
        [applied(&first)]
    );
    for change in [
        "update totals set transitions = 0",
        "delete from journal where id = 1",
    ] {
        execute(&file.path(), change).await;
    }
    let second = large(3, 4);
    assert_eq!(
        store
            .commit(std::slice::from_ref(&second))
            .await
            .expect("a commit"),
        [applied(&second)]
    );
    let audits = store.audit().await.expect("an audit");
    assert_eq!(audits[0].found[0], u64::MAX - 1);
    // Kept since it was made, they are not read.
    store.close().await;
    let store = open(&file).await;
    let environment = store.environment("hallway").expect("made");
    let why = store
        .actions(&environment)
        .await
        .expect_err("no sum")
        .to_string();
    assert!(why.contains("run `nudge check`"), "{why}");
    execute(&file.path(), "delete from journal").await;
    let audits = store.audit().await.expect("an audit");
    assert_eq!((audits[0].kept, audits[0].found), ([LARGEST, 0, 0], [0; 3]));
}

#[tokio::test]
async fn a_producer_can_reach_the_largest_sequence() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (id, _) = with_some_counts(&store).await;
    execute(
        &file.path(),
        "update producers set sequence = 9223372036854775806",
    )
    .await;
    let last = batch(id, "game", u64::MAX >> 1)
        .cell(1, 1, tally(1, 1))
        .done();
    assert_eq!(
        store
            .commit(&[last.clone(), last.clone()])
            .await
            .expect("a commit"),
        [applied(&last), duplicate(&last)]
    );
    assert_eq!(
        store
            .commit(std::slice::from_ref(&last))
            .await
            .expect("a commit"),
        [duplicate(&last)]
    );
    let first = batch(id, "game", 1).done();
    assert_eq!(
        store.commit(&[first]).await.expect("a commit"),
        [unverified()]
    );
    assert_eq!(
        store
            .watermark(id, &last.producer)
            .await
            .expect("a watermark"),
        last.sequence
    );
}

#[tokio::test]
async fn receipts_do_not_pile_up() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (id, _) = with_some_counts(&store).await;
    let batches: Vec<Numbered> = (2..=1_500)
        .map(|sequence| batch(id, "game", sequence).done())
        .collect();
    for chunk in batches.chunks(700) {
        store.commit(chunk).await.expect("a commit");
    }
    assert_eq!(
        number(&file.path(), "select count(*) from batches").await,
        1_024
    );
    assert_eq!(
        number(&file.path(), "select min(sequence) from batches").await,
        1_500 - 1_023
    );
}

#[tokio::test]
async fn an_interrupted_removal_goes_on_when_the_store_is_opened() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (id, _) = with_some_counts(&store).await;
    let model = NewModel {
        ego: 0,
        other: 1,
        kind: "joint".into(),
        card: String::new(),
        weights: vec![7; 9_000],
    };
    for _ in 0..12 {
        store.keep_model(id, &model).await.expect("kept");
    }
    drop(store);
    execute(&file.path(), "update environments set name = null").await;
    execute(&file.path(), "delete from totals").await;
    let store = open(&file).await;
    assert!(store.environments().is_empty());
    assert!(
        number(&file.path(), ROWS).await > 12,
        "opening does not wait for a removal"
    );
    sweep(&store).await;
    assert_eq!(number(&file.path(), ROWS).await, 0);
    let (new, _) = with_some_counts(&store).await;
    assert_ne!(id, new);
}

/// Returns a place whose row has no other.
fn row_of_its_own(number: u32) -> u32 {
    number * 16
}

/// Every row that belongs to an environment.
const ROWS: &str =
    "select (select count(*) from environments) + (select count(*) from states) + (select count(*) from cells)
    + (select count(*) from packed) + (select count(*) from journal)
    + (select count(*) from producers) + (select count(*) from batches) + (select count(*) from segments)
    + (select count(*) from models) + (select count(*) from model_weights) + (select count(*) from model_versions)
    + (select count(*) from fits) + (select count(*) from totals)";

async fn sweep(store: &Arc<dyn Store>) {
    while store.leftovers().environments > 0 {
        store.sweep().await.expect("a step");
    }
}

/// However its rows are spread: in states, in one producer, in segments.
#[tokio::test]
async fn no_step_of_a_removal_has_many_rows() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (id, _) = with_some_counts(&store).await;
    let wide = filled(id, "game", 2, (0..9_000).map(row_of_its_own));
    store.commit(&[wide]).await.expect("a commit");
    let many: Vec<Numbered> = (3..=3_000)
        .map(|sequence| {
            batch(id, "game", sequence)
                .cell(2, 1, tally(1, 1))
                .segment(&format!("s{sequence}"))
                .done()
        })
        .collect();
    store.commit(&many).await.expect("a commit");
    store.close().await;
    drop(store);
    file.compact_all().await;
    let store = open(&file).await;
    for sequence in 3_001..=3_020 {
        let next = batch(id, "game", sequence).cell(2, 1, tally(1, 1)).done();
        store.commit(&[next]).await.expect("a commit");
    }
    store.delete(id).await.expect("removed");

    let mut before = number(&file.path(), ROWS).await;
    assert!(before > 13_000, "{before}");
    while store.leftovers().environments > 0 {
        store.sweep().await.expect("a step");
        let after = number(&file.path(), ROWS).await;
        assert!(
            (1..=1_024).contains(&(before - after)),
            "{before} - {after}"
        );
        before = after;
    }
    assert_eq!(before, 0);
}

#[tokio::test]
async fn a_removal_that_fails_keeps_no_other_from_its_end() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (sick, _) = with_some_counts(&store).await;
    store.delete(sick).await.expect("removed");
    let (sound, _) = with_some_counts(&store).await;
    store.delete(sound).await.expect("removed");
    // As a damaged page would: deleting this one's counts fails.
    let fault = "create trigger fault before delete on journal when old.environment = 1
                 begin select raise(abort, 'disk I/O error'); end";
    execute(&file.path(), fault).await;

    let mut failed = 0;
    while store.leftovers().environments > 1 {
        failed += u32::from(store.sweep().await.is_err());
    }
    assert!(failed > 0 && store.sweep().await.is_err());
    assert_eq!(
        number(
            &file.path(),
            "select count(*) from environments where id = 1"
        )
        .await,
        1
    );
    assert_eq!(
        number(&file.path(), ROWS).await,
        1 + 1 + 1 + 1 + 1,
        "what the failed one has is all there"
    );
    let (other, first) = with_some_counts(&store).await;
    assert_eq!(
        store.totals(other).await.expect("unharmed").transitions,
        first.increment.transitions
    );

    execute(&file.path(), "drop trigger fault").await;
    sweep(&store).await;
    assert_eq!(
        number(&file.path(), "select count(*) from environments").await,
        1
    );
}

#[tokio::test]
async fn commits_go_on_while_an_environment_is_removed() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let large = store
        .create(
            &"large".parse().expect("a name"),
            &schema(),
            &Default::default(),
        )
        .await
        .expect("made")
        .id;
    let first = filled(large, "game", 1, (0..10_000).map(row_of_its_own));
    store.commit(&[first]).await.expect("a commit");
    store.close().await;
    drop(store);
    file.compact_all().await;
    let store = open(&file).await;
    let (small, _) = with_some_counts(&store).await;
    store.delete(large).await.expect("removed");
    let removal = tokio::spawn({
        let store = Arc::clone(&store);
        async move { sweep(&store).await }
    });
    // One that waits for the connection has it next, so that at least every other turn is a commit.
    let mut sequence = 1;
    while !removal.is_finished() {
        sequence += 1;
        let next = batch(small, "game", sequence)
            .cell(7, sequence, tally(1, 1))
            .done();
        assert_eq!(
            store
                .commit(std::slice::from_ref(&next))
                .await
                .expect("a commit"),
            [applied(&next)]
        );
    }
    removal.await.expect("no panic");
    assert!(sequence > 10, "{sequence} commits came between the steps");
    assert!(
        store
            .audit()
            .await
            .expect("an audit")
            .iter()
            .all(|audit| audit.is_sound())
    );
    assert_eq!(store.totals(small).await.expect("totals").states, 2);
    assert_eq!(
        number(&file.path(), "select count(*) from packed").await,
        0,
        "only the large one's were folded"
    );
}

/// The store's promise when the future of a commit is dropped at any moment: it happened or it did
/// not, and everything agrees which.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_commit_that_is_cancelled_happened_or_not() {
    let file = SqliteFile::new();
    let store = open(&file).await;
    let (id, first) = with_some_counts(&store).await;
    let environment = store.environment("hallway").expect("made");
    let (mut happened, mut cancelled) = (0, 0);
    for round in 0..300_u64 {
        let last = store
            .watermark(id, &first.producer)
            .await
            .expect("a watermark")
            .get();
        let next = batch(id, "game", last + 1).cell(5, 5, tally(1, 1)).done();
        let patience = std::time::Duration::from_micros(round * 7 % 900);
        let answer =
            tokio::time::timeout(patience, store.commit(std::slice::from_ref(&next))).await;
        cancelled += u64::from(answer.is_err());
        // Read before the next transaction settles it, and after.
        let early = visits(&store, id, 5).await;
        if round % 2 == 1 {
            let [first, second] = [0; 2].map(|_| store.actions(&environment));
            let (first, second) = (
                first.await.expect("actions"),
                second.await.expect("actions"),
            );
            assert!(Arc::ptr_eq(&first, &second), "read from the cells twice");
        }
        let committed = store
            .watermark(id, &first.producer)
            .await
            .expect("a watermark")
            .get()
            - 1;
        let late = visits(&store, id, 5).await;
        assert!(
            early <= late && late == committed,
            "{early} {late} {committed}"
        );
        assert!(
            answer.is_err() || committed == last,
            "acknowledged and lost"
        );
        let actions = store.actions(&environment).await.expect("actions");
        assert_eq!(actions.revision, 5 + committed, "five were counted before");
        happened = committed;
    }
    assert!(
        cancelled > 0 && happened > 0,
        "{cancelled} cancelled, {happened} happened"
    );
    assert!(store.audit().await.expect("an audit")[0].is_sound());
}

/// Returns transitions, states and cells of an environment as a scrape is told them.
async fn held(store: &Arc<dyn Store>, id: EnvironmentId) -> [u64; 3] {
    let held = store.held().await.expect("held");
    let (_, held) = held
        .into_iter()
        .find(|(of, _)| *of == id)
        .expect("it is there");
    [
        held.totals.transitions,
        held.totals.states,
        held.totals.cells,
    ]
}

/// While more is in no row than is looked up for it, states and cells are those of a while ago.
#[tokio::test]
async fn what_is_held_never_falls_and_is_exact_once_it_is_in_rows() {
    const MANY: u32 = 12_000;
    let mut file = SqliteFile::new();
    file.fold_from = 1;
    let store = open(&file).await;
    let (id, _) = with_some_counts(&store).await;
    assert_eq!(held(&store, id).await, [5, 1, 2], "few are looked up");

    let most = u64::from(MANY);
    let commit = async |sequence, places| {
        let more = filled(id, "wide", sequence, places);
        store.commit(&[more]).await.expect("a commit");
    };
    commit(1, 1..MANY + 1).await;
    assert_eq!(
        held(&store, id).await,
        [5 + most, 1, 2],
        "as of a while ago"
    );
    let totals = store.totals(id).await.expect("totals");
    assert_eq!([totals.states, totals.cells], [most, most + 1]);
    let known = [5 + most, most, most + 1];
    assert_eq!(held(&store, id).await, known, "somebody has counted them");

    commit(2, MANY + 1..2 * MANY + 1).await;
    let mut seen = held(&store, id).await;
    assert_eq!(seen, [5 + 2 * most, most, most + 1]);
    while number(&file.path(), LEFT).await > 0 {
        store.compact().await.expect("a step");
        let now = held(&store, id).await;
        assert!(
            now >= seen && now[1] >= seen[1] && now[2] >= seen[2],
            "{seen:?} {now:?}"
        );
        seen = now;
    }
    assert_eq!(seen, [5 + 2 * most, 2 * most, 2 * most + 1]);

    commit(3, 2 * MANY + 1..3 * MANY + 1).await;
    drop(store);
    let store = open(&file).await;
    let all = [5 + 3 * most, 3 * most, 3 * most + 1];
    assert_eq!(held(&store, id).await, all, "what nobody has counted is");
}

async fn visits(store: &Arc<dyn Store>, id: EnvironmentId, place: u32) -> u64 {
    let counts = store.counts(id, &[state_at(place)]).await.expect("counts");
    counts[0]
        .counts
        .cells()
        .iter()
        .map(|cell| cell.tally.n)
        .sum()
}
