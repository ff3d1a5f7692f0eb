//! Background refits: a fit that is due is made while nobody waits for it, answers say on which fit
//! they stand, and no fit is made twice.

use std::time::{Duration, Instant};

use nudge::domain::FitId;
use serde_json::{Value, json};

use crate::support::TestApp;

/// How often it is looked whether a fit is due.
const OFTEN: Duration = Duration::from_millis(10);

/// Nothing here takes so long.
const SOON: Duration = Duration::from_secs(60);

/// Transitions of one batch: each of the lane's states twice, once in each way.
const BATCH: u64 = 40;

async fn count(app: &TestApp, sequence: u64) {
    let transition = |at: u64| {
        json!({
            "state": {"place": at % 20},
            "actions": {"a": at / 20, "b": (at / 20) * (at % 2)},
        })
    };
    let transitions: Vec<Value> = (0..BATCH).map(transition).collect();
    let batch = json!({"producer": "p", "sequence": sequence, "transitions": transitions});
    let path = "/v1/environments/street/transitions";
    let (status, receipt) = app.rest("POST", path, Some(&batch)).await;
    assert_eq!(
        (status, &receipt["accepted"]),
        (200, &json!(BATCH)),
        "{receipt}"
    );
}

async fn street() -> TestApp {
    let app = TestApp::start().await;
    let action = json!([{"name": "move", "integer": {"min": 0, "max": 1}}]);
    let description = json!({
        "state": [{"name": "place", "integer": {"min": 0, "max": 19}}],
        "agents": [{"name": "a", "action": action}, {"name": "b", "action": action}],
    });
    let path = "/v1/environments/street";
    assert_eq!(app.rest("PUT", path, Some(&description)).await.0, 201);
    count(&app, 1).await;
    app
}

/// Returns the fit that an answer says it stands on: its version, and its revision.
async fn fit_of_an_answer(app: &TestApp) -> (u64, u64) {
    let told = app
        .get("/v1/environments/street/influence?key=3&view=figures")
        .await;
    let fit = &told["answers"][0]["fit"];
    let figure = |name: &str| fit[name].as_u64().unwrap_or_else(|| panic!("{told}"));
    (figure("version"), figure("revision"))
}

async fn until_answers_stand_on(app: &TestApp, expected: (u64, u64)) {
    let reached = async {
        while fit_of_an_answer(app).await != expected {
            tokio::time::sleep(OFTEN).await;
        }
    };
    let reached = tokio::time::timeout(SOON, reached).await;
    assert!(reached.is_ok(), "no answer stands on {expected:?}");
}

/// Waits until a fit waits for a worker.
async fn until_one_is_begun(app: &TestApp) {
    let begun = async {
        while app.app.work.fits.waiting() == 0 {
            tokio::time::sleep(OFTEN).await;
        }
    };
    let begun = tokio::time::timeout(SOON, begun).await;
    assert!(begun.is_ok(), "no fit was begun");
}

async fn kept(app: &TestApp) -> Vec<FitId> {
    let environment = app.app.environments.find("street").expect("made");
    let records = app.app.store.fits(environment.id).await.expect("read");
    records.into_iter().map(|record| record.id).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fit_that_is_due_is_made_in_the_background_and_answers_name_it() {
    let app = street().await;
    let refits = tokio::spawn(app.app.fits.clone().keep_up(OFTEN));
    tokio::time::sleep(OFTEN * 10).await;
    assert_eq!(kept(&app).await, [], "nobody asked");

    let worker = app.app.work.fits.enter().await.expect("free");
    assert_eq!(fit_of_an_answer(&app).await, (0, 0));
    until_one_is_begun(&app).await;
    let asked = Instant::now();
    assert_eq!(
        fit_of_an_answer(&app).await,
        (0, 0),
        "nobody waits for the fit: the last one answers"
    );
    assert!(asked.elapsed() < SOON && app.app.work.fits.waiting() > 0);
    drop(worker);
    until_answers_stand_on(&app, (1, BATCH)).await;

    count(&app, 2).await;
    until_answers_stand_on(&app, (2, 2 * BATCH)).await;
    let id = FitId {
        version: 2,
        revision: 2 * BATCH,
    };
    assert_eq!(kept(&app).await, [id], "the last one is kept");
    refits.abort();
    app.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fit_that_several_want_at_once_is_made_once() {
    let app = street().await;
    fit_of_an_answer(&app).await;
    let worker = app.app.work.fits.enter().await.expect("free");

    // One on request is begun, and two passes in the background find that one is due.
    let registry = app.app.fits.clone();
    let environment = app.app.environments.find("street").expect("made");
    let requested = tokio::spawn({
        let (app, environment) = (app.app.clone(), environment.clone());
        async move { app.influence.fit(&environment, None).await }
    });
    until_one_is_begun(&app).await;
    let passes = [registry.clone(), registry]
        .map(|registry| tokio::spawn(async move { registry.keep_up_once(Instant::now()).await }));
    // They look within this; where they did not wait for their turn, each would be begun.
    tokio::time::sleep(OFTEN * 20).await;
    assert_eq!(app.app.work.fits.waiting(), 1, "one at a time");

    drop(worker);
    let fitted = requested.await.expect("it ends").expect("fitted");
    let expected = FitId {
        version: 1,
        revision: BATCH,
    };
    assert_eq!(fitted[0].fit, expected);
    for pass in passes {
        pass.await.expect("it ends");
    }
    assert_eq!(
        kept(&app).await,
        [expected],
        "what was just made is not due"
    );
    app.stop().await;
}
