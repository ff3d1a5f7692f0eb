//! Work is bounded, can be cancelled, and goes on for those who ask again. Where a test needs
//! something to take long, it holds the workers itself.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nudge::api::proto;
use nudge::work::{Gate, Turn};
use reqwest::header::RETRY_AFTER;
use serde_json::{Value, json};
use tempfile::TempDir;
use tonic::{Code, Request, Status};
use tonic_types::StatusExt;

use crate::server::Server;
use crate::support::{TestApp, open, reason};

/// States of the environment, each seen a hundred times.
const STATES: u64 = 1_000;

/// How long something may take that would never come to an end, or take minutes, if it were not cut
/// short.
const SOON: Duration = Duration::from_secs(60);

fn description() -> Value {
    let agent = |name: &str| json!({"name": name, "action": [{"name": "do", "integer": {"min": 0, "max": 9}}]});
    json!({"state": [{"name": "place", "integer": {"min": 0, "max": STATES - 1}}], "agents": [agent("a"), agent("b")]})
}

/// A hundred visits of each state, each pair of actions now and then.
fn transitions(sequence: u64) -> Value {
    let one = |at: u64| {
        let (place, a) = (at % STATES, at / STATES);
        json!({"state": {"place": place}, "actions": {"a": a, "b": (a * a + place + sequence) % 10}, "count": 10})
    };
    json!({"producer": "p", "sequence": sequence, "transitions": (0..10 * STATES).map(one).collect::<Vec<_>>()})
}

async fn fill(app: &TestApp) {
    assert_eq!(
        app.rest("PUT", "/v1/environments/wide", Some(&description()))
            .await
            .0,
        201
    );
    let (status, receipt) = app
        .rest(
            "POST",
            "/v1/environments/wide/transitions",
            Some(&transitions(1)),
        )
        .await;
    assert_eq!(
        (status, &receipt["accepted"]),
        (200, &json!(10 * STATES)),
        "{receipt}"
    );
}

async fn filled() -> TestApp {
    let app = TestApp::start().await;
    fill(&app).await;
    app
}

/// A question that takes minutes where nobody has optimised anything: a permutation test of every
/// state.
fn slow() -> Value {
    let keys: Vec<String> = (0..STATES).map(|place| place.to_string()).collect();
    json!({"keys": keys, "significance": "pooled", "estimators": ["nsb"]})
}

fn scope() -> Option<proto::Scope> {
    Some(proto::Scope {
        environment: "wide".into(),
        ..Default::default()
    })
}

/// A call whose deadline only the service knows of.
fn with_deadline<T>(message: T, timeout: &str) -> Request<T> {
    let mut request = Request::new(message);
    request
        .metadata_mut()
        .insert("grpc-timeout", timeout.parse().expect("a value"));
    request
}

/// Takes every worker of a lane.
async fn hold(gate: &Gate) -> Vec<Turn> {
    let mut held = Vec::new();
    for _ in 0..gate.workers() {
        held.push(gate.enter().await.expect("free"));
    }
    held
}

async fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let reached = async {
        while !is_so() {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(SOON, reached)
        .await
        .unwrap_or_else(|_| panic!("not soon: {what}"));
}

fn retries(status: &Status) -> bool {
    status.get_details_retry_info().is_some()
}

#[tokio::test(flavor = "multi_thread")]
async fn who_finds_no_place_is_told_when_to_ask_again_on_both_faces() {
    let app = filled().await;
    let gate = &app.app.work.questions;
    let held = hold(gate).await;
    let mut waiting = Vec::new();
    loop {
        let entering = tokio::spawn({
            let gate = gate.clone();
            async move { gate.enter().await.map(drop) }
        });
        let before = waiting.len();
        until("it waits, or is refused", || {
            entering.is_finished() || gate.busy() > held.len() + before
        })
        .await;
        if entering.is_finished() {
            break;
        }
        waiting.push(entering);
    }

    let url = app.url("/v1/environments/wide/influence");
    let refused = reqwest::Client::new()
        .post(url)
        .json(&slow())
        .send()
        .await
        .expect("answered");
    assert_eq!(
        (refused.status().as_u16(), &refused.headers()[RETRY_AFTER]),
        (503, &"2".parse().expect("a value"))
    );
    let problem: Value = refused.json().await.expect("JSON");
    assert_eq!(problem["reason"], "OVERLOADED");
    let keys = (0..STATES).map(|place| place.to_string()).collect();
    let question = proto::BatchGetInfluenceRequest {
        scope: scope(),
        keys,
        ..Default::default()
    };
    let status = app
        .influence()
        .await
        .batch_get_influence(question)
        .await
        .expect_err("full");
    assert_eq!(
        (status.code(), reason(&status).as_str(), retries(&status)),
        (Code::Unavailable, "OVERLOADED", true)
    );
    assert_eq!(
        Some(status.message()),
        problem["detail"].as_str(),
        "the same words"
    );

    // What takes next to nothing needs no worker.
    assert_eq!(app.get("/livez").await, "ok\n");
    app.get("/v1/environments/wide/influence?key=7&view=figures")
        .await;
    drop((held, waiting));
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn clients_that_leave_take_their_work_with_them() {
    let app = filled().await;
    let gate = app.app.work.questions.clone();
    let asking: Vec<_> = (0..60)
        .map(|_| {
            let request = reqwest::Client::new()
                .post(app.url("/v1/environments/wide/influence"))
                .json(&slow());
            tokio::spawn(request.send())
        })
        .collect();
    until("all sixty work or wait", || gate.busy() == 60).await;
    asking.iter().for_each(tokio::task::JoinHandle::abort);
    until("nobody works or waits", || gate.busy() == 0).await;
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_call_ends_with_its_deadline_and_its_place_is_free() {
    let app = filled().await;
    let gate = &app.app.work.questions;
    let held = hold(gate).await;
    let keys = (0..STATES).map(|place| place.to_string()).collect();
    let question = proto::BatchGetInfluenceRequest {
        scope: scope(),
        keys,
        ..Default::default()
    };
    // By hand: a client of ours would look at the clock itself, and not wait for what the service
    // says.
    let message = prost::Message::encode_to_vec(&question);
    let frame = [&[0][..], &(message.len() as u32).to_be_bytes(), &message].concat();
    let call = reqwest::Client::new()
        .post(app.url("/nudge.v1.InfluenceService/BatchGetInfluence"))
        .header("content-type", "application/grpc-web+proto")
        .header("grpc-timeout", "200m");
    let refused = call.body(frame).send().await.expect("answered");
    let status = Status::from_header_map(refused.headers()).expect("a status");
    assert_eq!(
        (status.code(), reason(&status).as_str()),
        (Code::DeadlineExceeded, "TIMEOUT")
    );
    assert_eq!(
        status.message(),
        "no answer within 0.2 seconds: ask for less at a time"
    );
    assert!(!retries(&status), "it would take as long again");
    until("it waits no more", || gate.busy() == held.len()).await;
    drop(held);
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deadline_that_has_passed_is_told_at_once_and_one_that_is_none_is_refused() {
    let app = filled().await;
    let ask = async |timeout: &str| {
        let call = reqwest::Client::new()
            .post(app.url("/nudge.v1.EnvironmentService/ListEnvironments"))
            .header("content-type", "application/grpc-web+proto")
            .header("grpc-timeout", timeout);
        let answer = call.body(vec![0; 5]).send().await.expect("answered");
        Status::from_header_map(answer.headers()).unwrap_or_else(|| Status::ok(""))
    };
    for passed in ["0n", "0u", "0m", "0S", "0M", "0H", "00000000S", "1n"] {
        assert_eq!(ask(passed).await.code(), Code::DeadlineExceeded, "{passed}");
    }
    for enough in [
        "99999999u",
        "20000m",
        "20S",
        "1M",
        "1H",
        "99999999H",
        "00000020S",
    ] {
        assert_eq!(ask(enough).await.code(), Code::Ok, "{enough}");
    }
    for wrong in [
        "",
        "5",
        "S",
        "5s",
        "-5S",
        "1.5S",
        "123456789m",
        "5 S",
        "soon",
    ] {
        let status = ask(wrong).await;
        assert_eq!(status.code(), Code::InvalidArgument, "{wrong:?}");
        let faults = status
            .get_details_bad_request()
            .expect("the field is named")
            .field_violations;
        assert_eq!(faults[0].field, "grpc-timeout", "{wrong:?}");
    }
    app.stop().await;
}

/// What is made of all states, asked for with that deadline.
async fn shared(app: &TestApp, what: &str, timeout: &str) -> Result<(), Status> {
    let mut client = app.influence().await;
    let method = if what == "bh" {
        proto::DiscoveryMethod::Bh
    } else {
        proto::DiscoveryMethod::Bayes
    };
    match what {
        "ranking" => {
            let order_by = "p_dependent".into();
            let request = proto::ListStatesRequest {
                scope: scope(),
                order_by,
                ..Default::default()
            };
            client
                .list_states(with_deadline(request, timeout))
                .await
                .map(drop)
        }
        "bh" | "bayes" => {
            let discovery = Some(proto::Discovery {
                fdr: Some(0.05),
                method: method.into(),
            });
            let request = proto::SummarizeRequest {
                scope: scope(),
                discovery,
                omit_segments: false,
            };
            client
                .summarize(with_deadline(request, timeout))
                .await
                .map(drop)
        }
        "explore" => {
            let request = proto::ExploreRequest {
                scope: scope(),
                ..Default::default()
            };
            client
                .explore(with_deadline(request, timeout))
                .await
                .map(drop)
        }
        _ => {
            let request = proto::FitPriorRequest {
                environment: "wide".into(),
                ..Default::default()
            };
            client
                .fit_prior(with_deadline(request, timeout))
                .await
                .map(drop)
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn shared_results_tell_how_far_they_are_and_go_on() {
    let app = filled().await;
    let work = app.app.work.clone();
    for (what, gate) in [
        ("ranking", &work.passes),
        ("bh", &work.passes),
        ("bayes", &work.passes),
        ("explore", &work.passes),
        ("fit", &work.fits),
    ] {
        // Another transition makes what was kept stale.
        let committed =
            app.get("/v1/environments/wide/producers/p").await["committed_sequence"].as_u64();
        let more = transitions(committed.expect("a number") + 1);
        assert_eq!(
            app.rest("POST", "/v1/environments/wide/transitions", Some(&more))
                .await
                .0,
            200
        );
        let held = hold(gate).await;
        let status = shared(&app, what, "2S").await.expect_err(what);
        assert_eq!(
            (status.code(), reason(&status).as_str()),
            (Code::Unavailable, "STILL_WORKING"),
            "{what}: {status:?}"
        );
        assert!(retries(&status), "{what}");
        assert!(
            status.message().ends_with("it goes on, ask again"),
            "{}",
            status.message()
        );
        let details = status.get_details_error_info().expect("signed").metadata;
        assert_eq!(
            (details["done"].as_str(), details["total"].as_str()),
            ("0", "1000"),
            "{what}: {}",
            status.message()
        );
        drop(held);
        shared(&app, what, "5M")
            .await
            .unwrap_or_else(|status| panic!("{what}: {status:?}"));
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fit_that_nobody_was_told_is_told_when_it_is_asked_for_again() {
    let app = filled().await;
    let held = hold(&app.app.work.fits).await;
    shared(&app, "fit", "400m")
        .await
        .expect_err("it takes longer");
    drop(held);
    let environment = app.app.store.environment("wide").expect("made");
    let made = async {
        while app
            .app
            .store
            .fits(environment.id)
            .await
            .expect("read")
            .is_empty()
        {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(SOON, made)
        .await
        .expect("it goes on without anybody");

    let told = app.rest("POST", "/v1/environments/wide/fit", None).await;
    assert_eq!(
        (told.0, &told.1["fits"][0]["fit"]["version"]),
        (200, &json!(1)),
        "{}",
        told.1
    );
    let again = app.rest("POST", "/v1/environments/wide/fit", None).await;
    assert_eq!(
        again.1["fits"][0]["fit"]["version"], 2,
        "it was told already: {}",
        again.1
    );
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_ranking_is_made_for_all_who_ask() {
    let app = filled().await;
    let held = hold(&app.app.work.passes).await;
    let asking = async {
        app.get("/v1/environments/wide/states?order_by=p_dependent&page_size=5")
            .await
    };
    let (a, b, c, ()) = tokio::join!(
        asking,
        app.get("/v1/environments/wide/summary"),
        app.get("/v1/environments/wide/summary"),
        async {
            until("one piece of one pass waits", || {
                app.app.work.passes.busy() > held.len()
            })
            .await;
            assert_eq!(app.app.work.passes.busy(), held.len() + 1);
            drop(held);
        }
    );
    assert_eq!((&a["as_of"], &b), (&c["as_of"], &c));
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn orders_that_need_no_evidence_make_none_and_say_the_same() {
    let app = filled().await;
    let paths = ["visits", "visits%20asc", "plug_in", "plug_in%20asc"].map(|order| {
        format!("/v1/environments/wide/states?order_by={order}&page_size=7&min_visits=3")
    });
    let mut before = Vec::new();
    for path in &paths {
        let first = app.get(path).await;
        let token = first["next_page_token"].as_str().expect("more").to_owned();
        before.push([first, app.get(&format!("{path}&page_token={token}")).await]);
    }
    // With a survey of the same moment the same pages come from that.
    app.get("/v1/environments/wide/states?order_by=posterior_mean")
        .await;
    for (path, [first, second]) in paths.iter().zip(before) {
        assert_eq!(app.get(path).await, first, "{path}");
        let token = first["next_page_token"].as_str().expect("more");
        assert_eq!(
            app.get(&format!("{path}&page_token={token}")).await,
            second,
            "{path}"
        );
        assert!(
            first["states"][0]["probability"]["dependent"].is_number(),
            "the states of a page have evidence: {first}"
        );
    }
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_sent_is_refused_before_it_is_made() {
    let app = TestApp::start().await;
    let label = |feature: usize, at: usize| format!("{at}-{feature}-{}", "x".repeat(50));
    let feature = |at: usize| {
        let name = format!("{at:03}{}", "n".repeat(57));
        json!({"name": name, "categorical": {"labels": [label(at, 0), label(at, 1)]}})
    };
    let actions: Vec<String> = (0..60).map(|at| format!("act {at}")).collect();
    let agent = |name: &str| json!({"name": name, "action": [{"name": "do", "categorical": {"labels": actions}}]});
    let wide = json!({"state": (0..60).map(feature).collect::<Vec<_>>(), "agents": [agent("a"), agent("b")]});
    assert_eq!(
        app.rest("PUT", "/v1/environments/wide", Some(&wide))
            .await
            .0,
        201
    );
    let key = |at: usize| {
        (0..60)
            .map(|bit| if bit < 20 { (at >> bit) & 1 } else { 0 }.to_string())
            .collect::<Vec<_>>()
            .join(".")
    };
    let keys = |n: usize| (0..n).map(key).collect::<Vec<_>>();

    // Nobody works: what is refused was not made.
    let held = hold(&app.app.work.questions).await;
    for (question, view) in [
        (json!({"keys": keys(800), "view": "figures"}), "figures"),
        (json!({"keys": keys(60), "view": "full"}), "full"),
    ] {
        let (status, problem) = app
            .rest("POST", "/v1/environments/wide/influence", Some(&question))
            .await;
        assert_eq!(
            (status, &problem["reason"]),
            (413, &json!("ANSWER_TOO_LARGE")),
            "{problem}"
        );
        assert!(
            problem["detail"].as_str().expect("text").contains(view),
            "{problem}"
        );
        let view = if view == "full" {
            proto::View::Full
        } else {
            proto::View::Figures
        };
        let keys = question["keys"]
            .as_array()
            .expect("keys")
            .iter()
            .map(|key| key.as_str().expect("text").into());
        let (view, keys) = (view.into(), keys.collect());
        let request = proto::BatchGetInfluenceRequest {
            scope: scope(),
            keys,
            view,
            ..Default::default()
        };
        let refused = app
            .influence()
            .await
            .batch_get_influence(request)
            .await
            .expect_err("too large");
        assert_eq!(
            (refused.code(), reason(&refused).as_str()),
            (Code::OutOfRange, "ANSWER_TOO_LARGE")
        );
    }

    let values = |at: usize| {
        let bit = |bit: usize| if bit < 20 { (at >> bit) & 1 } else { 0 };
        (0..60)
            .map(|f| (format!("{f:03}{}", "n".repeat(57)), json!(label(f, bit(f)))))
            .collect::<serde_json::Map<_, _>>()
    };
    let seen: Vec<Value> = (0..800)
        .map(|at| json!({"state": values(at), "actions": {"a": "act 1", "b": "act 2"}}))
        .collect();
    let batch = json!({"producer": "p", "sequence": 1, "transitions": seen});
    assert_eq!(
        app.rest("POST", "/v1/environments/wide/transitions", Some(&batch))
            .await
            .1["accepted"],
        800
    );
    let page =
        |size: usize| format!("/v1/environments/wide/states?order_by=visits&page_size={size}");
    drop(held);
    let told = app.get(&page(1_000)).await;
    let first = told["states"].as_array().expect("states").len();
    assert!(
        (100..800).contains(&first) && told["next_page_token"].is_string(),
        "a page ends where a message is full: {first}"
    );
    let request = proto::ListStatesRequest {
        scope: scope(),
        page_size: 1_000,
        ..Default::default()
    };
    let listed = app
        .influence()
        .await
        .list_states(request)
        .await
        .expect("a page that fits")
        .into_inner();
    assert_eq!(
        (listed.states.len(), listed.next_page_token.is_empty()),
        (first, false)
    );
    assert_eq!(
        app.get(&page(100)).await["states"]
            .as_array()
            .expect("states")
            .len(),
        100,
        "a smaller page fits"
    );
    app.stop().await;
}

/// Sends SIGTERM, and returns how long the process took to end.
fn terminated(server: &mut Server) -> Duration {
    let since = Instant::now();
    server.ask_to_stop();
    assert!(server.ended().success(), "it says that all is well");
    since.elapsed()
}

/// Fills a database, so that the process under test begins with it.
async fn data(directory: &Path) {
    let directory = Arc::new(directory.to_owned());
    let store = open(&directory, Default::default()).await;
    let app = TestApp::with(Arc::new(TempDir::new().expect("a directory")), store).await;
    fill(&app).await;
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_signal_ends_the_process_whatever_it_computes() {
    let directory = TempDir::new().expect("a directory");
    data(directory.path()).await;
    let mut server = Server::start(directory.path(), "127.0.0.1:0");
    let url = |path: &str| format!("http://{}/v1/environments/wide/{path}", server.address);
    let client = reqwest::Client::new();
    let mut asking: Vec<_> = (0..60)
        .map(|_| tokio::spawn(client.post(url("influence")).json(&slow()).send()))
        .collect();
    for path in ["explore", "states?fdr=0.05&method=bh", "summary"] {
        asking.push(tokio::spawn(client.get(url(path)).send()));
    }
    asking.push(tokio::spawn(client.post(url("fit")).send()));
    let trained = client.post(url("models")).send().await.expect("answered");
    assert_eq!(trained.status(), 202);
    let metrics = format!("http://{}/metrics", server.address);
    let working = async {
        loop {
            let told = client
                .get(&metrics)
                .send()
                .await
                .expect("answered")
                .text()
                .await
                .expect("text");
            if told.contains("nudge_work_turns{lane=\"questions\"} 60") {
                return;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    tokio::time::timeout(SOON, working)
        .await
        .expect("sixty questions work or wait");

    let took = tokio::task::spawn_blocking(move || terminated(&mut server))
        .await
        .expect("it ends");
    assert!(took <= Duration::from_secs(10), "the promise: {took:?}");
    for asked in asking {
        // Told that the service stops, or cut off: but not left waiting.
        let told = tokio::time::timeout(SOON, asked)
            .await
            .expect("nobody waits on")
            .expect("no panic");
        assert!(told.is_err() || told.is_ok_and(|told| told.status() == 503));
    }
}
