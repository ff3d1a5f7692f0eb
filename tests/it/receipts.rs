//! What a sender is told of its batches, on every face: counted, counted before, rejected as a
//! whole, or so old that nobody can tell; null, NaN and the environment's uid in what it sends.

use nudge::api::proto::{self, BatchStatus};
use serde_json::{Value, json};
use tonic::Code;

use crate::support::{RawStream, TestApp, hello, reason, row, rows};

const TRANSITIONS: &str = "/v1/environments/lane/transitions";

fn good() -> Value {
    json!({"state": {"distance": 0.1, "held": "nothing"}, "actions": {"robot": "go", "human": "stay"}})
}

fn bad() -> Value {
    json!({"state": {"distance": 0.1, "held": "soup"}, "actions": {"robot": "go", "human": "stay"}})
}

fn body(sequence: u64, transitions: &[Value]) -> Value {
    json!({"producer": "p", "sequence": sequence, "transitions": transitions})
}

async fn post(app: &TestApp, body: &Value) -> Value {
    let (status, receipt) = app.rest("POST", TRANSITIONS, Some(body)).await;
    assert_eq!(status, 200, "{receipt}");
    receipt
}

/// Posts text under a content type.
async fn post_text(app: &TestApp, query: &str, kind: &str, text: String) -> (u16, Value) {
    let request = reqwest::Client::new().post(app.url(&format!("{TRANSITIONS}{query}")));
    let response = request
        .header("content-type", kind)
        .body(text)
        .send()
        .await
        .expect("answered");
    (
        response.status().as_u16(),
        response.json().await.expect("JSON"),
    )
}

async fn write(app: &TestApp, batch: proto::Batch) -> proto::Receipt {
    let request = proto::WriteRequest {
        environment: "lane".into(),
        producer: "p".into(),
        batch: Some(batch),
        ..Default::default()
    };
    app.ingest()
        .await
        .write(request)
        .await
        .expect("acknowledged")
        .into_inner()
        .receipt
        .expect("present")
}

fn bad_rows(sequence: u64) -> proto::Batch {
    rows(
        sequence,
        vec![
            row([0.1, 7.0], [0.0, 2.0]),
            row([f32::NAN, 0.0], [0.0, 2.0]),
        ],
    )
}

fn good_rows(sequence: u64) -> proto::Batch {
    rows(sequence, vec![row([0.1, 0.0], [0.0, 2.0])])
}

#[tokio::test]
async fn a_batch_of_which_every_record_was_rejected_says_so_and_uses_its_number() {
    let app = TestApp::start().await;
    app.lane().await;
    let rejected = post(&app, &body(1, &[bad(), bad()])).await;
    let told = (
        &rejected["status"],
        &rejected["accepted"],
        &rejected["rejected_count"],
    );
    assert_eq!(told, (&json!("rejected"), &json!(0), &json!(2)));
    assert_eq!(rejected["rejected"][1]["index"], 1);
    let by_write = write(&app, bad_rows(2)).await;
    assert_eq!(
        (
            by_write.status(),
            by_write.rejected_count,
            by_write.unverified
        ),
        (BatchStatus::Rejected, 2, false)
    );
    let (welcome, mut stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    assert_eq!(welcome.committed_sequence, 2, "the numbers are used");
    for batch in [bad_rows(3), good_rows(4)] {
        stream.send(batch).await.expect("open");
    }
    let mut receipts = stream.acknowledged().await.expect("acknowledged").receipts;
    while receipts.len() < 2 {
        receipts.extend(stream.acknowledged().await.expect("acknowledged").receipts);
    }
    let statuses: Vec<BatchStatus> = receipts.iter().map(proto::Receipt::status).collect();
    assert_eq!(
        statuses,
        [BatchStatus::Rejected, BatchStatus::Applied],
        "later ones are on their way"
    );
    drop(stream);

    // Sent again, it is a duplicate with its first receipt, through a restart.
    let app = app.restart().await;
    let again = post(&app, &body(1, &[bad(), bad()])).await;
    assert_eq!(again["status"], "duplicate");
    assert_eq!(
        (&again["rejected"], &again["rejected_count"]),
        (&rejected["rejected"], &rejected["rejected_count"])
    );
    assert_eq!(
        write(&app, bad_rows(2)).await.status(),
        BatchStatus::Duplicate
    );
    let other = app
        .rest("POST", TRANSITIONS, Some(&body(1, &[good()])))
        .await;
    assert_eq!(
        (other.0, &other.1["reason"]),
        (409, &json!("SEQUENCE_REUSED"))
    );

    // What is empty or partly good is applied.
    assert_eq!(post(&app, &body(5, &[])).await["status"], "applied");
    assert_eq!(
        post(&app, &body(6, &[bad(), good()])).await["status"],
        "applied"
    );
    assert_eq!(app.cells("0.0").await[0].2, 2);
    app.stop().await;
}

#[tokio::test]
async fn a_producer_that_begins_again_at_one_is_told_that_nobody_can_tell() {
    let app = TestApp::start().await;
    app.lane().await;
    let (_, stream) = RawStream::open(app.ingest().await, hello("p"))
        .await
        .expect("welcome");
    let (requests, mut responses) = stream.split();
    let sending = tokio::spawn(async move {
        for sequence in 1..=1_025 {
            let message = Some(proto::ingest_request::Message::Batch(good_rows(sequence)));
            requests
                .send(proto::IngestRequest { message })
                .await
                .expect("open");
        }
    });
    while let Some(response) = responses.message().await.expect("acknowledged") {
        let Some(proto::ingest_response::Message::Acknowledgement(told)) = response.message else {
            continue;
        };
        assert!(
            told.receipts
                .iter()
                .all(|receipt| receipt.status() == BatchStatus::Applied)
        );
    }
    sending.await.expect("all is sent");

    let receipt = post(&app, &body(1, &[good(), good()])).await;
    assert_eq!(
        receipt,
        json!({"sequence": 1, "status": "unverified", "accepted": 0, "rejected_count": 0, "rejected": [], "unverified": true})
    );
    let told = write(&app, good_rows(1)).await;
    assert_eq!(
        (told.status(), told.unverified, told.accepted),
        (BatchStatus::Unverified, true, 0)
    );
    assert_eq!(
        write(&app, good_rows(2)).await.status(),
        BatchStatus::Duplicate,
        "still kept"
    );
    let (_, metrics) = app.rest("GET", "/metrics", None).await;
    assert!(
        metrics.as_str().is_some_and(
            |text| text.contains("nudge_batches_unverified_total{environment=\"lane\"}")
        )
    );
    app.stop().await;
}

#[tokio::test]
async fn a_uid_that_is_another_ones_is_refused_on_every_face() {
    let app = TestApp::start().await;
    let uid = app.lane().await.uid;
    let with_uid = |uid: &str, sequence| {
        let mut body = body(sequence, &[good()]);
        body["environment_uid"] = json!(uid);
        body
    };
    assert_eq!(post(&app, &with_uid(&uid, 1)).await["status"], "applied");
    let line = good().to_string();
    let lines =
        |uid: &str, sequence: u64| format!("?producer=p&sequence={sequence}&environment_uid={uid}");
    let (status, receipt) =
        post_text(&app, &lines(&uid, 2), "application/x-ndjson", line.clone()).await;
    assert_eq!(
        (status, &receipt["status"]),
        (200, &json!("applied")),
        "{receipt}"
    );

    let (status, by_body) = app
        .rest("POST", TRANSITIONS, Some(&with_uid("other", 3)))
        .await;
    let (also, by_query) = post_text(&app, &lines("other", 3), "application/x-ndjson", line).await;
    assert_eq!((status, also), (409, 409));
    let request = proto::WriteRequest {
        environment: "lane".into(),
        environment_uid: "other".into(),
        producer: "p".into(),
        batch: Some(good_rows(3)),
    };
    let by_grpc = app
        .ingest()
        .await
        .write(request)
        .await
        .expect_err("another environment");
    assert_eq!(
        (by_grpc.code(), reason(&by_grpc)),
        (Code::FailedPrecondition, "ENVIRONMENT_REPLACED".into())
    );
    for problem in [by_body, by_query] {
        assert_eq!(
            (&problem["reason"], &problem["environment_uid"]),
            (&json!("ENVIRONMENT_REPLACED"), &json!(uid))
        );
        assert_eq!(problem["detail"], by_grpc.message());
    }
    assert_eq!(app.cells("0.0").await[0].2, 2, "nothing of it is counted");
    app.stop().await;
}

#[tokio::test]
async fn what_is_no_number_of_json_is_named_with_its_record() {
    let app = TestApp::start().await;
    app.lane().await;
    for (number, sequence) in [("NaN", 1), ("Infinity", 2), ("-Infinity", 3)] {
        let line = good().to_string().replace("0.1", number);
        let document = format!(
            "{{\"producer\": \"p\", \"sequence\": {sequence}, \"transitions\": [{}, {line}]}}",
            good()
        );
        let (status, problem) = post_text(&app, "", "application/json", document).await;
        assert_eq!(
            (status, &problem["errors"][0]["pointer"]),
            (400, &json!("/transitions/1/state/distance"))
        );
        let detail = problem["detail"].as_str().expect("text");
        assert!(
            detail.contains(&format!("got {number}, expected a finite number")),
            "{detail}"
        );

        let lines = format!("{line}\n{}\n", good());
        let query = format!("?producer=p&sequence={sequence}");
        let (status, receipt) = post_text(&app, &query, "application/x-ndjson", lines).await;
        let told = (
            &receipt["status"],
            &receipt["accepted"],
            &receipt["rejected"][0]["field"],
        );
        assert_eq!(
            (status, told),
            (
                200,
                (&json!("applied"), &json!(1), &json!("/state/distance"))
            )
        );
        let why = receipt["rejected"][0]["reason"].as_str().expect("text");
        assert!(
            why.starts_with(&format!("got {number}, expected a finite number")),
            "{why}"
        );
    }
    app.stop().await;
}

/// A request with a JSON body: method, path, the schema's name in the document, and a body of which
/// everything optional is absent.
fn requests() -> Vec<(&'static str, &'static str, &'static str, Value)> {
    let state = json!([{"distance": 0.1, "held": 0}]);
    vec![
        (
            "PUT",
            "/v1/environments/lane",
            "Description",
            crate::support::lane_json(),
        ),
        (
            "PATCH",
            "/v1/environments/lane",
            "EnvironmentChange",
            json!({"rule": {}}),
        ),
        (
            "POST",
            "/v1/environments/lane/influence",
            "Question",
            json!({"states": state}),
        ),
        (
            "POST",
            "/v1/environments/lane/transitions",
            "Transitions",
            body(1, &[good()]),
        ),
    ]
}

/// Returns the pointers of every object in a body with the schemas that describe it, found by the
/// document.
fn objects(
    document: &Value,
    schema: &Value,
    body: &Value,
    at: String,
    found: &mut Vec<(String, Value)>,
) {
    let schema = resolved(document, schema);
    if let (Some(properties), Some(members)) = (schema["properties"].as_object(), body.as_object())
    {
        found.push((at.clone(), schema.clone()));
        for (name, inner) in members {
            if let Some(described) = properties.get(name) {
                objects(document, described, inner, format!("{at}/{name}"), found);
            }
        }
    }
    for (i, inner) in body.as_array().into_iter().flatten().enumerate() {
        objects(
            document,
            &schema["items"],
            inner,
            format!("{at}/{i}"),
            found,
        );
    }
}

/// Follows references, and takes what a member is where it may be null too.
fn resolved(document: &Value, schema: &Value) -> Value {
    if let Some(name) = schema["$ref"]
        .as_str()
        .and_then(|reference| reference.rsplit('/').next())
    {
        return resolved(document, &document["components"]["schemas"][name]);
    }
    match schema["oneOf"].as_array() {
        Some(ways) => ways
            .iter()
            .find(|way| way["type"] != "null")
            .map_or(Value::Null, |way| resolved(document, way)),
        None => schema.clone(),
    }
}

fn may_be_null(document: &Value, property: &Value) -> bool {
    let is_null = |schema: &Value| match &schema["type"] {
        Value::Array(types) => types.iter().any(|one| one == "null"),
        one => one == "null",
    };
    let ways = property["oneOf"].as_array().cloned().unwrap_or_default();
    is_null(property) || ways.iter().any(is_null) || is_null(&resolved(document, property))
}

/// Leaves out what tells when something was asked.
fn steady(mut answer: Value) -> Value {
    answer
        .as_object_mut()
        .map(|members| members.remove("status"));
    answer
}

#[tokio::test]
async fn every_optional_member_of_every_request_may_be_null_and_nothing_unknown_is_taken() {
    let app = TestApp::start().await;
    app.lane().await;
    let (_, document) = app.rest("GET", "/openapi.json", None).await;
    let mut tried = Vec::new();
    for (method, path, name, body) in requests() {
        let (status, plain) = app.rest(method, path, Some(&body)).await;
        assert_eq!(status, 200, "{method} {path}: {plain}");
        let mut found = Vec::new();
        objects(
            &document,
            &document["components"]["schemas"][name],
            &body,
            String::new(),
            &mut found,
        );
        for (at, schema) in found {
            let required = schema["required"].as_array().cloned().unwrap_or_default();
            let present = body.pointer(&at).expect("an object");
            for (property, described) in schema["properties"].as_object().expect("an object") {
                if required.contains(&json!(property)) || present.get(property).is_some() {
                    continue;
                }
                assert!(
                    may_be_null(&document, described),
                    "{name}{at}/{property} is optional: {described}"
                );
                let mut with_null = body.clone();
                with_null.pointer_mut(&at).expect("an object")[property] = Value::Null;
                let (status, answer) = app.rest(method, path, Some(&with_null)).await;
                assert_eq!(
                    (status, steady(answer)),
                    (200, steady(plain.clone())),
                    "{method} {path} {at}/{property}"
                );
                tried.push(format!("{name}{at}/{property}"));
            }
            // A transition's own faults reject it alone.
            let mut with_more = body.clone();
            with_more.pointer_mut(&at).expect("an object")["unheard_of"] = json!(1);
            let (status, answer) = app.rest(method, path, Some(&with_more)).await;
            let in_record = at.contains("/transitions/") && status == 409;
            assert!(
                status == 400 && answer.to_string().contains("unheard_of") || in_record,
                "{name}{at}: {answer}"
            );
        }
    }
    for expected in [
        "Transitions/segment",
        "Transitions/environment_uid",
        "Transitions/transitions/0/entry",
        "Transitions/transitions/0/count",
        "Question/given",
        "Question/visits_to_decide",
        "Question/rule",
        "Description/rule",
        "Description/state/0/unit",
        "EnvironmentChange/rule/estimators",
    ] {
        assert!(
            tried.iter().any(|one| one == expected),
            "{expected} in {tried:?}"
        );
    }
    let (status, problem) = app
        .rest(
            "POST",
            "/v1/environments/lane/models",
            Some(&json!({"ego": "ghost"})),
        )
        .await;
    let nulls = json!({"ego": "ghost", "other": null, "kind": null, "width": null, "members": null, "folds": null,
        "epochs": null, "weighting": null, "seed": null, "activate": null});
    let (also, with_nulls) = app
        .rest("POST", "/v1/environments/lane/models", Some(&nulls))
        .await;
    assert_eq!(
        (status, also, &problem),
        (400, 400, &with_nulls),
        "a training that would be refused for its ego alone"
    );
    app.stop().await;
}
