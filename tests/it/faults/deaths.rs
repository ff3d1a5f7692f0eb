//! Kill -9 where it hurts: at each step to the disk of a migration and of a deletion. Between two
//! steps nothing changes that outlives the process, so these are all the moments at which a kill
//! can differ; `kill.rs` kills at random times.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use nudge::store::Options;
use serde_json::json;
use tempfile::TempDir;

use super::disk::{CHANGES, DEATH, Disk, FOR_EVER};
use super::wide::{self, STATES};
use super::{asked, eventually, scaled, settled};
use crate::server::Server;
use crate::support::databases::{compact_all, number};
use crate::support::fixtures::Fixture;
use crate::support::load::{Load, Shape, Voice, assert_exactly_once, make_lane};

/// Returns some of the steps, or all of them in the long form. The first are those that matter
/// most: a commit of many pages.
pub fn some_of(steps: u64, most: u64) -> impl Iterator<Item = u64> {
    const FIRST: u64 = 8;
    let every = (steps / scaled(most, steps)).max(1);
    (0..steps).filter(move |step| *step < FIRST || step % every == 0)
}

/// Starts a service that dies at a step; returns whether it came so far.
async fn dies_at(disk: &Disk, step: u64) -> bool {
    disk.fail(CHANGES, step, FOR_EVER, DEATH);
    let started = settled(disk.under(&mut Server::command(disk.path(), "127.0.0.1:0"))).await;
    disk.mend();
    started.is_none()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_migration_that_is_killed_at_any_step_goes_on_at_the_next_start() {
    for name in ["schema-1-af3f5d0", "schema-2-a8de69e"] {
        let fixture = Fixture::named(name);
        let whole = Disk::holding(&fixture.path());
        whole.count(CHANGES);
        settled(whole.under(&mut Server::command(whole.path(), "127.0.0.1:0")))
            .await
            .expect("it starts")
            .kill();
        let steps = whole.seen();
        assert!(steps > 20, "{name}: {steps}");

        let mut deaths = 0;
        for step in some_of(steps, 10) {
            let disk = Disk::holding(&fixture.path());
            deaths += u64::from(dies_at(&disk, step).await);
            // Again, at another step of what the next start has to do.
            deaths += u64::from(dies_at(&disk, step / 2).await);
            super::assert_as_told(&fixture, disk.path()).await;
        }
        assert!(deaths > steps.min(10), "{name}: {deaths}");
        println!("{name}: {steps} steps of a first start, {deaths} deaths");
    }
}

/// A database with an environment that is to go and one that is to stay.
struct Pair {
    directory: TempDir,
    /// The uid of the one that is to go.
    doomed: String,
    /// How far the producers of the other are.
    acknowledged: Vec<u64>,
}

impl Pair {
    async fn new() -> Self {
        let directory = TempDir::new().expect("a temporary directory");
        let mut server = Server::start(directory.path(), "127.0.0.1:0");
        make_lane(server.address).await;
        let load = Load::start(server.address, Shape::SMALL, &[Voice::Stream, Voice::Rest]);
        load.progress(40).await;
        let acknowledged = load.finish().await;
        let doomed = wide::make(server.address).await;
        wide::fill(server.address).await;
        server.ask_to_stop();
        assert!(
            server
                .ended_within(Duration::from_secs(10))
                .await
                .is_some_and(|status| status.success())
        );
        let database = directory.path().join("nudge.db");
        compact_all(&database, Options::default()).await;
        Self {
            directory,
            doomed,
            acknowledged,
        }
    }

    fn path(&self) -> PathBuf {
        self.directory.path().join("nudge.db")
    }
}

/// Returns what is left of environments that are gone: the rows of counts refer to nothing that would
/// keep them from being forgotten.
async fn left(directory: &Path) -> i64 {
    let left = "select (select count(*) from environments where name is null) + (
        select count(*) from packed where id >> 44 not in (
            select block from environments where block is not null))";
    number(&directory.join("nudge.db"), left).await
}

/// Asks for the deletion; returns whether it was said to be done.
async fn delete(address: SocketAddr) -> bool {
    let sent = reqwest::Client::new()
        .delete(format!("http://{address}/v1/environments/wide"))
        .send()
        .await;
    sent.is_ok_and(|response| response.status().is_success())
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deletion_that_is_killed_at_any_step_is_done_or_not_begun() {
    let pair = Pair::new().await;
    let whole = Disk::holding(&pair.path());
    let server = settled(whole.under(&mut Server::command(whole.path(), "127.0.0.1:0")))
        .await
        .expect("it starts");
    whole.count(CHANGES);
    assert!(delete(server.address).await);
    eventually("its rows go", async || left(whole.path()).await == 0).await;
    let steps = whole.seen();
    assert!(steps > 50, "{steps}");
    server.kill();

    let mut whole_again = 0;
    for step in some_of(steps, 12) {
        let disk = Disk::holding(&pair.path());
        let mut command = Server::command(disk.path(), "127.0.0.1:0");
        let mut server = settled(disk.under(&mut command)).await.expect("it starts");
        disk.fail(CHANGES, step, FOR_EVER, DEATH);
        let said = delete(server.address).await;
        // Behind the answer the rows go, and with them the process; unless it had fewer steps this
        // time.
        eventually("it dies or is done", async || {
            server.ended_within(Duration::ZERO).await.is_some()
                || said && left(disk.path()).await == 0
        })
        .await;
        drop(server);
        disk.mend();
        whole_again += u64::from(!is_gone_for_good(&pair, disk.path(), said).await);
        assert_exactly_once(disk.path(), Shape::SMALL, &pair.acknowledged).await;
    }
    println!("{steps} steps of a deletion; {whole_again} times it had not begun");
}

/// Starts the service again. What was not deleted must be whole, and what was must go and stay
/// away, whatever it is called later.
async fn is_gone_for_good(pair: &Pair, directory: &Path, said: bool) -> bool {
    let server = settled(&mut Server::command(directory, "127.0.0.1:0"))
        .await
        .expect("it starts");
    let (status, summary) = asked(server.address, "/v1/environments/wide/summary").await;
    if status == 200 {
        assert!(!said, "it was said to be deleted");
        assert_eq!(
            (&summary["transitions"], &summary["states"]),
            (&json!(STATES), &json!(STATES))
        );
        return false;
    }
    assert_eq!(status, 404, "{summary}");
    eventually("its rows go", async || left(directory).await == 0).await;
    assert_ne!(
        wide::make(server.address).await,
        pair.doomed,
        "a uid is never used again"
    );
    let (_, summary) = asked(server.address, "/v1/environments/wide/summary").await;
    assert_eq!(summary["transitions"], json!(0), "{summary}");
    server.kill();
    true
}
