//! Ready means that a commit would succeed: full disks, files that are moved away, databases that
//! others keep locked, and the way back from each without a restart.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use nudge::store::{Options, SqliteStore, Store};
use serde_json::{Value, json};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions, Connection};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use crate::support::disks::{SmallDisk, run_as_root};
use crate::support::{TestApp, lane_json};

const TRANSITIONS: &str = "/v1/environments/lane/transitions";

/// Longer than any turn of readiness may take.
const SOON: Duration = Duration::from_secs(15);

fn batch(sequence: u64) -> Value {
    let transition =
        json!({"state": {"distance": 0.1, "held": 0}, "actions": {"robot": 0, "human": 2}});
    json!({"producer": "p", "sequence": sequence, "transitions": vec![transition; 1_000]})
}

async fn checked(app: &TestApp) -> (u16, String) {
    let (status, told) = app.rest("GET", "/readyz?verbose", None).await;
    (
        status,
        told["checks"]["database"]
            .as_str()
            .unwrap_or_default()
            .to_owned(),
    )
}

/// Waits until readiness turns to a status, and returns what is said of the database.
async fn turned(app: &TestApp, status: u16) -> String {
    let since = Instant::now();
    loop {
        let (found, database) = checked(app).await;
        if found == status {
            return database;
        }
        assert!(since.elapsed() < SOON, "still {found}: {database}");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

/// Gives so many bytes of a file back.
fn shorten(file: &Path, bytes: u64) {
    let file = std::fs::File::options()
        .write(true)
        .open(file)
        .expect("there");
    let taken = file.metadata().expect("there").len();
    file.set_len(taken - bytes).expect("shortened");
}

async fn metric(app: &TestApp) -> String {
    let (_, text) = app.rest("GET", "/metrics", None).await;
    let text = text.as_str().unwrap_or_default();
    text.lines()
        .find(|line| line.starts_with("nudge_ready{check=\"database\"}"))
        .expect("the metric")
        .to_owned()
}

async fn visits(app: &TestApp) -> u64 {
    app.cells("0.0").await.iter().map(|cell| cell.2).sum()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_is_not_ready_and_says_so_and_recovers_without_a_restart() {
    let Some(disk) = SmallDisk::mount("24m") else {
        return run_as_root(
            "readiness::a_full_disk_is_not_ready_and_says_so_and_recovers_without_a_restart",
        );
    };
    let app = TestApp::on(disk.directory()).await;
    app.lane().await;
    assert_eq!(app.rest("POST", TRANSITIONS, Some(&batch(1))).await.0, 200);
    assert_eq!(checked(&app).await, (200, "ok".into()));
    assert_eq!(metric(&app).await, "nudge_ready{check=\"database\"} 1");

    // Nobody commits: the service finds it out by itself.
    let filler = disk.fill();
    let told = turned(&app, 503).await;
    assert!(told.starts_with("the disk is full ("), "{told}");
    assert_eq!(metric(&app).await, "nudge_ready{check=\"database\"} 0");
    let (_, plain) = app.rest("GET", "/readyz", None).await;
    assert_eq!(plain, json!("not ready\n"));

    // What is refused says that nothing was counted, or changed, and why.
    let (status, problem) = app.rest("POST", TRANSITIONS, Some(&batch(2))).await;
    let told = (&problem["reason"], &problem["detail"], &problem["cause"]);
    let expected = "nothing was counted: the disk is full; send it again";
    assert_eq!(
        (status, told),
        (
            503,
            (
                &json!("STORE_UNAVAILABLE"),
                &json!(expected),
                &json!("disk_full")
            )
        )
    );
    let (status, problem) = app
        .rest("PUT", "/v1/environments/another", Some(&lane_json()))
        .await;
    assert_eq!(
        (status, &problem["detail"]),
        (
            503,
            &json!("nothing was changed: the disk is full; send it again")
        )
    );
    assert_eq!(visits(&app).await, 1_000, "questions are answered");
    let mut health = HealthClient::new(app.channel().await);
    let since = Instant::now();
    while health
        .check(HealthCheckRequest::default())
        .await
        .expect("known")
        .into_inner()
        .status
        != 2
    {
        assert!(since.elapsed() < SOON, "gRPC says that it serves");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }

    // A little room is not enough to be believed: the next commit would need more than a page.
    shorten(&filler, 1 << 20);
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(checked(&app).await.0, 503);

    std::fs::remove_file(&filler).expect("removed");
    assert_eq!(turned(&app, 200).await, "ok");
    for sequence in [2, 3] {
        assert_eq!(
            app.rest("POST", TRANSITIONS, Some(&batch(sequence)))
                .await
                .1["status"],
            "applied"
        );
    }
    assert_eq!(visits(&app).await, 3_000, "each once");
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_commit_that_fails_is_not_ready_at_once_and_its_lines_of_the_log_are_few() {
    let Some(disk) = SmallDisk::mount("24m") else {
        return run_as_root(
            "readiness::a_commit_that_fails_is_not_ready_at_once_and_its_lines_of_the_log_are_few",
        );
    };
    let directory = disk.directory();
    let mut child = Command::new(env!("CARGO_BIN_EXE_nudge"))
        .args([
            "serve",
            "--listen",
            "127.0.0.1:0",
            "--fit-every",
            "0s",
            "--log",
            "json",
            "--data",
        ])
        .arg(directory.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the binary starts");
    let mut line = String::new();
    BufReader::new(child.stdout.take().expect("piped"))
        .read_line(&mut line)
        .expect("a line");
    let url = line
        .trim()
        .strip_prefix("listening on ")
        .expect("an address")
        .to_owned();
    let client = reqwest::Client::new();
    let put = client
        .put(format!("{url}/v1/environments/lane"))
        .json(&lane_json())
        .send()
        .await
        .expect("answered");
    assert_eq!(put.status(), 201);

    disk.fill();
    for _ in 0..50 {
        let answer = client
            .post(format!("{url}{TRANSITIONS}"))
            .json(&batch(1))
            .send()
            .await
            .expect("answered");
        assert_eq!(answer.status(), 503);
        let ready = client
            .get(format!("{url}/readyz"))
            .send()
            .await
            .expect("answered");
        assert_eq!(ready.status(), 503, "at once");
    }
    assert!(
        Command::new("kill")
            .args(["-TERM", &child.id().to_string()])
            .status()
            .expect("kill is there")
            .success()
    );
    let stderr = child.stderr.take().expect("piped");
    let logged = tokio::task::spawn_blocking(move || {
        BufReader::new(stderr)
            .lines()
            .map(|line| line.expect("text"))
            .collect::<Vec<_>>()
    });
    let lines: Vec<Value> = logged
        .await
        .expect("no panic")
        .iter()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    child.wait().expect("it ends");
    let of = |message: &str| {
        lines
            .iter()
            .filter(|line| line["message"] == message)
            .count()
    };
    let (failed, not_ready) = (
        of("a commit failed; its producers will resume"),
        of("not ready: a write failed"),
    );
    // The first, and one in five seconds.
    assert!(
        (1..=10).contains(&failed) && (1..=10).contains(&not_ready),
        "{failed} and {not_ready}: {lines:#?}"
    );
    let why = lines
        .iter()
        .find(|line| line["message"] == "not ready: a write failed")
        .expect("told");
    assert!(
        why["why"]
            .as_str()
            .is_some_and(|why| why.starts_with("the disk is full (")),
        "{why}"
    );
    assert!(why["left_out"].is_u64(), "{why}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_service_starts_on_a_full_disk_and_answers_what_it_has() {
    let Some(disk) = SmallDisk::mount("24m") else {
        return run_as_root("readiness::a_service_starts_on_a_full_disk_and_answers_what_it_has");
    };
    let directory = disk.directory();
    let app = TestApp::on(directory.clone()).await;
    app.lane().await;
    assert_eq!(app.rest("POST", TRANSITIONS, Some(&batch(1))).await.0, 200);
    // A crash leaves the journal, which the next start need not write anew.
    let copy = disk.directory();
    for file in ["nudge.db", "nudge.db-wal"] {
        std::fs::copy(directory.path().join(file), copy.path().join(file)).expect("copied");
    }
    app.stop().await;
    let filler = disk.fill();
    // For the index of the journal, which is made anew at every start.
    shorten(&filler, 64 << 10);
    let app = TestApp::on(copy).await;
    assert_eq!(visits(&app).await, 1_000);
    disk.fill();
    assert!(turned(&app, 503).await.starts_with("the disk is full ("));
    std::fs::remove_file(filler).expect("removed");
    turned(&app, 200).await;
    app.stop().await;
}

#[tokio::test]
async fn a_database_that_is_moved_away_takes_nothing_until_it_is_back() {
    let app = TestApp::start().await;
    app.lane().await;
    assert_eq!(app.rest("POST", TRANSITIONS, Some(&batch(1))).await.0, 200);
    let (database, away) = (
        app.directory.path().join("nudge.db"),
        app.directory.path().join("away.db"),
    );
    std::fs::rename(&database, &away).expect("moved");
    let told = turned(&app, 503).await;
    assert!(
        told.starts_with("the database's file was moved away or replaced ("),
        "{told}"
    );
    let (status, problem) = app.rest("POST", TRANSITIONS, Some(&batch(2))).await;
    let expected =
        "nothing was counted: the database's file was moved away or replaced; send it again";
    assert_eq!((status, &problem["detail"]), (503, &json!(expected)));
    std::fs::copy(&away, &database).expect("another file of that name");
    let (status, problem) = app.rest("POST", TRANSITIONS, Some(&batch(2))).await;
    assert_eq!(
        (status, &problem["cause"]),
        (503, &json!("moved")),
        "it would be lost in the file that has no name"
    );
    std::fs::rename(&away, &database).expect("moved back");
    turned(&app, 200).await;
    assert_eq!(app.rest("POST", TRANSITIONS, Some(&batch(2))).await.0, 200);
    assert_eq!(visits(&app).await, 2_000);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_journal_that_is_moved_away_takes_nothing_until_it_is_back() {
    let app = TestApp::start().await;
    app.lane().await;
    assert_eq!(app.rest("POST", TRANSITIONS, Some(&batch(1))).await.0, 200);
    let (journal, away) = (
        app.directory.path().join("nudge.db-wal"),
        app.directory.path().join("away"),
    );
    std::fs::rename(&journal, &away).expect("moved");
    let (status, problem) = app.rest("POST", TRANSITIONS, Some(&batch(2))).await;
    let expected =
        "nothing was counted: the database's file was moved away or replaced; send it again";
    assert_eq!(
        (status, &problem["detail"], &problem["cause"]),
        (503, &json!(expected), &json!("moved"))
    );
    let (status, told) = checked(&app).await;
    assert!(
        status == 503 && told.contains("nudge.db-wal: No such file"),
        "at once: {status}, {told}"
    );

    for other in [true, false] {
        if other {
            std::fs::copy(&away, &journal).expect("another file of that name");
        } else {
            std::fs::remove_file(&journal).expect("removed");
        }
        let (status, problem) = app.rest("POST", TRANSITIONS, Some(&batch(2))).await;
        assert_eq!((status, &problem["cause"]), (503, &json!("moved")));
    }
    std::fs::rename(&away, &journal).expect("moved back");
    turned(&app, 200).await;
    assert_eq!(
        app.rest("POST", TRANSITIONS, Some(&batch(2))).await.1["status"],
        "applied"
    );
    assert_eq!(visits(&app).await, 2_000);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_journal_that_is_removed_is_not_ready_and_a_stop_keeps_what_it_had() {
    let app = TestApp::start().await;
    app.lane().await;
    assert_eq!(app.rest("POST", TRANSITIONS, Some(&batch(1))).await.0, 200);
    std::fs::remove_file(app.directory.path().join("nudge.db-wal")).expect("removed");
    // Nobody commits: the service finds it out by itself.
    let told = turned(&app, 503).await;
    assert!(
        told.starts_with("the database's file was moved away or replaced ("),
        "{told}"
    );
    assert_eq!(app.rest("POST", TRANSITIONS, Some(&batch(2))).await.0, 503);
    let app = app.restart().await;
    assert_eq!(visits(&app).await, 1_000);
    assert_eq!(
        app.rest("POST", TRANSITIONS, Some(&batch(2))).await.1["status"],
        "applied"
    );
    app.stop().await;
}

#[tokio::test]
async fn a_database_that_another_program_keeps_locked_is_not_ready() {
    let app = TestApp::start().await;
    app.lane().await;
    let path = app.directory.path().join("nudge.db");
    let mut other = SqliteConnectOptions::new()
        .filename(&path)
        .connect()
        .await
        .expect("a connection");
    sqlx::query("begin immediate")
        .execute(&mut other)
        .await
        .expect("the lock");
    let told = turned(&app, 503).await;
    assert!(
        told.starts_with("another program keeps the database locked ("),
        "{told}"
    );
    sqlx::query("rollback")
        .execute(&mut other)
        .await
        .expect("ended");
    other.close().await.expect("closed");
    turned(&app, 200).await;
    app.stop().await;
}

/// How old a write may be that proves something.
const PROOF: Duration = Duration::from_secs(3);

#[tokio::test]
async fn a_proof_reaches_the_journal_and_changes_nothing() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("nudge.db");
    let store = SqliteStore::open(&path, Options::default())
        .await
        .expect("a database");
    let journal = || {
        std::fs::metadata(directory.path().join("nudge.db-wal"))
            .expect("a journal")
            .len()
    };
    let mut other = SqliteConnectOptions::new()
        .filename(&path)
        .connect()
        .await
        .expect("a connection");
    sqlx::query("pragma user_version = 7")
        .execute(&mut other)
        .await
        .expect("a number of somebody's");
    let before = journal();
    store.prove(PROOF).await.expect("proven");
    assert_eq!(
        journal(),
        before,
        "it was opened a moment ago, which is proof enough"
    );
    tokio::time::sleep(Duration::from_millis(3_100)).await;
    store.prove(PROOF).await.expect("proven");
    assert_eq!(journal() - before, 24 + 4_096, "one page");
    let version: i64 = sqlx::query_scalar("pragma user_version")
        .fetch_one(&mut other)
        .await
        .expect("a number");
    assert_eq!(version, 7);
    store.prove(PROOF).await.expect("proven");
    assert_eq!(journal() - before, 24 + 4_096, "not more often");
    assert!(store.ready().await.is_ok());
    store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn whoever_asks_whether_it_is_ready_is_told_how_it_is_now() {
    let app = TestApp::start().await;
    app.lane().await;
    let (journal, away) = (
        app.directory.path().join("nudge.db-wal"),
        app.directory.path().join("away"),
    );
    for path in ["/readyz", "/v2/health/ready"] {
        // Long enough that the last proof is not of this moment, and not so long that the service
        // looks by itself.
        let a_moment = || tokio::time::sleep(Duration::from_millis(600));
        assert_eq!(app.rest("GET", path, None).await.0, 200);
        std::fs::rename(&journal, &away).expect("moved");
        a_moment().await;
        assert_eq!(
            app.rest("GET", path, None).await.0,
            503,
            "{path}: at the first question"
        );
        std::fs::rename(&away, &journal).expect("moved back");
        a_moment().await;
        assert_eq!(app.rest("GET", path, None).await.0, 200, "{path}: likewise");
    }
    app.stop().await;
}
