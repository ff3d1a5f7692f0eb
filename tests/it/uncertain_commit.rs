//! A store that commits and then reports failure: nothing may be acknowledged, and resuming finds
//! that it was counted once.

use std::sync::Arc;

use nudge::api::proto;
use nudge::store::Options;
use tempfile::TempDir;
use tonic::Code;

use crate::support::faulty::{Failure, Faulty};
use crate::support::{RawStream, TestApp, hello, open, reason, row, rows};

/// A client must hear which it was: the reason and the words are different promises.
async fn resumes_after(failure: Failure, expected: (&str, &str), committed: u64) {
    let directory = Arc::new(TempDir::new().expect("a temporary directory"));
    let store = open(directory.path(), Options::default()).await;
    let faulty = Faulty::new(store, failure);
    let app = TestApp::with(directory, faulty.clone()).await;
    app.lane().await;
    let one = |sequence| rows(sequence, vec![row([0.1, 0.0], [0.0, 2.0])]);
    let (_, mut stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    stream.send(one(1)).await.expect("open");
    stream.acknowledged().await.expect("committed");
    faulty.arm();
    stream.send(one(2)).await.expect("open");
    let end = stream
        .acknowledged()
        .await
        .expect_err("it must not be acknowledged");
    assert_eq!(end.code(), Code::Unavailable, "{end}");
    assert_eq!((reason(&end).as_str(), end.message()), expected);
    let (welcome, stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    assert_eq!(welcome.committed_sequence, committed);
    for sequence in committed + 1..=3 {
        stream.send(one(sequence)).await.expect("open");
    }
    let (receipts, _) = stream.finish().await;
    assert_eq!(receipts.len() as u64, 3 - committed);
    assert_eq!(
        app.cells("0.0").await,
        [(vec![0, 2], String::new(), 3, None)]
    );
    let resent = proto::WriteRequest {
        environment: "lane".into(),
        producer: "p".into(),
        batch: Some(one(2)),
        ..Default::default()
    };
    let resent = app
        .ingest()
        .await
        .write(resent)
        .await
        .expect("a duplicate")
        .into_inner();
    assert_eq!(
        resent.receipt.expect("present").status(),
        proto::BatchStatus::Duplicate
    );
    assert_eq!(app.cells("0.0").await[0].2, 3);
}

#[tokio::test]
async fn a_commit_that_lies_about_failing_is_found_by_resuming() {
    let uncertain = (
        "OUTCOME_UNKNOWN",
        "the batch may have been counted: the database refused; resume and send it again, it counts once",
    );
    resumes_after(Failure::AfterCommit, uncertain, 2).await;
}

#[tokio::test]
async fn a_commit_that_failed_is_sent_again() {
    let certain = (
        "STORE_UNAVAILABLE",
        "nothing was counted: the database refused; send it again",
    );
    resumes_after(Failure::BeforeCommit, certain, 1).await;
}
