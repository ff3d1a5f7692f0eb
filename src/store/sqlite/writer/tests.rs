//! Transactions that end badly.

use super::*;
use crate::domain::{Counts, EnvironmentId, StateKey};
use crate::store::sqlite::lock::Lock;

const ENVIRONMENT: EnvironmentId = EnvironmentId(1);

fn writer(directory: &tempfile::TempDir) -> Writer {
    let path = directory.path().join("test.db");
    let options = SqliteConnectOptions::new().filename(&path).create_if_missing(true);
    let lock = Lock::take(&path).expect("free");
    Writer::new(options, lock.identity().clone(), Arc::new(Memory::new(100)))
}

async fn execute(transaction: &mut Transaction<'_>, text: &'static str) {
    sqlx::raw_sql(text).execute(transaction.connection()).await.expect("a statement that works");
}

/// Returns a writer with a table of environments, for the first transaction to read, and one whose references are checked at COMMIT only.
async fn prepared(directory: &tempfile::TempDir) -> Writer {
    let mut connection = writer(directory).options.connect().await.expect("a connection");
    let text = "create table environments (id, uid, name, schema, schema_hash, rule);
                create table parents (id integer primary key);
                create table children (parent references parents (id) deferrable initially deferred)";
    sqlx::raw_sql(text).execute(&mut connection).await.expect("tables");
    connection.close().await.expect("closed");
    writer(directory)
}

async fn children(writer: &Writer) -> i64 {
    let mut transaction = writer.begin().await.expect("a transaction");
    let count = sqlx::query_scalar("select count(*) from children").fetch_one(transaction.connection()).await;
    transaction.end().await.expect("ended");
    count.expect("a number")
}

/// Offers a state to the cache, and returns whether it is served from there.
fn remember_a_state(cache: &CountsCache) -> bool {
    let key = StateKey::new(&[1]);
    let (_, epoch) = cache.get(ENVIRONMENT, &[]);
    cache.insert(ENVIRONMENT, epoch, 1, std::iter::once((key.clone(), Arc::new(Counts::default()))));
    cache.get(ENVIRONMENT, &[key]).0[0].is_some()
}

#[tokio::test]
async fn a_failed_commit_has_an_unknown_outcome_and_is_settled_by_the_next_transaction() {
    let directory = tempfile::tempdir().expect("a directory");
    let writer = prepared(&directory).await;
    let mut transaction = writer.begin().await.expect("a transaction");
    execute(&mut transaction, "insert into children values (7)").await;
    transaction.parts().1.add_state(ENVIRONMENT, &StateKey::new(&[1]), 1);
    remember_a_state(&writer.memory.cache);
    let failed = transaction.commit(|_, _| panic!("memory must not be told")).await;
    assert!(matches!(failed, Err(StoreError::OutcomeUnknown(_))), "{failed:?}");
    assert!(!remember_a_state(&writer.memory.cache), "nothing is cached until it is settled");
    assert!(writer.place.lock().await.connection.is_none(), "the connection is dropped");
    assert_eq!(children(&writer).await, 0);
    assert!(remember_a_state(&writer.memory.cache));
    let known = &mut writer.place.lock().await.known;
    assert_eq!(known.state(ENVIRONMENT, &StateKey::new(&[1])), None);
}

#[tokio::test]
async fn a_dropped_transaction_leaves_nothing_behind() {
    let directory = tempfile::tempdir().expect("a directory");
    let writer = prepared(&directory).await;
    let mut transaction = writer.begin().await.expect("a transaction");
    execute(&mut transaction, "insert into parents values (7); insert into children values (7)").await;
    drop(transaction);
    assert_eq!(children(&writer).await, 0);
    let mut transaction = writer.begin().await.expect("a transaction");
    execute(&mut transaction, "insert into parents values (7); insert into children values (7)").await;
    transaction.commit(|_, _| ()).await.expect("committed");
    assert_eq!(children(&writer).await, 1);
    writer.close().await.expect("closed");
    assert!(writer.begin().await.is_err(), "no call may follow");
}
