//! A damaged database: what is damaged takes nothing, what is sound stays served, and deleting the
//! damaged part keeps nobody from starting.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use nudge::domain::draft::{DerivedDraft, DerivedKindDraft};
use nudge::domain::{Change, DerivedFeatures, EnvironmentId, FitId, RuleDraft, WrittenRule};
use nudge::store::{
    ByVisits, Cursor, FitRecord, NewModel, Numbered, Options, Outcome, Quotas, Refusal,
    SqliteStore, Store, StoreError,
};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use tempfile::TempDir;

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::batches::*;
use crate::support::databases::{Database, SqliteFile, execute, number};
use crate::support::{TestApp, lane_json};

const PAGE: usize = 4_096;

/// The pages of another environment's counts that one may need: of the table of rows, the one where
/// the other begins, which was split off the last one.
const BORDERS: u32 = 1;

/// The places of the environment that will be hurt: their rows stand on pages of their own.
const HURT: std::ops::Range<u32> = 700_000..702_000;

/// A cell of its first place in a segment of its own.
const ODD: u64 = 1_000_000;

async fn make(store: &Arc<dyn Store>, name: &str) -> EnvironmentId {
    store
        .create(
            &name.parse().expect("a name"),
            &schema(),
            &Default::default(),
        )
        .await
        .expect("made")
        .id
}

/// Makes two environments whose counts are in rows, and closes the database.
async fn prepared() -> (SqliteFile, EnvironmentId, EnvironmentId) {
    let prepared = unfolded().await;
    prepared.0.compact_all().await;
    prepared
}

/// The same, with all counts in the journal.
async fn unfolded() -> (SqliteFile, EnvironmentId, EnvironmentId) {
    let file = SqliteFile::new();
    let store = file.open(Quotas::default()).await;
    let (hurt, sound) = (make(&store, "hurt").await, make(&store, "sound").await);
    let small = (1..50).fold(batch(sound, "game", 1), |sending, place| {
        sending.cell(place, 1, tally(1, 1))
    });
    let odd = batch(hurt, "odd", 1).cell(HURT.start, ODD, tally(1, 1));
    for batch in [
        filled(hurt, "game", 1, HURT),
        odd.segment("odd").done(),
        small.done(),
    ] {
        store.commit(&[batch]).await.expect("a commit");
    }
    store.close().await;
    (file, hurt, sound)
}

/// The row of a place in the middle of those that are hurt; theirs is the first block.
const ROW: &str = "select cells from packed where id = (1 << 44) + (701000 >> 4)";
/// The entry of the journal that has all of them.
const ENTRY: &str = "select cells from journal where id = 1";

/// Returns where in its database a blob ends, in its checksum.
async fn end_of_blob(path: &Path, sql: &'static str) -> usize {
    let options = SqliteConnectOptions::new().filename(path).read_only(true);
    let mut raw = options.connect().await.expect("a connection");
    let blob: Vec<u8> = sqlx::query_scalar(sql)
        .fetch_one(&mut raw)
        .await
        .expect("a blob");
    raw.close().await.expect("closed");
    // A long one goes on on pages of its own: its end is in one piece.
    let end = &blob[blob.len().saturating_sub(40)..];
    let bytes = std::fs::read(path).expect("read");
    let at = bytes.windows(end.len()).rposition(|window| window == end);
    at.expect("there") + end.len() - 1
}

/// Spoils the page that has the end of a blob: nobody can read its table beyond.
async fn spoil_blob(path: &Path, sql: &'static str) {
    let at = end_of_blob(path, sql).await;
    let mut bytes = std::fs::read(path).expect("read");
    // No page has this kind: whoever reads it is told that the database is malformed.
    bytes[at / PAGE * PAGE] = 0x77;
    std::fs::write(path, bytes).expect("written");
}

/// Flips a bit of a blob, of which SQLite knows nothing.
async fn flip_blob(path: &Path, sql: &'static str) {
    let at = end_of_blob(path, sql).await - 10;
    let mut bytes = std::fs::read(path).expect("read");
    bytes[at] ^= 4;
    std::fs::write(path, bytes).expect("written");
}

/// Spoils every leaf of a kind (13: rows, 10: index) that has a text, and returns how many there
/// are.
fn spoil(path: &Path, kind: u8, text: &str) -> usize {
    let mut bytes = std::fs::read(path).expect("read");
    let mut spoiled = 0;
    for page in bytes.chunks_mut(PAGE).skip(1) {
        let has_text = page
            .windows(text.len())
            .any(|window| window == text.as_bytes());
        if page[0] == kind && has_text {
            page[0] = 0x77;
            spoiled += 1;
        }
    }
    std::fs::write(path, bytes).expect("written");
    spoiled
}

fn read_only() -> Outcome {
    Outcome::Refused(Refusal::ReadOnly)
}

/// Sees that an audit finds one environment damaged and passes the other, and that nothing more is
/// counted in the damaged one.
async fn assert_audit_finds(
    store: &Arc<dyn Store>,
    hurt: EnvironmentId,
    sound: EnvironmentId,
    why: &str,
) {
    let audits = store.audit().await.expect("an audit of what can be read");
    let is_sound: Vec<bool> = audits.iter().map(|audit| audit.is_sound()).collect();
    assert_eq!(is_sound, [false, true], "{audits:?}");
    assert!(
        audits[0]
            .unreadable
            .as_ref()
            .is_some_and(|told| told.contains(why)),
        "{why}: {audits:?}"
    );
    let listed = store.read_only();
    assert!(
        matches!(&listed[..], [(name, told)] if name.as_str() == "hurt" && told.contains(why)),
        "{listed:?}"
    );

    let more = batch(sound, "game", 2).cell(1, 1, tally(1, 1)).done();
    let refused = batch(hurt, "game", 2).cell(1, 1, tally(1, 1)).done();
    assert_eq!(
        store
            .commit(&[refused, more.clone()])
            .await
            .expect("a commit"),
        [read_only(), applied(&more)]
    );
}

#[tokio::test]
async fn an_audit_that_cannot_read_makes_the_environment_read_only() {
    let (file, hurt, sound) = prepared().await;
    spoil_blob(&file.path(), ROW).await;
    let store = file.open(Quotas::default()).await;
    assert_audit_finds(&store, hurt, sound, "malformed").await;
}

#[tokio::test]
async fn an_audit_finds_a_flipped_bit_in_a_row() {
    let (file, hurt, sound) = prepared().await;
    flip_blob(&file.path(), ROW).await;
    let store = file.open(Quotas::default()).await;
    assert_audit_finds(&store, hurt, sound, "row 43812 of the counts").await;
}

#[tokio::test]
async fn an_audit_finds_a_flipped_bit_in_the_journal() {
    let (file, hurt, sound) = unfolded().await;
    flip_blob(&file.path(), ENTRY).await;
    let store = file.open(Quotas::default()).await;
    assert_audit_finds(&store, hurt, sound, "entry 1 of the journal").await;
}

/// A row is where no other may be, though its checksum is right.
#[tokio::test]
async fn an_audit_finds_a_row_in_anothers_place() {
    let (file, hurt, sound) = prepared().await;
    let text = "update packed set cells = (select cells from packed where id = (1 << 44) + 43813)
         where id = (1 << 44) + 43812";
    execute(&file.path(), text).await;
    let store = file.open(Quotas::default()).await;
    assert_audit_finds(&store, hurt, sound, "row 43812 of the counts").await;
}

/// An entry that cannot be read had counted something: no answer is given that lacks it.
#[tokio::test]
async fn nobody_is_told_less_than_was_counted_where_the_journal_is_damaged() {
    let (file, hurt, sound) = unfolded().await;
    flip_blob(&file.path(), ENTRY).await;
    let store = file.open(Quotas::default()).await;
    let environment = store.environment("hurt").expect("there");
    let met = [
        // That of the odd cell is in a sound entry.
        store.counts(hurt, &[state_at(HURT.start)]).await.err(),
        store.scan(hurt, Cursor::default(), 10).await.err(),
        store.actions(&environment).await.err(),
        store.totals(hurt).await.err(),
    ];
    assert!(
        met.iter()
            .all(|error| matches!(error, Some(StoreError::Damaged(_)))),
        "{met:?}"
    );
    let page = store.scan(sound, Cursor::default(), 100).await;
    assert_eq!(page.expect("a page").len(), 49);
}

/// Where states are numbered by a table.
#[tokio::test]
async fn an_audit_reads_the_rows_of_states_and_not_only_their_index() {
    of_too_many_states();
    let (file, hurt, sound) = prepared().await;
    assert!(spoil(&file.path(), 13, "701000.") > 0);
    let store = file.open(Quotas::default()).await;
    assert_audit_finds(&store, hurt, sound, "malformed").await;
}

/// Lets the hurt environment have the schema of another one, which is narrower. As if an earlier
/// build had written that: it has no checksum.
const NARROWED: &str = "update environments set (schema, schema_hash, checksum) = (
    select schema, schema_hash, null from environments where name = 'narrow') where name = 'hurt'";

/// Changes what an environment has, as damage would, under cells that it counted.
async fn changed_below(change: &'static str) -> (SqliteFile, EnvironmentId, EnvironmentId) {
    let (file, hurt, sound) = prepared().await;
    let store = file.open(Quotas::default()).await;
    let narrow = schema_of(&[("robot", 1_024), ("human", 512)]);
    let name = "narrow".parse().expect("a name");
    let made = store.create(&name, &narrow, &Default::default()).await;
    let narrow = made.expect("made").id;
    store.close().await;
    execute(&file.path(), change).await;
    let store = file.open(Quotas::default()).await;
    store.delete(narrow).await.expect("deleted");
    store.close().await;
    (file, hurt, sound)
}

#[tokio::test]
async fn an_audit_finds_cells_of_actions_and_segments_that_are_not_there() {
    for change in [NARROWED, "delete from segments where label = 'odd'"] {
        let (file, hurt, sound) = changed_below(change).await;
        let store = file.open(Quotas::default()).await;
        assert_audit_finds(&store, hurt, sound, "1 of its cells").await;
        let environment = store.environment("hurt").expect("there");
        let met = [
            store.counts(hurt, &[state_at(HURT.start)]).await.err(),
            store.scan(hurt, Cursor::default(), 10).await.err(),
            store.actions(&environment).await.err(),
        ];
        // Nothing can be worked out with an action that nobody has; a segment without a name is
        // told as one.
        if change == NARROWED {
            assert!(
                met.iter()
                    .all(|error| matches!(error, Some(StoreError::Damaged(_)))),
                "{change}: {met:?}"
            );
        }
        assert_eq!(
            store
                .scan(sound, Cursor::default(), 100)
                .await
                .expect("a page")
                .len(),
            49
        );
    }
}

/// Where states are numbered by a table, that is the first that a commit asks.
#[tokio::test]
async fn damage_that_a_commit_meets_is_its_environments_and_nobody_elses() {
    of_too_many_states();
    let (file, hurt, sound) = prepared().await;
    assert!(
        spoil(&file.path(), 10, "701000.") > 0,
        "the index by which a commit finds its states"
    );
    let store = file.open(Quotas::default()).await;
    let met = batch(hurt, "game", 2).cell(701_000, 1, tally(1, 1)).done();
    let neighbour = batch(sound, "game", 2).cell(2, 1, tally(1, 1)).done();
    let outcomes = store
        .commit(&[met.clone(), neighbour.clone()])
        .await
        .expect("a commit");
    assert_eq!(outcomes, [read_only(), applied(&neighbour)]);
    assert_refuses_one(&store, hurt, sound, &met).await;
}

/// A fold meets it: what was acknowledged before stays in the journal, and nobody else waits.
#[tokio::test]
async fn damage_that_a_fold_meets_is_its_environments_and_nobody_elses() {
    for spoil in [true, false] {
        let (mut file, hurt, sound) = prepared().await;
        match spoil {
            true => spoil_blob(&file.path(), ROW).await,
            false => flip_blob(&file.path(), ROW).await,
        }
        file.fold_from = 1;
        let store = file.open(Quotas::default()).await;
        let met = batch(hurt, "game", 2).cell(701_000, 1, tally(1, 1)).done();
        let neighbour = batch(sound, "game", 2).cell(2, 1, tally(1, 1)).done();
        let outcomes = store.commit(&[met.clone(), neighbour.clone()]).await;
        assert_eq!(
            outcomes.expect("a commit"),
            [applied(&met), applied(&neighbour)],
            "nothing that is damaged was read"
        );
        let mut failed = 0;
        while number(&file.path(), OF_SOUND).await > 0 {
            failed += u32::from(store.compact().await.is_err());
        }
        while store.read_only().is_empty() {
            failed += u32::from(store.compact().await.is_err());
        }
        assert_eq!(failed, 1, "it is left alone from then on");

        let next = batch(hurt, "game", 3).done();
        assert_eq!(
            store.commit(&[next]).await.expect("a commit"),
            [read_only()]
        );
        let counted = number(
            &file.path(),
            "select transitions from totals order by environment",
        )
        .await;
        assert_eq!(counted, 2_002, "what was acknowledged is kept");
        let entries = number(&file.path(), "select count(*) from journal").await;
        assert_eq!(entries, 1, "in the journal");
        assert_eq!(store.totals(sound).await.expect("totals").transitions, 50);
    }
}

/// How many entries the journal has of the other environment.
const OF_SOUND: &str = "select count(*) from journal where environment = (
    select id from environments where name = 'sound')";

/// Sees that one environment refuses a batch for good, and the other, with 50 transitions, goes on.
async fn assert_refuses_one(
    store: &Arc<dyn Store>,
    hurt: EnvironmentId,
    sound: EnvironmentId,
    met: &Numbered,
) {
    assert!(store.ready().await.is_ok(), "others are counted");
    assert_eq!(
        store
            .commit(std::slice::from_ref(met))
            .await
            .expect("a commit"),
        [read_only()],
        "for good"
    );
    assert_eq!(
        store
            .watermark(hurt, &met.producer)
            .await
            .expect("read")
            .get(),
        1,
        "nothing was acknowledged"
    );
    let totals = store.totals(sound).await.expect("totals");
    assert_eq!(totals.transitions, 50);
}

#[tokio::test]
async fn damage_that_a_question_meets_makes_the_environment_read_only() {
    for spoil in [true, false] {
        let (file, hurt, _) = prepared().await;
        match spoil {
            true => spoil_blob(&file.path(), ROW).await,
            false => flip_blob(&file.path(), ROW).await,
        }
        let store = file.open(Quotas::default()).await;
        let refused = store
            .counts(hurt, &[state_at(701_000)])
            .await
            .expect_err("damaged");
        assert!(matches!(refused, StoreError::Damaged(_)), "{refused}");
        let next = batch(hurt, "game", 2).cell(1, 1, tally(1, 1)).done();
        assert_eq!(
            store.commit(&[next]).await.expect("a commit"),
            [read_only()]
        );
    }
}

/// Changes a byte of a file; the same again changes it back.
fn change(path: &Path, at: usize, bits: u8) {
    let mut bytes = std::fs::read(path).expect("read");
    bytes[at] ^= bits;
    std::fs::write(path, bytes).expect("written");
}

/// A page came wrong, and comes right again: the environment stays read-only as long as all of it
/// read anew is not as it was written, and no longer.
#[tokio::test]
async fn what_seemed_damaged_takes_batches_again_once_it_is_found_to_be_sound() {
    for (sql, is_page) in [(ROW, true), (ROW, false), (ENTRY, false)] {
        let (file, hurt, _) = if sql == ROW {
            prepared().await
        } else {
            unfolded().await
        };
        let end = end_of_blob(&file.path(), sql).await;
        // A kind that no page has, or a bit of which SQLite knows nothing.
        let (at, bits) = if is_page {
            (end / PAGE * PAGE, 0x7a)
        } else {
            (end - 10, 4)
        };
        change(&file.path(), at, bits);

        let store = file.open(Quotas::default()).await;
        let key = [state_at(701_000)];
        let refused = store.counts(hurt, &key).await.expect_err("damaged");
        assert!(matches!(refused, StoreError::Damaged(_)), "{refused}");
        let told = store.read_only();
        assert_eq!(told.len(), 1, "{sql}");
        for _ in 0..3 {
            store.look_again().await;
            assert_eq!(store.read_only(), told, "{sql}: it is damaged");
        }
        let met = batch(hurt, "game", 2).cell(701_000, 1, tally(1, 1)).done();
        let refused = store.commit(std::slice::from_ref(&met)).await;
        assert_eq!(refused.expect("a commit"), [read_only()]);

        change(&file.path(), at, bits);
        store.look_again().await;
        assert_eq!(store.read_only(), [], "{sql}: it is sound");
        let outcomes = store.commit(std::slice::from_ref(&met)).await;
        assert_eq!(outcomes.expect("a commit"), [applied(&met)]);
        let counts = store.counts(hurt, &key).await.expect("sound");
        let cells = counts[0].counts.cells();
        assert_eq!(
            cells.iter().map(|cell| cell.tally.n).sum::<u64>(),
            2,
            "{sql}"
        );
        assert!(store.audit().await.expect("an audit")[0].is_sound());
    }
}

/// Every page that came with an environment is spoiled in turn, and one that was there before is
/// asked about: it borders on some of them, and has a few rows on those that were split.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn damage_of_one_environment_is_not_that_of_another() {
    let file = SqliteFile::new();
    let store = file.open(Quotas::default()).await;
    let sound = make(&store, "sound").await;
    let keys = 100_000..102_000;
    store
        .commit(&[filled(sound, "game", 1, keys.clone())])
        .await
        .expect("a commit");
    store.close().await;
    file.compact_all().await;
    let before = std::fs::metadata(file.path()).expect("there").len() as usize / PAGE;
    let store = file.open(Quotas::default()).await;
    let hurt = make(&store, "hurt").await;
    // So many that their rows take many pages.
    store
        .commit(&[filled(hurt, "game", 1, 700_000..740_000)])
        .await
        .expect("a commit");
    store.close().await;
    file.compact_all().await;

    let bytes = std::fs::read(file.path()).expect("read");
    let directory = TempDir::new().expect("a directory");
    let keys: Vec<_> = keys.map(state_at).collect();
    let wanted = ByVisits {
        segments: None,
        min_visits: 0,
        descending: true,
        after: None,
        states: 10,
    };
    let (mut hurt_by, mut failed) = (0, [0; 5]);
    for page in before..bytes.len() / PAGE {
        let path = directory.path().join(format!("{page}.db"));
        let mut spoiled = bytes.clone();
        spoiled[page * PAGE] = 0x77;
        std::fs::write(&path, spoiled).expect("written");
        let store = SqliteStore::inspect(&path, Options::default())
            .await
            .expect("it can be looked at");
        let environment = store.environment("sound").expect("there");
        let audits = store.audit().await.expect("an audit");
        let is_sound = |name: &str| {
            audits
                .iter()
                .any(|audit| audit.environment.as_str() == name && audit.is_sound())
        };
        hurt_by += u32::from(!is_sound("hurt"));
        let asked = [
            is_sound("sound"),
            store
                .scan(sound, Cursor::default(), 10_000)
                .await
                .is_ok_and(|page| page.len() == keys.len()),
            store
                .actions(&environment)
                .await
                .is_ok_and(|actions| actions.revision == 2_000),
            store
                .by_visits(sound, &wanted)
                .await
                .is_ok_and(|(page, _)| page.len() == 10),
            store.counts(sound, &keys).await.is_ok(),
        ];
        failed
            .iter_mut()
            .zip(asked)
            .for_each(|(failed, is_well)| *failed += u32::from(!is_well));
        store.close().await;
        std::fs::remove_file(&path).expect("removed");
    }
    assert!(hurt_by > 20, "{hurt_by} pages are the other's");
    assert!(
        failed.iter().all(|failed| *failed <= BORDERS),
        "{failed:?} of {hurt_by}"
    );
}

/// A count beyond the largest, which no batch can bring about, is damage too: a fold does not write
/// it.
#[tokio::test]
async fn a_count_that_cannot_be_is_damage() {
    const LARGEST: u64 = i64::MAX as u64;
    let mut file = SqliteFile::new();
    file.fold_from = 1;
    let store = file.open(Quotas::default()).await;
    let (hurt, sound) = (make(&store, "hurt").await, make(&store, "sound").await);
    let first = batch(hurt, "game", 1).cell(1, 1, tally(LARGEST, 0)).done();
    store.commit(&[first]).await.expect("a commit");
    store.close().await;
    file.compact_all().await;
    execute(&file.path(), "update totals set transitions = 0").await;
    let store = file.open(Quotas::default()).await;
    let met = batch(hurt, "game", 2).cell(1, 1, tally(1, 1)).done();
    let neighbour = batch(sound, "game", 1).cell(2, 1, tally(1, 1)).done();
    let outcomes = store.commit(&[met.clone(), neighbour.clone()]).await;
    assert_eq!(
        outcomes.expect("a commit"),
        [applied(&met), applied(&neighbour)]
    );
    while store.read_only().is_empty() {
        store.compact().await.ok();
    }
    assert_eq!(store.read_only()[0].0.as_str(), "hurt");
    let asked = store.counts(hurt, &[state_at(1)]).await;
    assert!(matches!(asked, Err(StoreError::Damaged(_))), "{asked:?}");
    while number(&file.path(), OF_SOUND).await > 0 {
        store.compact().await.expect("the other one's is folded");
    }
    assert_eq!(store.totals(sound).await.expect("totals").cells, 1);
    let rows = number(&file.path(), "select count(*) from packed").await;
    assert_eq!(rows, 2, "the damaged one's is as it was");
}

/// Puts the database where a service looks for it.
fn served(file: &SqliteFile) -> Arc<TempDir> {
    let directory = Arc::new(TempDir::new().expect("a directory"));
    std::fs::copy(file.path(), directory.path().join("nudge.db")).expect("copied");
    directory
}

async fn check(data: &Path) -> (i32, Value, String) {
    let data = data.to_str().expect("text");
    let (code, stdout, stderr) =
        exit_and_texts(&output(nudge("", &["check", "--json", "--data", data])).await);
    (
        code,
        serde_json::from_str(&stdout).unwrap_or_default(),
        stderr,
    )
}

fn post(place: u32, sequence: u64) -> Value {
    let transition = json!({"state": {"place": place}, "actions": {"robot": 1, "human": 1}});
    json!({"producer": "web", "sequence": sequence, "transitions": [transition]})
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn deleting_what_is_damaged_keeps_nobody_from_starting() {
    let (file, ..) = prepared().await;
    // The rows that a removal goes through, and an audit.
    spoil_blob(&file.path(), ROW).await;
    let directory = served(&file);
    let (code, report, stderr) = check(directory.path()).await;
    assert_eq!(
        (code, &report["sound"], &report["environments"][1]["sound"]),
        (1, &json!(false), &json!(true)),
        "{report}"
    );
    assert!(
        report["environments"][0]["unreadable"].is_string(),
        "{report}"
    );
    assert!(
        report["integrity"]
            .as_array()
            .is_some_and(|lines| !lines.is_empty()),
        "{report}"
    );
    assert!(
        stderr.contains("the database is damaged; 1 of 2 environments do not match"),
        "{stderr}"
    );

    let app = TestApp::on(directory.clone()).await;
    app.app.store.audit().await.expect("an audit");
    let (status, ready) = app.rest("GET", "/readyz?verbose", None).await;
    assert_eq!(status, 200, "the sound one is served: {ready}");
    assert!(
        ready["read_only"]["hurt"]
            .as_str()
            .is_some_and(|why| why.contains("cannot be read")),
        "{ready}"
    );
    let (_, metrics) = app.rest("GET", "/metrics", None).await;
    assert!(
        metrics
            .as_str()
            .is_some_and(|text| text.contains("nudge_environments_read_only 1"))
    );
    let (status, problem) = app
        .rest(
            "POST",
            "/v1/environments/hurt/transitions",
            Some(&post(1, 1)),
        )
        .await;
    assert_eq!(
        (status, &problem["reason"]),
        (409, &json!("ENVIRONMENT_READ_ONLY")),
        "{problem}"
    );
    assert_eq!(
        app.rest(
            "POST",
            "/v1/environments/sound/transitions",
            Some(&post(1, 1))
        )
        .await
        .0,
        200
    );
    let (status, problem) = app
        .rest("GET", "/v1/environments/hurt/states/701000", None)
        .await;
    assert_eq!(
        (status, &problem["reason"]),
        (500, &json!("DATABASE_DAMAGED")),
        "{problem}"
    );

    assert_eq!(
        app.rest("DELETE", "/v1/environments/hurt", None).await.0,
        204
    );
    // Now and ever after.
    let mut app = app;
    for sequence in [2, 3] {
        app = app.restart().await;
        let (_, list) = app.rest("GET", "/v1/environments", None).await;
        let names: Vec<&str> = list["environments"]
            .as_array()
            .expect("a list")
            .iter()
            .filter_map(|one| one["name"].as_str())
            .collect();
        assert_eq!(names, ["sound"]);
        assert_eq!(
            app.rest(
                "POST",
                "/v1/environments/sound/transitions",
                Some(&post(1, sequence))
            )
            .await
            .0,
            200
        );
        assert_eq!(app.rest("GET", "/readyz", None).await.0, 200);
    }
    assert_eq!(
        app.rest("PUT", "/v1/environments/hurt", Some(&lane_json()))
            .await
            .0,
        201,
        "its name is free"
    );
    let (_, state) = app
        .rest("GET", "/v1/environments/sound/states/1", None)
        .await;
    assert_eq!(state["visits"], 4, "{state}");
    app.stop().await;
}

/// Descriptions so long that they go on on pages of their own, one of which is spoiled.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_description_that_is_damaged_keeps_no_other_environment_away() {
    let directory = Arc::new(TempDir::new().expect("a directory"));
    let app = TestApp::on(directory.clone()).await;
    for name in ["aa", "hurt", "zz"] {
        let labels: Vec<String> = (0..2_000)
            .map(|label| format!("{name}-label-{label:05}"))
            .collect();
        let mut description = lane_json();
        description["state"][1]["categorical"]["labels"] = json!(labels);
        let (status, told) = app
            .rest(
                "PUT",
                &format!("/v1/environments/{name}"),
                Some(&description),
            )
            .await;
        assert_eq!(status, 201, "{told}");
    }
    app.stop().await;
    let path = directory.path().join("nudge.db");
    let mut bytes = std::fs::read(&path).expect("read");
    let text = b"hurt-label-01000";
    let page = bytes
        .chunks_mut(PAGE)
        .find(|page| page.windows(text.len()).any(|window| window == text))
        .expect("there");
    // Where it goes on: nowhere.
    page[..4].copy_from_slice(&[0x7f; 4]);
    std::fs::write(&path, bytes).expect("written");

    let app = TestApp::on(directory.clone()).await;
    let (_, list) = app.rest("GET", "/v1/environments", None).await;
    let names = |list: &Value| {
        list.as_array()
            .expect("a list")
            .iter()
            .map(|one| one["name"].clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(
        (names(&list["environments"]), names(&list["unreadable"])),
        (vec![json!("aa"), json!("zz")], vec![json!("hurt")])
    );
    assert!(
        list["unreadable"][0]["unreadable"]
            .as_str()
            .is_some_and(|why| why.contains("damaged")),
        "{list}"
    );
    let transition = json!({"state": {"distance": 1, "held": "zz-label-00000"}, "actions": {"robot": 0, "human": 0}});
    let body = json!({"producer": "p", "sequence": 1, "transitions": [transition]});
    assert_eq!(
        app.rest("POST", "/v1/environments/zz/transitions", Some(&body))
            .await
            .0,
        200
    );
    app.stop().await;
    let (code, report, _) = check(directory.path()).await;
    assert_eq!(
        (code, &report["unreadable"][0]["name"]),
        (1, &json!("hurt")),
        "{report}"
    );
}

/// Changes a database as a flipped bit would: where SQLite sees nothing.
async fn changed(file: &SqliteFile, text: &'static str) -> Arc<TempDir> {
    let directory = served(file);
    let options = SqliteConnectOptions::new().filename(directory.path().join("nudge.db"));
    let mut raw = options
        .pragma("writable_schema", "on")
        .connect()
        .await
        .expect("a connection");
    let done = sqlx::query(text).execute(&mut raw).await.expect("changed");
    assert!(
        done.rows_affected() > 0 || text.starts_with("alter"),
        "{text}"
    );
    raw.close().await.expect("closed");
    directory
}

/// The tables say what they are, and that is not so: nobody is served by them, in the same words as
/// the check has.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_a_database_says_of_its_tables_is_checked() {
    let (file, ..) = prepared().await;
    for (text, expected) in [
        (
            "update _sqlx_migrations set checksum = zeroblob(48) where version = 1",
            "its record of migration 1 is not as it was written",
        ),
        (
            "update _sqlx_migrations set version = 19 where version = 3",
            "its record of migration 3 is not as it was written",
        ),
        (
            "update _sqlx_migrations set success = 0 where version = 2",
            "its record of migration 2 is not as it was written",
        ),
        (
            "update sqlite_schema set sql = replace(sql, 'n > 0', 'n > 1') where name = 'cells'",
            "the definition of `cells` is not as it was written",
        ),
        (
            "alter table _sqlx_migrations rename to x_sqlx_migrations",
            "its list of migrations is missing",
        ),
        (
            "delete from _sqlx_migrations",
            "its list of migrations is empty",
        ),
    ] {
        let directory = changed(&file, text).await;
        let (code, report, stderr) = check(directory.path()).await;
        assert_eq!(
            (code, &report["integrity"]),
            (1, &json!([expected])),
            "{text}: {report} {stderr}"
        );
        let data = directory.path().to_str().expect("text");
        let serving = nudge("", &["serve", "--listen", "127.0.0.1:0", "--data", data]);
        let (code, _, stderr) = exit_and_texts(&output(serving).await);
        assert_eq!((code, stderr.lines().count()), (2, 1), "{text}: {stderr}");
        assert!(
            stderr.contains(&format!("it is damaged: {expected}; `nudge check` tells")),
            "{text}: {stderr}"
        );
    }
    // What somebody else added is none of ours.
    let directory = served(&file);
    let options = SqliteConnectOptions::new().filename(directory.path().join("nudge.db"));
    let mut raw = options.connect().await.expect("a connection");
    sqlx::raw_sql("create index mine on cells (n); analyze")
        .execute(&mut raw)
        .await
        .expect("added");
    raw.close().await.expect("closed");
    assert_eq!(check(directory.path()).await.0, 0);
    TestApp::on(directory).await.stop().await;
}

/// The page of the list of migrations, and the first of all, which say what the tables are: every
/// start reads them.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn pages_that_every_start_reads_are_told_to_be_damaged_in_words() {
    let (file, ..) = prepared().await;
    let mut raw = SqliteConnectOptions::new()
        .filename(file.path())
        .connect()
        .await
        .expect("a connection");
    let text = "select rootpage from sqlite_schema where name = '_sqlx_migrations'";
    let page: i64 = sqlx::query_scalar(text)
        .fetch_one(&mut raw)
        .await
        .expect("a page");
    raw.close().await.expect("closed");
    let sound = std::fs::read(file.path()).expect("read");
    let table = b"CREATE TABLE totals";
    // A copy may be left where it stood before.
    let defined = (0..sound.len())
        .filter(|at| sound[*at..].starts_with(table))
        .map(|at| at + "CREATE ".len());
    for (places, byte) in [
        (vec![(page as usize - 1) * PAGE], 0x77),
        (defined.collect(), b'x'),
    ] {
        let at = places[0];
        let directory = Arc::new(TempDir::new().expect("a directory"));
        let mut bytes = sound.clone();
        places.into_iter().for_each(|at| bytes[at] = byte);
        std::fs::write(directory.path().join("nudge.db"), bytes).expect("written");
        let (code, report, stderr) = check(directory.path()).await;
        assert_eq!(
            (code, &report["sound"]),
            (1, &json!(false)),
            "{at}: {report} {stderr}"
        );
        assert!(
            report["integrity"].to_string().contains("malformed"),
            "{at}: {report}"
        );
        let data = directory.path().to_str().expect("text");
        let serving = nudge("", &["serve", "--listen", "127.0.0.1:0", "--data", data]);
        let (code, _, stderr) = exit_and_texts(&output(serving).await);
        assert_eq!((code, stderr.lines().count()), (2, 1), "{at}: {stderr}");
        assert!(
            stderr.contains("it is damaged: ") && stderr.contains("`nudge check` tells"),
            "{at}: {stderr}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_check_reads_receipts_and_fits() {
    let (file, hurt, _) = prepared().await;
    let store = file.open(Quotas::default()).await;
    let many: Vec<_> = (2..=1_100)
        .map(|sequence| batch(hurt, "game", sequence).done())
        .collect();
    store.commit(&many).await.expect("a commit");
    store.close().await;
    assert_eq!(
        check(served(&file).path()).await.0,
        0,
        "the first are kept no longer"
    );
    for (text, expected) in [
        (
            "update batches set receipt = replace(receipt, 'accepted', 'accdpted') where sequence = 900",
            "the receipt of batch 900",
        ),
        (
            "update batches set receipt = '{\"accepted\":1,\"rejected_count\":2}' where sequence = 900",
            "tells of more or fewer",
        ),
        (
            "update batches set receipt = '{\"accepted\":0,\"rejected_count\":1,\"rejected\":[[7,\"a\",\"b\"]]}' where sequence = 900",
            "the batch cannot have",
        ),
        (
            "update batches set sequence = 70000 where sequence = 900",
            "its last number is 1100",
        ),
        (
            "delete from batches where sequence = 77",
            "its last number is 1100",
        ),
        (
            "delete from batches where sequence = 1100",
            "its last number is 1100",
        ),
        (
            "update producers set sequence = 1101 where sequence = 1100",
            "its last number is 1101",
        ),
        (
            "update producers set name = '' where sequence = 1100",
            "nobody can have this name",
        ),
        (
            "insert into fits (environment, pair, version, revision, body) values (1, '0,1', 1, 1, '{\"form\":1')",
            "fit of 0,1: CANNOT BE READ",
        ),
    ] {
        let directory = changed(&file, text).await;
        let (code, report, stderr) = check(directory.path()).await;
        assert_eq!(
            (code, &report["sound"], &report["integrity"]),
            (1, &json!(false), &json!([])),
            "{text}: {report}"
        );
        assert!(report.to_string().contains(expected), "{text}: {report}");
        assert!(
            stderr.contains("cannot be read") || stderr.contains("not as they were written"),
            "{text}: {stderr}"
        );
        let data = directory.path().to_str().expect("text");
        let (_, stdout, _) = exit_and_texts(&output(nudge("", &["check", "--data", data])).await);
        assert!(stdout.contains(expected), "{text}: {stdout}");
    }
}

async fn quick_check(path: &Path) -> bool {
    let Ok(mut raw) = SqliteConnectOptions::new()
        .filename(path)
        .read_only(true)
        .connect()
        .await
    else {
        return false;
    };
    let lines: Result<Vec<String>, _> = sqlx::query_scalar("pragma quick_check")
        .fetch_all(&mut raw)
        .await;
    let _ = raw.close().await;
    lines.is_ok_and(|lines| lines == ["ok"])
}

/// Returns whether a check finds nothing: what `nudge check` asks of the store.
async fn is_passed(path: &Path) -> bool {
    let Ok(store) = SqliteStore::inspect(path, Options::default()).await else {
        return false;
    };
    let integrity = store.integrity().await;
    let audits = store.audit().await;
    let mut is_sound = store.unreadable().is_empty();
    for environment in store.environments() {
        let faults = store.receipts(environment.id).await;
        is_sound &= faults.is_ok_and(|faults| faults.is_empty());
        let rows = store.damaged_rows(environment.id).await;
        is_sound &= rows.is_ok_and(|rows| rows.is_empty());
        is_sound &= are_sound(&store, environment.id).await.unwrap_or(false);
    }
    store.close().await;
    is_sound
        && integrity.is_ok_and(|lines| lines.is_empty())
        && audits.is_ok_and(|audits| audits.iter().all(|audit| audit.is_sound()))
}

/// Returns whether the fits and networks of an environment are as they were kept.
async fn are_sound(store: &SqliteStore, id: EnvironmentId) -> Result<bool, StoreError> {
    let fits = store.fits(id).await?;
    let mut are_sound = fits.iter().all(|fit| fit.is_sound);
    for record in store.models(id).await? {
        let model = store.model(id, record.version).await?;
        are_sound &= model.is_some_and(|(record, _)| record.is_sound);
    }
    Ok(are_sound)
}

/// Everything that a database tells, in words: environments, totals, segments, every cell, fits,
/// networks, producers, and what becomes of each batch that is sent again.
async fn told_by(path: &Path, sent: &[Numbered]) -> Result<String, StoreError> {
    let store = SqliteStore::open(path, Options::default()).await?;
    let mut told = String::new();
    for environment in store.environments() {
        let id = environment.id;
        let (totals, segments) = (store.totals(id).await?, store.segments(id).await?);
        told.push_str(&format!("{environment:?} {totals:?} {segments:?}"));
        let mut cursor = Cursor::default();
        loop {
            let page = store.scan(id, cursor, 1_000).await?;
            for state in &page {
                told.push_str(&format!("{:?} {:?}", state.key, state.counts.cells()));
            }
            match page.last() {
                Some(last) => cursor = last.cursor,
                None => break,
            }
        }
        told.push_str(&format!("{:?}", store.fits(id).await?));
        for record in store.models(id).await? {
            let (record, weights) = store.model(id, record.version).await?.expect("listed");
            told.push_str(&format!("{record:?} {}", blake3::hash(&weights)));
        }
        let producers: BTreeSet<_> = sent.iter().map(|batch| &batch.producer).collect();
        for producer in producers {
            let last = store.watermark(id, producer).await?;
            let owner = store.owner(id, producer).await?;
            told.push_str(&format!("{producer} {last:?} {owner:?}"));
        }
        let next = store.keep_model(id, &network("next")).await?;
        told.push_str(&format!("next network {next}"));
    }
    told.push_str(&format!("{:?}", store.commit(sent).await?));
    store.close().await;
    Ok(told)
}

fn network(card: &str) -> NewModel {
    NewModel {
        ego: 0,
        other: 1,
        kind: "direct".into(),
        card: format!("{{\"said\":\"{card}\"}}"),
        weights: card.bytes().cycle().take(700).collect(),
    }
}

/// Keeps fits and networks, one of them active and one deleted.
async fn keep_others(store: &Arc<dyn Store>, id: EnvironmentId) {
    for (pair, version) in [("0,1", 3), ("1,0", 7)] {
        let fit = FitRecord {
            pair: pair.into(),
            id: FitId {
                version,
                revision: 1_234,
            },
            body: format!("{{\"said\":{version}}}"),
            is_sound: true,
        };
        store.keep_fit(id, &fit).await.expect("kept");
    }
    for card in ["first", "second", "third"] {
        store.keep_model(id, &network(card)).await.expect("kept");
    }
    for version in [2, 1] {
        store.activate_model(id, version).await.expect("activated");
    }
    store.delete_model(id, 3).await.expect("deleted");
}

/// Lets a batch be of a segment and of a key.
fn owned(mut batch: Numbered, segment: &str, owner: &str) -> Numbered {
    batch.increment.segment = Some(segment.parse().expect("a label"));
    batch.owner = Some(owner.parse().expect("a name"));
    batch
}

/// Makes a database that has everything: rows, a fold that is half way, a journal beside, an
/// environment whose states are listed, and one whose counts are half in the tables of earlier
/// builds. Returns it with what was sent. No page is free, so that a flipped bit hits something.
async fn of_everything() -> (SqliteFile, Vec<Numbered>) {
    let mut file = SqliteFile::new();
    file.fold_from = 1;
    let store = file.open(Quotas::default()).await;
    let (one, other) = (make(&store, "one").await, make(&store, "other").await);
    let old = make(&store, "old").await;
    let rows = |rows: std::ops::Range<u32>| rows.map(|row| 16 * row);
    let mut sent = vec![
        filled(one, "a", 1, rows(0..300)),
        owned(filled(other, "b", 1, rows(0..1_500)), "train", "key-1"),
        owned(filled(old, "d", 1, rows(0..50)), "früher", "key-2"),
    ];
    sent.extend((1..40).map(|sequence| {
        batch(other, "c", sequence)
            .cell(7, sequence, tally(3, 2))
            .done()
    }));
    let half_folded = [
        filled(other, "b", 2, rows(100..1_600)),
        filled(one, "a", 2, rows(200..400)),
    ];
    let beside = filled(other, "b", 3, rows(0..50));

    // From here on states are too many.
    of_too_many_states();
    let listed = make(&store, "listed").await;
    sent.push(owned(filled(listed, "e", 1, 0..200), "liste", "key-3"));
    store.commit(&sent).await.expect("a commit");
    let rule = RuleDraft {
        share: Some(0.375),
        min_visits: Some(12),
        ..RuleDraft::default()
    };
    let names = ["place", "depth"].map(String::from).to_vec();
    let level = DerivedDraft {
        name: "level".into(),
        kinds: vec![DerivedKindDraft::Equal(names)],
    };
    let change = Change {
        derived: Some(DerivedFeatures::checked(&[level], &schema()).expect("valid")),
        rule: Some(WrittenRule::default().merged(&rule).expect("valid")),
    };
    store.change(listed, &change).await.expect("set");
    keep_others(&store, one).await;
    store.close().await;
    drop(store);
    file.compact_all().await;

    // So many that a step is taken, and so few that no commit takes one.
    file.fold_from = 1_000;
    let store = file.open(Quotas::default()).await;
    store.commit(&half_folded).await.expect("a commit");
    // One step of two.
    store.compact().await.expect("a step");
    let beside = [beside, filled(listed, "e", 2, 150..220)];
    store.commit(&beside).await.expect("a commit");
    store.close().await;
    drop(store);
    let half_way = "select count(*) from totals where fold_row is not null";
    assert_eq!(number(&file.path(), half_way).await, 1);
    sent.extend(half_folded.into_iter().chain(beside));
    execute(&file.path(), HALF_MOVED).await;
    (file, sent)
}

/// Puts some cells of the environment `old` into the tables of earlier builds.
const HALF_MOVED: &str = "
    create temp table old as select environments.id as environment, segments.id as segment
        from environments join segments on environment = environments.id where name = 'old';
    create temp table place as
        with recursive place(at) as (select 1 union all select at + 1 from place where at < 60) select at from place;
    insert into states (id, environment, key) select 1000000 + at, environment, 16 * 50 + at from old, place;
    insert into cells (state, segment, joint, n, entries) select 1000000 + at, segment, at, at, at / 2 from old, place;
    update totals set unmoved = 1, transitions = transitions + 1830, states = states + 60, cells = cells + 60
        where environment in (select environment from old);
    drop table old;
    drop table place;
    vacuum";

/// Where bits are flipped.
struct Places {
    sound: Vec<u8>,
    /// Most of a page may be a gap of zeros, which few flips are spent on.
    written: Vec<usize>,
    /// The first bytes of the root pages of tables and indices: all that there is of small ones.
    roots: Vec<usize>,
    /// The bytes of the cells of earlier builds, which have no checksum: what is damaged among them
    /// shows where it changes a sum.
    unsealed: std::ops::Range<usize>,
}

impl Places {
    async fn of(path: &Path) -> Self {
        let sound = std::fs::read(path).expect("read");
        let options = SqliteConnectOptions::new().filename(path).read_only(true);
        let mut raw = options.connect().await.expect("a connection");
        let text = "select rootpage, name = 'cells' from sqlite_schema union select 1, 0";
        let pages: Vec<(i64, bool)> = sqlx::query_as(text)
            .fetch_all(&mut raw)
            .await
            .expect("pages");
        raw.close().await.expect("closed");
        let first = |page: i64| (page as usize - 1) * PAGE;
        let cells = pages.iter().find(|(_, is_cells)| *is_cells);
        let cells = first(cells.expect("a table").0);
        assert_eq!(
            sound[cells], 10,
            "one page has all the cells of earlier builds"
        );
        Self {
            written: (0..sound.len()).filter(|at| sound[*at] != 0).collect(),
            roots: pages.iter().map(|(page, _)| first(*page)).collect(),
            unsealed: cells..cells + PAGE,
            sound,
        }
    }

    /// Returns a byte: any at all, one that is written, or one of a small table.
    fn any(&self, round: u64, random: &mut StdRng) -> usize {
        match round % 8 {
            0 => random.random_range(0..self.sound.len()),
            1..=4 => self.written[random.random_range(0..self.written.len())],
            _ => {
                let root = self.roots[random.random_range(0..self.roots.len())];
                let first = self.written.partition_point(|at| *at < root);
                let last = self.written.partition_point(|at| *at < root + PAGE);
                self.written[random.random_range(first..last)]
            }
        }
    }
}

/// Bits are flipped at random places of pages that are in use. What the check passes must be without
/// effect: a gap between cells of a page, or a text that nothing is read from.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flipped_bit_is_found_or_changes_nothing() {
    let rounds = crate::faults::scaled(300, 3_000);
    let (file, sent) = of_everything().await;
    let places = Places::of(&file.path()).await;
    let directory = TempDir::new().expect("a directory");
    let path = directory.path().join("flipped.db");
    std::fs::write(&path, &places.sound).expect("written");
    assert!(is_passed(&path).await);
    let expected = told_by(&path, &sent).await.expect("told");
    assert!(!expected.contains("Refused") && !expected.contains("Applied"));

    let mut random = StdRng::seed_from_u64(16);
    let (mut passed, mut unsealed) = (0, 0);
    for round in 0..rounds {
        let mut bytes = places.sound.clone();
        let (at, bit) = (places.any(round, &mut random), random.random_range(0..8));
        bytes[at] ^= 1 << bit;
        std::fs::write(&path, bytes).expect("written");
        if is_passed(&path).await {
            passed += 1;
            let told = told_by(&path, &sent).await;
            let is_same = told.as_ref().is_ok_and(|told| *told == expected);
            unsealed += u64::from(!is_same && places.unsealed.contains(&at));
            assert!(
                is_same || places.unsealed.contains(&at),
                "round {round}: bit {bit} of byte {at} (page {}) was passed: {}",
                at / PAGE + 1,
                told.map_or_else(
                    |error| error.to_string(),
                    |told| difference(&expected, &told)
                ),
            );
        }
        for rest in ["-wal", "-shm"] {
            let _ = std::fs::remove_file(directory.path().join(format!("flipped.db{rest}")));
        }
    }
    println!("{rounds} flips, {passed} passed, {unsealed} of them in cells of earlier builds");
    assert!(passed < rounds / 3, "{passed} of {rounds}");
}

/// Bits are flipped, and everything is asked for: what made an environment read-only is found again
/// by whoever looks at all of it anew.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn damage_that_any_call_meets_is_met_again() {
    let rounds = crate::faults::scaled(150, 3_000);
    let (file, sent) = of_everything().await;
    let places = Places::of(&file.path()).await;
    let directory = TempDir::new().expect("a directory");
    let path = directory.path().join("flipped.db");
    let options = Options {
        look_again_after: Duration::ZERO,
        ..Options::default()
    };

    let mut random = StdRng::seed_from_u64(18);
    let mut met = 0;
    for round in 0..rounds {
        let mut bytes = places.sound.clone();
        let (at, bit) = (places.any(round, &mut random), random.random_range(0..8));
        bytes[at] ^= 1 << bit;
        std::fs::write(&path, bytes).expect("written");
        if let Ok(store) = SqliteStore::open(&path, options.clone()).await {
            ask_everything(&store, &sent).await;
            let told = store.read_only();
            for _ in &told {
                store.look_again().await;
            }
            assert_eq!(
                store.read_only(),
                told,
                "round {round}: bit {bit} of byte {at} (page {})",
                at / PAGE + 1
            );
            met += u32::from(!told.is_empty());
            store.close().await;
        }
        for rest in ["-wal", "-shm"] {
            let _ = std::fs::remove_file(directory.path().join(format!("flipped.db{rest}")));
        }
    }
    println!("{rounds} flips, {met} met");
    assert!(u64::from(met) > rounds / 10, "{met} of {rounds}");
}

/// Makes every call, whatever comes of it.
async fn ask_everything(store: &SqliteStore, sent: &[Numbered]) {
    for environment in store.environments() {
        let id = environment.id;
        let mut cursor = Cursor::default();
        while let Ok(page) = store.scan(id, cursor, 1_000).await
            && let Some(last) = page.last()
        {
            cursor = last.cursor;
            let keys: Vec<_> = page.iter().map(|state| state.key.clone()).collect();
            let _ = store.counts(id, &keys).await;
        }
        let _ = store.totals(id).await;
        let _ = store.segments(id).await;
        let _ = store.actions(&environment).await;
        let _ = store.fits(id).await;
        for record in store.models(id).await.unwrap_or_default() {
            let _ = store.model(id, record.version).await;
        }
        for batch in sent {
            let _ = store.watermark(id, &batch.producer).await;
            let _ = store.owner(id, &batch.producer).await;
        }
        let _ = store.keep_model(id, &network("next")).await;
    }
    for batch in sent {
        let _ = store.commit(std::slice::from_ref(batch)).await;
    }
}

/// Returns where two texts begin to differ.
fn difference(expected: &str, told: &str) -> String {
    let same = expected.chars().zip(told.chars());
    let same = same.take_while(|(a, b)| a == b).count();
    let near = |text: &str| {
        text.chars()
            .skip(same.saturating_sub(60))
            .take(120)
            .collect::<String>()
    };
    format!("expected {:?}, got {:?}", near(expected), near(told))
}

/// What no flip does but a hand that has SQL: texts that an index agrees with, and rows of nobody.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_check_finds_what_was_changed_by_hand() {
    let (file, _) = of_everything().await;
    let directory = TempDir::new().expect("a directory");
    for (round, change) in [
        "select 1",
        "insert into packed (id, cells) select (7 << 44) + 2, cells from packed limit 1",
        "update states set key = key || '.0' where environment = (select id from environments where name = 'listed')",
        "delete from totals where environment = (select id from environments where name = 'listed')",
        "update model_versions set environment = (select id from environments where name = 'listed')",
    ]
    .into_iter()
    .enumerate()
    {
        let path = directory.path().join(format!("{round}.db"));
        std::fs::copy(file.path(), &path).expect("copied");
        execute(&path, change).await;
        assert_eq!(is_passed(&path).await, round == 0, "{change}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_the_check_passes_sqlites_own_passes_too() {
    let (file, ..) = prepared().await;
    assert!(is_passed(&file.path()).await && quick_check(&file.path()).await);
    let sound = std::fs::read(file.path()).expect("read");
    let directory = TempDir::new().expect("a directory");
    let mut random = StdRng::seed_from_u64(12);
    let (mut found, mut by_both) = (0, 0);
    for round in 0..120 {
        let mut bytes = sound.clone();
        // A page of another kind, a torn page, a flipped bit.
        let at = random.random_range(1..bytes.len() / PAGE) * PAGE;
        match round % 3 {
            0 => bytes[at] ^= 0x0f,
            1 => bytes[at + PAGE / 2..at + PAGE].fill(0),
            _ => bytes[at + random.random_range(0..PAGE)] ^= 1 << random.random_range(0..8),
        }
        let path: PathBuf = directory.path().join(format!("{round}.db"));
        std::fs::write(&path, bytes).expect("written");
        let (passed, quick) = (is_passed(&path).await, quick_check(&path).await);
        assert!(
            quick || !passed,
            "round {round}: the check passes what quick_check refuses"
        );
        found += u32::from(!passed);
        by_both += u32::from(!quick);
    }
    assert!(
        found >= by_both && by_both > 20,
        "{found} found, {by_both} by quick_check"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_check_changes_nothing_and_runs_beside_a_service() {
    let app = TestApp::start().await;
    app.lane().await;
    let transition =
        json!({"state": {"distance": 1, "held": 0}, "actions": {"robot": 0, "human": 0}});
    let body =
        |sequence: u64| json!({"producer": "p", "sequence": sequence, "transitions": [transition]});
    assert_eq!(
        app.rest("POST", "/v1/environments/lane/transitions", Some(&body(1)))
            .await
            .0,
        200
    );
    let (code, report, stderr) = check(app.directory.path()).await;
    assert_eq!(
        (code, &report["sound"], &report["integrity"]),
        (0, &json!(true), &json!([])),
        "{stderr}"
    );
    assert_eq!(
        report["environments"][0]["kept"]["transitions"], 1,
        "what the journal has is seen"
    );
    assert_eq!(
        app.rest("POST", "/v1/environments/lane/transitions", Some(&body(2)))
            .await
            .0,
        200
    );
    let directory = app.directory.clone();
    app.stop().await;

    let database = directory.path().join("nudge.db");
    let before = std::fs::read(&database).expect("read");
    assert_eq!(check(directory.path()).await.0, 0);
    assert!(std::fs::read(&database).expect("read") == before);

    for (bytes, expected) in [
        ("".as_bytes(), "no database of nudge"),
        (&b"to be or not to be".repeat(500)[..], "not a database"),
    ] {
        std::fs::write(&database, bytes).expect("written");
        let (code, _, stderr) = check(directory.path()).await;
        assert_eq!((code, stderr.lines().count()), (2, 1), "{stderr}");
        assert!(stderr.contains(expected), "{stderr}");
        assert!(
            std::fs::read(&database).expect("read") == bytes,
            "nothing is written there"
        );
    }
}
