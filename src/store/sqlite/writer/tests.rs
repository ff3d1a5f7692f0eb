//! Transactions that end badly.

use super::*;
use crate::domain::{Counts, EnvironmentId, StateKey};
use crate::store::sqlite::cache::CountsCache;
use crate::store::sqlite::lock::Lock;
use crate::store::sqlite::migrations::MIGRATIONS;

const ENVIRONMENT: EnvironmentId = EnvironmentId(1);

fn writer(directory: &tempfile::TempDir) -> Writer {
    let path = directory.path().join("test.db");
    let options = SqliteConnectOptions::new()
        .filename(&path)
        .create_if_missing(true);
    let lock = Lock::take(&path).expect("free");
    Writer::new(
        options,
        lock.identity().clone(),
        Arc::new(Memory::new(100, Duration::ZERO)),
    )
}

async fn execute(transaction: &mut Transaction<'_>, text: &'static str) {
    sqlx::raw_sql(text)
        .execute(transaction.connection())
        .await
        .expect("a statement that works");
}

/// Returns a writer with our tables, for the first transaction to read, and one whose references
/// are checked at COMMIT only.
async fn prepared(directory: &tempfile::TempDir) -> Writer {
    let mut connection = writer(directory)
        .options
        .connect()
        .await
        .expect("a connection");
    for migration in MIGRATIONS.iter() {
        let tables = sqlx::raw_sql(migration.sql);
        tables.execute(&mut connection).await.expect("tables");
    }
    let text = "create table parents (id integer primary key);
                create table children (parent references parents (id) deferrable initially deferred)";
    sqlx::raw_sql(text)
        .execute(&mut connection)
        .await
        .expect("tables");
    connection.close().await.expect("closed");
    writer(directory)
}

async fn children(writer: &Writer) -> i64 {
    let mut transaction = writer.begin().await.expect("a transaction");
    let count = sqlx::query_scalar("select count(*) from children")
        .fetch_one(transaction.connection())
        .await;
    transaction.end().await.expect("ended");
    count.expect("a number")
}

/// Offers a state to the cache, and returns whether it is served from there.
fn remember_a_state(cache: &CountsCache) -> bool {
    let key = StateKey::new(&[1]);
    let (_, epoch) = cache.get(ENVIRONMENT, &[]);
    cache.insert(
        ENVIRONMENT,
        epoch,
        1,
        std::iter::once((key.clone(), Arc::new(Counts::default()))),
    );
    cache.get(ENVIRONMENT, &[key]).0[0].is_some()
}

#[tokio::test]
async fn a_failed_commit_has_an_unknown_outcome_and_is_settled_by_the_next_transaction() {
    let directory = tempfile::tempdir().expect("a directory");
    let writer = prepared(&directory).await;
    let mut transaction = writer.begin().await.expect("a transaction");
    execute(&mut transaction, "insert into children values (7)").await;
    transaction
        .parts()
        .1
        .add_state(ENVIRONMENT, &StateKey::new(&[1]), 1);
    remember_a_state(&writer.memory.cache);
    let failed = transaction
        .commit(|_, _| panic!("memory must not be told"))
        .await;
    assert!(
        matches!(failed, Err(StoreError::OutcomeUnknown(_))),
        "{failed:?}"
    );
    assert!(
        !remember_a_state(&writer.memory.cache),
        "nothing is cached until it is settled"
    );
    assert!(
        writer.place.lock().await.connection.is_none(),
        "the connection is dropped"
    );
    assert_eq!(children(&writer).await, 0);
    assert!(remember_a_state(&writer.memory.cache));
    let row_ids = &mut writer.place.lock().await.row_ids;
    assert_eq!(row_ids.state_id(ENVIRONMENT, &StateKey::new(&[1])), None);
}

#[tokio::test]
async fn a_dropped_transaction_leaves_nothing_behind() {
    let directory = tempfile::tempdir().expect("a directory");
    let writer = prepared(&directory).await;
    let mut transaction = writer.begin().await.expect("a transaction");
    execute(
        &mut transaction,
        "insert into parents values (7); insert into children values (7)",
    )
    .await;
    drop(transaction);
    assert_eq!(children(&writer).await, 0);
    let mut transaction = writer.begin().await.expect("a transaction");
    execute(
        &mut transaction,
        "insert into parents values (7); insert into children values (7)",
    )
    .await;
    transaction.commit(|_, _| ()).await.expect("committed");
    assert_eq!(children(&writer).await, 1);
    writer.close().await.expect("closed");
    assert!(writer.begin().await.is_err(), "no call may follow");
}

#[tokio::test]
async fn a_journal_that_vanishes_before_the_commit_is_told_makes_it_uncertain() {
    let directory = tempfile::tempdir().expect("a directory");
    let made = prepared(&directory).await;
    let options = made
        .options
        .clone()
        .journal_mode(sqlx::sqlite::SqliteJournalMode::Wal);
    let writer = Writer {
        options: options.clone(),
        ..made
    };
    let (journal, away) = (
        directory.path().join("test.db-wal"),
        directory.path().join("away"),
    );
    let mut transaction = writer.begin().await.expect("a transaction");
    execute(
        &mut transaction,
        "insert into parents values (7); insert into children values (7)",
    )
    .await;
    std::fs::rename(&journal, &away).expect("moved");
    let told = transaction.commit(|_, _| ()).await;
    let is_moved = |cause: &Cause| cause.fault == StorageFault::Moved;
    assert!(
        matches!(&told, Err(StoreError::OutcomeUnknown(cause)) if is_moved(cause)),
        "{told:?}"
    );
    assert!(
        writer
            .health
            .ready(Instant::now())
            .is_err_and(|cause| is_moved(&cause))
    );
    let refused = writer.begin().await.err();
    assert!(
        matches!(&refused, Some(StoreError::Aborted(cause)) if is_moved(cause)),
        "{refused:?}"
    );
    assert!(
        writer.checkpoint().await.is_err(),
        "a new connection would make another journal"
    );
    assert!(!journal.exists());

    std::fs::rename(&away, &journal).expect("moved back");
    assert_eq!(children(&writer).await, 1);
    // A new connection beside one that is open has the same journal, or none.
    let mut other = options.connect().await.expect("a connection");
    sqlx::query("select * from children")
        .execute(&mut other)
        .await
        .expect("read");
    drop(writer.begin().await.expect("a transaction"));
    std::fs::rename(&journal, &away).expect("moved");
    assert!(writer.begin().await.is_err());
    std::fs::rename(&away, &journal).expect("moved back");
    assert_eq!(children(&writer).await, 1);
    other.close().await.expect("closed");
}
