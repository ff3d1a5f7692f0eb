//! The ingest protocol, case by case: numbers, resumes, fences, bad records, bad batches.

use nudge::api::proto::{self, BatchStatus};
use serde_json::json;
use tonic::Code;

use crate::support::{RawStream, TestApp, hello, lane_json, reason, row, rows};

const NEAR: [f32; 2] = [0.1, 0.0];

fn one(sequence: u64) -> proto::Batch {
    rows(sequence, vec![row(NEAR, [0.0, 2.0])])
}

async fn write(
    app: &TestApp,
    producer: &str,
    batch: proto::Batch,
) -> Result<proto::Receipt, tonic::Status> {
    let request = proto::WriteRequest {
        environment: "lane".into(),
        producer: producer.into(),
        batch: Some(batch),
        ..Default::default()
    };
    Ok(app
        .ingest()
        .await
        .write(request)
        .await?
        .into_inner()
        .receipt
        .expect("a receipt"))
}

async fn visits(app: &TestApp) -> u64 {
    app.cells("0.0").await.iter().map(|cell| cell.2).sum()
}

#[tokio::test]
async fn a_stream_counts_and_acknowledges_in_order() {
    let app = TestApp::start().await;
    let environment = app.lane().await;
    let (welcome, stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    assert_eq!(
        (welcome.committed_sequence, &welcome.environment_uid),
        (0, &environment.uid)
    );
    assert_eq!(welcome.schema_hash, environment.schema_hash);
    for sequence in 1..=50 {
        stream.send(one(sequence)).await.expect("open");
    }
    let (receipts, end) = stream.finish().await;
    assert_eq!(end.code(), Code::Ok);
    assert_eq!(
        receipts.iter().map(|r| r.sequence).collect::<Vec<_>>(),
        (1..=50).collect::<Vec<_>>()
    );
    assert!(
        receipts
            .iter()
            .all(|r| r.status() == BatchStatus::Applied && r.accepted == 1)
    );
    assert_eq!(visits(&app).await, 50);
    let (welcome, _) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    assert_eq!(welcome.committed_sequence, 50);
}

#[tokio::test]
async fn rows_and_columns_and_json_are_one_content() {
    let app = TestApp::start().await;
    app.lane().await;
    let columns = proto::Columns {
        count: 2,
        states: vec![0.1, 0.0, 0.7, 1.0],
        actions: vec![0.0, 2.0, 1.0, 0.0],
        entries: vec![2, 1],
        counts: vec![1, 3],
        ..Default::default()
    };
    let by_bytes = proto::Columns {
        states: vec![],
        states_le: le(&[0.1, -0.0, 0.7, 1.0]),
        actions: vec![],
        actions_le: le(&[0.0, 2.0, 1.0, -0.0]),
        ..columns.clone()
    };
    let mixed = proto::Columns {
        actions: columns.actions.clone(),
        actions_le: le(&[]),
        ..by_bytes.clone()
    };
    let mut by_rows = vec![row([0.1, 0.0], [0.0, 2.0]), row([0.7, 1.0], [1.0, 0.0])];
    (by_rows[0].entry, by_rows[1].entry, by_rows[1].count) = (2, 1, Some(3));
    for (columns, status) in [
        (columns, BatchStatus::Applied),
        (by_bytes, BatchStatus::Duplicate),
        (mixed, BatchStatus::Duplicate),
    ] {
        let receipt = write(&app, "p", of_columns(1, columns))
            .await
            .expect("valid");
        assert_eq!((receipt.status(), receipt.accepted), (status, 2));
    }
    assert_eq!(
        write(&app, "p", rows(1, by_rows))
            .await
            .expect("the same")
            .status(),
        BatchStatus::Duplicate
    );
    let body = json!({"producer": "p", "sequence": 1, "transitions": [
        {"state": {"held": "nothing", "distance": 0.1}, "actions": {"human": "stay", "robot": {"move": "go"}}, "entry": true},
        {"state": {"distance": 0.7, "held": 1}, "actions": {"robot": "stop", "human": "left"}, "entry": false, "count": 3},
    ]});
    let (status, receipt) = app
        .rest("POST", "/v1/environments/lane/transitions", Some(&body))
        .await;
    assert_eq!(
        (status, &receipt["status"]),
        (200, &json!("duplicate")),
        "{receipt}"
    );
    assert_eq!(
        app.cells("0.0").await,
        [(vec![0, 2], String::new(), 1, Some(1))]
    );
    assert_eq!(
        app.cells("2.1").await,
        [(vec![1, 0], String::new(), 3, Some(0))]
    );
}

#[tokio::test]
async fn numbers_decide() {
    let app = TestApp::start().await;
    app.lane().await;
    write(&app, "p", one(1)).await.expect("first");
    let gap = write(&app, "p", one(3)).await.expect_err("a gap");
    assert_eq!(
        (gap.code(), reason(&gap)),
        (Code::FailedPrecondition, "OUT_OF_ORDER".into())
    );
    assert!(gap.message().contains("expected 2"), "{}", gap.message());
    let reused = write(&app, "p", rows(1, vec![row([0.2, 0.0], [0.0, 2.0])]))
        .await
        .expect_err("another content");
    assert_eq!(
        (reused.code(), reason(&reused)),
        (Code::FailedPrecondition, "SEQUENCE_REUSED".into())
    );
    for wrong in [0, u64::MAX, 1 << 63] {
        let refused = write(&app, "p", one(wrong))
            .await
            .expect_err("not a number of a batch");
        assert_eq!(refused.code(), Code::InvalidArgument, "{wrong}");
    }
    let far = write(&app, "p", one(i64::MAX as u64))
        .await
        .expect_err("far future");
    assert_eq!(reason(&far), "OUT_OF_ORDER");
    assert_eq!(
        write(&app, "p", one(2)).await.expect("next").status(),
        BatchStatus::Applied
    );
    assert_eq!(visits(&app).await, 2);
}

#[tokio::test]
async fn a_duplicate_is_acknowledged_however_late() {
    let app = TestApp::start().await;
    app.lane().await;
    let bad = || {
        rows(
            1,
            vec![row([f32::NAN, 0.0], [0.0, 0.0]), row(NEAR, [0.0, 2.0])],
        )
    };
    let first = write(&app, "p", bad()).await.expect("one is good");
    for sequence in 2..=5 {
        write(&app, "p", one(sequence)).await.expect("next");
    }
    let app = app.restart().await;
    let again = write(&app, "p", bad()).await.expect("a duplicate");
    assert_eq!(again.status(), BatchStatus::Duplicate);
    assert_eq!(
        (again.accepted, again.rejected_count, &again.rejected),
        (1, 1, &first.rejected)
    );
    assert_eq!(visits(&app).await, 5);
}

#[tokio::test]
async fn a_later_stream_fences_the_older_one() {
    let app = TestApp::start().await;
    app.lane().await;
    let (_, mut older) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    older.send(one(1)).await.expect("open");
    older.acknowledged().await.expect("committed");
    let (welcome, newer) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    assert_eq!(welcome.committed_sequence, 1);
    let fenced = older.acknowledged().await.expect_err("fenced");
    assert_eq!(
        (fenced.code(), reason(&fenced)),
        (Code::FailedPrecondition, "FENCED".into())
    );
    newer.send(one(2)).await.expect("open");
    let (receipts, end) = newer.finish().await;
    assert_eq!((receipts.len(), end.code()), (1, Code::Ok));
    assert_eq!(visits(&app).await, 2);
}

#[tokio::test]
async fn an_environment_made_again_refuses_late_resends() {
    let app = TestApp::start().await;
    let old = app.lane().await;
    let (_, mut stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    stream.send(one(1)).await.expect("open");
    stream.acknowledged().await.expect("committed");
    let delete = proto::DeleteEnvironmentRequest {
        name: "lane".into(),
    };
    app.environments()
        .await
        .delete_environment(delete)
        .await
        .expect("there");
    let ended = stream.acknowledged().await.expect_err("deleted");
    assert_eq!(ended.code(), Code::NotFound);
    let new = app.lane().await;
    assert_ne!(old.uid, new.uid);
    let late = proto::Hello {
        environment_uid: old.uid,
        ..hello("p")
    };
    let refused = RawStream::open(app.ingest().await, late)
        .await
        .err()
        .expect("another environment");
    assert_eq!(
        (refused.code(), reason(&refused)),
        (Code::FailedPrecondition, "ENVIRONMENT_REPLACED".into())
    );
    let (welcome, _) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    assert_eq!(welcome.committed_sequence, 0);
    assert_eq!(visits(&app).await, 0);
}

#[tokio::test]
async fn a_producer_that_goes_on_learns_that_its_environment_is_gone() {
    let app = TestApp::start().await;
    app.lane().await;
    let (_, stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    let sending = tokio::spawn(async move {
        let mut sequence = 1;
        while stream.send(one(sequence)).await.is_ok() && sequence < 20_000 {
            sequence += 1;
        }
        stream.finish().await
    });
    while visits(&app).await == 0 {}
    let delete = proto::DeleteEnvironmentRequest {
        name: "lane".into(),
    };
    app.environments()
        .await
        .delete_environment(delete)
        .await
        .expect("there");
    app.lane().await;
    let (_, end) = sending.await.expect("ends");
    assert_eq!(end.code(), Code::NotFound, "{end}");
    assert_eq!(
        visits(&app).await,
        0,
        "nothing of the old environment is in the new one"
    );
}

#[tokio::test]
async fn bad_records_are_told_and_the_rest_is_counted() {
    let app = TestApp::start().await;
    app.lane().await;
    let cases = [
        (row([f32::NAN, 0.0], [0.0, 0.0]), "/state/distance"),
        (row([f32::INFINITY, 0.0], [0.0, 0.0]), "/state/distance"),
        (row([f32::NEG_INFINITY, 0.0], [0.0, 0.0]), "/state/distance"),
        (row([0.1, 2.0], [0.0, 0.0]), "/state/held"),
        (row([0.1, 0.5], [0.0, 0.0]), "/state/held"),
        (row([0.1, -1.0], [0.0, 0.0]), "/state/held"),
        (row([0.1, 16_777_217.0], [0.0, 0.0]), "/state/held"),
        (row([0.1, 0.0], [2.0, 0.0]), "/actions/robot/move"),
        (row([0.1, 0.0], [0.0, 3.0]), "/actions/human/move"),
        (
            proto::Transition {
                state: vec![0.1, 0.0, 0.0],
                ..row(NEAR, [0.0, 0.0])
            },
            "/state",
        ),
        (
            proto::Transition {
                state: vec![],
                ..row(NEAR, [0.0, 0.0])
            },
            "/state",
        ),
        (
            proto::Transition {
                actions: vec![0.0],
                ..row(NEAR, [0.0, 0.0])
            },
            "/actions",
        ),
        (
            proto::Transition {
                count: Some(0),
                ..row(NEAR, [0.0, 0.0])
            },
            "/count",
        ),
        (
            proto::Transition {
                count: Some(u64::MAX),
                ..row(NEAR, [0.0, 0.0])
            },
            "/count",
        ),
        (
            proto::Transition {
                entry: 7,
                ..row(NEAR, [0.0, 0.0])
            },
            "/entry",
        ),
    ];
    let bad = cases.len() as u64;
    let (mut transitions, fields): (Vec<_>, Vec<_>) = cases.into_iter().unzip();
    transitions.push(row([-0.0, 0.0], [-0.0, 2.0]));
    let receipt = write(&app, "p", rows(1, transitions))
        .await
        .expect("one is good");
    assert_eq!((receipt.accepted, receipt.rejected_count), (1, bad));
    let told: Vec<_> = receipt
        .rejected
        .iter()
        .map(|r| (r.index as usize, r.field.as_str()))
        .collect();
    assert_eq!(told, fields.into_iter().enumerate().collect::<Vec<_>>());
    assert_eq!(visits(&app).await, 1);
}

#[tokio::test]
async fn values_on_edges_land_above_them_on_every_face() {
    let app = TestApp::start().await;
    app.lane().await;
    let values = [0.5, 0.7, 1.0, 0.699_999, 0.0];
    let transitions = values
        .iter()
        .map(|value| row([*value, 0.0], [0.0, 0.0]))
        .collect();
    write(&app, "p", rows(1, transitions)).await.expect("valid");
    let written = ["0.5", "0.7", "1", "0.699999", "-0.0"];
    let keys = ["1.0", "2.0", "3.0", "1.0", "0.0"];
    for (value, key) in written.into_iter().zip(keys) {
        let path =
            format!("/v1/environments/lane/influence?state.distance={value}&state.held=nothing");
        let (status, answer) = app.rest("GET", &path, None).await;
        assert_eq!(
            (status, &answer["answers"][0]["state"]["key"]),
            (200, &json!(key)),
            "{value}: {answer}"
        );
        assert!(answer["answers"][0]["visits"].as_u64() > Some(0), "{value}");
    }
}

#[tokio::test]
async fn empty_and_all_bad_batches_use_their_numbers() {
    let app = TestApp::start().await;
    app.lane().await;
    let empty = write(&app, "p", rows(1, vec![])).await.expect("empty");
    assert_eq!((empty.accepted, empty.rejected_count), (0, 0));
    let all_bad = write(&app, "p", rows(2, vec![row([f32::NAN, 0.0], [0.0, 0.0])]))
        .await
        .expect("all bad");
    assert_eq!((all_bad.accepted, all_bad.rejected_count), (0, 1));
    assert_eq!(write(&app, "p", one(3)).await.expect("next").accepted, 1);
    let app = app.restart().await;
    assert_eq!(
        write(&app, "p", rows(1, vec![]))
            .await
            .expect("late")
            .status(),
        BatchStatus::Duplicate
    );
}

fn le(values: &[f32]) -> bytes::Bytes {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

fn of_columns(sequence: u64, columns: proto::Columns) -> proto::Batch {
    proto::Batch {
        transitions: Some(proto::batch::Transitions::Columns(columns)),
        ..rows(sequence, vec![])
    }
}

#[tokio::test]
async fn a_bad_value_in_bytes_is_rejected_as_one_in_floats() {
    let app = TestApp::start().await;
    app.lane().await;
    // A signalling NaN, a half label, an action that nobody has.
    let states = [
        f32::from_bits(0x7fa0_0000),
        0.0,
        0.7,
        0.5,
        0.1,
        1.0,
        0.1,
        1.0,
    ];
    let actions = [0.0, 0.0, 0.0, 0.0, 0.0, 3.0, 1.0, 2.0];
    let bytes = proto::Columns {
        count: 4,
        states_le: le(&states),
        actions_le: le(&actions),
        ..Default::default()
    };
    let floats = proto::Columns {
        count: 4,
        states: states.to_vec(),
        actions: actions.to_vec(),
        ..Default::default()
    };

    let first = write(&app, "p", of_columns(1, bytes)).await.expect("valid");
    assert_eq!((first.status(), first.accepted), (BatchStatus::Applied, 1));
    let fields: Vec<&str> = first.rejected.iter().map(|one| &*one.field).collect();
    assert_eq!(
        fields,
        ["/state/distance", "/state/held", "/actions/human/move"]
    );

    let again = write(&app, "p", of_columns(1, floats))
        .await
        .expect("valid");
    assert_eq!(again.status(), BatchStatus::Duplicate);
    assert_eq!(again.rejected, first.rejected);
}

#[tokio::test]
async fn states_are_counted_whether_they_have_ranks_or_too_many_siblings() {
    let app = TestApp::start().await;
    let edge = 65_535.0;
    for features in [3, 4, 16] {
        let name = format!("wide-{features}");
        let feature = |i| json!({"name": format!("x{i}"), "integer": {"min": 0, "max": 65_535}});
        let agent = |name| json!({"name": name, "action": [{"name": "go", "integer": {"min": 0, "max": 2}}]});
        let state: Vec<_> = (0..features).map(feature).collect();
        let description = json!({"state": state, "agents": [agent("a"), agent("b")]});
        let path = format!("/v1/environments/{name}");
        assert_eq!(app.rest("PUT", &path, Some(&description)).await.0, 201);

        // The first and the last state of all, each in both batches.
        let states = [
            vec![0.0; features],
            vec![edge; features],
            vec![edge; features],
        ]
        .concat();
        for sequence in 1..=2 {
            let columns = proto::Columns {
                count: 3,
                states_le: le(&states),
                actions_le: le(&[0.0, 0.0, 2.0, 2.0, 2.0, 1.0]),
                ..Default::default()
            };
            let request = proto::WriteRequest {
                environment: name.clone(),
                producer: "p".into(),
                batch: Some(of_columns(sequence, columns)),
                ..Default::default()
            };
            let told = app.ingest().await.write(request).await.expect("valid");
            let receipt = told.into_inner().receipt.expect("a receipt");
            assert_eq!(
                (receipt.status(), receipt.accepted),
                (BatchStatus::Applied, 3)
            );

            for (bin, visits) in [(0, sequence), (65_535, 2 * sequence)] {
                let key = vec![bin.to_string(); features].join(".");
                let counts = app.get(&format!("{path}/states/{key}")).await;
                assert_eq!(counts["visits"], visits, "{name} {key}: {counts}");
            }
        }
    }
}

#[tokio::test]
async fn columns_that_do_not_fit_are_told_by_pointer() {
    let app = TestApp::start().await;
    app.lane().await;
    let fits = proto::Columns {
        count: 2,
        states_le: le(&[0.1, 0.0, 0.7, 1.0]),
        actions_le: le(&[0.0, 2.0, 1.0, 0.0]),
        ..Default::default()
    };
    let bytes = |len: usize| bytes::Bytes::from(vec![0; len]);
    let changed = |change: &dyn Fn(&mut proto::Columns)| {
        let mut columns = fits.clone();
        change(&mut columns);
        columns
    };

    let cases = [
        (
            changed(&|columns| (columns.states_le, columns.states) = (bytes(0), vec![0.1; 3])),
            "/columns/states: got 3 values, expected 4 for 2 transitions",
        ),
        (
            changed(&|columns| columns.states_le = bytes(0)),
            "/columns/states: got 0 values, expected 4 for 2 transitions",
        ),
        (
            changed(&|columns| columns.states_le = bytes(13)),
            "/columns/states_le: got 13 bytes, expected 16 for 2 transitions of 8 each",
        ),
        (
            changed(&|columns| columns.actions_le = bytes(24)),
            "/columns/actions_le: got 24 bytes, expected 16 for 2 transitions of 8 each",
        ),
        (
            changed(&|columns| columns.count = 0),
            "/columns/states_le: got 16 bytes, expected 0 for 0 transitions of 8 each",
        ),
        (
            changed(&|columns| columns.actions = vec![0.0; 4]),
            "/columns/actions_le: got 16 bytes beside 4 values in `actions`, expected one of the two",
        ),
        (
            changed(&|columns| columns.entries = vec![1]),
            "/columns/entries: got 1 values, expected 2 for 2 transitions",
        ),
        (
            changed(&|columns| columns.outcomes_le = bytes(8)),
            "/columns/outcomes_le: got 8 bytes, expected none: this environment has no outcomes",
        ),
        (
            changed(&|columns| columns.outcomes_present = bytes(1)),
            "/columns/outcomes_present: got 1 bytes, expected none: this environment has no outcomes",
        ),
        (
            changed(&|columns| columns.actions_present = bytes(2)),
            "/columns/actions_present: got 2 bytes, expected 1 for 2 transitions of 2 bits each, or none",
        ),
    ];
    for (columns, expected) in cases {
        let refused = write(&app, "p", of_columns(1, columns))
            .await
            .expect_err(expected);
        assert_eq!(refused.code(), Code::InvalidArgument, "{expected}");
        assert!(
            refused.message().contains(expected),
            "{} for {expected}",
            refused.message()
        );
    }
    let receipt = write(&app, "p", of_columns(1, fits))
        .await
        .expect("the number is free");
    assert_eq!(
        (receipt.status(), receipt.accepted),
        (BatchStatus::Applied, 2)
    );
}

#[tokio::test]
async fn whole_batch_faults_do_not_use_the_number() {
    let app = TestApp::start().await;
    app.lane().await;
    let columns = proto::Columns {
        count: 2,
        states: vec![0.1; 3],
        actions: vec![0.0; 4],
        ..Default::default()
    };
    let refused = write(&app, "p", of_columns(1, columns))
        .await
        .expect_err("columns that do not fit");
    assert_eq!(refused.code(), Code::InvalidArgument);
    assert!(
        refused.message().contains("/columns/states"),
        "{}",
        refused.message()
    );
    let segment = proto::Batch {
        segment: "\u{200f}x".into(),
        ..one(1)
    };
    assert_eq!(
        write(&app, "p", segment)
            .await
            .expect_err("not printable")
            .code(),
        Code::InvalidArgument
    );
    let large = rows(1, vec![row(NEAR, [0.0, 0.0]); 10_001]);
    assert_eq!(
        write(&app, "p", large).await.expect_err("too large").code(),
        Code::OutOfRange
    );
    assert_eq!(
        write(&app, "../p", one(1))
            .await
            .expect_err("a path")
            .code(),
        Code::InvalidArgument
    );
    assert_eq!(
        write(&app, "p", one(1)).await.expect("unused").status(),
        BatchStatus::Applied
    );
}

#[tokio::test]
async fn a_refused_batch_ends_the_stream_after_the_receipts_before_it() {
    let app = TestApp::start().await;
    app.lane().await;
    let (_, stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    for sequence in [1, 2, 4] {
        stream.send(one(sequence)).await.expect("open");
    }
    let (receipts, end) = stream.finish().await;
    assert_eq!(
        receipts.iter().map(|r| r.sequence).collect::<Vec<_>>(),
        [1, 2]
    );
    assert_eq!(reason(&end), "OUT_OF_ORDER");
}

#[tokio::test]
async fn a_stream_begins_with_a_hello_of_the_same_schema() {
    let app = TestApp::start().await;
    app.lane().await;
    let cases = [
        (
            proto::Hello {
                environment: "lame".into(),
                ..hello("p")
            },
            Code::NotFound,
            "ENVIRONMENT_NOT_FOUND",
        ),
        (
            proto::Hello {
                producer: "a b".into(),
                ..hello("p")
            },
            Code::InvalidArgument,
            "INVALID_INPUT",
        ),
        (
            proto::Hello {
                schema_hash: vec![7; 32],
                ..hello("p")
            },
            Code::FailedPrecondition,
            "SCHEMA_CONFLICT",
        ),
    ];
    for (hello, code, word) in cases {
        let refused = RawStream::open(app.ingest().await, hello)
            .await
            .err()
            .expect("refused");
        assert_eq!((refused.code(), reason(&refused)), (code, word.into()));
    }
}

#[tokio::test]
async fn a_graceful_stop_ends_streams_after_their_last_receipt() {
    let app = TestApp::start().await;
    app.lane().await;
    let (_, stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    let (requests, mut responses) = stream.split();
    for sequence in 1..=20 {
        let message = Some(proto::ingest_request::Message::Batch(one(sequence)));
        requests
            .send(proto::IngestRequest { message })
            .await
            .expect("open");
    }
    let first = responses
        .message()
        .await
        .expect("acknowledged")
        .expect("open");
    let directory = app.directory.clone();
    let stopping = tokio::spawn(app.stop());
    let mut last = first;
    let end = loop {
        match responses.message().await {
            Ok(Some(response)) => last = response,
            Ok(None) => panic!("a stream that was cut short must say so"),
            Err(status) => break status,
        }
    };
    assert_eq!(
        (end.code(), reason(&end)),
        (Code::Unavailable, "STOPPING".into())
    );
    stopping.await.expect("stops");
    let Some(proto::ingest_response::Message::Acknowledgement(told)) = last.message else {
        panic!("{last:?}")
    };
    let app = TestApp::on(directory).await;
    assert_eq!(
        visits(&app).await,
        told.committed_sequence,
        "what was taken was told"
    );
}

#[tokio::test]
async fn segments_are_counted_apart() {
    let app = TestApp::start().await;
    app.lane().await;
    for (sequence, segment) in [(1, "trial-1"), (2, "trial-2"), (3, "trial-2")] {
        let batch = proto::Batch {
            segment: segment.into(),
            ..one(sequence)
        };
        write(&app, "p", batch).await.expect("valid");
    }
    let visits = async |segments: &[&str]| {
        let body = json!({"keys": ["0.0"], "segments": segments, "view": "verdict"});
        let (status, answer) = app
            .rest("POST", "/v1/environments/lane/influence", Some(&body))
            .await;
        (status, answer["answers"][0]["visits"].as_u64())
    };
    assert_eq!(visits(&[]).await, (200, Some(3)));
    assert_eq!(visits(&["trial-2"]).await, (200, Some(2)));
    assert_eq!(
        visits(&["trial-2", "trial-1", "trial-1"]).await,
        (200, Some(3))
    );
    assert_eq!(visits(&["trial-3"]).await.0, 400);
}

#[tokio::test]
async fn the_description_made_over_rest_is_the_one_of_grpc() {
    let app = TestApp::start().await;
    let environment = app.lane().await;
    let (status, same) = app
        .rest("PUT", "/v1/environments/lane", Some(&lane_json()))
        .await;
    assert_eq!(
        (status, &same["uid"]),
        (200, &json!(environment.uid)),
        "{same}"
    );
}
