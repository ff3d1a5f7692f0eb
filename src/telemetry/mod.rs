//! Logs and metrics: what operators see of the service.
//!
//! | room | for |
//! |---|---|
//! | `list` | every metric, with its labels and what it says |
//! | `metric` | counters, gauges and histograms, and how Prometheus reads them |
//! | `process` | what the process takes of its machine |
//! | `log` | lines for people or as JSON |
//!
//! Labels are bounded: never a state, an agent or a producer, nor anything that a caller invents.

use std::time::{Duration, SystemTime};

mod list;
mod log;
mod metric;
mod process;

pub use list::ALL;
pub use log::{LogFormat, Seldom, log};
pub use metric::{Kind, Metric, Page};

use list::{
    ACCEPTED, BUILD, CACHE, CELLS, CERTIFICATE_EXPIRES, CERTIFICATE_RELOADS, COMMIT_SECONDS,
    COMMIT_TRANSITIONS, COMMITS, CONNECTIONS, CONNECTIONS_ENDED, DATABASE, DENIED, DISK, DISK_FREE,
    DUPLICATES, ENVIRONMENTS, FIT_AGE, FIT_BEHIND, HANDSHAKES_FAILED, INFERENCE_SECONDS,
    INFERENCES, INFERRED_STATES, JOBS, KEPT, LAST_BATCH, MODELS, MODELS_ACTIVE, QUERY_SECONDS,
    QUEUED, QUOTA, READ_ONLY, READY, REFUSED, REJECTED, REQUEST_SECONDS, REQUESTS, SHED, STATES,
    STREAMS, TRAINING_SECONDS, TRAININGS, UNVERIFIED, VERDICTS, WAITING, WORKING,
};

/// The parts of a record that may be at fault, as labels.
pub const PARTS: [&str; 6] = ["state", "actions", "entry", "count", "other", "untold"];

/// Begins to measure: from now on the process has an age, and what is counted is told from 0.
pub fn begin() {
    process::begin();
    BUILD.set(&[env!("CARGO_PKG_VERSION"), env!("NUDGE_REVISION")], 1.0);
    [
        &CONNECTIONS,
        &STREAMS,
        &INFERRED_STATES,
        &COMMIT_SECONDS,
        &COMMIT_TRANSITIONS,
        &QUERY_SECONDS,
        &INFERENCE_SECONDS,
    ]
    .into_iter()
    .for_each(|metric| metric.begin(&[]));
    let words: [(&Metric, &[&str]); 9] = [
        (
            &DENIED,
            &[
                "unauthenticated",
                "scope",
                "environment",
                "producer",
                "host",
                "origin",
                "media",
                "rate",
            ],
        ),
        (
            &SHED,
            &["TOO_MANY_CONNECTIONS", "TOO_MANY_UNFINISHED_BYTES"],
        ),
        (
            &CONNECTIONS_ENDED,
            &[
                "head",
                "idle",
                "unread",
                "age",
                "grace",
                "evicted",
                "refused",
                "malformed",
                "head_too_large",
                "http2",
                "silent",
            ],
        ),
        (
            &REFUSED,
            &[
                "OVERLOADED",
                "QUOTA_EXCEEDED",
                "OUT_OF_ORDER",
                "STORE_UNAVAILABLE",
                "OUTCOME_UNKNOWN",
            ],
        ),
        (&COMMITS, &["committed", "failed"]),
        (&CACHE, &["hit", "miss"]),
        (&TRAININGS, &["done", "failed", "cancelled"]),
        (&TRAINING_SECONDS, &["done", "failed", "cancelled"]),
        (&INFERENCES, &["OK"]),
    ];

    for (metric, words) in words {
        words.iter().for_each(|word| metric.begin(&[word]));
    }

    for verdict in ["influences", "no_influence", "undecided"] {
        ["counts", "model", "prior"]
            .iter()
            .for_each(|basis| VERDICTS.begin(&[verdict, basis]));
    }
}

/// Records a commit of so many transitions, whether it reached the disk or not.
pub fn committed(took: Duration, transitions: usize, is_committed: bool) {
    COMMITS.add(&[if is_committed { "committed" } else { "failed" }], 1.0);
    COMMIT_SECONDS.observe(&[], took.as_secs_f64());
    COMMIT_TRANSITIONS.observe(&[], transitions as f64);
}

/// Records a batch that was refused as a whole.
pub fn refused(reason: &'static str) {
    REFUSED.add(&[reason], 1.0);
}

/// Records a request that was refused for want of connections or of memory.
pub fn shed(reason: &'static str) {
    SHED.add(&[reason], 1.0);
}

/// Records a request that was refused because of who asks.
pub fn denied(reason: &'static str) {
    DENIED.add(&[reason], 1.0);
}

/// Records how many connections are open.
pub fn connections(open: usize) {
    CONNECTIONS.set(&[], open as f64);
}

/// Records that the service ended a connection, or did not let it in, by reason.
pub fn connection_ended(reason: &'static str) {
    CONNECTIONS_ENDED.add(&[reason], 1.0);
}

/// Begins to measure TLS: what is counted is told from 0.
pub fn begin_tls() {
    let reasons = [
        "plain_text",
        "timeout",
        "closed",
        "no_client_certificate",
        "bad_client_certificate",
        "refused_by_client",
        "protocol",
    ];
    reasons
        .iter()
        .for_each(|reason| HANDSHAKES_FAILED.begin(&[reason]));
    ["done", "failed"]
        .iter()
        .for_each(|outcome| CERTIFICATE_RELOADS.begin(&[outcome]));
}

/// Records that a client and the service did not agree on TLS, by reason.
pub fn handshake_failed(reason: &'static str) {
    HANDSHAKES_FAILED.add(&[reason], 1.0);
}

/// Records until when the certificate is valid, in seconds since 1970.
pub fn certificate_expires(at: i64) {
    CERTIFICATE_EXPIRES.set(&[], at as f64);
}

/// Records that the files of TLS were read again, and whether they are used.
pub fn certificate_reloaded(is_used: bool) {
    CERTIFICATE_RELOADS.add(&[if is_used { "done" } else { "failed" }], 1.0);
}

/// Records that a stream opened; the guard records that it ended.
pub fn stream_opened() -> impl Drop {
    struct Open;
    impl Drop for Open {
        fn drop(&mut self) {
            STREAMS.add(&[], -1.0);
        }
    }
    STREAMS.add(&[], 1.0);
    Open
}

/// Records of how many states the counts were in memory, and of how many they were not.
pub fn cached(hits: usize, misses: usize) {
    CACHE.add(&["hit"], hits as f64);
    CACHE.add(&["miss"], misses as f64);
}

/// Records a question that was answered.
pub fn answered(took: Duration) {
    QUERY_SECONDS.observe(&[], took.as_secs_f64());
}

/// Records verdicts and what they rest on.
pub fn decided(verdict: &'static str, basis: &'static str, verdicts: u64) {
    VERDICTS.add(&[verdict, basis], verdicts as f64);
}

/// Records a training that is over, by its outcome.
pub fn trained(outcome: &'static str, took: Duration) {
    TRAININGS.add(&[outcome], 1.0);
    TRAINING_SECONDS.observe(&[outcome], took.as_secs_f64());
}

/// Records a request for predictions: `OK` or why it was refused, one of few words, and for how
/// many states.
pub fn inferred(took: Duration, code: &'static str, states: u64) {
    INFERENCE_SECONDS.observe(&[], took.as_secs_f64());
    INFERENCES.add(&[code], 1.0);
    INFERRED_STATES.add(&[], states as f64);
}

/// Lets a route be told before anybody asks for it, with the codes that alerts look at.
pub fn expect_requests(face: &'static str, route: &str, codes: &[&str]) {
    codes
        .iter()
        .for_each(|code| REQUESTS.begin(&[face, route, code]));
}

/// Records a request with the code that its caller saw; without a time where it took as long as its
/// caller liked.
pub fn request(face: &'static str, route: &str, code: &str, took: Option<Duration>) {
    REQUESTS.add(&[face, route, code], 1.0);
    if let Some(took) = took {
        REQUEST_SECONDS.observe(&[face, route], took.as_secs_f64());
    }
}

/// Gauges of the service at the time of a scrape.
#[derive(Debug, Default)]
pub struct Standing {
    /// Each check of readiness, and its outcome.
    pub checks: Vec<(&'static str, bool)>,
    /// Transitions that wait for their commit.
    pub queued: usize,
    /// Each lane: how many turns are taken or waited for, and how many wait.
    pub lanes: Vec<(&'static str, usize, usize)>,
    /// Trainings by state.
    pub jobs: Vec<(&'static str, usize)>,
    /// Environments that are damaged.
    pub read_only: usize,
    /// The bytes of the database.
    pub database: Option<u64>,
    /// The free bytes of its disk, and all.
    pub disk: Option<[u64; 2]>,
    /// The most environments.
    pub most_environments: u64,
    /// What there is of each environment.
    pub environments: Vec<OfEnvironment>,
}

/// Gauges of an environment at the time of a scrape.
#[derive(Debug, Default)]
pub struct OfEnvironment {
    /// Its name.
    pub name: String,
    /// Records counted.
    pub accepted: u64,
    /// Records rejected, by each of [`PARTS`].
    pub rejected: [u64; PARTS.len()],
    /// Batches that had been counted before.
    pub duplicates: u64,
    /// Batches of which nobody can tell.
    pub unverified: u64,
    /// When a batch was last acknowledged.
    pub last_batch: Option<SystemTime>,
    /// Transitions that are kept.
    pub transitions: u64,
    /// States.
    pub states: u64,
    /// Cells.
    pub cells: u64,
    /// Each quota: what is used, and the most.
    pub quotas: Vec<(&'static str, u64, u64)>,
    /// Transitions since the oldest fit that is asked for.
    pub fit_behind: Option<u64>,
    /// The time since it was made.
    pub fit_age: Option<Duration>,
    /// Versions of networks.
    pub models: u64,
    /// Pairs with an active one.
    pub active: u64,
}

/// Returns every metric in Prometheus' text format.
pub fn render(standing: &Standing) -> String {
    let mut page = Page::default();
    process::tell(&mut page);
    tell(&mut page, standing);
    standing
        .environments
        .iter()
        .for_each(|environment| tell_environment(&mut page, environment));
    page.render(ALL)
}

fn tell(page: &mut Page, standing: &Standing) {
    for (check, is_ready) in &standing.checks {
        page.tell(&READY, &[check], f64::from(u8::from(*is_ready)));
    }

    for (lane, turns, waiting) in &standing.lanes {
        page.tell(&WORKING, &[lane], *turns as f64);
        page.tell(&WAITING, &[lane], *waiting as f64);
    }

    for (state, jobs) in &standing.jobs {
        page.tell(&JOBS, &[state], *jobs as f64);
    }

    page.tell(&QUEUED, &[], standing.queued as f64);
    page.tell(&READ_ONLY, &[], standing.read_only as f64);
    page.tell(&ENVIRONMENTS, &[], standing.environments.len() as f64);
    page.tell(
        &QUOTA,
        &["", "environments"],
        share(
            standing.environments.len() as u64,
            standing.most_environments,
        ),
    );
    if let Some(bytes) = standing.database {
        page.tell(&DATABASE, &[], bytes as f64);
    }

    if let Some([free, all]) = standing.disk {
        page.tell(&DISK_FREE, &[], free as f64);
        page.tell(&DISK, &[], all as f64);
    }
}

fn tell_environment(page: &mut Page, told: &OfEnvironment) {
    let name = told.name.as_str();
    let numbers = [
        (&ACCEPTED, told.accepted),
        (&DUPLICATES, told.duplicates),
        (&UNVERIFIED, told.unverified),
        (&KEPT, told.transitions),
        (&STATES, told.states),
        (&CELLS, told.cells),
        (&MODELS, told.models),
        (&MODELS_ACTIVE, told.active),
    ];

    numbers
        .into_iter()
        .for_each(|(metric, number)| page.tell(metric, &[name], number as f64));

    for (part, rejected) in PARTS.iter().zip(told.rejected) {
        page.tell(&REJECTED, &[name, part], rejected as f64);
    }

    for (quota, used, most) in &told.quotas {
        page.tell(&QUOTA, &[name, quota], share(*used, *most));
    }

    let known = [
        (&LAST_BATCH, told.last_batch.map(process::seconds)),
        (&FIT_BEHIND, told.fit_behind.map(|behind| behind as f64)),
        (&FIT_AGE, told.fit_age.map(|age| age.as_secs_f64())),
    ];

    for (metric, number) in known {
        if let Some(number) = number {
            page.tell(metric, &[name], number);
        }
    }
}

/// What is used of a quota; all of one that allows nothing.
fn share(used: u64, most: u64) -> f64 {
    if most == 0 {
        1.0
    } else {
        used as f64 / most as f64
    }
}
