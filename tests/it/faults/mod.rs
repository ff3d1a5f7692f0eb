//! The fault programme: what breaks around the service, and that nothing is lost or counted twice
//! by it.
//!
//! Each kind has a short form, which runs with every `cargo test`, and a long one, which
//! `NUDGE_LONG=1` asks for and `.ci/long` runs on a release build: see `docs/faults.md`. `disk`
//! builds the shim that stands between a server and its files; `shim.rs` is that shim, and no
//! module.

use std::net::SocketAddr;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use nudge::store::Options;
use serde_json::{Value, json};

use crate::server::Server;
use crate::support::fixtures::Fixture;
use crate::support::open;

mod connections;
mod crowd;
mod deaths;
mod disk;
mod folds;
mod full_disk;
mod io_errors;
mod overload;
mod power_cuts;
pub mod process;
mod readiness;
mod reads;
mod wide;

/// Returns whether the long form was asked for.
pub fn long() -> bool {
    std::env::var("NUDGE_LONG").is_ok_and(|told| !["", "0"].contains(&told.as_str()))
}

/// Returns how much of something the short or the long form does.
pub fn scaled(short: u64, long_form: u64) -> u64 {
    if long() { long_form } else { short }
}

/// Waits until something is so.
async fn eventually(what: &str, is_so: impl AsyncFnMut() -> bool) {
    eventually_within(Duration::from_secs(30), what, is_so).await;
}

/// Waits so long at most until something is so.
async fn eventually_within(limit: Duration, what: &str, mut is_so: impl AsyncFnMut() -> bool) {
    let late = Instant::now() + limit;
    while !is_so().await {
        assert!(Instant::now() < late, "not within {limit:?}: {what}");
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

/// Returns what a path of REST tells: its status, or 0 without an answer, and its body, as JSON
/// where it is.
async fn asked(address: SocketAddr, path: &str) -> (u16, Value) {
    let Ok(response) = reqwest::get(format!("http://{address}{path}")).await else {
        return (0, Value::Null);
    };
    let status = response.status().as_u16();
    let text = response.text().await.unwrap_or_default();
    (
        status,
        serde_json::from_str(&text).unwrap_or(Value::String(text)),
    )
}

/// Starts a service, and returns it once it is ready; nothing where it died before.
async fn settled(command: &mut Command) -> Option<Server> {
    let mut server = Server::run(command).ok()?;
    let late = Instant::now() + Duration::from_secs(30);
    while asked(server.address, "/readyz").await.0 != 200 {
        if server.ended_within(Duration::ZERO).await.is_some() {
            return None;
        }
        assert!(Instant::now() < late, "ready in time");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    Some(server)
}

/// Checks that a database of yesterday holds what it held, and that what is sent again counts
/// nothing.
async fn assert_as_told(fixture: &Fixture, directory: &Path) {
    let server = settled(&mut Server::command(directory, "127.0.0.1:0"))
        .await
        .expect("it starts");
    for (path, body, answer) in fixture.posted() {
        let url = format!("http://{}/v1/environments{path}", server.address);
        let again = reqwest::Client::new()
            .post(url)
            .json(body)
            .send()
            .await
            .expect("answered");
        let again: Value = again.json().await.expect("JSON");
        assert_eq!(
            (&again["status"], &again["accepted"]),
            (&json!("duplicate"), &answer["accepted"]),
            "{path}"
        );
    }
    for (path, told) in fixture.got().filter(|(path, _)| path.contains("/states/")) {
        let (status, now) = asked(server.address, &format!("/v1/environments{path}")).await;
        assert_eq!(
            (status, &now["visits"], &now["entries"]),
            (200, &told["visits"], &told["entries"]),
            "{path}"
        );
    }
    server.kill();
    let store = open(directory, Options::default()).await;
    let audits = store.audit().await.expect("read");
    assert!(
        audits.len() == 3 && audits.iter().all(|audit| audit.is_sound()),
        "{audits:?}"
    );
    store.close().await;
}
