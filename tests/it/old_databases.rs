//! Databases of every landed build are opened by this one, and what was told of them is told again.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use nudge::domain::{Digest, EnvironmentId, Pair, Schema, StateKey, Tally};
use nudge::priors::PriorRegistry;
use nudge::store::{Cursor, Numbered, Options, SqliteStore, Store, Totals};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};

use crate::cli::{exit_and_texts, nudge, output};
use crate::support::batches::{applied, batch, tally};
use crate::support::databases::{LEFT, compact_all, number};
use crate::support::fixtures::{BEFORE_VERSIONS, Fixture};
use crate::support::{TestApp, open};

const ENVIRONMENTS: &str = "/v1/environments";

/// Says where a new answer does not have what an old one had: fields are added, never renamed, and
/// values stay.
fn lost(old: &Value, new: &Value, at: &str) -> Vec<String> {
    match (old, new) {
        (Value::Object(old), Value::Object(new)) => {
            let missing = Value::Null;
            let member = |(name, old): (&String, _)| {
                lost(
                    old,
                    new.get(name).unwrap_or(&missing),
                    &format!("{at}/{name}"),
                )
            };
            old.iter().flat_map(member).collect()
        }
        (Value::Array(old), Value::Array(new)) if old.len() == new.len() => (0..)
            .zip(old)
            .zip(new)
            .flat_map(|((i, old), new): ((u32, _), _)| lost(old, new, &format!("{at}/{i}")))
            .collect(),
        _ if same(old, new) => Vec::new(),
        _ => vec![format!("{at}: was {old}, is {new}")],
    }
}

/// 5 and 5.0 are one number.
fn same(old: &Value, new: &Value) -> bool {
    old == new
        || (old.is_f64() || new.is_f64()) && old.as_f64().is_some() && old.as_f64() == new.as_f64()
}

/// Opens a database, and asks what was asked of the build that left it.
async fn opened(fixture: &Fixture) -> TestApp {
    let app = TestApp::on(fixture.directory.clone()).await;
    let (status, ready) = app.rest("GET", "/readyz?verbose", None).await;
    assert_eq!(
        (status, &ready["ready"]),
        (200, &json!(true)),
        "{}: {ready}",
        fixture.name
    );
    app
}

async fn get(app: &TestApp, path: &str) -> Value {
    app.get(&format!("{ENVIRONMENTS}{path}")).await
}

/// Returns every fixture; there is one of each landed build at least.
fn fixtures() -> Vec<Fixture> {
    let fixtures = Fixture::all();
    for name in [
        "schema-1-af3f5d0",
        "schema-2-a8de69e",
        BEFORE_VERSIONS,
        "schema-5-c788985",
        "schema-5-f1075ef",
        "schema-6-60781e2",
    ] {
        assert!(
            fixtures.iter().any(|fixture| fixture.name == name),
            "{name} is missing"
        );
    }
    fixtures
}

/// What a database keeps of its migrations: the table's definition, and each record with the types of
/// its columns, but for when and how fast it was.
async fn migrations(path: &Path) -> (String, Vec<(i64, String, bool, Vec<u8>, String)>) {
    let options = SqliteConnectOptions::new().filename(path);
    let mut raw = options.connect().await.expect("a database");
    let table = sqlx::query_scalar("select sql from sqlite_schema where name = '_sqlx_migrations'")
        .fetch_one(&mut raw)
        .await
        .expect("a table");
    let records = sqlx::query_as(
        "select version, description, success, checksum, typeof(version) || typeof(description)
             || typeof(success) || typeof(checksum) || typeof(installed_on) || typeof(execution_time)
         from _sqlx_migrations where execution_time > 0 order by version",
    );
    let records = records.fetch_all(&mut raw).await.expect("records");
    raw.close().await.expect("closed");
    (table, records)
}

/// Those of the first builds were written by the driver.
#[tokio::test]
async fn migrations_are_recorded_as_they_always_were() {
    let directory = tempfile::tempdir().expect("a directory");
    open(directory.path(), Options::default())
        .await
        .close()
        .await;
    let (table, records) = migrations(&directory.path().join("nudge.db")).await;
    for fixture in fixtures() {
        let (old_table, old_records) = migrations(&fixture.path()).await;
        assert_eq!(old_table, table, "{}", fixture.name);
        assert!(!old_records.is_empty(), "{}", fixture.name);
        assert_eq!(
            old_records,
            records[..old_records.len()],
            "{}",
            fixture.name
        );
    }
}

/// Looked at before they are opened, and after.
#[tokio::test]
async fn a_check_passes_them() {
    for fixture in fixtures() {
        for _ in 0..2 {
            let data = fixture.directory.path().to_str().expect("text").to_owned();
            let (code, stdout, stderr) =
                exit_and_texts(&output(nudge("", &["check", "--data", &data])).await);
            assert_eq!(code, 0, "{}: {stdout}{stderr}", fixture.name);
            opened(&fixture).await.stop().await;
        }
    }
}

#[tokio::test]
async fn environments_counts_and_watermarks_are_what_they_were() {
    for fixture in fixtures() {
        let app = opened(&fixture).await;
        let exact = |path: &str| {
            !path.contains("/influence") && !path.ends_with("/fit") && !path.ends_with("/models")
        };
        let mut asked = 0;
        for (path, old) in fixture.got().filter(|(path, _)| exact(path)) {
            assert_eq!(
                lost(old, &get(&app, path).await, ""),
                [""; 0],
                "{}: {path}",
                fixture.name
            );
            asked += 1;
        }
        assert!(asked >= 11, "{}: {asked}", fixture.name);
        let list = get(&app, "").await;
        let (_, told) = fixture
            .got()
            .find(|(path, _)| path.is_empty())
            .expect("told");
        let number = |list: &Value| list["environments"].as_array().map(Vec::len);
        assert_eq!(
            (number(&list), list.get("unreadable")),
            (number(told), None)
        );
        app.stop().await;
    }
}

#[tokio::test]
async fn batches_that_are_sent_again_get_their_first_receipt_and_count_nothing() {
    for fixture in fixtures() {
        let app = opened(&fixture).await;
        let totals = async || {
            app.app
                .store
                .totals(app.app.environments.find("corner").expect("there").id)
                .await
        };
        let before = totals().await.expect("totals");
        for (path, body, answer) in fixture.posted() {
            let (status, again) = app
                .rest("POST", &format!("{ENVIRONMENTS}{path}"), Some(body))
                .await;
            let mut expected = answer.clone();
            expected["status"] = json!("duplicate");
            assert_eq!(
                (status, lost(&expected, &again, "")),
                (200, vec![]),
                "{}: {path}",
                fixture.name
            );
        }
        assert_eq!(totals().await.expect("totals"), before, "{}", fixture.name);
        assert_eq!(
            (before.transitions, before.segments, before.producers),
            (868, 2, 2),
            "{}",
            fixture.name
        );

        let one = json!({"place": 0});
        let next = json!({"producer": "p", "sequence": 2, "transitions": [{"state": one, "actions": {"a": 0, "b": 0, "c": 0}}]});
        let (status, receipt) = app
            .rest(
                "POST",
                &format!("{ENVIRONMENTS}/trio/transitions"),
                Some(&next),
            )
            .await;
        assert_eq!(
            (status, &receipt["status"]),
            (200, &json!("applied")),
            "{}: it goes on",
            fixture.name
        );
        app.stop().await;
    }
}

#[tokio::test]
async fn questions_are_answered_from_the_same_counts() {
    const FIGURES: [&str; 3] = ["/answers/0/state", "/answers/0/visits", "/answers/0/unit"];
    for fixture in fixtures() {
        let app = opened(&fixture).await;
        for (path, old) in fixture
            .got()
            .filter(|(path, _)| path.contains("/influence"))
        {
            let new = get(&app, path).await;
            for pointer in ["/labels"].iter().chain(&FIGURES) {
                let [old, new] = [old, &new].map(|answer| answer.pointer(pointer).expect("told"));
                assert_eq!(lost(old, new, pointer), [""; 0], "{}: {path}", fixture.name);
            }
            let plug_in = |answer: &Value| {
                answer
                    .pointer("/answers/0/mutual_information/plug_in")
                    .and_then(Value::as_f64)
            };
            let difference = plug_in(old).expect("a number") - plug_in(&new).expect("a number");
            assert!(
                difference.abs() < 1e-9,
                "{}: {path}: {difference}",
                fixture.name
            );
            let version = |answer: &Value| answer.pointer("/answers/0/model/version").cloned();
            assert_eq!(
                version(&new),
                version(old),
                "{}: {path}: the same network answers",
                fixture.name
            );
        }
        app.stop().await;
    }
}

#[tokio::test]
async fn fits_are_read_or_made_again_under_the_next_version() {
    let mut stored = 0;
    for fixture in fixtures() {
        let app = opened(&fixture).await;
        let (store, fits) = (
            app.app.store.clone(),
            PriorRegistry::new(app.app.store.clone()),
        );
        for (name, given) in [("corner", vec![]), ("trio", vec![2])] {
            let environment = store.environment(name).expect("there");
            let Some(record) = store.fits(environment.id).await.expect("read").pop() else {
                continue;
            };
            let pair = Pair::new(0, 1, given);
            let fitted = fits
                .get(&environment, &pair)
                .await
                .expect("read")
                .expect("not too large");
            // A form that is not used any more is as if nothing was fitted, and no answer names its
            // version.
            assert!(
                fitted.id == record.id || fitted.id.version == 0,
                "{}: {name}: {:?}",
                fixture.name,
                fitted.id
            );
            let next = fits
                .fit(&environment, &pair)
                .await
                .expect("fitted")
                .expect("not too large");
            assert_eq!(
                next.id.version,
                record.id.version + 1,
                "{}: {name}: never used twice",
                fixture.name
            );
            stored += 1;
        }
        app.stop().await;
    }
    assert!(stored >= 4, "{stored}");
}

#[tokio::test]
async fn networks_are_listed_with_their_cards_and_the_active_one_answers() {
    let mut networks = 0;
    for fixture in fixtures() {
        let Some((_, old)) = fixture.got().find(|(path, _)| *path == "/corner/models") else {
            continue;
        };
        let app = opened(&fixture).await;
        let new = get(&app, "/corner/models").await;
        assert_eq!(
            lost(&old["models"], &new["models"], "/models"),
            [""; 0],
            "{}",
            fixture.name
        );
        let models = new["models"].as_array().expect("a list");
        assert!(
            models.iter().all(|model| model.get("unreadable").is_none()),
            "{new}"
        );
        networks += models.len();

        let (status, model) = app.rest("GET", "/v2/models/corner", None).await;
        assert_eq!(
            (status, &model["versions"]),
            (200, &json!(["1", "2", "3"])),
            "{}: {model}",
            fixture.name
        );
        let file = app
            .app
            .networks
            .export(&app.app.environments.find("corner").expect("there"), 1)
            .await
            .expect("kept");
        let environment = app.app.environments.find("corner").expect("there");
        let imported = app
            .app
            .networks
            .import(&environment, file)
            .await
            .expect("it comes back");
        assert_eq!(
            imported.version, 5,
            "{}: the fourth was deleted, and its number is not used again",
            fixture.name
        );
        app.stop().await;
    }
    assert!(networks >= 3, "{networks}");
}

/// What an environment counted: of each state, the cells by segment and joint action.
type Cells = BTreeMap<StateKey, BTreeMap<(i64, u64), Tally>>;

/// Reads what an earlier build counted, by its name, with its own totals.
async fn counted(path: &Path) -> BTreeMap<String, (Cells, [i64; 3])> {
    let options = SqliteConnectOptions::new().filename(path);
    let mut raw = options.connect().await.expect("a database");
    let totals: Vec<(String, i64, i64, i64)> = sqlx::query_as(
        "select name, transitions, states, cells from totals join environments on id = environment",
    )
    .fetch_all(&mut raw)
    .await
    .expect("totals");
    let cells: Vec<(String, String, i64, i64, i64, Option<i64>)> = sqlx::query_as(
        "select name, key, segment, joint, n, entries from cells
         join states on states.id = state join environments on environments.id = environment",
    )
    .fetch_all(&mut raw)
    .await
    .expect("cells");
    raw.close().await.expect("closed");
    let mut counted = BTreeMap::new();
    for (name, transitions, states, cells) in totals {
        counted.insert(name, (Cells::new(), [transitions, states, cells]));
    }
    for (name, key, segment, joint, n, entries) in cells {
        let (of, _) = counted.get_mut(&name).expect("it has totals");
        let key = StateKey::from_stored(&key).expect("a key");
        let tally = Tally {
            n: n as u64,
            entries: entries.map(|entries| entries as u64),
        };
        of.entry(key)
            .or_default()
            .insert((segment, joint as u64), tally);
    }
    counted
}

/// Compares the counts of states that are asked for, and the totals.
async fn assert_counts(store: &SqliteStore, id: EnvironmentId, cells: &Cells, totals: Totals) {
    let keys: Vec<StateKey> = cells.keys().cloned().collect();
    let found = store.counts(id, &keys).await.expect("counts");
    for (state, found) in cells.iter().zip(found) {
        let told = found.counts.cells().iter();
        let told = told.map(|cell| ((cell.segment.0, cell.joint), cell.tally));
        assert_eq!((state.0, &told.collect()), state);
        assert_eq!(found.revision, totals.transitions);
    }
    assert_eq!(store.totals(id).await.expect("totals"), totals);
}

/// While its counts are moved into rows, and interrupted anywhere, a database answers as it did; and
/// what is counted meanwhile is counted.
#[tokio::test]
async fn counts_are_what_they_were_before_while_and_after_they_are_moved() {
    let mut random = StdRng::seed_from_u64(5);
    let mut half_way = 0;
    // Later builds have nothing that is to be moved.
    for fixture in fixtures().into_iter().filter(|one| *one.name < *"schema-5") {
        let path = fixture.path();
        let mut expected = counted(&path).await;
        let options = Options {
            fold_from: 1,
            cache_cells: 0,
            ..Options::default()
        };
        let mut round = 0;
        loop {
            round += 1;
            let store = SqliteStore::open(&path, options.clone())
                .await
                .expect("opened");
            let left = number(&path, "select sum(unmoved) from totals").await;
            assert!(
                round > 1 || left > 0,
                "{}: nothing is moved yet",
                fixture.name
            );
            for environment in store.environments() {
                let (id, name) = (environment.id, environment.name.to_string());
                let before = store.totals(id).await.expect("totals");
                let (cells, totals) = expected.get_mut(&name).expect("it was there");
                let kept = [before.transitions, before.states, before.cells];
                assert_eq!(
                    kept.map(|total| total as i64),
                    *totals,
                    "{}: {name}",
                    fixture.name
                );
                assert_counts(&store, id, cells, before).await;

                // Something more, of a state that it has.
                let Some(key) = cells.keys().next().cloned() else {
                    continue;
                };
                let more = one_more(id, &environment.schema, round, &key);
                assert_eq!(
                    store
                        .commit(std::slice::from_ref(&more))
                        .await
                        .expect("a commit"),
                    [applied(&more)]
                );
                let unnamed = store.segments(id).await.expect("segments");
                let (segment, _) = unnamed
                    .iter()
                    .find(|(_, label)| label.is_none())
                    .expect("there");
                let of = cells.get_mut(&key).expect("it has some");
                let is_new = !of.contains_key(&(segment.0, 0));
                of.entry((segment.0, 0))
                    .or_insert(Tally::EMPTY)
                    .add(tally(1, 1));
                totals[0] += 1;
                totals[2] += i64::from(is_new);
                let after = store.totals(id).await.expect("totals");
                let kept = [after.transitions, after.states, after.cells];
                assert_eq!(
                    kept.map(|total| total as i64),
                    *totals,
                    "{}: {name}",
                    fixture.name
                );
                assert_counts(&store, id, cells, after).await;
            }
            let audits = store.audit().await.expect("an audit");
            assert!(audits.iter().all(|audit| audit.is_sound()), "{audits:?}");

            let patience = Duration::from_micros(random.random_range(0..6_000) * round);
            let interrupted = async {
                while number(&path, LEFT).await > 0 {
                    store.compact().await.expect("a step");
                }
            };
            let is_done = tokio::time::timeout(patience, interrupted).await.is_ok();
            half_way += u32::from(!is_done);
            // As a kill would leave it.
            drop(store);
            if is_done && round > 2 {
                break;
            }
        }

        let store = SqliteStore::open(&path, options).await.expect("opened");
        let old = "select (select count(*) from cells) + (select sum(unmoved) from totals)";
        assert_eq!(
            number(&path, old).await,
            0,
            "{}: all are moved",
            fixture.name
        );
        for environment in store.environments() {
            let (cells, _) = &expected[environment.name.as_str()];
            let totals = store.totals(environment.id).await.expect("totals");
            assert_counts(&store, environment.id, cells, totals).await;
            let scanned = store.scan(environment.id, Cursor::default(), 10_000).await;
            let scanned = scanned.expect("a page").into_iter().map(|state| state.key);
            let mut scanned: Vec<StateKey> = scanned.collect();
            scanned.sort();
            assert!(cells.keys().eq(&scanned), "{}", fixture.name);
        }
        store.close().await;
    }
    assert!(half_way > 5, "{half_way}");
}

/// Returns a batch of one transition, of the joint action 0.
fn one_more(id: EnvironmentId, schema: &Schema, round: u64, key: &StateKey) -> Numbered {
    let mut more = batch(id, "later", round).done();
    more.increment.cells = vec![(schema.rank(key), 0, tally(1, 1))];
    more.increment.transitions = 1;
    more.receipt.accepted = 1;
    more.digest = Digest([7; 32]);
    more
}

/// A build that folded a journal was killed half way: the next one tells the same, and goes on.
#[tokio::test]
async fn a_fold_that_was_left_half_way_is_told_as_before_and_ended() {
    let fixtures = fixtures().into_iter();
    for fixture in fixtures.filter(|one| *one.name >= *"schema-5") {
        let path = fixture.path();
        let half_way = "select count(*) from totals where fold_row > 0";
        assert_eq!(number(&path, half_way).await, 1, "{}", fixture.name);
        let mut before = None;
        for is_folded in [false, true] {
            if is_folded {
                compact_all(&path, Options::default()).await;
                assert_eq!(number(&path, half_way).await, 0);
            }
            let store = open(fixture.directory.path(), Options::default()).await;
            let audits = store.audit().await.expect("an audit");
            assert!(audits.iter().all(|audit| audit.is_sound()), "{audits:?}");
            let mut totals = Vec::new();
            for environment in store.environments() {
                totals.push(store.totals(environment.id).await.expect("totals"));
            }
            let wide = store.environment("wide").expect("there").id;
            let page = store.scan(wide, Cursor::default(), 10_000).await;
            let counts: Vec<_> = page
                .expect("a page")
                .into_iter()
                .map(|state| state.counts)
                .collect();
            assert_eq!(counts.len(), 5_000, "{}", fixture.name);
            let told = (totals, counts);
            assert!(
                before.as_ref().is_none_or(|before| *before == told),
                "{}",
                fixture.name
            );
            before = Some(told);
            store.close().await;
        }
    }
}
