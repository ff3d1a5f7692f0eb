//! A damaged database: what is damaged takes nothing, what is sound stays served, and deleting the
//! damaged part keeps nobody from starting.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use nudge::domain::{EnvironmentId, WrittenRule};
use nudge::store::{
    ByVisits, Cursor, Options, Outcome, Quotas, Refusal, SqliteStore, Store, StoreError,
};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use tempfile::TempDir;

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::batches::*;
use crate::support::databases::{Database, SqliteFile};
use crate::support::{TestApp, lane_json};

const PAGE: usize = 4_096;

/// Pages of another environment that one may need: on each of the tables of states and cells and
/// the index of keys, the one where the other begins, which was split off the last one.
const BORDERS: u32 = 3;

/// The places of the environment that will be hurt: their keys stand on pages of their own.
const HURT: std::ops::Range<u32> = 700_000..702_000;

async fn make(store: &Arc<dyn Store>, name: &str) -> EnvironmentId {
    store
        .create(
            &name.parse().expect("a name"),
            &schema(),
            WrittenRule::default(),
        )
        .await
        .expect("made")
        .id
}

/// Makes two environments, and closes the database.
async fn prepared() -> (SqliteFile, EnvironmentId, EnvironmentId) {
    let file = SqliteFile::new();
    let store = file.open(Quotas::default()).await;
    let (hurt, sound) = (make(&store, "hurt").await, make(&store, "sound").await);
    let large = HURT.fold(batch(hurt, "game", 1), |sending, place| {
        sending.cell(place, 1, tally(1, 1))
    });
    store.commit(&[large.done()]).await.expect("a commit");
    let small = (1..50).fold(batch(sound, "game", 1), |sending, place| {
        sending.cell(place, 1, tally(1, 1))
    });
    store.commit(&[small.done()]).await.expect("a commit");
    store.close().await;
    (file, hurt, sound)
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
            // No page has this kind: whoever reads it is told that the database is malformed.
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

#[tokio::test]
async fn an_audit_that_cannot_read_makes_the_environment_read_only() {
    let (file, hurt, sound) = prepared().await;
    assert!(spoil(&file.path(), 10, "701000") > 0);
    let store = file.open(Quotas::default()).await;
    let audits = store.audit().await.expect("an audit of what can be read");
    assert_eq!(
        audits
            .iter()
            .map(|audit| audit.is_sound())
            .collect::<Vec<_>>(),
        [false, true]
    );
    assert!(
        audits[0]
            .unreadable
            .as_ref()
            .is_some_and(|why| why.contains("malformed")),
        "{audits:?}"
    );
    let listed = store.read_only();
    assert!(
        matches!(&listed[..], [(name, why)] if name.as_str() == "hurt" && why.contains("cannot be read")),
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
async fn an_audit_reads_the_rows_of_states_and_not_only_their_index() {
    let (file, hurt, _) = prepared().await;
    assert!(spoil(&file.path(), 13, "701000") > 0);
    let store = file.open(Quotas::default()).await;
    let audits = store.audit().await.expect("an audit of what can be read");
    assert_eq!(
        audits
            .iter()
            .map(|audit| audit.is_sound())
            .collect::<Vec<_>>(),
        [false, true],
        "{audits:?}"
    );
    let next = batch(hurt, "game", 2).cell(1, 1, tally(1, 1)).done();
    assert_eq!(
        store.commit(&[next]).await.expect("a commit"),
        [read_only()]
    );
}

#[tokio::test]
async fn an_audit_finds_cells_of_actions_and_segments_that_are_not_there() {
    for change in ["joint = 1 << 40", "segment = 999"] {
        let (file, hurt, sound) = prepared().await;
        let mut raw = SqliteConnectOptions::new()
            .filename(file.path())
            .connect()
            .await
            .expect("a connection");
        let text =
            format!("update cells set {change} where state = (select min(state) from cells)");
        sqlx::query(sqlx::AssertSqlSafe(text))
            .execute(&mut raw)
            .await
            .expect("changed");
        raw.close().await.expect("closed");
        let store = file.open(Quotas::default()).await;
        let environment = store.environment("hurt").expect("there");
        let met = [
            store.counts(hurt, &[state_at(HURT.start)]).await.err(),
            store.scan(hurt, Cursor::default(), 10).await.err(),
            store.actions(&environment).await.err(),
        ];
        // Nothing can be worked out with an action that nobody has; a segment without a name is
        // told as one.
        if change.starts_with("joint") {
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
        let audits = store.audit().await.expect("an audit");
        let why = audits[0].unreadable.as_ref().expect("found");
        assert!(
            audits[1].is_sound() && why.starts_with("1 of its cells"),
            "{audits:?}"
        );
        let refused = batch(hurt, "game", 2).cell(1, 1, tally(1, 1)).done();
        let taken = batch(sound, "game", 2).cell(1, 1, tally(1, 1)).done();
        assert_eq!(
            store
                .commit(&[refused, taken.clone()])
                .await
                .expect("a commit"),
            [read_only(), applied(&taken)]
        );
    }
}

#[tokio::test]
async fn damage_that_a_commit_meets_is_its_environments_and_nobody_elses() {
    let (file, hurt, sound) = prepared().await;
    assert!(
        spoil(&file.path(), 10, "701000") > 0,
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
    assert!(store.ready().await.is_ok(), "others are counted");
    assert_eq!(
        store.commit(&[met]).await.expect("a commit"),
        [read_only()],
        "for good"
    );
    assert_eq!(
        store
            .watermark(hurt, &neighbour.producer)
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
    let (file, hurt, _) = prepared().await;
    assert!(spoil(&file.path(), 10, "701000") > 0);
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

/// Every page that came with an environment is spoiled in turn, and one that was there before is
/// asked about: it borders on some of them, and has a few rows on those that were split.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn damage_of_one_environment_is_not_that_of_another() {
    let file = SqliteFile::new();
    let store = file.open(Quotas::default()).await;
    let sound = make(&store, "sound").await;
    let keys = 100_000..102_000;
    let fill = |id, places: std::ops::Range<u32>| {
        places
            .fold(batch(id, "game", 1), |sending, place| {
                sending.cell(place, 1, tally(1, 1))
            })
            .done()
    };
    store
        .commit(&[fill(sound, keys.clone())])
        .await
        .expect("a commit");
    store.close().await;
    let before = std::fs::metadata(file.path()).expect("there").len() as usize / PAGE;
    let store = file.open(Quotas::default()).await;
    let hurt = make(&store, "hurt").await;
    store.commit(&[fill(hurt, HURT)]).await.expect("a commit");
    store.close().await;

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

/// A row that breaks a rule of its table is damage too: a count beyond the largest, which no batch
/// can bring about.
#[tokio::test]
async fn a_count_that_cannot_be_is_damage() {
    let (file, hurt, sound) = prepared().await;
    let mut raw = SqliteConnectOptions::new()
        .filename(file.path())
        .connect()
        .await
        .expect("a connection");
    let text =
        "update cells set n = 9223372036854775807 where state = (select min(state) from cells)";
    sqlx::query(text).execute(&mut raw).await.expect("changed");
    raw.close().await.expect("closed");
    let store = file.open(Quotas::default()).await;
    let met = batch(hurt, "game", 2)
        .cell(HURT.start, 1, tally(1, 1))
        .done();
    let neighbour = batch(sound, "game", 2).cell(2, 1, tally(1, 1)).done();
    assert_eq!(
        store
            .commit(&[met, neighbour.clone()])
            .await
            .expect("a commit"),
        [read_only(), applied(&neighbour)]
    );
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
    // The rows that a removal goes through, and the index that an audit reads instead of them.
    assert!(
        [13, 10]
            .iter()
            .all(|kind| spoil(&file.path(), *kind, "701000") > 0)
    );
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

async fn is_passed(path: &Path) -> bool {
    let Ok(store) = SqliteStore::inspect(path, Options::default()).await else {
        return false;
    };
    let integrity = store.integrity().await;
    let audits = store.audit().await;
    store.close().await;
    integrity.is_ok_and(|lines| lines.is_empty())
        && audits.is_ok_and(|audits| audits.iter().all(|audit| audit.is_sound()))
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
