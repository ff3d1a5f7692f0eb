//! Deleting a large environment: accepted at once, finished behind the answers, through failures,
//! kill -9 and restarts.

use std::net::SocketAddr;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;

use nudge::store::{Options, SqliteStore, Store};
use serde_json::{Value, json};
use tempfile::TempDir;
use tonic::Code;

use crate::server::Server;
use crate::support::batches::{filled, schema};
use crate::support::databases::{compact_all, execute, number};
use crate::support::faulty::{Failure, Faulty};
use crate::support::{RawStream, TestApp, hello, lane_json, open, reason, row, rows};

async fn background(address: SocketAddr) -> String {
    let answer = reqwest::get(format!("http://{address}/readyz?verbose"))
        .await
        .expect("answered");
    assert_eq!(answer.status(), 200);
    answer.json::<Value>().await.expect("JSON")["background"]
        .as_str()
        .expect("words")
        .to_owned()
}

/// Waits until the background says something that passes.
async fn until(address: SocketAddr, passes: impl Fn(&str) -> bool) -> String {
    loop {
        let told = background(address).await;
        if passes(&told) {
            return told;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// Returns the states that are left, where an environment is being removed.
fn left(told: &str) -> Option<u64> {
    let states = told
        .strip_prefix("removing 1 environment, ")?
        .split(" state")
        .next()?;
    states.replace(',', "").parse().ok()
}

#[tokio::test]
async fn a_deletion_is_accepted_at_once_and_goes_on_until_it_can() {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let faulty = Faulty::new(
        open(directory.path(), Options::default()).await,
        Failure::Sweep,
    );
    faulty.arm();
    let app = TestApp::with(directory.clone(), faulty.clone()).await;
    app.lane().await;
    let (_, mut stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    stream
        .send(rows(1, vec![row([0.1, 0.0], [0.0, 2.0])]))
        .await
        .expect("open");
    stream.acknowledged().await.expect("committed");
    until(app.address, |told| told == "idle").await;

    let (status, _) = app.rest("DELETE", "/v1/environments/lane", None).await;
    assert_eq!(status, 204);
    let ended = stream.acknowledged().await.expect_err("deleted");
    assert_eq!(
        (ended.code(), reason(&ended)),
        (Code::NotFound, "ENVIRONMENT_NOT_FOUND".into())
    );
    assert_eq!(app.rest("GET", "/v1/environments/lane", None).await.0, 404);
    assert_eq!(
        app.rest("DELETE", "/v1/environments/lane", None).await.0,
        404
    );
    assert_eq!(
        background(app.address).await,
        "removing 1 environment, 1 state left"
    );

    // Nothing of it can be removed yet, and nobody else waits: its name begins anew, and another
    // one goes.
    for removing in [
        "removing 2 environments, 2 states left",
        "removing 3 environments, 3 states left",
    ] {
        assert_eq!(
            app.rest("PUT", "/v1/environments/lane", Some(&lane_json()))
                .await
                .0,
            201
        );
        let body = json!({"producer": "p", "sequence": 1, "transitions": [
            {"state": {"distance": 1, "held": 0}, "actions": {"robot": 0, "human": 0}}]});
        let (status, receipt) = app
            .rest("POST", "/v1/environments/lane/transitions", Some(&body))
            .await;
        assert_eq!(
            (status, &receipt["status"]),
            (200, &json!("applied")),
            "{receipt}"
        );
        assert_eq!(
            app.rest("DELETE", "/v1/environments/lane", None).await.0,
            204
        );
        assert_eq!(background(app.address).await, removing);
    }

    faulty.disarm();
    until(app.address, |told| told == "idle").await;
    app.stop().await;
    let rows = "select (select count(*) from environments) + (select count(*) from states) + (select count(*) from cells)
        + (select count(*) from packed) + (select count(*) from journal)";
    assert_eq!(number(&directory.path().join("nudge.db"), rows).await, 0);
}

/// An environment `old` that an earlier build had, and that was deleted, with 40,000 states of two
/// cells; what is half way cannot be removed, so that nothing ends by itself.
const HALF_SWEPT: &str = "
    insert into environments (uid, name, schema, schema_hash, rule) select 'old', null, schema, schema_hash, rule from environments;
    insert into states (id, environment, key)
        with recursive n (x) as (select 1 union all select x + 1 from n where x < 40000)
        select 1000 + x, (select id from environments where uid = 'old'), printf('%05d', x) from n;
    insert into cells select id, 9, 0, 1, 1 from states where id > 1000;
    insert into cells select id, 9, 1, 1, 1 from states where id > 1000;
    create trigger fault before delete on states when old.key = '20000' begin select raise(abort, 'disk I/O error'); end;";

/// The same of this build, in rows.
async fn half_swept_rows(database: &Path) {
    let store = SqliteStore::open(database, Options::default())
        .await
        .expect("opened");
    let name = "old".parse().expect("a name");
    let made = store.create(&name, &schema(), &Default::default()).await;
    let id = made.expect("made").id;
    for sequence in 1..=4 {
        // Each in a row of its own.
        let places = (1..=10_000).map(|place| 16 * ((sequence as u32 - 1) * 10_000 + place));
        let batch = filled(id, "p", sequence, places);
        store.commit(&[batch]).await.expect("a commit");
    }
    store.close().await;
    drop(store);
    compact_all(database, Options::default()).await;
    let hide = "update environments set name = null, uid = 'old' where name = 'old';
        delete from totals where environment = (select id from environments where uid = 'old');
        create trigger fault before delete on packed when old.id = (1 << 44) + 20000
            begin select raise(abort, 'disk I/O error'); end;";
    execute(database, hide).await;
}

fn count_one(sequence: u64) -> Value {
    json!({"producer": "p", "sequence": sequence, "transitions": [
        {"state": {"distance": 1, "held": 0}, "actions": {"robot": 0, "human": 0}}]})
}

async fn post(address: SocketAddr, sequence: u64) {
    let url = format!("http://{address}/v1/environments/lane/transitions");
    let answer = reqwest::Client::new()
        .post(url)
        .json(&count_one(sequence))
        .send()
        .await
        .expect("answered");
    assert_eq!(answer.status(), 200);
    assert_eq!(
        answer.json::<Value>().await.expect("JSON")["status"],
        "applied"
    );
}

/// How many states `old` has left: in the tables of an earlier build, and in rows of their own, which
/// are in the first block.
const LEFT: &str = "select (select count(*) from packed where id >> 44 = 1)
    + (select count(*) from states where environment = (select id from environments where uid = 'old'))";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_removal_goes_on_after_kills_and_restarts_behind_the_answers() {
    removal_goes_on(async |database| execute(database, HALF_SWEPT).await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_removal_of_rows_goes_on_after_kills_and_restarts_behind_the_answers() {
    removal_goes_on(half_swept_rows).await;
}

/// Prepares a database with a removal that cannot end, and lets it go on in spite of what may come.
async fn removal_goes_on(prepare: impl AsyncFnOnce(&Path)) {
    let directory = TempDir::new().expect("a temporary directory");
    let database = directory.path().join("nudge.db");
    let server = Server::start(directory.path(), "127.0.0.1:0");
    let put = reqwest::Client::new()
        .put(format!("http://{}/v1/environments/lane", server.address))
        .json(&lane_json());
    assert_eq!(put.send().await.expect("answered").status(), 201);
    server.kill();
    prepare(&database).await;

    // Killed as soon as some of it is removed, then while the rest cannot be, then told to stop:
    // each start serves at once.
    let mut before = 40_000;
    for (sequence, round) in (1..).zip(["begun", "half way", "stopped"]) {
        let server = Server::start(directory.path(), "127.0.0.1:0");
        post(server.address, sequence).await;
        let told = match round {
            "begun" => {
                // None are told to be left until they are counted.
                until(server.address, |told| {
                    left(told).is_some_and(|left| (1..40_000).contains(&left))
                })
                .await
            }
            _ => {
                until(server.address, |told| {
                    left(told).is_some_and(|left| (20_001..=before).contains(&left))
                })
                .await
            }
        };
        assert!(told.starts_with("removing 1 environment, "), "{told}");
        if round == "stopped" {
            assert_eq!(server.terminate(), Some(0), "a signal ends it");
        } else {
            server.kill();
        }
        before = number(&database, LEFT).await.unsigned_abs();
        assert!((20_001..40_000).contains(&before), "{round}: {before}");
    }

    let server = Server::start(directory.path(), "127.0.0.1:0");
    execute(&database, "drop trigger fault").await;
    until(server.address, |told| told == "idle").await;
    post(server.address, 4).await;
    server.kill();
    assert_eq!(number(&database, LEFT).await, 0);
    assert_eq!(
        number(
            &database,
            "select (select count(*) from cells) + (select count(*) from environments)"
        )
        .await,
        1
    );
    let check = Command::new(env!("CARGO_BIN_EXE_nudge"))
        .args(["check", "--data"])
        .arg(directory.path())
        .output();
    let check = check.expect("it starts");
    assert!(
        check.status.success(),
        "{}",
        String::from_utf8_lossy(&check.stdout)
    );
}
